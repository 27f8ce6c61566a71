"""Simulated recordings: their geometry is the truth's, their noise is what was asked for, and a seed repeats them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from factors import CAMERA_MODELS
from factors.rigid import inverse
from gtcal.board import PAPER_A2, AprilGrid, CharucoBoard
from gtcal.cli.simulate import simulate as simulate_command
from gtcal.errors import GtcalError
from gtcal.estimation.observations import synchronise
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import load_recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation import (
    CornerNoise,
    IntrinsicsError,
    MocapNoise,
    Simulation,
    SimulationOptions,
    fixed_cameras_rig,
    quest3_like_rig,
    read_ground_truth,
    simulate,
    write_simulation,
)
from gtcal.simulation.quest3 import FRONT_LEFT, FRONT_RIGHT
from gtcal.simulation.scene import BOARD_SPEED_M_S, BOARD_TURN_RATE_RAD_S, RIG_SPEED_M_S, RIG_TURN_RATE_RAD_S
from gtcal.simulation.simulate import START_NS

NO_MOCAP_NOISE = MocapNoise(translation_mm=0.0, rotation_deg=0.0)
CHARUCO = CharucoBoard("DICT_5X5_100", 8, 6, 0.06, 0.045)
ALL_MODELS = tuple(CAMERA_MODELS)


def options(**changes: object) -> SimulationOptions:
    return SimulationOptions(**{"duration_s": 20.0, "n_frames": 40, **changes})


def reprojection_errors_px(simulation: Simulation, name: str) -> np.ndarray:
    """(N, 2) detected corner less camera_T_ref * ref_T_body * body_T_board * corner, all of the truth."""
    truth, detections = simulation.truth.cameras[name], simulation.recording.detections[name]
    frames = truth.frames_of(detections.stamps_ns)
    camera_T_board = truth.camera_T_ref @ truth.ref_T_body[frames] @ simulation.truth.body_T_board
    poses = camera_T_board[detections.view_of_corner]
    corners_m = simulation.recording.board.corners_m[detections.corner_ids]
    in_camera = np.einsum("nij,nj->ni", poses[:, :3, :3], corners_m) + poses[:, :3, 3]
    pixels, valid = truth.camera.project(in_camera)
    assert valid.all()
    return detections.corners_px - pixels


def pose_errors(true_T: np.ndarray, measured_T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vectors in deg and translations in mm (N, 3) of true_T^-1 * measured_T."""
    difference = inverse(true_T) @ measured_T
    return Rotation.from_matrix(difference[:, :3, :3]).as_rotvec(degrees=True), 1e3 * difference[:, :3, 3]


def seconds(trajectory: Trajectory) -> np.ndarray:
    return (trajectory.stamps_ns - START_NS) * 1e-9


# Geometry


@pytest.mark.parametrize("capture", list(Capture))
@pytest.mark.parametrize("board", [PAPER_A2, CHARUCO, AprilGrid(6, 6, 0.06, 0.3)], ids=lambda b: type(b).__name__)
def test_without_pixel_noise_the_truth_reprojects_exactly(capture: Capture, board: object) -> None:
    simulation = simulate(options(capture=capture, board=board, corners=CornerNoise(pixel_px=0.0)), seed=3)
    for name in simulation.recording.cameras:
        assert len(reprojection_errors_px(simulation, name)) > 200
        np.testing.assert_allclose(reprojection_errors_px(simulation, name), 0.0, atol=1e-7)


def test_every_camera_model_reprojects_exactly() -> None:
    rig = fixed_cameras_rig(len(ALL_MODELS), models=ALL_MODELS)
    simulation = simulate(options(rig=rig, capture=Capture.FIXED_CAMERAS, corners=CornerNoise(pixel_px=0.0)), seed=0)
    assert [camera.model.name for camera in simulation.recording.cameras.values()] == list(ALL_MODELS)
    for name in simulation.recording.cameras:
        np.testing.assert_allclose(reprojection_errors_px(simulation, name), 0.0, atol=1e-7)


@pytest.mark.parametrize("capture", list(Capture))
def test_the_recorded_trajectories_carry_the_truth(capture: Capture) -> None:
    """With a faultless mocap, what the product interpolates at a view is the true ref_T_body, but for the bend of
    the path between two samples (1/8 of the acceleration times the interval squared, some micrometres)."""
    simulation = simulate(options(capture=capture, mocap=NO_MOCAP_NOISE, mocap_rate_hz=480.0), seed=1)
    observations = synchronise(simulation.recording)
    assert observations.dropped == ()
    for name, views in observations.views.items():
        truth = simulation.truth.cameras[name]
        turned_deg, moved_mm = pose_errors(truth.ref_T_body[truth.frames_of(views.stamps_ns)], views.ref_T_body)
        assert np.abs(moved_mm).max() < 0.01
        assert np.abs(turned_deg).max() < 0.001


def test_a_standing_board_stands_and_fixed_cameras_stay() -> None:
    times_s = np.linspace(0, 20, 9)
    standing = simulate(options(capture=Capture.STANDING_BOARD), seed=0)
    assert standing.recording.board_body is None
    np.testing.assert_array_equal(np.ptp(standing.scene.world_T_board(times_s), axis=0), 0.0)
    assert np.ptp(standing.scene.world_T_platform(times_s)[:, :3, 3], axis=0).min() > 0.1
    fixed = simulate(options(capture=Capture.FIXED_CAMERAS), seed=0)
    assert fixed.recording.platform is None
    np.testing.assert_array_equal(np.ptp(fixed.scene.world_T_camera(0, times_s), axis=0), 0.0)


def test_body_frames_are_nowhere_near_the_board_or_the_device() -> None:
    turns_deg = []
    for seed in range(8):
        scene = simulate(options(n_frames=1), seed=seed).scene
        for transform in (scene.boardbody_T_board, scene.rig_T_platform):
            assert np.linalg.norm(transform[:3, 3]) > 0.1
            turns_deg.append(np.degrees(Rotation.from_matrix(transform[:3, :3]).magnitude()))
    assert np.median(turns_deg) > 90.0  # uniform over the rotations: 126 deg in the median


# Motion


def test_people_move_no_faster_than_they_can() -> None:
    scene = simulate(options(duration_s=60.0), seed=5).scene
    interval_s = 0.002
    times_s = np.arange(-0.9, 60.9, interval_s)
    for motion, speed_m_s, turn_rate_rad_s in (
        (scene.rig_T_board, BOARD_SPEED_M_S, BOARD_TURN_RATE_RAD_S),
        (scene.world_T_anchor, RIG_SPEED_M_S, RIG_TURN_RATE_RAD_S),
    ):
        poses = motion.at(times_s)
        steps = inverse(poses[:-1]) @ poses[1:]
        speeds = np.linalg.norm(steps[:, :3, 3], axis=1) / interval_s
        rates = Rotation.from_matrix(steps[:, :3, :3]).magnitude() / interval_s
        assert 0.5 * speed_m_s < speeds.max() < 1.01 * speed_m_s
        assert 0.7 * turn_rate_rad_s < rates.max() < 1.01 * turn_rate_rad_s
        assert np.abs(np.diff(speeds)).max() / interval_s < 10.0  # m/s^2: no jerks


def test_the_headset_shows_the_board_to_every_camera_at_all_angles_and_distances() -> None:
    simulation = simulate(SimulationOptions(), seed=0)
    for name, detections in simulation.recording.detections.items():
        assert detections.n_views >= 0.4 * 80
        assert detections.n_corners >= 40 * detections.n_views
        camera = simulation.truth.cameras[name].camera
        bearings, _ = camera.unproject(detections.corners_px)
        angles_deg = np.degrees(np.arccos(bearings[:, 2]))  # NaN where noise left the lens's field
        assert np.nanpercentile(angles_deg, 5) < 25
        assert np.nanpercentile(angles_deg, 97) > 65
        size_px = np.array([camera.image_width_px, camera.image_height_px])
        cells = np.floor(detections.corners_px / size_px * 6).astype(int)
        assert len(np.unique(cells, axis=0)) >= 28  # of 36; the lens leaves the four corners of the image dark


def test_fixed_cameras_all_get_views() -> None:
    simulation = simulate(SimulationOptions(rig=fixed_cameras_rig(), capture=Capture.FIXED_CAMERAS), seed=0)
    assert min(detections.n_views for detections in simulation.recording.detections.values()) >= 12


@pytest.mark.parametrize(("motion", "rank"), [("free", 3), ("single_axis", 1), ("translation", 0)])
@pytest.mark.parametrize("capture", list(Capture))
def test_the_rank_of_the_rotations_is_that_of_the_motion(capture: Capture, motion: str, rank: int) -> None:
    simulation = simulate(options(duration_s=60.0, capture=capture, motion=motion), seed=2)
    for detections in simulation.recording.detections.values():
        assert detections.n_views >= 8
    ref_R_body = simulation.truth.cameras["front_left"].ref_T_body[:, :3, :3]
    turns_rad = Rotation.from_matrix(np.swapaxes(ref_R_body[:1], 1, 2) @ ref_R_body).as_rotvec()
    spread_rad = np.linalg.svd(turns_rad, compute_uv=False) / np.sqrt(len(turns_rad))
    assert (spread_rad > 0.3).sum() == rank
    np.testing.assert_allclose(spread_rad[rank:], 0.0, atol=1e-9)


# Visibility


def test_corners_are_inside_the_image_on_the_printed_side_and_large_enough() -> None:
    simulation = simulate(options(corners=CornerNoise(pixel_px=0.0)), seed=4)
    limits, board = simulation.options.limits, simulation.recording.board
    for name, detections in simulation.recording.detections.items():
        truth = simulation.truth.cameras[name]
        low = limits.border_px - 0.5
        assert (detections.corners_px >= low - 1e-9).all()
        high = np.array([truth.camera.image_width_px, truth.camera.image_height_px]) - 0.5 - limits.border_px
        assert (detections.corners_px <= high + 1e-9).all()
        assert (np.diff(detections.view_start) >= 4).all()
        assert (detections.corner_ids.reshape(-1, 4) // 4 == detections.corner_ids[::4, None] // 4).all()  # whole tags
        tags_px = detections.corners_px.reshape(-1, 4, 2)
        sides_px = np.linalg.norm(tags_px - np.roll(tags_px, 1, axis=1), axis=2)
        assert sides_px.min() >= limits.min_feature_px
        frames = truth.frames_of(detections.stamps_ns)[detections.view_of_corner]
        body_T_camera = inverse(truth.camera_T_ref @ truth.ref_T_body[frames] @ simulation.truth.body_T_board)
        sight_m = body_T_camera[:, :3, 3] - board.corners_m[detections.corner_ids]
        incidence_deg = np.degrees(np.arccos(sight_m[:, 2] / np.linalg.norm(sight_m, axis=1)))
        assert 60.0 < incidence_deg.max() <= limits.max_incidence_deg


# Noise


def test_pixel_noise_is_white_with_the_sigma_asked_for() -> None:
    simulation = simulate(options(n_frames=300, corners=CornerNoise(pixel_px=0.25)), seed=0)
    errors_px = np.concatenate([reprojection_errors_px(simulation, name) for name in simulation.recording.cameras])
    assert len(errors_px) > 40_000
    np.testing.assert_allclose(errors_px.std(axis=0), 0.25, rtol=0.015)
    np.testing.assert_allclose(errors_px.mean(axis=0), 0.0, atol=0.006)
    assert abs(np.corrcoef(errors_px.T)[0, 1]) < 0.02
    assert abs(np.corrcoef(errors_px[:-1, 0], errors_px[1:, 0])[0, 1]) < 0.02


def mocap_errors(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Rotation in deg and translation in mm (M, 3) by which the recorded platform is wrong, in the body frame."""
    trajectory = simulation.recording.platform
    assert trajectory is not None
    return pose_errors(simulation.scene.world_T_platform(seconds(trajectory)), trajectory.world_T_body)


def test_white_mocap_noise_has_the_sigmas_asked_for() -> None:
    noise = MocapNoise(translation_mm=0.3, rotation_deg=0.05)
    turned_deg, moved_mm = mocap_errors(simulate(options(duration_s=60.0, mocap=noise), seed=0))
    np.testing.assert_allclose(turned_deg.std(axis=0), 0.05, rtol=0.03)
    np.testing.assert_allclose(moved_mm.std(axis=0), 0.3, rtol=0.03)
    np.testing.assert_allclose(moved_mm.mean(axis=0), 0.0, atol=0.015)
    assert abs(np.corrcoef(moved_mm[:-1, 0], moved_mm[1:, 0])[0, 1]) < 0.04


def test_correlated_mocap_noise_keeps_its_sigma_and_its_time() -> None:
    noise = MocapNoise(translation_mm=0.3, rotation_deg=0.05, correlation_s=0.1)
    turned_deg, moved_mm = mocap_errors(simulate(options(duration_s=300.0, mocap=noise), seed=1))
    np.testing.assert_allclose(moved_mm.std(), 0.3, rtol=0.05)
    np.testing.assert_allclose(turned_deg.std(), 0.05, rtol=0.05)
    for lag in (1, 6, 12):  # samples of 1/120 s
        correlation = np.mean(moved_mm[:-lag] * moved_mm[lag:]) / moved_mm.var()
        assert correlation == pytest.approx(np.exp(-lag / 12.0), abs=0.05)


def test_both_bodies_have_noise_of_their_own() -> None:
    simulation = simulate(options(duration_s=60.0), seed=0)
    body = simulation.recording.board_body
    assert body is not None
    truth = simulation.scene.world_T_boardbody(seconds(body))
    _, board_mm = pose_errors(truth, body.world_T_body)
    _, platform_mm = mocap_errors(simulation)
    assert board_mm.std() == pytest.approx(0.1, rel=0.03)
    assert abs(np.corrcoef(board_mm[:, 0], platform_mm[:, 0])[0, 1]) < 0.04


def test_jitter_shifts_samples_in_time() -> None:
    """The recorded pose is that of another moment: the error along the velocity, over the speed, is the jitter."""
    still = simulate(options(duration_s=60.0, mocap=NO_MOCAP_NOISE), seed=0)
    jittered = simulate(options(duration_s=60.0, mocap=replace(NO_MOCAP_NOISE, jitter_s=0.001)), seed=0)
    assert still.recording.board_body is not None
    assert jittered.recording.board_body is not None
    times_s = seconds(still.recording.board_body)
    velocity_m_s = np.gradient(still.recording.board_body.world_T_body[:, :3, 3], times_s, axis=0)
    difference_m = (jittered.recording.board_body.world_T_body - still.recording.board_body.world_T_body)[:, :3, 3]
    speed2 = (velocity_m_s**2).sum(axis=1)
    fast = speed2 > 0.1**2
    shift_s = (difference_m * velocity_m_s).sum(axis=1)[fast] / speed2[fast]
    assert shift_s.std() == pytest.approx(0.001, rel=0.05)
    np.testing.assert_array_equal(jittered.recording.board_body.stamps_ns, still.recording.board_body.stamps_ns)


def test_gaps_lose_their_share_of_the_samples_in_stretches() -> None:
    full = simulate(options(duration_s=60.0), seed=0).recording.platform
    gappy_recording = simulate(options(duration_s=60.0, mocap=MocapNoise(gap_share=0.2)), seed=0).recording
    gappy = gappy_recording.platform
    assert full is not None
    assert gappy is not None
    assert 1 - gappy.n_samples / full.n_samples == pytest.approx(0.2, abs=0.006)
    gaps_s = np.diff(gappy.stamps_ns) * 1e-9
    assert gaps_s[gaps_s > 0.02].min() >= 0.25 - 1e-9
    reasons = {drop.reason for drop in synchronise(gappy_recording).dropped}
    assert any("gap" in reason and "platform" in reason for reason in reasons)
    assert any("gap" in reason and "board_body" in reason for reason in reasons)


@pytest.mark.parametrize("capture", list(Capture))
def test_swaps_spoil_their_share_of_the_frames_and_are_owned_up_to(capture: Capture) -> None:
    simulation = simulate(options(capture=capture, n_frames=None, mocap=NO_MOCAP_NOISE, swap_share=0.2), seed=0)
    for name, views in synchronise(simulation.recording).views.items():
        truth = simulation.truth.cameras[name]
        assert truth.swapped.mean() == pytest.approx(0.2, abs=0.02)
        frames = truth.frames_of(views.stamps_ns)
        turned_deg, moved_mm = pose_errors(truth.ref_T_body[frames], views.ref_T_body)
        swapped = truth.swapped[frames]
        assert swapped.any()
        assert np.abs(moved_mm[~swapped]).max() < 0.5
        assert np.median(np.linalg.norm(turned_deg[swapped], axis=1)) > 30.0
        assert np.linalg.norm(moved_mm[swapped], axis=1).min() > 0.5


def test_wrong_corners_have_their_share_and_are_owned_up_to() -> None:
    noise = CornerNoise(pixel_px=0.1, wrong_corner_share=0.05)
    simulation = simulate(options(n_frames=200, corners=noise), seed=0)
    for name, truth in simulation.truth.cameras.items():
        wrong = truth.wrong_corners
        assert wrong.mean() == pytest.approx(0.05, abs=0.01)
        distances_px = np.linalg.norm(reprojection_errors_px(simulation, name), axis=1)
        assert distances_px[~wrong].max() < 0.7
        assert distances_px[wrong].min() > 3.0
        camera = truth.camera
        assert camera.in_image(simulation.recording.detections[name].corners_px).all()


def test_wrong_tags_lie_where_another_tag_of_the_view_is() -> None:
    noise = CornerNoise(pixel_px=0.0, wrong_tag_share=0.1)
    simulation = simulate(options(n_frames=200, corners=noise), seed=0)
    clean = simulate(options(n_frames=200, corners=CornerNoise(pixel_px=0.0)), seed=0)
    for name, truth in simulation.truth.cameras.items():
        detections = simulation.recording.detections[name]
        wrong = truth.wrong_corners.reshape(-1, 4)
        np.testing.assert_array_equal(wrong, np.broadcast_to(wrong[:, :1], wrong.shape))
        assert wrong.mean() == pytest.approx(0.1, abs=0.02)
        views = detections.view_of_corner[truth.wrong_corners]
        for view, corner_px in zip(views[:40], detections.corners_px[truth.wrong_corners][:40], strict=True):
            rows = slice(*clean.recording.detections[name].view_start[view : view + 2])
            apart_px = np.linalg.norm(clean.recording.detections[name].corners_px[rows] - corner_px, axis=1)
            assert apart_px.min() < 1e-9


def test_missed_tags_have_their_share() -> None:
    clean = simulate(options(n_frames=200), seed=0)
    missing = simulate(options(n_frames=200, corners=CornerNoise(missed_share=0.3)), seed=0)
    kept = sum(d.n_corners for d in missing.recording.detections.values())
    assert kept / sum(d.n_corners for d in clean.recording.detections.values()) == pytest.approx(0.7, abs=0.02)


def test_a_clock_offset_puts_the_cameras_stamps_ahead() -> None:
    offsets_s = (0.05, 0.0, -0.03, 0.01)
    simulation = simulate(options(mocap=NO_MOCAP_NOISE, clock_offset_s=offsets_s), seed=0)
    for (name, truth), offset_s in zip(simulation.truth.cameras.items(), offsets_s, strict=True):
        stamps_ns = simulation.recording.detections[name].stamps_ns
        expected = truth.ref_T_body[truth.frames_of(stamps_ns)]
        at = simulation.recording.motion.at(stamps_ns - round(1e9 * offset_s))
        _, moved_mm = pose_errors(expected[at.ok], at.ref_T_body[at.ok])
        assert np.abs(moved_mm).max() < 0.3
        at = simulation.recording.motion.at(stamps_ns)
        _, moved_mm = pose_errors(expected[at.ok], at.ref_T_body[at.ok])
        assert offset_s == 0.0 or np.abs(moved_mm).max() > 2.0


def test_stated_intrinsics_can_be_wrong_or_missing() -> None:
    error = IntrinsicsError(focal_share=0.01, centre_px=4.0, distortion_share=0.1)
    wrong = simulate(options(intrinsics="perturbed", intrinsics_error=error), seed=0)
    ratios = []
    for name, camera in wrong.recording.cameras.items():
        true_theta = wrong.truth.intrinsics[name]
        assert camera.theta[0] / true_theta[0] == pytest.approx(camera.theta[1] / true_theta[1])
        assert 0.01 < np.abs(camera.theta[2:4] - true_theta[2:4]).max() < 20.0
        ratios.append(camera.theta[0] / true_theta[0] - 1)
    assert 0.001 < np.std(ratios) < 0.03
    none = simulate(options(intrinsics="none"), seed=0)
    assert all(camera.parameters is None for camera in none.recording.cameras.values())


# Reproducibility


def test_a_seed_repeats_everything_and_another_one_nothing() -> None:
    first, again, other = (simulate(options(), seed=seed) for seed in (7, 7, 8))
    for name in first.recording.cameras:
        np.testing.assert_array_equal(
            first.recording.detections[name].corners_px, again.recording.detections[name].corners_px
        )
        assert np.abs(first.truth.camera_T_ref[name] - other.truth.camera_T_ref[name]).max() > 0.01
    assert first.recording.platform is not None
    assert again.recording.platform is not None
    np.testing.assert_array_equal(first.recording.platform.world_T_body, again.recording.platform.world_T_body)


def test_noise_leaves_the_true_world_as_it_is() -> None:
    noisy = options(
        mocap=MocapNoise(1.0, 0.1, correlation_s=0.1, jitter_s=0.001, gap_share=0.1),
        corners=CornerNoise(0.5, 0.1, 0.1, 0.1),
        swap_share=0.1,
    )
    clean, noised = simulate(options(), seed=0), simulate(noisy, seed=0)
    for name, truth in clean.truth.cameras.items():
        np.testing.assert_array_equal(truth.ref_T_body, noised.truth.cameras[name].ref_T_body)
        np.testing.assert_array_equal(truth.camera_T_ref, noised.truth.cameras[name].camera_T_ref)


def folder_bytes(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_seed_writes_the_same_files_byte_for_byte(tmp_path: Path) -> None:
    for name in ("first", "again"):
        write_simulation(simulate(options(), seed=1), tmp_path / name, images=False)
    first = folder_bytes(tmp_path / "first")
    assert first == folder_bytes(tmp_path / "again")
    assert {"recording.yaml", "ground_truth.json", "platform.csv", "board_body.csv"} <= set(first)


# On disk


@pytest.mark.parametrize("capture", list(Capture))
def test_a_written_simulation_reads_back(capture: Capture, tmp_path: Path) -> None:
    noise = CornerNoise(wrong_corner_share=0.02)
    simulation = simulate(options(capture=capture, swap_share=0.1, corners=noise), seed=2)
    manifest = write_simulation(simulation, tmp_path / "recording", images=False)
    recording, truth = load_recording(manifest), read_ground_truth(tmp_path / "recording")
    np.testing.assert_array_equal(truth.body_T_board, simulation.truth.body_T_board)
    for name, expected in simulation.truth.cameras.items():
        read = truth.cameras[name]
        np.testing.assert_array_equal(
            recording.detections[name].corners_px, simulation.recording.detections[name].corners_px
        )
        for field in ("camera_T_ref", "stamps_ns", "ref_T_body", "swapped", "wrong_corners"):
            np.testing.assert_array_equal(getattr(read, field), getattr(expected, field))
        np.testing.assert_array_equal(read.camera.theta, expected.camera.theta)
        assert read.camera.image_width_px == expected.camera.image_width_px


def test_nothing_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(GtcalError, match="holds something already"):
        write_simulation(simulate(options(n_frames=2), seed=0), tmp_path, images=False)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ('{"gtcal_ground_truth": 99}', "version 1"),
        ('{"gtcal_ground_truth": 1, "ref_T_body": [], "cameras": {}}', "damaged .*body_T_board"),
    ],
)
def test_a_damaged_ground_truth_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "ground_truth.json").write_text(text)
    with pytest.raises(GtcalError, match=message):
        read_ground_truth(tmp_path)


def test_a_recording_without_ground_truth_says_so(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match="only simulated recordings have one"):
        read_ground_truth(tmp_path)


# Rigs and options


def test_the_front_cameras_are_the_real_ones(shared: Callable[[str], Path]) -> None:
    oracle = json.loads(shared("oracles/fisheye62_quest3.json").read_text())
    for camera, real in zip((FRONT_LEFT, FRONT_RIGHT), oracle["cameras"], strict=True):
        assert list(camera.theta) == list(real["params"].values())
        assert list(camera.device_q_camera_wxyz) == real["device_T_camera"]["quat_wxyz"]
        assert list(camera.device_t_camera_m) == real["device_T_camera"]["t_m"]
    assert (oracle["cameras"][0]["width_px"], oracle["cameras"][0]["height_px"]) == (1280, 1024)


def test_a_scaled_rig_sees_the_same_directions() -> None:
    rig = quest3_like_rig()
    for camera, small in zip(rig.cameras, rig.scaled(0.5).cameras, strict=True):
        assert (small.image_width_px, small.image_height_px) == (640, 512)
        # The corners of the image stay where they were: at -0.5 and size - 0.5.
        for whole_px, half_px in (((300.0, 100.0), (149.75, 49.75)), ((-0.5, 511.5), (-0.5, 255.5))):
            expected, _ = camera.unproject(np.array([whole_px]))
            bearing, _ = small.unproject(np.array([half_px]))
            np.testing.assert_allclose(bearing, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_frames": 601}, "n_frames is 601; expected 1 to 600"),
        ({"n_frames": 0}, "n_frames is 0"),
        ({"duration_s": 0.0}, "duration_s is 0.0; expected a number above 0"),
        ({"swap_share": 1.5}, "swap_share is 1.5"),
        ({"corners": CornerNoise(missed_share=-0.1)}, r"corners.missed_share is -0.1"),
        ({"corners": CornerNoise(pixel_px=-0.1)}, r"corners.pixel_px is -0.1"),
        ({"mocap": MocapNoise(rotation_deg=float("nan"))}, "mocap.rotation_deg is nan"),
        ({"mocap": MocapNoise(jitter_s=1.0)}, "mocap.jitter_s is 1.0; expected 0 to 0.05"),
        ({"clock_offset_s": (0.1, 0.2)}, "2 values for 4 cameras"),
    ],
)
def test_options_out_of_range_are_named(changes: dict[str, object], message: str) -> None:
    with pytest.raises(GtcalError, match=message):
        options(**changes)


def test_an_unknown_model_and_a_negative_seed_are_named() -> None:
    with pytest.raises(GtcalError, match=r"'fisheye63' is not known; models: fisheye62"):
        fixed_cameras_rig(models=("fisheye63",))
    with pytest.raises(GtcalError, match="seed is -1"):
        simulate(options(), seed=-1)


# Command line


def test_the_command_writes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    board = {"type": "aprilgrid", "tag_columns": 4, "tag_rows": 3, "tag_side_m": 0.08, "tag_spacing": 0.3}
    (tmp_path / "board.yaml").write_text(yaml.safe_dump({"board": board}))
    simulate_command(
        tmp_path / "out", rig="fixed", board=str(tmp_path / "board.yaml"), frames=30, duration_s=10.0, seed=4
    )
    recording = load_recording(tmp_path / "out")
    assert recording.capture is Capture.FIXED_CAMERAS
    assert recording.board == AprilGrid(4, 3, 0.08, 0.3)
    assert "30 frames of 4 cameras" in capsys.readouterr().out
    simulate_command(tmp_path / "quiet", frames=2, duration_s=1.0, quiet=True)
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_the_command_names_a_board_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match="'paper_a3' is no preset"):
        simulate_command(tmp_path / "out", board="paper_a3")
    (tmp_path / "bad.yaml").write_text("type: aprilgrid\n")
    with pytest.raises(GtcalError, match=r"bad.yaml: board of type aprilgrid lacks tag_columns"):
        simulate_command(tmp_path / "out", board=str(tmp_path / "bad.yaml"))
    (tmp_path / "broken.yaml").write_text("type: [")
    with pytest.raises(GtcalError, match=r"broken.yaml: is not valid YAML"):
        simulate_command(tmp_path / "out", board=str(tmp_path / "broken.yaml"))
