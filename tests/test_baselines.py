"""Other people's methods against the truth, and against ours."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, NO_MOCAP_NOISE, errors_of, simulated, with_exact_mocap, worst
from cli_support import run

from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError
from gtcal.baselines.compare import (
    CLOSED_FORMS,
    JOINT,
    MARKERS,
    PAPER,
    STURM,
    _estimated,
    _farthest,
    _jackknifed,
    _without_a_block_each,
    compare,
)
from gtcal.baselines.marker_file import read_marker_sightings
from gtcal.baselines.markers import MarkerSightings, calibrate_on_markers
from gtcal.baselines.pose_pairs import PosePairs, pose_pairs, relative_motions
from gtcal.baselines.sturm import sturm
from gtcal.estimation.observations import synchronise
from gtcal.simulation import CornerNoise, MocapNoise, Simulation, write_simulation
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation

EXACT = {"corners": CornerNoise(pixel_px=0.0), "mocap": NO_MOCAP_NOISE}


def true_pairs(simulation: Simulation) -> dict[str, PosePairs]:
    """Poses without any error."""
    truth = simulation.truth
    return {
        name: PosePairs(camera.ref_T_body, truth.camera_T_ref[name] @ camera.ref_T_body @ truth.body_T_board)
        for name, camera in truth.cameras.items()
    }


@pytest.mark.parametrize("method", CLOSED_FORMS)
def test_without_noise_the_poses_give_the_truth(method: str) -> None:
    simulation = simulated(HEADSET, frames=20)
    X, cameras = CLOSED_FORMS[method](true_pairs(simulation))
    mm, deg = worst(errors_of(cameras, X, simulation).values())
    assert (mm < 1e-3, deg < 1e-4) == (True, True)


@pytest.mark.parametrize("method", CLOSED_FORMS)
def test_with_noise_they_come_near(method: str) -> None:
    simulation = simulated(HEADSET, frames=60, mocap=MocapNoise(0.1, 0.01))
    X, cameras = CLOSED_FORMS[method](pose_pairs(synchronise(simulation.recording).views))
    mm, deg = worst(errors_of(cameras, X, simulation).values())
    assert (0.01 < mm < 20.0, deg < 1.0) == (True, True)


def test_relative_motions_satisfy_the_hand_eye_equation() -> None:
    simulation = simulated(HEADSET, frames=20)
    A, B = relative_motions(true_pairs(simulation), np.random.default_rng(0))
    X = simulation.truth.body_T_board
    np.testing.assert_allclose(A @ X, X @ B, atol=1e-9)
    still = {
        name: PosePairs(pair.ref_T_body[[0, 0, 0]], pair.camera_T_board[[0, 0, 0]])
        for name, pair in true_pairs(simulation).items()
    }
    with pytest.raises(GtcalError, match="no two views differ by a turn"):
        relative_motions(still, np.random.default_rng(0))


def test_sturm_with_the_true_board_finds_the_cameras_and_holds_it() -> None:
    simulation = simulated(HEADSET, **EXACT)
    views = with_exact_mocap(simulation).views
    X = simulation.truth.body_T_board
    for huber in (False, True):
        found = sturm(views, pose_pairs(views), X, huber=huber)
        np.testing.assert_array_equal(found.body_T_board, X)
        assert worst(errors_of(found.camera_T_ref, X, simulation).values())[0] < 1e-2


def test_an_error_of_the_measured_board_goes_into_the_cameras() -> None:
    simulation = simulated(HEADSET)
    X = simulation.truth.body_T_board @ gtsam.Pose3.Expmap([0, 0, 0, 0.003, 0, 0]).matrix()
    views = synchronise(simulation.recording).views
    found = sturm(views, pose_pairs(views), X, huber=True)
    assert worst(errors_of(found.camera_T_ref, X, simulation).values())[0] > 1.0


# Markers


def sightings(simulation: Simulation, name: str, *, wrong: float, seed: int = 0) -> MarkerSightings:
    """Markers all over a camera's field, 0.3 px off; a share with the position of another one."""
    camera, truth = simulation.truth.cameras[name].camera, simulation.truth.camera_T_ref[name]
    random = np.random.default_rng(seed)
    pixels = random.uniform([100, 100], [camera.image_width_px - 100, camera.image_height_px - 100], (120, 2))
    rays, valid = camera.unproject(pixels)
    in_camera = rays[valid] * random.uniform(0.5, 3.0, (valid.sum(), 1))
    ref_T_camera = inverse(truth)
    in_ref = in_camera @ ref_T_camera[:3, :3].T + ref_T_camera[:3, 3]
    swapped = random.random(len(in_ref)) < wrong
    in_ref[swapped] = np.roll(in_ref[swapped], 1, axis=0)
    return MarkerSightings(camera, in_ref, pixels[valid] + random.normal(0.0, 0.3, (valid.sum(), 2)))


@pytest.mark.parametrize("wrong", [0.0, 0.4])
def test_markers_give_the_camera_swapped_labels_or_not(wrong: float) -> None:
    simulation = simulated(HEADSET)
    seen = sightings(simulation, "side_left", wrong=wrong)
    found = calibrate_on_markers(seen)
    truth = simulation.truth.camera_T_ref["side_left"]
    moved = inverse(found.camera_T_ref) @ truth
    assert np.linalg.norm(moved[:3, 3]) < 1e-3
    assert found.inlier.mean() > 0.95 - wrong
    assert 0.2 < found.rmse_px < 0.6


def test_markers_without_a_pose_are_told() -> None:
    seen = sightings(simulated(HEADSET), "side_left", wrong=0.0)
    anywhere = np.random.default_rng(0).permutation(seen.position_in_ref_m)[:40]
    with pytest.raises(GtcalError, match="support one pose; are labels, units and clocks"):
        calibrate_on_markers(replace(seen, position_in_ref_m=anywhere, centre_px=seen.centre_px[:40]))
    with pytest.raises(GtcalError, match="3 usable sightings of markers"):
        calibrate_on_markers(replace(seen, position_in_ref_m=anywhere[:3], centre_px=seen.centre_px[:3]))


# All of them


@pytest.fixture(scope="module", name="lollypop")
def _lollypop():
    simulation = simulated(HEADSET, mocap=MocapNoise(0.1, 0.01))
    options = LollypopOptions(calibrated_in=simulation.scene, duration_s=10.0)
    return simulate_lollypop(options, seed=1)


@pytest.mark.long
def test_the_joint_solution_is_the_best_by_the_lollypop(lollypop) -> None:
    simulation = simulated(HEADSET, mocap=MocapNoise(0.1, 0.01))
    X = simulation.truth.body_T_board @ gtsam.Pose3.Expmap([0.01, 0, 0, 0.003, 0, 0.002]).matrix()
    found = compare(simulation.recording, lollypop.recording, measured_body_T_board=X, truth=simulation.truth)
    by_method = {row.method: row for row in found}
    assert list(by_method) == [JOINT, PAPER, *CLOSED_FORMS, *STURM]
    assert not any(row.failure for row in found)
    rmse_px = {method: row.lollypop_rmse_px for method, row in by_method.items()}
    assert rmse_px[JOINT] <= 1.02 * min(rmse_px.values())
    assert rmse_px["Sturm, Huber"] > 1.3 * rmse_px[JOINT]
    assert by_method[JOINT].difference_mm == 0.0
    for row in found:
        if row.method not in (PAPER, *STURM):  # those see no mocap noise, or no error of X
            assert 0.1 < row.truth_mm / row.sigma_mm < 6
            assert 0.1 < row.truth_deg / row.sigma_deg < 6
    assert by_method[PAPER].sigma_mm < by_method["Tsai-Lenz (AX = XB)"].sigma_mm
    assert by_method[JOINT].truth_mm == min(row.truth_mm for row in found)
    assert by_method[JOINT].sigma_mm == max(
        camera.camera_T_ref.position_of_a_in_b_sigma_mm.max()
        for camera in by_method[JOINT].calibration.cameras.values()
    )
    assert by_method["Tsai-Lenz (AX = XB)"].calibration.warnings == (
        "by a baseline, for comparison: Tsai-Lenz (AX = XB)",
    )


def marker_file(simulation: Simulation, path: Path) -> Path:
    """Markers seen at one moment by every camera, in the mocap's world."""
    platform = simulation.recording.platform
    stamp_ns = int(platform.stamps_ns[100])
    lines = ["camera,stamp_ns,x_px,y_px,x_m,y_m,z_m"]
    for name in simulation.recording.cameras:
        seen = sightings(simulation, name, wrong=0.1)
        world_T_ref = platform.world_T_body[100]
        in_world = seen.position_in_ref_m @ world_T_ref[:3, :3].T + world_T_ref[:3, 3]
        for (x, y), p in zip(seen.centre_px, in_world, strict=True):
            lines.append(f"{name},{stamp_ns},{x:.3f},{y:.3f},{p[0]:.6f},{p[1]:.6f},{p[2]:.6f}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.long
def test_the_command_prints_and_writes_them(tmp_path: Path, lollypop) -> None:
    simulation = simulated(HEADSET, mocap=MocapNoise(0.1, 0.01))
    write_simulation(simulation, tmp_path / "recording", images=False)
    write_lollypop_simulation(lollypop, tmp_path / "lollypop", images=False)
    X = simulation.truth.body_T_board
    rotvec = cv2.Rodrigues(X[:3, :3])[0].ravel() * 180 / np.pi
    (tmp_path / "x.yaml").write_text(
        f"{{gtcal_priors: 1, body_T_board: {{position_mm: {(1e3 * X[:3, 3]).tolist()}, "
        f"rotvec_deg: {rotvec.tolist()}, sigma_mm: 2}}}}"
    )
    markers = marker_file(simulation, tmp_path / "markers.csv")
    arguments = ["--lollypop", tmp_path / "lollypop", "--measured-x", tmp_path / "x.yaml", "--markers", markers]
    ran = run("compare", tmp_path / "recording", *arguments, "-o", tmp_path / "c.json")
    assert (ran.code, ran.err) == (0, "")
    rows = json.loads((tmp_path / "c.json").read_text())["methods"]
    assert [row["method"] for row in rows] == [JOINT, PAPER, *CLOSED_FORMS, *STURM, MARKERS]
    assert all(row["lollypop_rmse_px"] > 0 for row in rows)
    assert all(row["method"][:12] in ran.out for row in rows)
    assert rows[-1]["difference_mm"] < 2.0
    assert all(row["truth_mm"] > 0 for row in rows)
    assert [row["method"] for row in rows if row["sigma_mm"] is None] == [MARKERS]
    assert "from truth, mm" in ran.out


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("camera,stamp,x", ":1: expected the columns camera, stamp_ns"),
        ("front_left,1,2,3,4,5", ":2: 6 cells; expected"),
        ("front_left,1.5,2,3,4,5,6", ":2: invalid literal"),
        ("front_left,1,nan,3,4,5,6", ":2: a number that is not finite"),
        ("left,1,2,3,4,5,6", ":2: camera 'left' is not in the recording"),
        ("front_left,1,2,3,4,5,6", ":2: the platform is not tracked at this time"),
    ],
)
def test_a_wrong_marker_file_is_told(tmp_path: Path, line: str, message: str) -> None:
    header = "" if line.startswith("camera") else "camera,stamp_ns,x_px,y_px,x_m,y_m,z_m\n"
    (tmp_path / "m.csv").write_text(header + line + "\n")
    with pytest.raises(GtcalError) as caught:
        read_marker_sightings(tmp_path / "m.csv", simulated(HEADSET).recording)
    assert message in str(caught.value)


@pytest.mark.long
def test_scatter_with_frames_left_out_is_that_of_recordings_with_other_noise() -> None:
    """One method, many recordings: what the jackknife of one says of its error, all of them show."""
    method, stated, found = "Shah (AX = ZB)", [], []
    for seed in range(6):
        simulation = simulated(HEADSET, seed=seed, frames=24, mocap=MocapNoise(0.3, 0.03))
        views = synchronise(simulation.recording).views
        pairs = pose_pairs(views)
        stated.append(_jackknifed(method, _without_a_block_each(views), None))
        found.append(_farthest(_estimated(method, views, pairs, None).camera_T_ref, simulation.truth.camera_T_ref))
    # the largest distance of four cameras beside the largest sigma of one axis of one
    assert np.median(found, axis=0) / np.median(stated, axis=0) == pytest.approx(1.5, rel=0.6)


def test_sturms_method_needs_a_measured_board(tmp_path: Path) -> None:
    write_simulation(simulated(HEADSET), tmp_path / "recording", images=False)
    (tmp_path / "x.yaml").write_text("gtcal_priors: 1")
    ran = run("compare", tmp_path / "recording", "--measured-x", tmp_path / "x.yaml")
    assert ran.code == 1
    assert "states no body_T_board" in ran.err
    assert CalibrationOptions().priors.body_T_board is None
