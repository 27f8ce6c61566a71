"""What the recorded motion can and can't determine, and what is said about it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from calibration_support import KINDS, errors, simulated
from scipy.spatial.transform import Rotation

from gtcal.errors import GtcalError
from gtcal.estimation.motion import Turning, check_turning, turning
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.simulation.transforms import transform

FAR_M = np.array([3.0, -2.0, 1.0])


def turned_about(axis: np.ndarray, rms_deg: float, seed: int = 0, n: int = 400) -> np.ndarray:
    """(N, 4, 4) poses turned about one axis of the body, in front of an attitude that means nothing."""
    rng = np.random.default_rng(seed)
    home = Rotation.from_rotvec([0.4, -1.0, 2.0])
    turns = Rotation.from_rotvec(np.deg2rad(rms_deg) * rng.standard_normal((n, 1)) * np.asarray(axis))
    return transform(home * turns, rng.normal(FAR_M, 0.3, (n, 3)))


def turned_freely(sigmas_deg: tuple[float, float, float], n: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(1)
    turns = Rotation.from_rotvec(np.deg2rad(sigmas_deg) * rng.standard_normal((n, 3)))
    return transform(Rotation.from_rotvec([1.0, 0.2, 0.3]) * turns, np.zeros((n, 3)))


def axis_in(message: str) -> np.ndarray:
    numbers = re.search(r"\((-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\) of the body frame", message)
    assert numbers, message
    return np.array([float(number) for number in numbers.groups()])


@pytest.mark.parametrize("seed", range(3))
def test_turns_are_measured_about_the_axes_of_the_body(seed: int) -> None:
    axis = np.random.default_rng(seed).standard_normal(3)
    axis /= np.linalg.norm(axis)
    found = turning([turned_about(axis, 10.0, seed)])
    assert abs(found.axes_in_body[0] @ axis) == pytest.approx(1.0, abs=1e-9)
    assert np.rad2deg(found.rms_rad[0]) == pytest.approx(10.0, rel=0.1)
    np.testing.assert_allclose(found.rms_rad[1:], 0.0, atol=1e-7)


def test_turns_about_several_axes_are_told_apart() -> None:
    found = turning([turned_freely((5.0, 20.0, 10.0))])
    np.testing.assert_allclose(np.rad2deg(found.rms_rad), [20.0, 10.0, 5.0], rtol=0.1)
    np.testing.assert_allclose(np.abs(found.axes_in_body), np.eye(3)[[1, 2, 0]], atol=0.05)


def test_different_attitudes_of_cameras_are_no_turns() -> None:
    """Each camera saw another attitude of the board, but none saw it turn: that says nothing about X."""
    still = [transform(Rotation.from_rotvec([0.0, angle, 0.0]), np.zeros((1, 3)))[[0] * 20] for angle in (0.0, 1.0)]
    assert turning(still).rms_rad.max() < 1e-9


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, -0.6, 0.8]])
def test_a_single_axis_is_refused_and_named(axis: list[float]) -> None:
    with pytest.raises(GtcalError, match="single axis") as caught:
        check_turning(turning([turned_about(np.array(axis), 30.0)]))
    assert abs(axis_in(str(caught.value)) @ axis) == pytest.approx(1.0, abs=0.01)
    assert "translation of the board along that axis" in str(caught.value)
    assert "second axis" in str(caught.value)


def test_a_pure_translation_is_refused_and_named() -> None:
    with pytest.raises(GtcalError, match="pure translation") as caught:
        check_turning(turning([turned_about(np.array([1.0, 0.0, 0.0]), 0.2)]))
    assert "position of the board in its body" in str(caught.value)


def test_a_weak_second_axis_is_warned_of() -> None:
    warning = check_turning(turning([turned_freely((30.0, 4.0, 1.0))]))
    assert warning is not None
    assert "weakly determined" in warning
    assert axis_in(warning) == pytest.approx([1.0, 0.0, 0.0], abs=0.02)


@pytest.mark.parametrize("sigmas_deg", [(30.0, 20.0, 10.0), (40.0, 12.0, 0.0)])
def test_two_good_axes_are_enough(sigmas_deg: tuple[float, float, float]) -> None:
    assert check_turning(turning([turned_freely(sigmas_deg)])) is None


def test_the_axis_is_worded_with_its_largest_component_positive() -> None:
    tilted = Turning(np.array([[0.1, -0.9, 0.3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.5, 0.05, 0.0]))
    warning = check_turning(tilted)
    assert warning is not None
    assert axis_in(warning).tolist() == [-0.1, 0.9, -0.3]


# Recordings

FULLY_TRACKED = ["headset, board tracked", "headset, AprilGrid stands", "pinholes and fisheyes fixed"]


@pytest.mark.parametrize("kind", FULLY_TRACKED)
def test_a_recording_of_rich_motion_passes_without_a_warning(kind: str) -> None:
    views = synchronise(simulated(kind).recording).views
    assert check_turning(turning(v.ref_T_body for v in views.values())) is None


@pytest.mark.long
@pytest.mark.parametrize("kind", FULLY_TRACKED)
@pytest.mark.parametrize(("motion", "named"), [("single_axis", "single axis"), ("translation", "pure translation")])
def test_a_degenerate_recording_is_refused_and_solved_only_if_asked_to(kind: str, motion: str, named: str) -> None:
    simulation = simulated(kind, motion=motion)
    observations = synchronise(simulation.recording)
    with pytest.raises(GtcalError, match=named):
        calibrate_observations(observations)
    calibration = calibrate_observations(observations, CalibrationOptions(allow_degenerate=True))
    assert any(named in warning for warning in calibration.warnings)
    # what such a motion does determine is found all the same
    assert max(deg for _, deg in errors(calibration, simulation).values()) < 0.1
    assert calibration.rmse_px < 0.4


def test_gross_views_do_not_hide_a_degenerate_motion() -> None:
    """Swaps turn the body about every axis; without them the motion is still about one."""
    simulation = simulated("headset, board tracked", motion="single_axis", swap_share=0.15)
    observations = synchronise(simulation.recording)
    assert turning(v.ref_T_body for v in observations.views.values()).rms_rad[1] > np.deg2rad(10.0)
    with pytest.raises(GtcalError, match="single axis"):
        calibrate_observations(observations)


def test_the_kinds_cover_every_capture() -> None:
    assert len({kind["capture"] for kind in KINDS.values()}) == 3
