"""Stage 4: its prior against simulated noise, its estimate and its covariance against the truth."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError, calibrate_observations, synchronise
from gtcal.estimation import errors_in_variables
from gtcal.estimation.adjustment import adjust
from gtcal.estimation.mocap_noise import MocapNoiseModel
from gtcal.estimation.options import MocapSigmas
from gtcal.estimation.solver import DisagreementError
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import PoseEstimate, pose_difference
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE
from gtcal.simulation import CornerNoise, MocapNoise, SimulationOptions, simulate

SIGMAS = MocapSigmas(translation_mm=0.2, rotation_deg=0.02)


def simulation(seed: int, capture: Capture = Capture.TRACKED_PLATFORM, n_frames: int = 60):
    noise = MocapNoise(translation_mm=SIGMAS.translation_mm, rotation_deg=SIGMAS.rotation_deg)
    return simulate(SimulationOptions(capture=capture, n_frames=n_frames, mocap=noise), seed=seed)


def nees_per_dof(estimate: PoseEstimate, truth: np.ndarray) -> float:
    xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(estimate.a_T_b) @ truth))
    return float(xi @ np.linalg.solve(estimate.covariance, xi) / 6)


@pytest.mark.long
@pytest.mark.parametrize("capture", list(Capture))
def test_the_prior_has_the_covariance_of_the_composed_and_interpolated_noise(capture):
    rng = np.random.default_rng(0)
    motion = simulation(0, capture, n_frames=1).recording.motion
    samples_ns = next(iter(motion.trajectories.values())).stamps_ns
    stamps_ns = samples_ns[100:103] + np.array([0, 2_000_000, 4_100_000])
    sigmas = np.repeat([np.deg2rad(SIGMAS.rotation_deg), 1e-3 * SIGMAS.translation_mm], 3)

    def noisy(trajectory):
        near = np.flatnonzero(np.abs(trajectory.stamps_ns - stamps_ns[1]) < 50_000_000)
        poses = trajectory.world_T_body[near].copy()
        for pose, xi in zip(poses, sigmas * rng.standard_normal((len(near), 6)), strict=True):
            pose[:] = pose @ gtsam.Pose3.Expmap(xi).matrix()
        return replace(trajectory, stamps_ns=trajectory.stamps_ns[near], world_T_body=poses)

    exact = motion.at(stamps_ns).ref_T_body
    samples = []
    for _ in range(3000):
        drawn = replace(motion, **{name: noisy(body) for name, body in motion.trajectories.items()})
        error = inverse(exact) @ drawn.at(stamps_ns).ref_T_body
        samples.append([gtsam.Pose3.Logmap(gtsam.Pose3(pose)) for pose in error])
    found = np.einsum("snj,snk->njk", samples, samples) / len(samples)
    expected = MocapNoiseModel(dict.fromkeys(motion.trajectories, SIGMAS)).covariance(motion, stamps_ns)
    scale = np.sqrt(np.einsum("njj->nj", expected))
    assert np.abs((found - expected) / (scale[:, :, None] * scale[:, None, :])).max() < 0.12


@pytest.mark.long
@pytest.mark.parametrize("mocap", ["estimate", SIGMAS], ids=["estimated", "given"])
def test_it_is_more_accurate_than_stage_3_and_its_covariance_is_true(mocap):
    plain_mm, found_mm, nees, naive, innovation = [], [], [], [], []
    for seed in range(10):
        simulated = simulation(seed)
        found = calibrate_observations(
            synchronise(simulated.recording), CalibrationOptions(mocap=mocap, intrinsics="exact")
        )
        assert (found.covariance_kind, found.mocap_noise.stage) == (ERRORS_IN_VARIABLES, 4)
        assert set(found.covariances) == {NAIVE, CLUSTERED, ERRORS_IN_VARIABLES}
        for name, truth in simulated.truth.camera_T_ref.items():
            for stage, errors in ((3, plain_mm), (4, found_mm)):
                pose = found.estimates[stage].camera_T_ref[name]
                errors.append(pose_difference(inverse(pose), inverse(truth))[0])
            nees.append(nees_per_dof(found.cameras[name].camera_T_ref, truth))
            stage_3 = PoseEstimate(found.estimates[3].camera_T_ref[name], found.covariances[NAIVE].camera_T_ref(name))
            naive.append(nees_per_dof(stage_3, truth))
        nees.append(nees_per_dof(found.body_T_board, simulated.truth.body_T_board))
        innovation.append(found.mocap_noise.innovation_variance)
        assert abs(found.mocap_noise.lag_1) < 0.25
    assert np.mean(found_mm) < 0.6 * np.mean(plain_mm)
    assert 0.75 < np.mean(nees) < 1.3  # the cameras of a recording err together: about 10 * 12 independent numbers
    assert np.mean(naive) > 10
    assert np.mean(innovation) == pytest.approx(1.0, abs=0.1)


def test_its_pixel_noise_is_that_of_the_pixels_alone():
    observations = synchronise(simulation(1).recording)
    options = CalibrationOptions(intrinsics="exact")
    assert calibrate_observations(observations, replace(options, mocap="exact")).sigma_px > 0.2
    assert calibrate_observations(observations, options).sigma_px == pytest.approx(0.1, rel=0.03)


def test_where_the_mocap_is_taken_as_exact_the_frames_are_clustered():
    options = CalibrationOptions(intrinsics="exact", mocap="exact")
    found = calibrate_observations(synchronise(simulation(0).recording), options)
    assert (found.covariance_kind, found.mocap_noise, list(found.estimates)) == (CLUSTERED, None, [3])
    ratio = np.diag(found.covariances[CLUSTERED].matrix) / np.diag(found.covariances[NAIVE].matrix)
    assert (ratio > 5).all()


@pytest.mark.long
def test_a_systematic_error_is_not_taken_for_noise():
    """A mocap volume that is 1 % too large: what noise would explain comes back at every place. Where the board's size
    is unknown too, it is that which is wrong by as much, and said to be."""
    simulated = simulation(0, Capture.STANDING_BOARD)
    platform = simulated.recording.platform
    stretched = platform.world_T_body.copy()
    stretched[:, :3, 3] *= 1.01
    recording = replace(simulated.recording, platform=replace(platform, world_T_body=stretched))
    found = calibrate_observations(synchronise(recording), CalibrationOptions(board="exact"))
    assert found.mocap_noise.stage == 3
    assert found.covariance_kind == CLUSTERED
    with_shape = calibrate_observations(synchronise(recording))
    assert next(with_shape.board_shape.parts).value == pytest.approx(1.0, abs=0.05)
    assert any("the board is not as it was expected to be: larger than stated" in w for w in with_shape.warnings)


def test_intrinsics_may_be_free_too():
    simulated = simulation(2)
    options = CalibrationOptions(mocap=SIGMAS, intrinsics="refine")
    found = calibrate_observations(synchronise(simulated.recording), options)
    for name, truth in simulated.truth.intrinsics.items():
        camera = found.cameras[name]
        sigmas = np.sqrt(np.diag(camera.theta_covariance))
        assert (np.abs(camera.camera.theta - truth) < 5 * sigmas).all()


def test_bad_choices_are_refused():
    with pytest.raises(GtcalError, match=r"translation_mm: 0\.0 is not a positive number"):
        MocapSigmas(translation_mm=0.0, rotation_deg=0.01)
    with pytest.raises(GtcalError, match="stages leave it out"):
        CalibrationOptions(mocap=SIGMAS, stages=(1, 2))
    for choice in ({"mocap": None}, {"intrinsics": "refined"}, {"intrinsics_prior": ""}, {"clock": "off"}):
        ((name, value),) = choice.items()
        with pytest.raises(GtcalError, match=f"^{name}: {value!r} is none of "):
            CalibrationOptions(**choice)


def edge_case():
    noise = MocapNoise(translation_mm=0.2, rotation_deg=0.02, correlation_s=0.1, jitter_s=0.001)
    options = SimulationOptions(
        n_frames=120,
        duration_s=12.0,
        mocap=noise,
        corners=CornerNoise(wrong_corner_share=0.05),
        swap_share=0.05,
    )
    return simulate(options, seed=20_091)  # of six hundred the one in which stage 4 used to stop furthest away


def test_corners_at_the_edge_of_the_field_do_not_keep_free_intrinsics_from_the_optimum():
    recorded = edge_case()
    found = calibrate_observations(synchronise(recorded.recording), CalibrationOptions(intrinsics="refine"))
    assert found.mocap_noise.stage == 4
    for name, camera in found.cameras.items():
        # stuck, it is 70 to 140
        assert nees_per_dof(camera.camera_T_ref, recorded.truth.camera_T_ref[name]) < 8.0


@pytest.mark.parametrize("swapped", [0.55, 0.8])
def test_a_mocap_that_is_mostly_wrong_is_refused(swapped):
    recorded = simulate(SimulationOptions(n_frames=20, swap_share=swapped), seed=3)
    with pytest.raises(DisagreementError, match="no calibration fits"):
        calibrate_observations(synchronise(recorded.recording), CalibrationOptions())


@pytest.mark.parametrize(("gross_share", "left_out"), [(0.3, True), (0.7, False)])
def test_gross_frames_are_left_out_unless_they_are_most(gross_share, left_out):
    observations = synchronise(simulation(0).recording)
    options = CalibrationOptions(mocap="exact")
    found = calibrate_observations(observations, options)
    adjusted = adjust(observations.views, found.solution.estimate, options)
    views = adjusted.screened.views
    gross = {name: np.arange(v.n_views) < gross_share * v.n_views for name, v in views.items()}
    rest, dropped = errors_in_variables._without(adjusted, gross)
    assert {d.camera for d in dropped} == (set(views) if left_out else set())
    for name, of_camera in views.items():
        kept = (~gross[name]).sum() if left_out else of_camera.n_views
        assert rest.screened.views[name].n_views == kept
