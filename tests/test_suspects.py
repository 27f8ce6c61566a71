"""Trajectories read the wrong way: refused, with what to change in the manifest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from calibration_support import HEADSET, errors, near, simulated

from factors.rigid import inverse
from gtcal.estimation.observations import synchronise
from gtcal.estimation.solver import DisagreementError
from gtcal.estimation.suspects import likely_mistake
from gtcal.recordings.recording import Recording
from gtcal.recordings.trajectory import poses_from_quaternions, quaternions_from_poses
from gtcal.workflow import calibrate

STANDING = "headset, AprilGrid stands"
FIXED = "pinholes and fisheyes fixed"

Misreading = Callable[[np.ndarray], np.ndarray]


def wxyz_taken_for_xyzw(world_T_body: np.ndarray) -> np.ndarray:
    return poses_from_quaternions(quaternions_from_poses(world_T_body, "wxyz"), "xyzw", world_T_body[:, :3, 3])


def xyzw_taken_for_wxyz(world_T_body: np.ndarray) -> np.ndarray:
    return poses_from_quaternions(quaternions_from_poses(world_T_body, "xyzw"), "wxyz", world_T_body[:, :3, 3])


def millimetres_taken_for_metres(world_T_body: np.ndarray) -> np.ndarray:
    return scaled(world_T_body, 1000.0)


def metres_taken_for_millimetres(world_T_body: np.ndarray) -> np.ndarray:
    return scaled(world_T_body, 0.001)


def scaled(world_T_body: np.ndarray, factor: float) -> np.ndarray:
    poses = world_T_body.copy()
    poses[:, :3, 3] *= factor
    return poses


def misread(recording: Recording, bodies: tuple[str, ...], how: Misreading) -> Recording:
    wrong = {
        body: replace(getattr(recording, body), world_T_body=how(getattr(recording, body).world_T_body))
        for body in bodies
    }
    return replace(recording, **wrong)


BOTH = ("platform", "board_body")


@pytest.mark.parametrize(
    ("kind", "bodies", "how", "fixes"),
    [
        (HEADSET, ("platform",), wxyz_taken_for_xyzw, ["platform.quaternion: wxyz"]),
        (HEADSET, ("board_body",), xyzw_taken_for_wxyz, ["board_body.quaternion: xyzw"]),
        (HEADSET, BOTH, wxyz_taken_for_xyzw, ["platform.quaternion: wxyz", "board_body.quaternion: wxyz"]),
        (STANDING, ("platform",), xyzw_taken_for_wxyz, ["platform.quaternion: xyzw"]),
        (FIXED, ("board_body",), wxyz_taken_for_xyzw, ["board_body.quaternion: wxyz"]),
        (HEADSET, ("board_body",), inverse, ["board_body.pose: body_T_world"]),
        (HEADSET, BOTH, inverse, ["platform.pose: body_T_world", "board_body.pose: body_T_world"]),
        (STANDING, ("platform",), inverse, ["platform.pose: body_T_world"]),
        (FIXED, ("board_body",), inverse, ["board_body.pose: body_T_world"]),
        (HEADSET, BOTH, millimetres_taken_for_metres, ["platform.length_unit: mm", "board_body.length_unit: mm"]),
        (FIXED, ("board_body",), millimetres_taken_for_metres, ["board_body.length_unit: mm"]),
        (STANDING, ("platform",), metres_taken_for_millimetres, ["platform.length_unit: m "]),
    ],
)
def test_a_misread_trajectory_is_refused_with_its_fix(
    kind: str, bodies: tuple[str, ...], how: Misreading, fixes: list[str]
) -> None:
    recording = misread(simulated(kind).recording, bodies, how)
    with pytest.raises(DisagreementError) as caught:
        calibrate(recording)
    message = str(caught.value)
    assert "\n" not in message
    assert message.count("set ") == len(fixes)
    for fix in fixes:
        assert f"set {fix}" in message
    assert caught.value.angle_deg > 3.0


def test_swapped_bodies_are_refused_with_their_fix() -> None:
    recording = simulated(HEADSET).recording
    swapped = replace(
        recording,
        platform=replace(recording.board_body, body="platform"),
        board_body=replace(recording.platform, body="board_body"),
    )
    with pytest.raises(DisagreementError, match="swap the trajectories of platform and board_body"):
        calibrate(swapped)


def test_what_no_reading_explains_gets_no_wrong_hint() -> None:
    """Clocks half a second apart: none of the readings helps, so the possible causes are listed."""
    with pytest.raises(DisagreementError, match="check quaternion order, inverse poses, units"):
        calibrate(simulated(HEADSET, clock_offset_s=0.5).recording)


@pytest.mark.parametrize("kind", [HEADSET, FIXED])
def test_a_right_reading_is_not_suspected(kind: str) -> None:
    assert likely_mistake(synchronise(simulated(kind).recording), seed=0, max_views=100) == ""


def test_the_fix_makes_it_right() -> None:
    """Read as the hint says, the recording calibrates to the truth."""
    simulation = simulated(FIXED)
    wrong = misread(simulation.recording, ("board_body",), wxyz_taken_for_xyzw)
    fixed = misread(wrong, ("board_body",), xyzw_taken_for_wxyz)
    assert near(errors(calibrate(fixed), simulation), mm=1.0, deg=0.1)
