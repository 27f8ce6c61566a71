"""Two calibrations against each other: nothing moved where nothing did, and what moved is named with its size."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from cli_support import run
from PIL import Image

from factors.rigid import adjoint, inverse
from gtcal import Calibration, CalibrationOptions, GtcalError, calibrate, write_calibration
from gtcal.differences.difference import ALL, TO_EACH_OTHER, Difference, DifferenceOptions, Verdict, difference
from gtcal.estimation.earlier import BOARD
from gtcal.recordings.capture import Capture
from gtcal.simulation import MocapNoise
from gtcal.simulation.simulate import simulate_take

NOISY = MocapNoise(translation_mm=0.1, rotation_deg=0.01)
EXACT = CalibrationOptions(intrinsics="refine", effects=False, clock="trust")


@pytest.fixture(scope="module", name="pair")
def _pair() -> tuple[Calibration, Calibration]:
    """Of one rig, from two recordings."""
    first = simulated(HEADSET, seed=5, frames=80, mocap=NOISY)
    again = simulate_take(first.options, seed=5, take=2)
    assert np.allclose(again.truth.body_T_board, first.truth.body_T_board)
    return calibrate(first.recording, EXACT), calibrate(again.recording, EXACT)


def moved(calibration: Calibration, name: str, xi: np.ndarray) -> Calibration:
    """The calibration with a camera elsewhere."""
    camera = calibration.cameras[name]
    pose = replace(camera.camera_T_ref, a_T_b=camera.camera_T_ref.a_T_b @ gtsam.Pose3.Expmap(xi).matrix())
    return replace(calibration, cameras=calibration.cameras | {name: replace(camera, camera_T_ref=pose)})


def moved_names(found: Difference) -> set[str]:
    return {change.what for change in found.changes if change.moved}


def test_nothing_moved_between_two_recordings_of_one_rig(pair: tuple[Calibration, Calibration]) -> None:
    found = difference(*pair)
    assert moved_names(found) == set()
    assert found.verdict is Verdict.SAME
    assert found.statements == ("nothing moved",)
    assert found.aligned is None
    cameras = [change for change in found.changes if change.what in pair[0].cameras]
    assert len(cameras) == 4
    assert all(change.rms_px < 2.0 * change.expected_px for change in cameras)
    per_dof = np.mean([change.distance2 / change.dof for change in found.changes])
    assert 0.4 < per_dof < 2.0


def test_a_bumped_camera_is_named_with_its_size(pair: tuple[Calibration, Calibration]) -> None:
    a, b = pair
    found = difference(a, moved(b, "side_left", np.array([0.0, 0.01, 0.0, 0.002, 0.0, 0.0])))
    assert moved_names(found) == {"side_left", TO_EACH_OTHER}
    (change,) = (change for change in found.changes if change.what == "side_left")
    assert change.turned_deg == pytest.approx(np.rad2deg(0.01), rel=0.05)
    assert change.verdict(found.options) is Verdict.MOVED
    assert found.verdict is Verdict.MOVED
    assert any(statement.startswith("side_left: moved by ") for statement in found.statements)


def in_another_ref(calibration: Calibration, other_T_ref: np.ndarray) -> Calibration:
    """The calibration with another body on the platform."""
    into = adjoint(other_T_ref[None])[0]
    J = np.eye(len(calibration.covariance.matrix))
    for name, camera in calibration.cameras.items():
        pose = replace(camera.camera_T_ref, a_T_b=camera.camera_T_ref.a_T_b @ inverse(other_T_ref))
        calibration = replace(calibration, cameras=calibration.cameras | {name: replace(camera, camera_T_ref=pose)})
        columns = calibration.covariance.columns_of_camera_T_ref(name)
        J[columns, columns] = into
    joint = replace(calibration.covariance, matrix=J @ calibration.covariance.matrix @ J.T)
    return replace(calibration, covariances={calibration.covariance_kind: joint})


def test_a_ref_that_was_defined_anew_is_one_change_and_not_four(pair: tuple[Calibration, Calibration]) -> None:
    a, b = pair
    ref_of_a_in_b = gtsam.Pose3.Expmap(np.array([0.3, -1.2, 0.5, 0.2, -0.1, 0.4])).matrix()
    b = in_another_ref(b, ref_of_a_in_b)
    found = difference(a, b)
    assert moved_names(found) == {ALL}
    assert found.aligned == pytest.approx(ref_of_a_in_b, abs=1e-3)
    assert "ref was defined anew" in found.statements[0]
    cameras = [change for change in found.changes if change.what in a.cameras]
    assert all(change.verdict(found.options) is Verdict.SAME and change.moved_mm < 1.0 for change in cameras)
    bumped = difference(a, moved(b, "front_left", np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])))
    assert moved_names(bumped) == {ALL, "front_left", TO_EACH_OTHER}


def test_a_lens_that_changed_is_named(pair: tuple[Calibration, Calibration]) -> None:
    a, b = pair
    camera = b.cameras["front_right"]
    theta = camera.camera.theta * np.r_[1.01, 1.01, np.ones(10)]
    other = replace(camera, camera=replace(camera.camera, parameters=theta))
    found = difference(a, replace(b, cameras=b.cameras | {"front_right": other}))
    assert moved_names(found) == {"intrinsics of front_right"}
    (change,) = (c for c in found.changes if c.moved)
    assert change.rms_px > 1.0


def test_what_is_too_uncertain_is_not_told_apart(pair: tuple[Calibration, Calibration]) -> None:
    a, b = (
        replace(found, covariances={kind: joint.times(400.0) for kind, joint in found.covariances.items()})
        for found in pair
    )
    found = difference(a, b)
    assert found.verdict is Verdict.UNTOLD
    assert "may differ by more than the tolerance" in found.statements[0]
    assert difference(a, b, DifferenceOptions(max_mm=100.0, max_px=100.0)).verdict is Verdict.SAME


def test_a_small_sure_change_is_within_the_tolerance(pair: tuple[Calibration, Calibration]) -> None:
    a, b = pair
    slightly = moved(b, "side_right", np.array([0.0, 0.0, 0.0, 0.0006, 0.0, 0.0]))
    found = difference(a, slightly, DifferenceOptions(max_mm=3.0, max_px=3.0))
    assert "side_right" in moved_names(found)
    assert found.verdict is Verdict.WITHIN
    assert any("(within the tolerance)" in statement for statement in found.statements)


def test_another_board_or_camera_is_left_out_with_a_note(pair: tuple[Calibration, Calibration]) -> None:
    a, b = pair
    only = {name: camera for name, camera in b.cameras.items() if name != "side_left"}
    found = difference(a, replace(b, cameras=only, board={**b.board, "square_side_m": 0.05}))
    assert {change.what for change in found.changes} & {BOARD, "side_left"} == set()
    assert any("side_left: only in A" in note for note in found.notes)
    assert any("the boards are different ones" in note for note in found.notes)


def test_what_can_not_be_compared_is_refused(pair: tuple[Calibration, Calibration]) -> None:
    a, b = pair
    with pytest.raises(GtcalError, match="the captures differ"):
        difference(a, replace(b, capture=Capture.STANDING_BOARD))
    with pytest.raises(GtcalError, match="no camera in common"):
        difference(a, replace(b, cameras={"other": b.cameras["side_left"]}))
    with pytest.raises(GtcalError, match="has no covariance"):
        difference(a, replace(b, covariances={}))
    with pytest.raises(GtcalError, match=r"max_mm: 0\.0 is not a positive number"):
        DifferenceOptions(max_mm=0.0)


def test_the_command_prints_writes_and_draws_it(pair: tuple[Calibration, Calibration], tmp_path: Path) -> None:
    a, b = pair
    write_calibration(tmp_path / "a.json", a)
    write_calibration(tmp_path / "b.json", moved(b, "side_left", np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])))
    write_calibration(tmp_path / "same.json", b)
    ran = run(
        "diff", tmp_path / "a.json", tmp_path / "b.json", "-o", tmp_path / "d.json", "--figure", tmp_path / "d.png"
    )
    assert (ran.code, ran.err) == (3, "")
    assert "side_left: moved by" in ran.out
    document = json.loads((tmp_path / "d.json").read_text())
    assert document["verdict"] == "moved"
    assert {change["what"] for change in document["changes"]} >= set(a.cameras) | {BOARD, TO_EACH_OTHER}
    assert document["provenance"]["inputs"][0]["path"].endswith("a.json")
    assert Image.open(tmp_path / "d.png").size[0] > 1000
    ran = run("diff", tmp_path / "a.json", tmp_path / "same.json", "-q")
    assert (ran.code, ran.out, ran.err) == (0, "", "")
    ran = run(
        "diff", tmp_path / "a.json", tmp_path / "b.json", "-o", tmp_path / "e.json", "--figure", tmp_path / "e.gif"
    )
    assert ran.code == 1
    assert "a figure is .svg or .png" in ran.err
    assert not (tmp_path / "e.json").exists()
    ran = run("diff", tmp_path / "a.json", tmp_path / "a.json")
    assert ran.code == 1
    assert "are the same calibration" in ran.err
