"""Intrinsics found from the views, and refined with the extrinsics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from calibration_support import HEADSET, NO_MOCAP_NOISE, errors, near, simulated, with_exact_mocap
from scipy.spatial.transform import Rotation

from factors import CAMERA_MODELS, PINHOLE_RADTAN
from gtcal.camera import Camera
from gtcal.errors import GtcalError
from gtcal.estimation.errors_in_variables import GROSS
from gtcal.estimation.intrinsics import calibrate_intrinsics
from gtcal.estimation.observations import Views, synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import select_corners, select_views
from gtcal.estimation.solver import calibrate_observations
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import load_recording
from gtcal.simulation import CornerNoise, Rig, Simulation, SimulationOptions, fixed_cameras_rig, simulate
from gtcal.workflow import calibrate


def rig_of(model: str, theta: list[float] | None = None) -> Rig:
    """One fixed camera, with a usual lens of the model or this one."""
    rig = fixed_cameras_rig(1, models=(model,))
    camera = rig.cameras[0] if theta is None else replace(rig.cameras[0], parameters=np.array(theta))
    nearer = camera.theta[0] / rig.cameras[0].theta[0]  # as large in the image
    return replace(rig, cameras=(camera,), nearest_m=rig.nearest_m * nearer, farthest_m=rig.farthest_m * nearer)


def recording_of(rig: Rig, **changes: object) -> Simulation:
    options = {"rig": rig, "n_frames": 60, "duration_s": 40.0, "intrinsics": "none", **changes}
    return simulate(SimulationOptions(capture=Capture.FIXED_CAMERAS, **options), seed=0)


@cache
def recording_with(model: str) -> Simulation:
    return recording_of(LENSES[model])


def views_of(simulation: Simulation) -> Views:
    return synchronise(simulation.recording).views["cam0"]


def lens_difference_px(found: Camera, true: Camera) -> np.ndarray:
    """Distance in the image between two lenses, on a grid all over it. The camera's attitude is free: a turned camera
    with a shifted principal point sees nearly the same, and the extrinsic takes it up."""
    u, v = np.meshgrid(np.linspace(0, true.image_width_px - 1, 33), np.linspace(0, true.image_height_px - 1, 25))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    (found_bearings, found_ok), (bearings, ok) = found.unproject(pixels), true.unproject(pixels)
    assert (found_ok | ~ok).mean() > 0.99
    both = ok & found_ok
    turn, _ = Rotation.align_vectors(found_bearings[both], bearings[both])
    seen, valid = found.project(turn.apply(bearings[both]))
    return np.linalg.norm(seen - pixels[both], axis=1)[valid]


WIDE_PINHOLE = [710.0, 710.0, 636.0, 515.0, -0.11, 0.07, 0.0004, -0.0007, -0.012]
LENSES = {
    "pinhole_radtan": rig_of("pinhole_radtan", WIDE_PINHOLE),
    "kannala_brandt4": rig_of("kannala_brandt4"),
    **{name: rig_of(name) for name in CAMERA_MODELS if name not in ("pinhole_radtan", "kannala_brandt4")},
}


@pytest.mark.long
@pytest.mark.parametrize("model", list(LENSES))
def test_each_model_recovers_its_lens(model: str) -> None:
    """From 60 frames with 0.1 px of noise: all over the image, the middle to 0.15 px, nearly all to 0.5 px."""
    simulation = recording_with(model)
    views = views_of(simulation)
    found = calibrate_intrinsics(views)
    difference = lens_difference_px(found.camera, simulation.truth.cameras["cam0"].camera)
    assert found.camera.model.name == model
    assert np.median(difference) < 0.15
    assert np.quantile(difference, 0.95) < 0.5
    assert found.rmse_px == pytest.approx(0.1 * np.sqrt(2.0), rel=0.05)  # the noise, less the poses' share
    assert 0.8 * views.n_views <= found.n_views <= views.n_views


@pytest.mark.long
def test_a_headset_without_intrinsics_is_calibrated() -> None:
    """Fisheyes that see to 89 degrees off the axis; then the extrinsics, with the lenses found, are near the truth."""
    simulation = simulated(HEADSET, intrinsics="none")
    calibration = calibrate(simulation.recording, CalibrationOptions(intrinsics="calibrate"))
    for name, truth in simulation.truth.cameras.items():
        difference = lens_difference_px(calibration.cameras[name].camera, truth.camera)
        assert np.median(difference) < 0.15
        assert np.quantile(difference, 0.95) < 0.5
    assert near(errors(calibration, simulation), mm=1.0, deg=0.1)
    assert [stage.name for stage in calibration.stages[:4]] == [f"intrinsics of {name}" for name in calibration.cameras]


@pytest.mark.long
def test_wrong_corners_and_tags_do_not_bend_a_lens() -> None:
    spoilt = CornerNoise(wrong_corner_share=0.05, wrong_tag_share=0.03)
    for model in ("pinhole_radtan", "fisheye62"):
        simulation = recording_of(LENSES[model], corners=spoilt)
        found = calibrate_intrinsics(views_of(simulation))
        difference = lens_difference_px(found.camera, simulation.truth.cameras["cam0"].camera)
        assert np.median(difference) < 0.2
        assert found.rmse_px == pytest.approx(0.1 * np.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize("focal_px", [1200.0, 2500.0])
def test_a_narrow_pinhole_keeps_k3_at_zero(focal_px: float) -> None:
    rig = rig_of("pinhole_radtan", [focal_px, focal_px, 645.0, 508.0, -0.1, 0.08, 0.0004, -0.0007, 0.0])
    found = calibrate_intrinsics(views_of(recording_of(rig))).camera
    assert found.theta[-1] == 0.0
    difference = lens_difference_px(found, rig.cameras[0])
    assert np.median(difference) < 3e-4 * focal_px  # a long lens hardly tells focal length from distance


def test_a_wide_pinhole_gets_its_k3() -> None:
    found = calibrate_intrinsics(views_of(recording_with("pinhole_radtan"))).camera
    assert found.theta[-1] == pytest.approx(WIDE_PINHOLE[-1], abs=0.003)


def test_pixels_are_square_unless_the_views_say_otherwise() -> None:
    square = calibrate_intrinsics(views_of(recording_with("pinhole_radtan"))).camera
    assert square.theta[0] == square.theta[1]
    oblong = [710.0, 720.0, *WIDE_PINHOLE[2:]]
    found = calibrate_intrinsics(views_of(recording_of(rig_of("pinhole_radtan", oblong)))).camera
    assert found.theta[1] / found.theta[0] == pytest.approx(720.0 / 710.0, rel=2e-4)


# Refusals


def test_too_few_views_are_refused() -> None:
    views = views_of(recording_with("fisheye62"))
    with pytest.raises(GtcalError, match=r"camera 'cam0': 5 views with 12 or more corners; at least 6"):
        calibrate_intrinsics(select_views(views, np.argsort(-np.diff(views.view_start))[:5]))
    only_first_tag = np.arange(views.n_corners) - views.view_start[views.view_of_corner] < 4
    with pytest.raises(GtcalError, match=r"camera 'cam0': 0 views with 12 or more corners"):
        calibrate_intrinsics(select_corners(views, only_first_tag))


@pytest.mark.long
@pytest.mark.parametrize("model", ["pinhole_radtan", "fisheye62"])
@pytest.mark.parametrize("what", ["pixels anywhere", "another board", "all on one pixel", "a board that is a line"])
def test_views_of_something_else_are_refused(model: str, what: str) -> None:
    views = select_views(views_of(recording_with(model)), np.arange(0, 45, 3))
    rng = np.random.default_rng(0)
    spoilt = {
        "pixels anywhere": {"corners_px": rng.uniform(0.0, 1000.0, views.corners_px.shape)},
        "another board": {"corners_m": rng.permutation(views.corners_m)},
        "all on one pixel": {"corners_px": np.full(views.corners_px.shape, 500.0)},
        "a board that is a line": {"corners_m": views.corners_m * np.array([1.0, 0.0, 0.0])},
    }[what]
    with pytest.raises(GtcalError, match=r"camera 'cam0': (its views fit no lens|no lens gives).*board's description"):
        calibrate_intrinsics(replace(views, **spoilt))


@pytest.mark.long
def test_a_fisheye_stated_as_a_pinhole_is_refused_with_what_fits_better() -> None:
    views = views_of(recording_with("kannala_brandt4"))
    as_pinhole = replace(views, camera=replace(views.camera, model=PINHOLE_RADTAN))
    with pytest.raises(GtcalError, match=r"pinhole_radtan fits its views to [\d.]+ px.*kannala_brandt4 to 0\.1"):
        calibrate_intrinsics(as_pinhole)


def test_richer_fisheyes_take_the_views_of_simpler_ones() -> None:
    views = views_of(recording_with("kannala_brandt4"))
    for name in ("fisheye62", "fisheye624"):
        found = calibrate_intrinsics(replace(views, camera=replace(views.camera, model=CAMERA_MODELS[name])))
        assert np.median(lens_difference_px(found.camera, LENSES["kannala_brandt4"].cameras[0])) < 0.15


# Refinement with the extrinsics


@pytest.mark.long
@pytest.mark.parametrize("prior", ["weak", "stated"])
def test_refinement_brings_wrong_intrinsics_to_the_truth(prior: str) -> None:
    simulation = simulated(HEADSET, intrinsics="perturbed")
    observations = synchronise(simulation.recording)
    fixed = calibrate_observations(observations, CalibrationOptions(intrinsics="exact"))
    options = CalibrationOptions(intrinsics="refine", intrinsics_prior=prior)
    refined = calibrate_observations(observations, options)
    assert refined.rmse_px < 0.3 < fixed.rmse_px
    assert near(errors(refined, simulation), mm=1.0, deg=0.1)
    for name, truth in simulation.truth.cameras.items():
        stated = lens_difference_px(observations.views[name].camera, truth.camera)
        found = lens_difference_px(refined.cameras[name].camera, truth.camera)
        assert np.median(found) < 0.25 * np.median(stated)
        assert np.median(found) < 0.3


@pytest.mark.long
@pytest.mark.parametrize("model", ["pinhole_rational", "double_sphere", "extended_unified", "mei_omni"])
def test_each_model_is_refined_beside_the_extrinsics(model: str) -> None:
    """Near what is stated (--intrinsics auto) and without trusting it (refine)."""
    simulation = recording_of(LENSES[model], n_frames=40, intrinsics="perturbed")
    observations = synchronise(simulation.recording)
    truth = simulation.truth.cameras["cam0"].camera
    stated = np.median(lens_difference_px(observations.views["cam0"].camera, truth))
    for mode in ("auto", "refine"):
        calibration = calibrate_observations(observations, CalibrationOptions(intrinsics=mode))
        camera = calibration.cameras["cam0"]
        found = np.median(lens_difference_px(camera.camera, truth))
        assert found < 0.5 * stated
        assert found < 0.5
        assert camera.theta_covariance is not None
        assert calibration.rmse_px < 0.3


def test_refined_intrinsics_come_with_their_covariance() -> None:
    """On data whose only noise is that of the pixels it is true: 4 sigma hold every parameter."""
    simulation = simulated(HEADSET, intrinsics="perturbed", mocap=NO_MOCAP_NOISE)
    calibration = calibrate_observations(
        with_exact_mocap(simulation), CalibrationOptions(intrinsics="refine", eps=1e-6)
    )
    for name, theta in simulation.truth.intrinsics.items():
        camera = calibration.cameras[name]
        assert camera.theta_covariance.shape == (len(theta), len(theta))
        deviation = (camera.camera.theta - theta) / np.sqrt(np.diag(camera.theta_covariance))
        assert np.abs(deviation).max() < 4.0


def test_fixed_intrinsics_stay_bit_for_bit() -> None:
    simulation = simulated(HEADSET)
    for mode in ("exact", "fixed"):
        options = CalibrationOptions(intrinsics=mode)
        calibration = calibrate_observations(synchronise(simulation.recording), options)
        for name, theta in simulation.truth.intrinsics.items():
            np.testing.assert_array_equal(calibration.cameras[name].camera.theta, theta)
            assert calibration.cameras[name].theta_covariance is None
            assert calibration.cameras[name].lens_moves == ()


# Real data


def test_real_corners_without_intrinsics(vicon_recording: Callable[..., Path]) -> None:
    recording = load_recording(vicon_recording())
    calibration = calibrate(recording, CalibrationOptions(intrinsics="calibrate", mocap="exact"))
    camera = calibration.cameras["cam0"]
    assert camera.residuals.rmse_px <= 0.95
    assert camera.residuals.n_views == 30
    assert camera.residuals.n_corners >= 0.995 * 4008
    assert calibration.stages[0].error_after < 0.3
    assert any("weakly determined" in warning for warning in calibration.warnings)  # it turns about the vertical


@pytest.mark.long
def test_real_images_without_intrinsics(vicon_recording: Callable[..., Path]) -> None:
    recording = load_recording(vicon_recording(given_corners=False))
    calibration = calibrate(recording, CalibrationOptions(intrinsics="calibrate"))
    residuals = calibration.cameras["cam0"].residuals
    assert residuals.rmse_px <= 1.0
    gross = [drop for drop in calibration.dropped if drop.n_views]
    assert residuals.n_views + sum(drop.n_views for drop in gross) == 30
    assert all(drop.reason == GROSS and drop.n_views <= 2 for drop in gross)  # by stage 4
    assert residuals.n_corners >= 3800
    assert calibration.stages[0].error_after < 0.25
