from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from factors.rigid import inverse
from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.trajectory import Trajectory
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import write_calibration
from gtcal.simulation import CornerNoise, MocapNoise, SimulationOptions, fixed_cameras_rig, simulate
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, LollypopSimulation, simulate_lollypop, write_lollypop_simulation
from gtcal.simulation.noise import pose_noise
from gtcal.simulation.simulate import scene_of
from gtcal.verification.blocks import fit_covariance, sum_covariance
from gtcal.verification.error_statistics import rmse_bounds
from gtcal.verification.lollypop import device_from_manifest
from gtcal.verification.lollypop_recording import LollypopRecording, load_lollypop_recording
from gtcal.verification.verdict import camera_verdict
from gtcal.verification.verification import ErrorStatistics, Verdict, Verification, VerificationOptions, error_classes
from gtcal.verification.verification_file import read_verification, write_sightings, write_verification
from gtcal.verification.workflow import verify

EXACT = LollypopOptions(corners=CornerNoise(pixel_px=0.0), mocap=MocapNoise(0.0, 0.0), mocap_rate_hz=480.0)
HALF = float(np.sqrt(0.5))
CUBE = device_from_manifest(
    {
        "dictionary": "DICT_5X5_50",
        "faces": [
            {"tag_id": 1, "tag_side_m": 0.06, "centre_in_body_m": [0.0, 0.0, 0.04]},
            {"tag_id": 2, "tag_side_m": 0.06, "centre_in_body_m": [0.04, 0, 0], "quat_wxyz": [HALF, 0, HALF, 0]},
            {"tag_id": 3, "tag_side_m": 0.06, "centre_in_body_m": [0, -0.04, 0], "quat_wxyz": [HALF, HALF, 0, 0]},
        ],
    }
)


@cache
def simulated(options: str = "usual", seed: int = 1) -> LollypopSimulation:
    """Simulations that several tests look at."""
    kinds = {"usual": LollypopOptions(), "exact": EXACT, "cube": LollypopOptions(device=CUBE, duration_s=15.0)}
    return simulate_lollypop(kinds[options], seed=seed)


@cache
def verified(options: str = "usual", seed: int = 1) -> Verification:
    simulation = simulated(options, seed)
    return verify(simulation.recording, simulation.true_calibration())


def verified_fault(fault: RigFault, seed: int = 2, **options: object) -> Verification:
    simulation = simulate_lollypop(replace(LollypopOptions(fault=fault), **options), seed=seed)  # type: ignore[arg-type]
    return verify(simulation.recording, simulation.true_calibration())


# -- errors of every frame


def test_without_noise_image_and_mocap_agree() -> None:
    """What is left is the interpolation between the mocap's samples."""
    found = verified("exact")
    assert found.verdict is Verdict.PASS
    assert found.pooled_px.worst < 0.02
    assert found.faults == ()


def test_errors_are_those_of_a_known_shift_of_one_camera() -> None:
    shift = small_motion((2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    simulation = simulate_lollypop(replace(EXACT, fault=RigFault(cameras={"front_left": shift})), seed=1)
    seen = verify(simulation.recording, simulation.true_calibration()).sightings["front_left"]
    moved, _ = seen.camera.project(seen.mocap_centre_in_camera_m + np.array([0.002, 0.0, 0.0]))
    np.testing.assert_allclose(seen.errors_px, moved - seen.mocap_centre_px, atol=0.02)
    # e_3D: the image centre at the mocap centre's depth is the shifted centre itself
    ahead = seen.field_angle_rad < np.deg2rad(75)
    np.testing.assert_allclose(seen.errors_in_camera_m[ahead], np.tile([0.002, 0, 0], (ahead.sum(), 1)), atol=1e-4)


def test_frames_left_out_are_counted_by_reason() -> None:
    simulation = simulated()
    recording, name = simulation.recording, "front_left"
    stamps = recording.device_body.stamps_ns
    middle = stamps[len(stamps) // 2]
    kept = (stamps < middle) | (stamps > middle + 2_000_000_000)
    late = recording.detections[name].stamps_ns[-1] - 1_500_000_000
    kept &= stamps < late
    broken = replace(
        recording, device_body=Trajectory("device_body", stamps[kept], recording.device_body.world_T_body[kept])
    )
    found = verify(broken, simulation.true_calibration(), VerificationOptions(max_viewing_angle_deg=30.0))
    counts = {entry.reason: entry.count for entry in found.left_out if entry.camera == name}
    assert set(counts) >= {
        "the device is not found in the image",
        "gap > 20.83 ms in device_body",
        "outside the device_body trajectory",
        "seen at more than 30 deg from the face's normal",
    }
    assert sum(counts.values()) + found.cameras[name].n_sightings == found.cameras[name].n_frames
    assert np.rad2deg(found.sightings[name].viewing_angle_rad).max() <= 30.0


def test_the_viewing_angle_is_the_true_one() -> None:
    simulation = simulated("exact")
    for index, (name, seen) in enumerate(verified("exact").sightings.items()):
        truth = simulation.world.truth.cameras[name]
        times_s = simulation.world.frame_times_s[truth.frames_of(seen.stamps_ns)]
        T = simulation.world.scene.camera_T_board(index, times_s) @ inverse(
            simulation.options.device.faces[0].body_T_board
        )
        sight = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=1, keepdims=True)
        true = np.arccos(-(T[:, :3, 2] * sight).sum(axis=1))
        np.testing.assert_allclose(seen.viewing_angle_rad, true, atol=1e-3)


def test_triangulation_sees_along_the_ray() -> None:
    """A camera moved along its optical axis hardly shows in e_3D in the middle of its image; in depth it does."""
    exact = verified("exact").triangulation
    assert exact.statistics is not None
    assert exact.statistics.count > 100
    assert np.abs(exact.depth_mm).max() < 0.5
    assert (exact.seen_by.sum(axis=1) >= 2).all()
    assert exact.parallax_deg.min() >= VerificationOptions().min_parallax_deg
    both = RigFault(cameras={name: small_motion((0, 0, 3), (0, 0, 0)) for name in ("front_left", "front_right")})
    simulation = simulate_lollypop(replace(EXACT, fault=both), seed=1)
    check = verify(simulation.recording, simulation.true_calibration()).triangulation
    front = check.seen_by[:, :2].all(axis=1) & ~check.seen_by[:, 2:].any(axis=1)
    # the front pair looks about 20 degrees apart: most of the 3 mm is depth for both
    assert 2.0 < np.median(check.depth_mm[front]) < 3.5


def test_several_faces_give_the_full_pose() -> None:
    found = verified("cube")
    assert {check.camera for check in found.pose_checks} == set(found.cameras)
    check = found.pose_checks[0]
    assert check.count > 20
    assert check.depth_rmse_mm < 3.0
    assert check.across_rmse_mm < 0.4
    assert check.rotation_rmse_deg < 1.0
    assert len(np.unique(found.sightings["front_left"].face_index)) > 1
    assert found.verdict is Verdict.PASS
    assert verified().pose_checks == ()


def test_a_shift_of_a_camera_shows_in_the_pose_of_a_device_with_faces() -> None:
    fault = RigFault(cameras={"front_left": small_motion((0, 0, 4.0), (0, 0, 0))})
    simulation = simulate_lollypop(
        replace(EXACT, device=CUBE, duration_s=15.0, fault=fault, corners=CornerNoise(pixel_px=0.02)), seed=1
    )
    found = verify(simulation.recording, simulation.true_calibration())
    check = next(check for check in found.pose_checks if check.camera == "front_left")
    seen = found.sightings["front_left"]
    first = {stamp: index for index, stamp in reversed(list(enumerate(seen.stamps_ns.tolist())))}
    rows = [first[stamp] for stamp in check.stamps_ns.tolist()]
    toward = (seen.camera_T_ref @ seen.ref_T_body[rows])[:, :3, 3]
    expected_mm = 4.0 * toward[:, 2] / np.linalg.norm(toward, axis=1)
    assert np.median(np.abs(check.depth_mm - expected_mm)) < 0.5


# -- statistics


def test_statistics_are_those_of_the_sightings() -> None:
    found = verified()
    for name, camera in found.cameras.items():
        e = found.sightings[name].e_2d_px
        assert camera.px.count == camera.n_sightings == len(e)
        np.testing.assert_allclose(camera.px.rmse, np.sqrt((e**2).mean()))
        np.testing.assert_allclose((camera.px.mean, camera.px.median), (e.mean(), np.median(e)))
        np.testing.assert_allclose(camera.px.worst, e.max())
        assert camera.px.rmse_low < camera.px.rmse < camera.px.rmse_high
        heat = camera.heat_map
        assert heat.count.sum() == len(e)
        np.testing.assert_allclose(np.nansum(heat.count * heat.rmse_px**2), (e**2).sum())
        assert ((heat.classes == -1) == (heat.count == 0)).all()
        for curve in camera.curves:
            assert curve.count.sum() == len(e)
            np.testing.assert_allclose(np.nansum(curve.count * curve.rmse_px**2), (e**2).sum())
        xy, rt = camera.bias.xy_px, (camera.bias.radial_px, camera.bias.tangential_px)
        np.testing.assert_allclose(xy, found.sightings[name].errors_px.mean(axis=0))
        np.testing.assert_allclose(rt, found.sightings[name].radial_tangential_px.mean(axis=0))
    pooled = np.concatenate([seen.e_2d_px for seen in found.sightings.values()])
    np.testing.assert_allclose(found.pooled_px.rmse, np.sqrt((pooled**2).mean()))


def test_colours_change_at_the_papers_limits() -> None:
    errors = np.array([0.0, 0.499, 0.5, 1.499, 1.5, 2.999, 3.0, np.nan])
    assert error_classes(errors).tolist() == [0, 0, 1, 1, 2, 2, 3, -1]


def _ar1(n: int, correlation_frames: float, random: np.random.Generator) -> np.ndarray:
    noise = pose_noise(n, 1.0, MocapNoise(1e3, 0.0, correlation_s=correlation_frames), random)
    return np.asarray(noise[:, :3, 3])


@pytest.mark.parametrize("correlation_frames", [0.0, 8.0])
def test_intervals_hold_also_where_errors_are_correlated(correlation_frames: float) -> None:
    """Of 200 records of 600 frames the 95 % interval of the mean covers zero nearly always; without the factor for
    the correlation it would miss in most of them."""
    random = np.random.default_rng(5)
    missed = naive = high = 0
    for _ in range(200):
        values = _ar1(600, correlation_frames, random)[:, :2]
        of_sum = sum_covariance(values[:, :1], np.arange(600))
        assert of_sum is not None
        missed += abs(values[:, 0].sum()) > 1.96 * np.sqrt(of_sum.covariance[0, 0])
        naive += abs(values[:, 0].sum()) > 1.96 * values[:, 0].std() * np.sqrt(600)
        high += rmse_bounds(np.linalg.norm(values, axis=1), np.arange(600), 0.95)[1] < np.sqrt(2.0)
    assert missed <= 20
    assert high <= 20
    assert naive > 80 if correlation_frames else naive < 25


def test_sightings_of_one_frame_count_once() -> None:
    """Four copies of each error say no more than one."""
    values = np.random.default_rng(1).standard_normal((300, 1))
    once = sum_covariance(values, np.arange(300))
    four = sum_covariance(np.repeat(values, 4, axis=0), np.repeat(np.arange(300), 4))
    assert once is not None
    assert four is not None
    np.testing.assert_allclose(four.covariance, 16 * once.covariance)
    assert sum_covariance(values[:5], np.arange(5)) is None


def test_the_jackknife_of_a_fit_is_its_spread() -> None:
    """A straight line through errors correlated over 10 of 400 frames: over 300 records the covariance is that of the
    estimates, or a little more."""
    random, x = np.random.default_rng(7), np.linspace(-1, 1, 400)
    J = np.stack([np.ones(400), x], axis=1)
    information = J[:, :, None] * J[:, None, :]
    estimates, claimed = [], []
    for _ in range(300):
        y = _ar1(400, 10.0, random)[:, 0]
        estimate = np.linalg.solve(J.T @ J, J.T @ y)
        of_fit = fit_covariance(J * (J @ estimate - y)[:, None], information, np.zeros((2, 2)), np.arange(400))
        assert of_fit is not None
        estimates.append(estimate)
        claimed.append(np.diag(of_fit.covariance))
    ratio = np.mean(claimed, axis=0) / np.var(estimates, axis=0)
    assert (ratio > 0.75).all()
    assert (ratio < 2.0).all()


# -- verdict


def _statistics(unit: str, low: float, high: float, count: int = 500) -> ErrorStatistics:
    return ErrorStatistics(unit, count, 0.5 * (low + high), 0.0, 0.0, 0.0, 0.0, low, high)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("px", "coverage", "independent", "verdict", "reason"),
    [
        (_statistics("px", 0.3, 0.4), 0.5, 100.0, Verdict.PASS, None),
        (_statistics("px", 0.6, 0.8), 0.5, 100.0, Verdict.FAIL, "RMSE 0.700 px exceeds 0.5 px"),
        (_statistics("px", 0.45, 0.55), 0.5, 100.0, Verdict.INCONCLUSIVE, "too near to the limit of 0.5 px"),
        (_statistics("px", 0.3, 0.4), 0.1, 100.0, Verdict.INCONCLUSIVE, "in 10 % of the image; 20 % are needed"),
        (_statistics("px", 0.6, 0.8), 0.1, 100.0, Verdict.FAIL, "exceeds"),
        (_statistics("px", 0.3, 0.4, 20), 0.5, 100.0, Verdict.INCONCLUSIVE, "20 sightings are too few"),
        (_statistics("px", 0.3, 0.4), 0.5, 3.0, Verdict.INCONCLUSIVE, "3.0 independent stretches"),
        (_statistics("px", np.nan, np.nan, 1), 0.5, 0.0, Verdict.INCONCLUSIVE, "1 sightings are too few"),
    ],
)
def test_the_verdict_is_on_bounds(
    px: ErrorStatistics, coverage: float, independent: float, verdict: Verdict, reason: str | None
) -> None:
    found, reasons = camera_verdict(px, _statistics("mm", 0.3, 0.4), independent, coverage, VerificationOptions())
    assert found is verdict
    assert (reasons == ()) if reason is None else (reason in reasons[0])


def test_too_little_shown_is_inconclusive_not_pass() -> None:
    simulation = simulate_lollypop(LollypopOptions(duration_s=4.0), seed=3)
    found = verify(simulation.recording, simulation.true_calibration())
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.reasons


# -- findings


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10, 18))
def test_a_true_calibration_raises_no_suspicion(seed: int) -> None:
    found = verified_fault(RigFault(), seed=seed, mocap=MocapNoise(0.1, 0.01, correlation_s=0.1))
    assert found.faults == ()
    assert found.verdict is Verdict.PASS


@pytest.mark.long
@pytest.mark.parametrize("name", ["front_left", "front_right", "side_left", "side_right"])
@pytest.mark.parametrize("motion", [((0.0, 0.0, 0.0), (0.0, 0.1, 0.0)), ((0.6, 0.0, 0.8), (0.0, 0.0, 0.0))])
def test_a_camera_that_moved_is_named_with_its_motion(name: str, motion: tuple[tuple[float, ...], ...]) -> None:
    moved = small_motion(*motion)
    (fault,) = verified_fault(RigFault(cameras={name: moved})).faults
    assert (fault.kind, fault.camera) == ("camera_moved", name)
    assert fault.sentence.startswith(f"camera {name!r} moved by ")
    np.testing.assert_allclose(fault.correction, moved, atol=4e-4)
    assert abs(fault.shift_mm - np.linalg.norm(motion[0])) < 4 * fault.shift_sigma_mm
    assert abs(fault.turn_deg - np.linalg.norm(motion[1])) < 4 * fault.turn_sigma_deg
    assert fault.rmse_after_px < 0.2 < fault.rmse_before_px
    assert fault.also_possible == ()


@pytest.mark.parametrize("capture", [Capture.TRACKED_PLATFORM, Capture.FIXED_CAMERAS])
def test_markers_that_moved_are_told_from_cameras(capture: Capture) -> None:
    moved = small_motion((0.7, -0.7, 0.5), (0.06, 0.0, 0.08))
    rig = {"rig": fixed_cameras_rig(), "farthest_m": 1.5} if capture is Capture.FIXED_CAMERAS else {}
    (fault,) = verified_fault(RigFault(markers=moved), capture=capture, **rig).faults
    assert (fault.kind, fault.camera) == ("markers_moved", None)
    np.testing.assert_allclose(fault.correction, moved, atol=3e-4)
    who = "the headset's markers moved by" if capture is Capture.TRACKED_PLATFORM else "the mocap's world moved by"
    assert fault.sentence.startswith(who)


def test_a_device_whose_centre_is_off_is_not_blamed_on_the_cameras() -> None:
    (fault,) = verified_fault(RigFault(device_centre_m=(0.0008, -0.0006, 0.0))).faults
    assert fault.kind == "device_centre"
    np.testing.assert_allclose(fault.shift_mm, 1.0, atol=0.05)
    np.testing.assert_allclose(fault.correction[:3, 3], [0.0008, -0.0006, 0.0], atol=5e-5)


def test_a_lens_that_warmed_up_is_told_from_a_camera_that_moved() -> None:
    (fault,) = verified_fault(RigFault(focal_shares={"side_left": 0.003})).faults
    assert (fault.kind, fault.camera) == ("lens_changed", "side_left")
    np.testing.assert_allclose(fault.focal_share, 0.003, atol=2e-4)


def test_two_cameras_that_moved_are_two_findings() -> None:
    cameras = {
        "front_left": small_motion((1, 0, 0), (0, 0, 0.1)),
        "side_right": small_motion((0, 0, -1), (0.1, 0, 0)),
    }
    faults = verified_fault(RigFault(cameras=cameras)).faults
    assert {(fault.kind, fault.camera) for fault in faults} == {("camera_moved", name) for name in cameras}
    assert all(fault.also_possible == () for fault in faults)


def test_a_single_camera_cannot_tell_itself_from_the_markers() -> None:
    simulation = simulate_lollypop(
        LollypopOptions(fault=RigFault(markers=small_motion((1, 1, 0), (0, 0.1, 0)))), seed=2
    )
    recording, name = simulation.recording, "front_left"
    alone = replace(recording, cameras={name: recording.cameras[name]}, detections={name: recording.detections[name]})
    calibration = simulation.true_calibration()
    only = replace(calibration, cameras={name: calibration.cameras[name]})
    fault = verify(alone, only).faults[0]
    assert fault.kind == "camera_moved"
    assert "or the markers" in fault.sentence


def test_what_the_calibration_itself_leaves_open_is_no_finding() -> None:
    """A correction of 0.3 mm is real, but not where the calibration claims no more than 0.5 mm."""
    simulation = simulate_lollypop(
        LollypopOptions(fault=RigFault(cameras={"front_left": small_motion((0.3, 0, 0), (0, 0, 0))})), seed=2
    )
    calibration = simulation.true_calibration()
    assert len(verify(simulation.recording, calibration).faults) == 1
    unsure = np.diag([1e-3] * 3 + [5e-4] * 3) ** 2
    cameras = {
        name: replace(camera, camera_T_ref=replace(camera.camera_T_ref, covariance=unsure))
        for name, camera in calibration.cameras.items()
    }
    assert verify(simulation.recording, replace(calibration, cameras=cameras)).faults == ()


@pytest.mark.parametrize("capture", [Capture.TRACKED_PLATFORM, Capture.FIXED_CAMERAS])
def test_a_lollypop_is_simulated_in_the_rig_that_was_calibrated(capture: Capture) -> None:
    rig = fixed_cameras_rig() if capture is Capture.FIXED_CAMERAS else LollypopOptions().rig
    of_board = SimulationOptions(rig=rig, capture=capture, n_frames=2, duration_s=4.0)
    truth = simulate(of_board, seed=3).truth
    fault = RigFault(
        markers=small_motion((1, 2, 3), (0.1, 0.2, 0.3)),
        cameras={rig.cameras[1].name: small_motion((0, 0, 5), (1, 0, 0))},
    )
    options = LollypopOptions(
        rig=rig, capture=capture, fault=fault, duration_s=4.0, calibrated_in=scene_of(of_board, seed=3)
    )
    calibration = simulate_lollypop(options, seed=8).true_calibration()
    for name, camera in calibration.cameras.items():
        np.testing.assert_allclose(camera.camera_T_ref.a_T_b, truth.camera_T_ref[name], atol=1e-12)


def test_simulate_lollypop_from_the_command_line(tmp_path: Path) -> None:
    given = ["--seed", "3", "--duration-s", "3", "--lollypop", "-q"]
    assert main(["simulate", "-o", str(tmp_path / "a"), *given]) == 0
    assert main(["simulate", "-o", str(tmp_path / "b"), *given]) == 0
    assert main(["simulate", "-o", str(tmp_path / "c"), *given, "--take", "2", "--fault", "camera"]) == 0
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert "recording.yaml" in files
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert load_lollypop_recording(tmp_path / "c").device == LollypopOptions().device
    assert (tmp_path / "a" / "platform.csv").read_bytes() != (tmp_path / "c" / "platform.csv").read_bytes()


# -- bad input


def _error(recording: LollypopRecording, calibration: Calibration) -> str:
    with pytest.raises(GtcalError) as error:
        verify(recording, calibration)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_device_that_is_not_in_the_recording() -> None:
    simulation = simulated()
    empty = CameraDetections.from_views([])
    recording = replace(simulation.recording, detections=dict.fromkeys(simulation.recording.cameras, empty))
    message = _error(recording, simulation.true_calibration())
    assert "the device is not in the recording: no frame shows it (Lollypop of one face, tag 0 of DICT_5X5" in message


def test_a_single_frame() -> None:
    simulation = simulated()
    detections = dict(simulation.recording.detections)
    empty, first = CameraDetections.from_views([]), np.arange(detections["front_left"].n_views) == 0
    kept = detections["front_left"].select_views(first)
    recording = replace(simulation.recording, detections=dict.fromkeys(detections, empty) | {"front_left": kept})
    assert "in a single frame of the recording" in _error(recording, simulation.true_calibration())


@pytest.mark.parametrize("factor", [0.5, 1.3, 10.0])
def test_a_tag_size_off_by_a_factor(factor: float) -> None:
    """Of no consequence to e_2D, so it is said on a good recording."""
    simulation = simulated()
    stated = device_from_manifest({"dictionary": "DICT_5X5_50", "tag_id": 0, "tag_side_m": 0.06 * factor})
    message = _error(replace(simulation.recording, device=stated), simulation.true_calibration())
    assert f"the tag looks {1 / factor:.2f} times as large as the device states" in message
    assert f"not {60 * factor:g} mm; measure the print and set tag_side_m" in message


def test_a_wrong_body() -> None:
    simulation = simulated()
    recording = simulation.recording
    assert recording.platform is not None
    other = simulated("exact", 5).recording.device_body
    message = _error(replace(recording, device_body=other), simulation.true_calibration())
    assert "the mocap's body does not move as the device does" in message
    own = replace(recording.platform, body="device_body")
    assert "was 'device_body' exported from another rigid body" in _error(
        replace(recording, device_body=own), simulation.true_calibration()
    )


@pytest.mark.parametrize("clock", ["calibration", "estimate"])
def test_no_time_in_common(clock: str) -> None:
    simulation = simulated()
    body = simulation.recording.device_body
    late = replace(body, stamps_ns=body.stamps_ns + 3_600_000_000_000)
    with pytest.raises(GtcalError, match=r"share no time.*: -3[56]\d* ns more in .*stamp_offset_ns") as error:
        verify(
            replace(simulation.recording, device_body=late),
            simulation.true_calibration(),
            VerificationOptions(clock=clock),  # type: ignore[arg-type]
        )
    assert "\n" not in str(error.value)


def test_a_calibration_of_another_rig() -> None:
    simulation, other = simulated(), simulated("exact", 5)
    calibration = simulation.true_calibration()
    renamed = replace(calibration, cameras={f"my_{name}": camera for name, camera in calibration.cameras.items()})
    assert "the calibration is of another rig: it has the cameras my_front_left" in _error(
        simulation.recording, renamed
    )
    message = _error(simulation.recording, other.true_calibration())
    assert "all cameras are off by about" in message
    assert "the calibration is of another rig, or the platform's rigid body was defined anew" in message
    fixed = replace(calibration, capture=Capture.FIXED_CAMERAS)
    assert "is of capture fixed_cameras, with camera poses against the mocap's world" in _error(
        simulation.recording, fixed
    )


def test_a_calibration_of_another_image_size_or_lens() -> None:
    simulation = simulated()
    calibration = simulation.true_calibration()
    recording = simulation.recording
    small = replace(recording.cameras["front_left"], image_width_px=640, image_height_px=512)
    message = _error(replace(recording, cameras=recording.cameras | {"front_left": small}), calibration)
    assert (
        "camera 'front_left' has images of 640 x 512 in the recording, but was calibrated with 1280 x 1024" in message
    )
    pinhole = fixed_cameras_rig().cameras[0]
    lens = replace(recording.cameras["front_left"], model=pinhole.model, parameters=pinhole.parameters)
    message = _error(replace(recording, cameras=recording.cameras | {"front_left": lens}), calibration)
    assert "is pinhole_radtan in the recording, but fisheye62 in the calibration" in message


def test_a_camera_that_was_not_recorded_is_not_passed() -> None:
    simulation = simulated()
    recording = simulation.recording
    without = {name: camera for name, camera in recording.cameras.items() if name != "side_left"}
    partial = replace(recording, cameras=without, detections={name: recording.detections[name] for name in without})
    found = verify(partial, simulation.true_calibration())
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.reasons == ("camera 'side_left' of the calibration is not in the recording",)
    calibration = simulation.true_calibration()
    fewer = replace(calibration, cameras={name: calibration.cameras[name] for name in without})
    extra = verify(recording, fewer)
    assert extra.warnings == ("camera 'side_left' is in the recording but not in the calibration; it is left out",)


@pytest.mark.parametrize(
    ("field", "value"), [("max_rmse_px", 0.0), ("confidence", 1.0), ("min_coverage", 1.5), ("min_sightings", 1)]
)
def test_options_out_of_range(field: str, value: float) -> None:
    with pytest.raises(GtcalError, match=field):
        VerificationOptions(**{field: value})  # type: ignore[arg-type]


# -- files and the command line


def _same(first: object, second: object) -> None:
    np.testing.assert_equal(first, second)


@pytest.mark.parametrize("kind", ["usual", "cube"])
def test_a_verification_is_read_back(kind: str, tmp_path: Path) -> None:
    found = verified(kind)
    write_verification(tmp_path / "v.json", found)
    again = read_verification(tmp_path / "v.json")
    assert (again.verdict, again.reasons, again.faults) == (found.verdict, found.reasons, found.faults)
    for name, camera in found.cameras.items():
        other = again.cameras[name]
        assert other.px == camera.px
        _same(other.bias.__dict__, camera.bias.__dict__)
        _same(other.heat_map.__dict__, camera.heat_map.__dict__)
        for mine, theirs in zip(camera.curves, other.curves, strict=True):
            _same(theirs.__dict__, mine.__dict__)
    assert again.triangulation.statistics == found.triangulation.statistics
    _same([c.depth_rmse_mm for c in again.pose_checks], [c.depth_rmse_mm for c in found.pose_checks])
    assert (again.device, again.options, again.left_out) == (found.device, found.options, found.left_out)
    assert again.duration_s == found.duration_s
    write_verification(tmp_path / "again.json", again)
    assert (tmp_path / "again.json").read_text() == (tmp_path / "v.json").read_text()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: "{", "is not valid JSON"),
        (lambda text: "[]", "is no verification of gtcal"),
        (
            lambda text: text.replace('"gtcal_verification": 1', '"gtcal_verification": 9'),
            "schema 9, .* up to 1; update",
        ),
        (lambda text: json.dumps({"gtcal_verification": 1}), "the field 'verdict' is missing"),
        (lambda text: text.replace('"verdict": "pass"', '"verdict": "maybe"', 1), "wrong form: 'maybe'"),
    ],
)
def test_a_damaged_verification_is_refused(damage: Callable[[str], str], message: str, tmp_path: Path) -> None:
    write_verification(tmp_path / "v.json", verified())
    (tmp_path / "v.json").write_text(damage((tmp_path / "v.json").read_text()))
    with pytest.raises(GtcalError, match=message):
        read_verification(tmp_path / "v.json")


def test_sightings_as_csv(tmp_path: Path) -> None:
    found = verified()
    write_sightings(tmp_path / "s.csv", found)
    rows = (tmp_path / "s.csv").read_text().splitlines()
    assert rows[0].startswith("timestamp_ns,camera,face,image_x_px")
    assert len(rows) - 1 == sum(len(seen) for seen in found.sightings.values())
    fields = dict(zip(rows[0].split(","), rows[1].split(","), strict=True))
    assert abs(float(fields["e_2d_px"]) - found.sightings["front_left"].e_2d_px[0]) < 1e-6


def test_verify_tells_its_verdict_by_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = simulated()
    write_calibration(tmp_path / "calibration.json", good.true_calibration())
    based = LollypopOptions(calibrated_in=good.world.scene)
    bad = replace(based, fault=RigFault(cameras={"side_left": small_motion((1, 0, 0), (0, 0.1, 0))}))
    short = replace(based, duration_s=3.0)
    for name, options in (("good", based), ("bad", bad), ("short", short)):
        write_lollypop_simulation(simulate_lollypop(options, seed=12), tmp_path / name, images=False)

    def run(name: str) -> tuple[int, str]:
        arguments = [str(tmp_path / "calibration.json"), str(tmp_path / name), "-o", str(tmp_path / f"{name}.json")]
        return main(["verify", *arguments]), capsys.readouterr().out

    assert run("good")[0] == 0, read_verification(tmp_path / "good.json").reasons
    code, said = run("bad")
    assert code == 3
    assert "FAIL: the calibration does not hold" in said
    assert "camera 'side_left' moved by" in " ".join(said.split())
    assert run("short")[0] == 4
    assert read_verification(tmp_path / "bad.json").verdict is Verdict.FAIL
    provenance = read_verification(tmp_path / "good.json").provenance
    assert {entry.path.name for entry in provenance.inputs} >= {"calibration.json", "recording.yaml"}
    text = (tmp_path / "calibration.json").read_text()
    (tmp_path / "calibration.json").write_text(text.replace('"gtcal_calibration": ', '"gtcal_calibration": 9', 1))
    assert main(["verify", str(tmp_path / "calibration.json"), str(tmp_path / "good")]) == 1
    assert "update gtcal" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ('{"gtcal_verification": 1, "verdict": NaN}', "NaN is no number of JSON"),
        ('{"gtcal_verification": 1, "verdict": "pass", "reasons": [], "cameras": []}', "a field has the wrong form"),
        ('{"gtcal_verification": 99}', "has verification schema 99"),
    ],
)
def test_a_damaged_verification_file_is_refused_in_one_line(tmp_path: Path, spoilt: str, said: str) -> None:
    (tmp_path / "v.json").write_text(spoilt)
    with pytest.raises(GtcalError, match=said):
        read_verification(tmp_path / "v.json")
