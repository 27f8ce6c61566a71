"""Going on from an earlier calibration: surer where nothing moved, found anew where something did."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from cli_support import run
from factors_support import derivative_to

from factors import JointPriorFactor
from factors.rigid import inverse
from gtcal import (
    Calibration,
    CalibrationOptions,
    GtcalError,
    calibrate,
    calibrate_jointly,
    read_calibration,
    write_calibration,
)
from gtcal.differences.carried_over import EarlierCalibration
from gtcal.estimation.earlier import SHAPE, Earlier, Growth, grown, intrinsics_of
from gtcal.recordings.capture import Capture
from gtcal.simulation import MocapNoise, Simulation, write_simulation
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.simulate import simulate_take

OPTIONS = CalibrationOptions(effects=False, clock="trust")
STEADY = Growth(mm=0.02, deg=0.002, lens=0.02)
BUMP = RigFault(cameras={"side_left": small_motion((1.0, 0.5, 0.0), (0.0, 0.4, 0.0))})


@pytest.fixture(scope="module", name="first")
def _first() -> Simulation:
    return simulated(HEADSET, seed=5, frames=80, mocap=MocapNoise(translation_mm=0.1, rotation_deg=0.01))


@pytest.fixture(scope="module", name="earlier")
def _earlier(first: Simulation) -> EarlierCalibration:
    return EarlierCalibration(calibrate(first.recording, OPTIONS), STEADY)


def take(first: Simulation, number: int, frames: int, fault: RigFault | None = None) -> Simulation:
    return simulate_take(replace(first.options, n_frames=frames), seed=5, take=number, fault=fault)


def errors(found: Calibration, simulation: Simulation) -> tuple[float, float]:
    """Mean over the cameras: of the position's error in mm, and of the NEES per degree of freedom."""
    mm, nees = [], []
    for name, camera in found.cameras.items():
        true_pose, pose = simulation.truth.camera_T_ref[name], camera.camera_T_ref
        mm.append(1e3 * np.linalg.norm(inverse(pose.a_T_b)[:3, 3] - inverse(true_pose)[:3, 3]))
        xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(pose.a_T_b) @ true_pose))
        nees.append(xi @ np.linalg.solve(pose.covariance, xi) / 6)
    return float(np.mean(mm)), float(np.mean(nees))


def test_the_joint_prior_is_its_covariance_and_its_jacobian_numeric() -> None:
    random = np.random.default_rng(0)
    root = random.normal(size=(14, 14)) * np.r_[[1e-3] * 6, [1e-2] * 6, [1.0] * 2][:, None]
    pose = gtsam.Pose3.Expmap(random.normal(size=6))
    other = gtsam.Pose3.Expmap(random.normal(size=6))
    keys = [1, 2, 3]
    factor = JointPriorFactor(keys, [pose.matrix(), other.matrix(), np.array([3.0, 4.0])], root @ root.T)
    values = gtsam.Values()
    xi = random.normal(size=14) * np.r_[[0.1] * 12, [1.0] * 2]
    values.insert(1, pose.retract(xi[:6]))
    values.insert(2, other.retract(xi[6:12]))
    values.insert(3, np.array([3.0, 4.0]) + xi[12:])
    assert factor.error(values) == pytest.approx(0.5 * xi @ np.linalg.solve(root @ root.T, xi), rel=1e-9)
    jacobian, _ = factor.linearize(values).jacobian()
    numeric = np.hstack([derivative_to(factor.unwhitenedError, values, key) for key in keys])
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-5, atol=1e-3)
    with pytest.raises(ValueError, match="expected"):
        JointPriorFactor([1], [pose.matrix()], np.eye(5))


@pytest.mark.long
@pytest.mark.parametrize(("frames", "gain"), [(8, 0.6), (40, 0.9)])
def test_a_recording_of_a_rig_that_did_not_move_is_surer_and_true(
    first: Simulation, earlier: EarlierCalibration, frames: int, gain: float
) -> None:
    takes = [take(first, number, frames) for number in (2, 3, 4)]
    alone = np.array([errors(calibrate(one.recording, OPTIONS), one) for one in takes])
    carried = [calibrate(one.recording, OPTIONS, earlier=earlier) for one in takes]
    found = np.array([errors(one, truth) for one, truth in zip(carried, takes, strict=True)])
    assert found[:, 0].mean() < gain * alone[:, 0].mean()
    assert found[:, 1].mean() < 1.5
    for one in carried:
        assert one.carried_over.moved == ()
        assert one.carried_over.alone
        assert set(one.carried_over.kept) == {
            "board",
            SHAPE,
            *one.cameras,
            *(intrinsics_of(name) for name in one.cameras),
        }
        assert not any("contradict" in warning for warning in one.warnings)


@pytest.mark.long
def test_a_camera_that_was_bumped_is_named_and_found_anew(first: Simulation, earlier: EarlierCalibration) -> None:
    bumped = take(first, 2, 40, BUMP)
    found = calibrate(bumped.recording, OPTIONS, earlier=earlier)
    assert any(line.startswith("side_left: moved by ") for line in found.carried_over.moved)
    assert "side_left" not in found.carried_over.kept
    assert {"front_left", "front_right", "side_right"} < set(found.carried_over.kept)
    mm, nees = errors(found, bumped)
    assert mm < 0.15
    assert nees < 2.0


@pytest.mark.long
def test_markers_that_were_set_anew_leave_the_rig_known(first: Simulation, earlier: EarlierCalibration) -> None:
    anew = RigFault(markers=small_motion((20.0, -10.0, 5.0), (3.0, 10.0, -4.0)))
    takes = [take(first, number, 8, anew) for number in (2, 3, 4)]
    found = [calibrate(one.recording, OPTIONS, earlier=earlier) for one in takes]
    for one in found:
        assert any("all cameras together: moved by" in line for line in one.carried_over.moved)
        assert set(one.cameras) < set(one.carried_over.kept)
    alone = np.array([errors(calibrate(one.recording, OPTIONS), one) for one in takes])
    carried = np.array([errors(one, truth) for one, truth in zip(found, takes, strict=True)])
    assert carried[:, 0].mean() < alone[:, 0].mean()
    assert carried[:, 1].mean() < 2.0


def test_a_recording_that_tells_nothing_by_itself_rests_on_the_earlier_one(
    first: Simulation, earlier: EarlierCalibration
) -> None:
    options = replace(first.options, n_frames=20, motion="single_axis")
    poor = simulate_take(options, seed=5, take=2)
    with pytest.raises(GtcalError, match=r"axis|determine"):
        calibrate(poor.recording, OPTIONS)
    found = calibrate(poor.recording, OPTIONS, earlier=earlier)
    assert not found.carried_over.alone
    assert "without it, the recording determines no calibration" in found.carried_over.statement
    mm, nees = errors(found, poor)
    assert mm < 0.3
    assert nees < 2.0


def test_what_is_known_fades_by_the_day(earlier: EarlierCalibration) -> None:
    now, later = (grown(earlier.calibration, replace(STEADY, days=days)).covariance.matrix for days in (1.0, 100.0))
    before = earlier.calibration.covariance.matrix
    assert np.diag(later - before) == pytest.approx(100.0 * np.diag(now - before), rel=1e-6)
    same_day = grown(earlier.calibration, replace(STEADY, days=0.0)).covariance.matrix
    assert np.allclose(same_day, now)
    with pytest.raises(GtcalError, match="growth: mm is -1"):
        Growth(mm=-1.0)


def test_what_is_kept_is_a_marginal_of_what_was_known(earlier: EarlierCalibration) -> None:
    known = Earlier.of(earlier.calibration)
    joint = earlier.calibration.covariance
    only = known.only(lambda what: what == "side_left")
    assert only.kept == ("side_left",)
    assert only.covariance == pytest.approx(joint.camera_T_ref("side_left"))
    assert known.theta_sigmas("side_left") == pytest.approx(np.sqrt(np.diag(joint.theta("side_left"))))
    assert known.only(lambda what: False).factor({"side_left": 0}) is None


def test_what_makes_no_sense_is_refused(first: Simulation, earlier: EarlierCalibration) -> None:
    with pytest.raises(GtcalError, match="intrinsics are 'exact' here: use 'auto'"):
        calibrate(first.recording, replace(OPTIONS, intrinsics="exact"), earlier=earlier)
    other = replace(earlier, calibration=replace(earlier.calibration, capture=Capture.STANDING_BOARD))
    with pytest.raises(GtcalError, match="the earlier calibration's capture is standing_board"):
        calibrate(first.recording, OPTIONS, earlier=other)
    bare = replace(earlier, calibration=replace(earlier.calibration, covariances={}))
    with pytest.raises(GtcalError, match="no covariance"):
        calibrate(first.recording, OPTIONS, earlier=bare)
    with pytest.raises(GtcalError, match="'poses' is none of lenses, board, rig"):
        EarlierCalibration(earlier.calibration, parts=("poses",))


@pytest.mark.long
def test_recordings_of_one_rig_together_are_surer_than_each(first: Simulation) -> None:
    takes = [take(first, number, 12) for number in (2, 3, 4)]
    together = calibrate_jointly([one.recording for one in takes], OPTIONS)
    alone = [calibrate(one.recording, OPTIONS) for one in takes]
    mm, nees = errors(together, takes[-1])
    assert mm < 0.8 * np.mean([errors(one, simulation)[0] for one, simulation in zip(alone, takes, strict=True)])
    assert nees < 2.0
    name = "front_left"
    sigma, of_each = (one.cameras[name].camera_T_ref.position_of_a_in_b_sigma_mm.max() for one in (together, alone[0]))
    assert sigma < 0.8 * of_each
    assert together.carried_over.source == "the 2 recordings before it"
    assert together.carried_over.moved == ()
    assert len(together.provenance.inputs) == sum(len(one.recording.inputs) for one in takes)


@pytest.mark.long
def test_what_moves_between_recordings_is_named_and_not_shared(first: Simulation) -> None:
    takes = [take(first, 2, 30), take(first, 3, 30, BUMP)]
    together = calibrate_jointly([one.recording for one in takes], OPTIONS)
    assert any(line.startswith("side_left: moved by") for line in together.carried_over.moved)
    assert errors(together, takes[-1])[1] < 2.0
    assert not any(warning.startswith("recording 1 of 2") for warning in together.warnings)
    poor = simulate_take(replace(first.options, n_frames=30, swap_share=0.4), seed=5, take=2)
    warned = calibrate_jointly([poor.recording, takes[0].recording], OPTIONS).warnings
    assert any(warning.startswith("recording 1 of 2: ") for warning in warned)
    with pytest.raises(GtcalError, match="segments are of one recording"):
        calibrate_jointly([one.recording for one in takes], CalibrationOptions(segments="auto"))


@pytest.mark.long
def test_the_command_goes_on_from_a_file(first: Simulation, earlier: EarlierCalibration, tmp_path: Path) -> None:
    write_calibration(tmp_path / "first.json", earlier.calibration)
    write_simulation(take(first, 2, 20, BUMP), tmp_path / "r", images=False)
    write_simulation(take(first, 3, 20, BUMP), tmp_path / "r2", images=False)
    ran = run(
        "calibrate", tmp_path / "r", "-o", tmp_path / "c.json", "--from", tmp_path / "first.json", "--from-days", 3,
        "--from-parts", "lenses", "rig",
    )  # fmt: skip
    assert (ran.code, ran.err) == (0, "")
    assert "known from the earlier calibration (3 days ago): front_left" in ran.out
    assert "since then: side_left: moved by" in ran.out
    found = read_calibration(tmp_path / "c.json")
    assert "board" not in found.carried_over.kept
    assert found.carried_over.days == 3.0
    ran = run("calibrate", tmp_path / "r", tmp_path / "r2", "-o", tmp_path / "both.json", "--no-effects")
    assert (ran.code, ran.err) == (0, "")
    assert "known from the recording before it: board, front_left" in ran.out
    assert any(entry.path.name == "first.json" for entry in found.provenance.inputs)
    document = json.loads((tmp_path / "c.json").read_text())
    assert document["provenance"]["options"]["priors"]["earlier"] == list(found.carried_over.kept)
    ran = run("calibrate", tmp_path / "r", "-o", tmp_path / "first.json", "--from", tmp_path / "first.json")
    assert ran.code == 1
    document["provenance"]["created_utc"] = "yesterday"
    (tmp_path / "undated.json").write_text(json.dumps(document))
    ran = run("calibrate", tmp_path / "r2", "-o", tmp_path / "x.json", "--from", tmp_path / "undated.json")
    assert (ran.code, ran.err.count("\n")) == (1, 1)
    assert "undated.json: provenance.created_utc: 'yesterday' is no time" in ran.err
    document["covariances"] = {}
    (tmp_path / "bare.json").write_text(json.dumps(document))
    for command in (["calibrate", tmp_path / "r2", "--from"], ["diff", tmp_path / "c.json"]):
        ran = run(*command, tmp_path / "bare.json", "-o", tmp_path / "x.json")
        assert (ran.code, ran.err.count("\n")) == (1, 1)
        assert "bare.json: has no covariance" in ran.err
    assert not (tmp_path / "x.json").exists()
    for twice in (["--from", tmp_path / "c.json"], [tmp_path / "r"]):
        ran = run("calibrate", tmp_path / "r", *twice, "-o", tmp_path / "again.json")
        assert ran.code == 1
        assert "the earlier calibration rests on it already" in ran.err
