"""The mocap's noise estimated from what frames say: sums against dense algebra, sigmas against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_support import HEADSET, simulated

from gtcal.estimation.adjustment import adjust
from gtcal.estimation.alignment import GuideViews, stage_1, stage_2
from gtcal.estimation.choice import choose
from gtcal.estimation.clustered import Priors, clustered_covariance, clusters
from gtcal.estimation.errors_in_variables import MocapNoiseFit, prior_information
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.frame_statistics import FrameMoments, eliminate_noise, frame_moments, frames_of
from gtcal.estimation.hold_out import FOLDS, hold_out
from gtcal.estimation.mocap_noise import (
    MocapNoiseModel,
    Whiteness,
    correlations,
    estimate_noise,
    gross_frames,
    innovations,
    lower_factors,
    shared_step,
    spread_blocks,
)
from gtcal.estimation.observations import Observations, Views, synchronise
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import chain_residuals_px, select_views
from gtcal.recordings.capture import Capture
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate

TRUE = MocapNoise(translation_mm=0.2, rotation_deg=0.02)


def at_stage_3(observations: Observations, options: CalibrationOptions) -> tuple[dict[str, Views], Estimate]:
    """The views that stage 3 keeps, and where it ends."""
    guides = {name: GuideViews.of(v, solve_pnp(v, max_views=100)) for name, v in observations.views.items()}
    aligned = stage_1(guides, np.random.default_rng(0))
    start, _ = stage_2(aligned.views, aligned.estimate, eps=1e-4, max_iterations=100)
    adjusted = adjust(observations.views, start, options)
    return dict(adjusted.screened.views), adjusted.estimate


def moments_of(simulation: Simulation) -> tuple[FrameMoments, Observations, np.ndarray]:
    options = CalibrationOptions(intrinsics="exact")
    observations = synchronise(simulation.recording)
    views, estimate = at_stage_3(observations, options)
    frames = frame_moments(views, estimate, sigma_px=0.1, free_theta=False)
    return frames, observations, prior_information(views, estimate, options)


# Sums


def test_noise_is_integrated_out_as_dense_algebra_does() -> None:
    """Against the marginal of a joint Gaussian of all the frames' noise, built as one matrix."""
    random = np.random.default_rng(0)
    n, p = 7, 5
    half = random.normal(size=(n, 6 + p + 1, 30))
    moments = half @ np.swapaxes(half, 1, 2)
    root = random.normal(size=(n, 6, 6))
    L = np.linalg.cholesky(0.01 * root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(6))
    rho = np.array([0.5, 0.9, 0.0, 0.3, 0.99, 0.2, 0.0])
    total = np.zeros((p + 1, p + 1))
    log_determinant = eliminate_noise(moments, L, rho, total)

    process = np.eye(n)
    for f in range(n):
        for g in range(f + 1, n):
            process[f, g] = process[g, f] = np.prod(rho[f:g])
    prior = np.kron(process, np.eye(6))
    H = np.zeros((6 * n, 6 * n))
    B = np.zeros((6 * n, p + 1))
    for f in range(n):
        rows = slice(6 * f, 6 * f + 6)
        H[rows, rows] = L[f].T @ moments[f, :6, :6] @ L[f]
        B[rows] = L[f].T @ moments[f, :6, 6:]
    posterior = H + np.linalg.inv(prior)
    expected = moments[:, 6:, 6:].sum(axis=0) - B.T @ np.linalg.solve(posterior, B)
    np.testing.assert_allclose(np.triu(total), np.triu(expected), rtol=1e-8)
    assert log_determinant == pytest.approx(np.linalg.slogdet(posterior @ prior)[1], rel=1e-8)


def test_correlation_falls_off_with_the_time_between_frames() -> None:
    stamps_ns = np.array([0, 10_000_000, 110_000_000, 10_110_000_000])
    np.testing.assert_allclose(correlations(stamps_ns, 0.1), [np.exp(-0.1), np.exp(-1.0), 0.0, 0.0])
    np.testing.assert_array_equal(correlations(stamps_ns, 0.0), 0.0)


def test_a_sample_of_a_long_recording_keeps_neighbours_together() -> None:
    frames = np.arange(5_000)
    sample = spread_blocks(frames)
    assert len(sample) == 200
    assert (sample[0], sample[-1]) == (0, 4_999)
    assert (np.diff(sample) == 1).sum() == 190
    np.testing.assert_array_equal(spread_blocks(frames[:150]), frames[:150])


# Sigmas


NOISES = {
    "white": TRUE,
    "little": MocapNoise(translation_mm=0.05, rotation_deg=0.005),
    "correlated": replace(TRUE, correlation_s=0.1),
    "jitter": MocapNoise(translation_mm=0.05, rotation_deg=0.005, jitter_s=0.001),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", NOISES)
def test_the_noise_is_recovered(kind: str) -> None:
    """What it does to the frames, that is: which body it is of, and which of its parts, they tell less well."""
    true = NOISES[kind]
    n_frames, duration_s = (200, 20.0) if true.correlation_s else (150, 100.0)
    ratios = []
    for seed in range(2):
        options = SimulationOptions(n_frames=n_frames, duration_s=duration_s, mocap=true)
        frames, observations, information = moments_of(simulate(options, seed=seed))
        motion = observations.motion
        found = estimate_noise(frames, motion, information)
        sigmas = MocapSigmas(true.translation_mm, true.rotation_deg)
        exact = MocapNoiseModel(
            dict.fromkeys(motion.trajectories, sigmas), correlation_s=true.correlation_s, jitter_s=true.jitter_s
        )
        sizes = [
            np.einsum("nii->ni", model.covariance(motion, frames.stamps_ns)).mean(axis=0) for model in (found, exact)
        ]
        ratios.append(np.sqrt(sizes[0] / sizes[1]))
        if true.correlation_s:
            assert found.correlation_s == pytest.approx(true.correlation_s, rel=0.5)
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.15)


def test_innovations_of_the_wrong_model_give_it_away() -> None:
    options = SimulationOptions(n_frames=200, duration_s=20.0, mocap=replace(TRUE, correlation_s=0.5))
    frames, observations, _ = moments_of(simulate(options, seed=0))
    motion = observations.motion
    white = MocapNoiseModel(dict.fromkeys(motion.trajectories, MocapSigmas(0.2, 0.02)))
    assert Whiteness.of(innovations(frames, white, motion)).lag_1 > 0.5
    small = MocapNoiseModel(dict.fromkeys(motion.trajectories, MocapSigmas(0.1, 0.01)))
    assert Whiteness.of(innovations(frames, small, motion)).variance > 2.0


def test_no_frame_of_a_few_is_gross_because_the_estimate_is_off() -> None:
    """An estimate that took the mocap as exact is itself off by more than a frame's noise where frames are few."""
    without, left_out = 0, 0
    for seed in range(6):
        simulation = simulate(SimulationOptions(n_frames=14, duration_s=60.0, mocap=TRUE), seed=seed)
        options = CalibrationOptions()
        observations = synchronise(simulation.recording)
        views, estimate = at_stage_3(observations, options)
        frames = frame_moments(views, estimate, sigma_px=0.1, free_theta=True, free_shape=True)
        information = prior_information(views, estimate, options)
        noise = MocapNoiseModel({name: MocapSigmas(0.2, 0.02) for name in observations.motion.trajectories})
        covariance = noise.covariance(observations.motion, frames.stamps_ns)
        step = shared_step(frames, noise, observations.motion, information)
        left_out += int(gross_frames(frames, covariance, step=step).sum())
        without += int(gross_frames(frames, covariance).sum())
    assert without > 3
    assert left_out == 0


def test_gross_frames_are_told_from_noise_and_do_not_sway_it() -> None:
    simulation = simulated(mocap=TRUE, frames=100)
    frames, observations, information = moments_of(simulation)
    spoilt = np.zeros(len(frames.frame_index), dtype=bool)
    spoilt[::10] = True
    shift = np.concatenate([np.eye(6), [[0.0, 0.0, 0.0, 0.0, 0.0, 0.01]]])[-1]  # 10 mm
    moments = frames.moments.copy()
    columns = np.eye(moments.shape[1])
    columns[:6, -1] = shift
    moments[spoilt] = columns.T @ moments[spoilt] @ columns
    dirty = replace(frames, moments=moments)
    clean = estimate_noise(frames, observations.motion, information)
    found = estimate_noise(dirty, observations.motion, information)
    for name, sigmas in clean.bodies.items():
        assert found.bodies[name].translation_mm == pytest.approx(sigmas.translation_mm, rel=0.25)
    gross = gross_frames(dirty, found.covariance(observations.motion, frames.stamps_ns))
    np.testing.assert_array_equal(gross, spoilt)


def test_a_view_whose_corners_lie_on_a_line_or_nowhere_does_no_harm() -> None:
    simulation = simulated(mocap=TRUE, frames=60)
    frames, observations, information = moments_of(simulation)
    moments = frames.moments.copy()
    moments[3] = 0.0
    column = moments[4][:, :1]
    moments[4] = column @ column.T / column[0]
    found = estimate_noise(replace(frames, moments=moments), observations.motion, information)
    assert all(0.05 < sigmas.translation_mm < 0.8 for sigmas in found.bodies.values())
    assert np.isfinite(innovations(replace(frames, moments=moments), found, observations.motion)).all()


def test_too_few_frames_tell_no_noise() -> None:
    frames, observations, information = moments_of(simulated(mocap=TRUE, frames=60))
    assert estimate_noise(frames.take(np.arange(2)), observations.motion, information) is None


def test_few_frames_tell_it_roughly_and_the_covariance_is_larger_for_it() -> None:
    frames, observations, information = moments_of(simulated(mocap=TRUE, frames=60))
    few = estimate_noise(frames.take(np.arange(9)), observations.motion, information)
    all_of_them = estimate_noise(frames, observations.motion, information)
    assert 3.0 <= few.degrees_of_freedom <= 54.0 - 12.0 + 1.0  # X and the rig's place take twelve numbers
    assert all_of_them.degrees_of_freedom > 5.0 * few.degrees_of_freedom
    assert few.small_sample_factor > all_of_them.small_sample_factor > 1.0


def test_frames_that_leave_an_unknown_open_tell_no_noise() -> None:
    frames, observations, information = moments_of(simulated(HEADSET))
    moments = frames.moments.copy()
    moments[:, 6, :], moments[:, :, 6] = 0.0, 0.0  # nothing is said of the first one
    assert estimate_noise(replace(frames, moments=moments), observations.motion, information) is None


# Frame-clustered


def test_clusters_are_spans_of_time() -> None:
    stamps_ns = np.arange(6) * 100_000_000
    np.testing.assert_array_equal(clusters(stamps_ns, 0.0), np.arange(6))
    np.testing.assert_array_equal(clusters(stamps_ns, 0.1), [0, 0, 0, 1, 1, 1])


def test_the_sandwich_is_that_of_the_textbook() -> None:
    """CR2 of Bell and McCaffrey (2002), written out on a small regression, in rows rather than sums."""
    random = np.random.default_rng(1)
    G, p, m = 12, 3, 5
    rows = random.normal(size=(G, m, p))
    y = rows @ [1.0, -2.0, 0.5] + random.normal(size=(G, 1)) + 0.1 * random.normal(size=(G, m))
    H = np.einsum("gmi,gmj->ij", rows, rows)
    solution = np.linalg.solve(H, np.einsum("gmi,gm->i", rows, y))
    residual = rows @ solution - y
    meat = np.zeros((p, p))
    for of_cluster, r in zip(rows, residual, strict=True):
        values, vectors = np.linalg.eigh(np.eye(m) - of_cluster @ np.linalg.solve(H, of_cluster.T))
        g = of_cluster.T @ (vectors / np.sqrt(values)) @ vectors.T @ r
        meat += np.outer(g, g)
    expected = np.linalg.solve(H, np.linalg.solve(H, meat).T)

    whole = np.concatenate([np.zeros((G, m, 6)), rows, residual[:, :, None]], axis=2)
    moments = np.swapaxes(whole, 1, 2) @ whole
    frames = FrameMoments(np.arange(G), np.arange(G) * 10**9, moments, 1.0, 1.0, 1)
    nothing = Priors(np.zeros((p, p)), np.zeros((p, p)))
    found = clustered_covariance([frames], nothing, 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    halves = [frames.take(np.arange(6)), frames.take(np.arange(6, G))]
    np.testing.assert_allclose(clustered_covariance(halves, nothing, 0.0), expected, rtol=1e-8)


# Hold-out and choice


def test_fewer_frames_than_folds_are_each_held_out() -> None:
    options = CalibrationOptions(intrinsics="exact")
    observations = synchronise(simulated(mocap=TRUE).recording)
    views, estimate = at_stage_3(observations, options)
    few = frames_of(views)[:6]
    views = {name: select_views(v, np.flatnonzero(np.isin(v.frame_index, few))) for name, v in views.items()}
    noise = MocapNoiseModel(dict.fromkeys(observations.motion.trajectories, MocapSigmas(0.2, 0.02)))
    information = prior_information(views, estimate, options)
    sums = hold_out(
        views,
        estimate,
        noise,
        observations.motion,
        sigma_px=0.1,
        free_theta=False,
        information=information,
        exact_information=information,
    )
    assert len(sums.blocks) == 6 < FOLDS
    assert 0.0 < sums.noisy_rmse_px < np.inf


@pytest.fixture(scope="module", name="held_out")
def _held_out() -> tuple[MocapNoiseFit, float]:
    """The linear hold-out of stage 3, and the one of a solution anew without each block."""
    options = CalibrationOptions(intrinsics="exact")
    observations = synchronise(simulated(mocap=TRUE, frames=60).recording)
    views, estimate = at_stage_3(observations, options)
    noise = MocapNoiseModel(dict.fromkeys(observations.motion.trajectories, MocapSigmas(0.2, 0.02)))
    information = prior_information(views, estimate, options)
    sums = hold_out(
        views,
        estimate,
        noise,
        observations.motion,
        sigma_px=0.1,
        free_theta=False,
        information=information,
        exact_information=information,
    )
    return MocapNoiseFit(noise, 0.1, sums, ()), _solved_anew(views, estimate, options)


def _solved_anew(views: dict[str, Views], estimate: Estimate, options: CalibrationOptions) -> float:
    squares, n = 0.0, 0
    for block in np.array_split(frames_of(views), FOLDS):
        kept = {name: select_views(v, np.flatnonzero(~np.isin(v.frame_index, block))) for name, v in views.items()}
        found = adjust(kept, estimate, replace(options, screen=False)).estimate
        for v in views.values():
            rows = np.flatnonzero(np.isin(v.frame_index, block))
            if not rows.size:
                continue
            out = chain_residuals_px(select_views(v, rows), found)
            squares, n = squares + float((out**2).sum()), n + len(out)
    return float(np.sqrt(squares / n))


def test_the_linear_hold_out_is_that_of_solving_anew(held_out: tuple[MocapNoiseFit, float]) -> None:
    fit, anew_px = held_out
    assert fit.hold_out.exact_rmse_px == pytest.approx(anew_px, rel=2e-3)
    assert fit.hold_out.noisy_rmse_px < fit.hold_out.exact_rmse_px


@pytest.mark.parametrize(
    ("lag_1", "stage", "because"), [(0.05, 4, "noise modelled"), (0.9, 3, "not white"), (-0.9, 4, "noise modelled")]
)
def test_the_stage_is_chosen_by_what_the_innovations_show(
    held_out: tuple[MocapNoiseFit, float], lag_1: float, stage: int, because: str
) -> None:
    chosen = choose(held_out[0], Whiteness(1.0, lag_1, 0.05))
    assert (chosen.stage, because in chosen.reason) == (stage, True)


def test_a_worse_hold_out_decides_for_stage_3(held_out: tuple[MocapNoiseFit, float]) -> None:
    """Blocks whose noisy sums teach something else than the exact ones."""
    fit = held_out[0]
    shift = np.eye(len(fit.hold_out.exact_information))
    shift[:6, -1] = 0.01
    blocks = tuple(replace(block, noisy=shift.T @ block.noisy @ shift) for block in fit.hold_out.blocks)
    worse = replace(fit, hold_out=replace(fit.hold_out, blocks=blocks))
    chosen = choose(worse, Whiteness(1.0, 0.0, 0.05))
    assert chosen.stage == 3
    assert "systematic" in chosen.reason


@pytest.mark.parametrize("capture", [Capture.FIXED_CAMERAS, Capture.STANDING_BOARD])
def test_one_tracked_body_has_one_pair_of_sigmas(capture: Capture) -> None:
    options = SimulationOptions(capture=capture, n_frames=60, duration_s=40.0, mocap=TRUE)
    frames, observations, information = moments_of(simulate(options, seed=0))
    found = estimate_noise(frames, observations.motion, information)
    assert list(found.bodies) == list(observations.motion.trajectories)
    L = lower_factors(found.covariance(observations.motion, frames.stamps_ns))
    assert (np.einsum("nii->ni", L) > 0.0).all()
