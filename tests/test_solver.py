"""The three stages end to end on simulated recordings: accuracy, covariance, outliers, ablations, refusals."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from calibration_support import (
    HEADSET,
    KINDS,
    NO_MOCAP_NOISE,
    errors,
    guides,
    simulated,
    with_exact_mocap,
    worst,
)
from scipy.optimize import least_squares

from factors import ROBUST_KERNELS, RobustKernel
from factors.moments import chain
from gtcal.camera import Camera
from gtcal.errors import GtcalError
from gtcal.estimation.adjustment import adjust, joint_covariance
from gtcal.estimation.alignment import stage_1, stage_2
from gtcal.estimation.field_edge import AT_EDGE
from gtcal.estimation.graph import camera_T_ref_key, minimise, reprojection_graph, to_values
from gtcal.estimation.observations import Observations, Views, synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import select_corners, select_views
from gtcal.estimation.solver import DisagreementError, calibrate_observations
from gtcal.results.calibration import Calibration
from gtcal.results.covariance import NAIVE
from gtcal.simulation import CornerNoise, MocapNoise, Simulation
from gtcal.simulation.transforms import apply

FIXED = "pinholes and fisheyes fixed"
GOOD_MOCAP = MocapNoise(translation_mm=0.05, rotation_deg=0.005)


def calibrated(simulation: Simulation, **options: object) -> Calibration:
    return calibrate_observations(
        synchronise(simulation.recording), CalibrationOptions(**{"intrinsics": "exact"} | options)
    )


def deviation(found_T: np.ndarray, true_T: np.ndarray) -> np.ndarray:
    """(6,) xi with found_T * Exp(xi) = true_T."""
    return gtsam.Pose3.Logmap(gtsam.Pose3(found_T).inverse() * gtsam.Pose3(true_T))


# Accuracy


@pytest.mark.parametrize("kind", list(KINDS))
def test_with_good_mocap_the_result_is_near_the_truth(kind: str) -> None:
    """100 frames, mocap noise of 0.05 mm and 0.005 deg on each body, 0.1 px. Over 12 seeds of every kind the worst
    camera or board was 0.09 mm and 0.012 deg off, typically 0.045 mm and 0.004 deg."""
    simulation = simulated(kind, frames=100, mocap=GOOD_MOCAP)
    calibration = calibrated(simulation)
    mm, deg = worst(errors(calibration, simulation).values())
    assert mm < 0.15
    assert deg < 0.015
    for camera in calibration.cameras.values():
        assert camera.residuals.rmse_px < 0.3
        assert camera.residuals.n_without_pixel == 0
    assert not any("contradict" in warning for warning in calibration.warnings)


@pytest.mark.long
@pytest.mark.parametrize("kind", [HEADSET, FIXED])
def test_with_exact_mocap_the_estimate_is_unbiased_and_the_naive_covariance_true(kind: str) -> None:
    """What it claims: pixel noise alone. NEES per degree of freedom over 32 recordings, which has a standard error of
    0.10 for each variable; and the mean of the whitened errors."""
    nees, whitened = {}, []
    for seed in range(32):
        simulation = simulated.__wrapped__(kind, seed=seed, frames=40, mocap_rate_hz=30.0)
        options = CalibrationOptions(intrinsics="exact", eps=1e-6, mocap="exact")
        calibration = calibrate_observations(with_exact_mocap(simulation), options)
        naive = calibration.covariances[NAIVE]
        poses = {
            name: (camera.camera_T_ref.a_T_b, simulation.truth.camera_T_ref[name], naive.camera_T_ref(name))
            for name, camera in calibration.cameras.items()
        }
        poses["X"] = calibration.body_T_board.a_T_b, simulation.truth.body_T_board, naive.body_T_board
        for name, (found_T, true_T, covariance) in poses.items():
            xi = deviation(found_T, true_T)
            factor = np.linalg.cholesky(np.linalg.inv(covariance))
            whitened.append(factor.T @ xi)
            nees.setdefault(name, []).append(xi @ np.linalg.solve(covariance, xi) / 6)
        assert calibration.sigma_px == pytest.approx(0.1, rel=0.03)
        assert all(drop.reason == AT_EDGE for drop in calibration.dropped)
    assert all(0.8 < np.mean(of_variable) < 1.2 for of_variable in nees.values()), nees
    # the variables of one recording err together: 32 independent numbers, at least
    np.testing.assert_allclose(np.mean(whitened, axis=0), 0.0, atol=3.0 / np.sqrt(32))


def test_a_stated_sigma_scales_the_covariance_and_not_the_result() -> None:
    simulation = simulated(HEADSET)
    once, twice = (calibrated(simulation, sigma_px=sigma, eps=1e-9, mocap="exact") for sigma in (0.1, 0.2))
    assert (once.sigma_px, twice.sigma_px) == (0.1, 0.2)
    np.testing.assert_allclose(twice.covariances[NAIVE].matrix, 4.0 * once.covariances[NAIVE].matrix, rtol=1e-4)
    np.testing.assert_allclose(twice.body_T_board.a_T_b, once.body_T_board.a_T_b, atol=1e-7)


def test_the_same_input_gives_the_same_bits() -> None:
    simulation = simulated(HEADSET, swap_share=0.1)
    first, second = calibrated(simulation), calibrated(simulation)
    for name, camera in first.cameras.items():
        np.testing.assert_array_equal(camera.camera_T_ref.a_T_b, second.cameras[name].camera_T_ref.a_T_b)
        np.testing.assert_array_equal(camera.camera_T_ref.covariance, second.cameras[name].camera_T_ref.covariance)
        assert camera.residuals == second.cameras[name].residuals
    np.testing.assert_array_equal(first.body_T_board.a_T_b, second.body_T_board.a_T_b)


@pytest.mark.long
def test_another_seed_of_the_sweep_ends_at_the_same_place() -> None:
    simulation = simulated(HEADSET)
    poses = [calibrated(simulation, seed=seed, eps=1e-8).body_T_board.a_T_b for seed in range(4)]
    for pose in poses[1:]:
        np.testing.assert_allclose(pose, poses[0], atol=1e-6)


# Stage 3 by itself


def two_cameras(simulation: Simulation, n_views: int) -> Observations:
    observations = synchronise(simulation.recording)
    names = list(observations.views)[:2]
    few = {name: select_views(observations.views[name], np.arange(n_views)) for name in names}
    return replace(observations, views=few)


def test_stage_3_ends_where_scipy_ends() -> None:
    """A small problem, from the same start, with an independent residual and numeric Jacobian."""
    observations = two_cameras(simulated(HEADSET), n_views=8)
    of_camera = guides(observations)
    aligned = stage_1(of_camera, np.random.default_rng(0))
    start, _ = stage_2(aligned.views, aligned.estimate, eps=1e-4, max_iterations=100)
    ours = adjust(observations.views, start, CalibrationOptions(intrinsics="exact", eps=1e-12, screen=False)).estimate

    def moved(T: np.ndarray, xi: np.ndarray) -> np.ndarray:
        return T @ gtsam.Pose3.Expmap(xi).matrix()

    def residuals(xi: np.ndarray) -> np.ndarray:
        parts = []
        for c, (name, views) in enumerate(observations.views.items(), start=1):
            Y, X = moved(start.camera_T_ref[name], xi[6 * c : 6 * c + 6]), moved(start.body_T_board, xi[:6])
            parts.append(_reprojection(views, Y, X))
        return np.concatenate(parts).ravel()

    found = least_squares(residuals, np.zeros(18), method="lm", x_scale=1e-3, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(ours.body_T_board, moved(start.body_T_board, found.x[:6]), atol=1e-7)
    for c, name in enumerate(observations.views, start=1):
        expected = moved(start.camera_T_ref[name], found.x[6 * c : 6 * c + 6])
        np.testing.assert_allclose(ours.camera_T_ref[name], expected, atol=1e-7)


def _reprojection(views: Views, camera_T_ref: np.ndarray, body_T_board: np.ndarray) -> np.ndarray:
    camera_T_board = (camera_T_ref @ views.ref_T_body @ body_T_board)[views.view_of_corner]
    in_camera = np.einsum("nij,nj->ni", camera_T_board[:, :3, :3], views.corners_m) + camera_T_board[:, :3, 3]
    return views.camera.project(in_camera)[0] - views.corners_px


def test_the_covariance_is_that_of_the_normal_equations() -> None:
    """sigma^2 (J^T J)^-1 with a numeric Jacobian, over X and both cameras."""
    observations = two_cameras(simulated(HEADSET), n_views=8)
    of_camera = guides(observations)
    aligned = stage_1(of_camera, np.random.default_rng(0))
    adjusted = adjust(
        observations.views, aligned.estimate, CalibrationOptions(intrinsics="exact", eps=1e-12, screen=False)
    )
    found, names = adjusted.estimate, list(observations.views)
    columns = []
    for block in range(3):
        for direction in 1e-6 * np.eye(6):
            rows = []
            for c, name in enumerate(names, start=1):
                ends = []
                for sign in (1.0, -1.0):
                    nudge = gtsam.Pose3.Expmap(sign * direction).matrix()
                    Y = found.camera_T_ref[name] @ (nudge if block == c else np.eye(4))
                    X = found.body_T_board @ (nudge if block == 0 else np.eye(4))
                    ends.append(_reprojection(observations.views[name], Y, X).ravel())
                rows.append((ends[0] - ends[1]) / 2e-6)
            columns.append(np.concatenate(rows))
    J = np.stack(columns, axis=1)
    expected = adjusted.sigma_px**2 * np.linalg.inv(J.T @ J)
    joint = joint_covariance(adjusted, NAIVE).matrix
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(joint / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4)


@pytest.mark.parametrize("eps", [1e-1, 1e-4, 1e-8])
def test_minimisation_stops_where_an_iteration_gains_less_than_eps(eps: float) -> None:
    observations = synchronise(simulated(HEADSET).recording)
    estimate = stage_1(guides(observations), np.random.default_rng(0)).estimate
    graph = reprojection_graph(
        observations.views, estimate, sigma_px=0.1, robust=RobustKernel(), intrinsics_priors=None
    )
    found = minimise(graph, to_values(estimate, with_theta=False), eps=eps, max_iterations=100)
    gains = -np.diff(found.errors)
    limits = eps * (1.0 + np.array(found.errors[1:]))
    assert found.converged
    assert (gains[:-1] >= limits[:-1]).all()
    assert gains[-1] < limits[-1]
    assert found.iterations == len(gains)
    assert graph.error(found.values) == pytest.approx(found.errors[-1])


def test_minimisation_says_when_it_ran_out_of_iterations() -> None:
    observations = synchronise(simulated(HEADSET).recording)
    estimate = stage_1(guides(observations), np.random.default_rng(0)).estimate
    graph = reprojection_graph(
        observations.views, estimate, sigma_px=0.1, robust=RobustKernel(), intrinsics_priors=None
    )
    found = minimise(graph, to_values(estimate, with_theta=False), eps=1e-12, max_iterations=1)
    assert not found.converged
    assert found.iterations == 1


def test_the_result_can_be_carried_on_with() -> None:
    """A researcher adds a factor to the solved graph and solves again."""
    simulation = simulated(HEADSET)
    solution = calibrated(simulation).solution
    truth = gtsam.Pose3(simulation.truth.camera_T_ref["front_left"])
    tight = gtsam.noiseModel.Isotropic.Sigma(6, 1e-9)
    solution.graph.add(gtsam.PriorFactorPose3(camera_T_ref_key(0), truth, tight))
    found = minimise(solution.graph, solution.values, eps=1e-8, max_iterations=50)
    pinned = found.values.atPose3(camera_T_ref_key(0)).matrix()
    np.testing.assert_allclose(pinned, truth.matrix(), atol=1e-8)


# Outliers

GROSS = {"swap_share": 0.2, "corners": CornerNoise(wrong_corner_share=0.05, wrong_tag_share=0.03)}


@pytest.mark.long
@pytest.mark.parametrize(("kind", "n_seeds"), [(HEADSET, 5), (FIXED, 3)])
def test_gross_outliers_do_not_decide_the_result(kind: str, n_seeds: int) -> None:
    """A fifth of the frames with mocap swaps, 5 % wrong corners, 3 % wrong tags: at most twice the error without."""
    off = {"clean": [], "Null": [], "Huber": []}
    tally = Counter()
    for seed in range(n_seeds):
        clean, spoilt = simulated(kind, seed=seed), simulated(kind, seed=seed, **GROSS)
        off["clean"].append(mean_error(calibrated(clean), clean))
        for kernel in ("Null", "Huber"):
            calibration = calibrated(spoilt, robust=RobustKernel.named(kernel))
            off[kernel].append(mean_error(calibration, spoilt))
        tally += tally_of(calibration, spoilt)
    clean_mm, clean_deg = np.median(off["clean"], axis=0)
    for kernel in ("Null", "Huber"):
        mm, deg = np.median(off[kernel], axis=0)
        assert mm < 2.0 * clean_mm, kernel
        assert deg < 2.0 * clean_deg, kernel
    assert tally["gross views found"] >= 0.95 * tally["gross views"] > 30
    assert tally["good views dropped"] <= 0.01 * tally["good views"]
    assert tally["wrong corners found"] >= 0.95 * tally["wrong corners"] > 500
    assert tally["good corners dropped"] <= 0.01 * tally["good corners"]


def mean_error(calibration: Calibration, simulation: Simulation) -> np.ndarray:
    return np.mean(list(errors(calibration, simulation).values()), axis=0)


def tally_of(calibration: Calibration, simulation: Simulation) -> Counter:
    """What was spoilt and what was dropped. A view is gross if a swap spoils it, or if half or more of its corners are
    wrong; corners are counted in the other views."""
    tally = Counter()
    for name, views in synchronise(simulation.recording).views.items():
        truth, kept = simulation.truth.cameras[name], calibration.solution.views[name]
        n_views = views.n_views
        assert views.n_corners == len(truth.wrong_corners)
        wrong_share = np.bincount(views.view_of_corner, truth.wrong_corners) / np.diff(views.view_start)
        gross = truth.swapped[truth.frames_of(views.stamps_ns)] | (wrong_share >= 0.5)
        keep = np.isin(views.stamps_ns, kept.stamps_ns)
        tally["gross views"] += int(gross.sum())
        tally["gross views found"] += int((gross & ~keep).sum())
        tally["good views"] += n_views - int(gross.sum())
        tally["good views dropped"] += int((~gross & ~keep).sum())
        in_good = (keep & ~gross)[views.view_of_corner]
        kept_corners = set(zip(kept.stamps_ns[kept.view_of_corner].tolist(), kept.corner_ids.tolist(), strict=True))
        stamps = views.stamps_ns[views.view_of_corner]
        keep_corner = np.array(
            [key in kept_corners for key in zip(stamps.tolist(), views.corner_ids.tolist(), strict=True)]
        )
        wrong = truth.wrong_corners
        tally["wrong corners"] += int((wrong & in_good).sum())
        tally["wrong corners found"] += int((wrong & in_good & ~keep_corner).sum())
        tally["good corners"] += int((~wrong & in_good).sum())
        tally["good corners dropped"] += int((~wrong & in_good & ~keep_corner).sum())
    return tally


def test_what_is_dropped_is_counted_by_camera_and_reason_and_adds_up() -> None:
    simulation = simulated(HEADSET, seed=1, mocap=MocapNoise(gap_share=0.05), **GROSS)
    calibration = calibrated(simulation)
    assert {entry.camera for entry in calibration.dropped} == set(calibration.cameras)
    for name, camera in calibration.cameras.items():
        dropped = [entry for entry in calibration.dropped if entry.camera == name]
        detections = simulation.recording.detections[name]
        assert camera.residuals.n_views + sum(entry.n_views for entry in dropped) <= detections.n_views
        assert camera.residuals.n_corners + sum(entry.n_corners for entry in dropped) == detections.n_corners
    reasons = {entry.reason.split(" (")[0] for entry in calibration.dropped}
    assert {"gross view", "gross corner"} <= reasons
    assert any("gap" in reason or "outside" in reason for reason in reasons)


def test_a_large_share_of_gross_views_is_warned_of() -> None:
    calibration = calibrated(simulated(HEADSET, seed=1, swap_share=0.35))
    assert any("of its views contradict the chain" in warning for warning in calibration.warnings)
    assert not any("contradict" in warning for warning in calibrated(simulated(HEADSET, swap_share=0.05)).warnings)


@pytest.mark.long
@pytest.mark.parametrize("kind", [HEADSET, FIXED])
def test_a_mocap_that_does_not_go_with_the_images_is_warned_of(kind: str) -> None:
    """Clocks 50 ms apart: the views by themselves fit to the pixel noise, in the chain they are pixels off."""
    late = calibrated(simulated(kind, clock_offset_s=0.05))
    assert late.stages[0].median_px < 0.15
    assert late.stages[-1].median_px > 3.0
    assert any("look for a clock offset" in warning for warning in late.warnings)
    assert not any("clock offset" in warning for warning in calibrated(simulated(kind)).warnings)


def test_without_screening_a_redescending_kernel_copes_and_the_numbers_stay_finite() -> None:
    """Swaps turn boards behind the camera: corners without a pixel, which are counted."""
    simulation = simulated(HEADSET, swap_share=0.2)
    calibration = calibrated(simulation, screen=False, robust=RobustKernel.named("Tukey"))
    mm, deg = worst(errors(calibration, simulation).values())
    assert mm < 1.0
    assert deg < 0.1
    assert sum(camera.residuals.n_without_pixel for camera in calibration.cameras.values()) > 0
    assert np.isfinite(calibration.rmse_px)
    assert all(drop.reason == AT_EDGE for drop in calibration.dropped)


@pytest.mark.long
@pytest.mark.parametrize("name", list(ROBUST_KERNELS))
def test_every_kernel_solves(name: str) -> None:
    simulation = simulated(HEADSET, mocap=GOOD_MOCAP)
    calibration = calibrated(simulation, robust=RobustKernel.named(name))
    mm, deg = worst(errors(calibration, simulation).values())
    assert mm < 0.3
    assert deg < 0.03
    assert calibration.sigma_px == pytest.approx(0.12, rel=0.25)


@pytest.mark.long
def test_graduated_non_convexity_finds_its_way_through_forty_percent_of_wrong_corners() -> None:
    """Without screening; from a wide kernel to a narrow one, where the narrow one alone need not."""
    corners = CornerNoise(wrong_corner_share=0.4)
    for name in ("GemanMcClure", "TruncatedLeastSquares"):
        for seed in range(2):
            simulation = simulated(HEADSET, seed=seed, mocap=GOOD_MOCAP, corners=corners)
            found = calibrated(simulation, screen=False, robust=RobustKernel.named(name), graduated=True)
            mm, deg = worst(errors(found, simulation).values())
            assert (mm < 0.5, deg < 0.05) == (True, True), (name, seed, mm, deg)


def test_graduated_non_convexity_needs_a_redescending_kernel() -> None:
    with pytest.raises(GtcalError, match=r"needs a redescending kernel .* not 'Huber'"):
        CalibrationOptions(graduated=True, robust=RobustKernel.named("Huber"))


# Stages, as in the paper's ablation


@pytest.mark.parametrize("stages", [(1,), (2,), (3,), (1, 2), (1, 3), (2, 3)])
def test_stages_can_be_left_out(stages: tuple[int, ...]) -> None:
    calibration = calibrated(simulated(HEADSET), stages=stages)
    assert [report.stage for report in calibration.stages] == [0, *stages, *([4] if 3 in stages else [])]
    assert (calibration.body_T_board.covariance is not None) == (3 in stages)
    assert np.isfinite(calibration.rmse_px)
    if 1 in stages:
        assert worst(errors(calibration, simulated(HEADSET)).values())[0] < 5.0
        assert calibration.stages[1].median_px < 5.0


def test_each_stage_lowers_its_own_objective_and_reports_it() -> None:
    for kind in (HEADSET, FIXED):
        reports = calibrated(simulated(kind)).stages
        names = ["PnP", "Procrustes sweep", "3-D alignment", "pixels", "mocap noise"]
        assert [report.name for report in reports] == names
        for report in reports[1:]:
            assert report.error_after <= report.error_before
            assert report.iterations >= 1
            assert report.median_px < 100.0
        assert reports[3].median_px <= min(report.median_px for report in reports[1:3]) + 0.05
        assert all(report.duration_s >= 0.0 for report in reports)


def test_progress_names_the_work_and_ends_at_its_total() -> None:
    calls: dict[str, list[tuple[int, int]]] = {}
    calibrate_observations(
        synchronise(simulated(HEADSET).recording),
        progress=lambda what, done, total: calls.setdefault(what, []).append((done, total)),
    )
    assert len(calls) == 5
    for steps in calls.values():
        done, totals = zip(*steps, strict=True)
        assert list(done) == sorted(done)
        assert len(set(totals)) == 1
        assert done[-1] == totals[-1]


# Refusals


def without_views(observations: Observations, name: str, keep: int) -> Observations:
    few = select_views(observations.views[name], np.arange(keep))
    return replace(observations, views=observations.views | {name: few})


def test_fewer_views_than_a_camera_needs_are_refused() -> None:
    observations = without_views(synchronise(simulated(HEADSET).recording), "side_left", 2)
    with pytest.raises(GtcalError, match=r"camera 'side_left' has 2 usable view\(s\); at least 3"):
        calibrate_observations(observations)


def test_fewer_coordinates_than_unknowns_are_refused() -> None:
    observations = synchronise(simulated(HEADSET).recording)
    views = select_views(observations.views["front_left"], np.arange(3))
    first_two = np.arange(views.n_corners) - views.view_start[views.view_of_corner] < 2
    poor = replace(observations, views=observations.views | {"front_left": select_corners(views, first_two)})
    with pytest.raises(GtcalError, match=r"camera 'front_left' has 12 measured coordinates for 24 unknowns"):
        calibrate_observations(poor, CalibrationOptions(intrinsics="refine"))


def test_views_that_pnp_cannot_solve_are_told_by_camera() -> None:
    observations = synchronise(simulated(HEADSET).recording)
    views = observations.views["side_right"]
    nowhere = replace(views, corners_m=np.zeros_like(views.corners_m))
    spoilt = replace(observations, views=observations.views | {"side_right": nowhere})
    with pytest.raises(GtcalError, match=rf"camera 'side_right': PnP solves 0 of its {views.n_views} views"):
        calibrate_observations(spoilt)


def test_a_camera_without_intrinsics_is_told_what_to_do() -> None:
    with pytest.raises(GtcalError, match=r"camera 'front_left' has no intrinsics.*--calibrate-intrinsics"):
        calibrated(simulated(HEADSET, intrinsics="none"))


def test_data_that_fit_no_chain_are_refused() -> None:
    simulation = simulated(HEADSET)
    rolled = {
        name: replace(views, ref_T_body=np.roll(views.ref_T_body, 5, axis=0))
        for name, views in synchronise(simulation.recording).views.items()
    }
    observations = replace(synchronise(simulation.recording), views=rolled)
    with pytest.raises(DisagreementError, match=r"no calibration fits.*quaternion order") as caught:
        calibrate_observations(observations)
    assert caught.value.angle_deg > 3.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stages": ()}, "stages"),
        ({"stages": (1, 4)}, "stages"),
        ({"stages": (3, 1)}, "stages"),
        ({"stages": (1, 2), "intrinsics": "refine"}, "stage 3"),
        ({"eps": 0.0}, "eps: 0.0 is not a positive number"),
        ({"eps": float("nan")}, "eps: nan"),
        ({"sigma_px": -1.0}, "sigma_px: -1.0"),
        ({"focal_sigma_px": 0.0}, "focal_sigma_px"),
        ({"max_iterations": 0}, "max_iterations: 0 is less than 1"),
        ({"pnp_views": 0}, "pnp_views: 0 is less than 3"),
        ({"seed": -1}, "seed: -1 is less than 0"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(GtcalError, match=message):
        CalibrationOptions(**options)


def test_a_view_that_shows_nothing_new_changes_nothing() -> None:
    """The same recording twice over has the same optimum, and half the variance."""
    observations = synchronise(simulated(HEADSET).recording)
    twice = {name: select_views(v, np.repeat(np.arange(v.n_views), 2)) for name, v in observations.views.items()}
    options = CalibrationOptions(intrinsics="exact", eps=1e-9, sigma_px=0.1, mocap="exact")
    once = calibrate_observations(observations, options)
    doubled = calibrate_observations(replace(observations, views=twice), options)
    np.testing.assert_allclose(doubled.body_T_board.a_T_b, once.body_T_board.a_T_b, atol=1e-6)
    np.testing.assert_allclose(doubled.covariances[NAIVE].matrix, 0.5 * once.covariances[NAIVE].matrix, rtol=1e-3)


def test_the_chain_is_the_documented_product() -> None:
    """camera_T_board = camera_T_ref * ref_T_body * body_T_board, and it reprojects the corners."""
    simulation = simulated(HEADSET, corners=CornerNoise(pixel_px=0.0), mocap=NO_MOCAP_NOISE)
    observations = with_exact_mocap(simulation)
    calibration = calibrate_observations(observations)
    for name, views in observations.views.items():
        camera: Camera = calibration.cameras[name].camera
        Y, X = calibration.cameras[name].camera_T_ref.a_T_b, calibration.body_T_board.a_T_b
        in_camera = apply(chain(Y, views.ref_T_body[:1], X)[0], views.corners_m[: views.view_start[1]])
        pixels, valid = camera.project(in_camera)
        assert valid.all()
        np.testing.assert_allclose(pixels, views.corners_px[: views.view_start[1]], atol=1e-2)
