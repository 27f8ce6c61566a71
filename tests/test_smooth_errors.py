"""Errors of the mocap that are no noise are found, modelled and told; noise is not taken for them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import gtsam
import numpy as np
import pytest
import systematic
from calibration_support import simulated

from factors.rigid import inverse
from gtcal.effects.find import noise_model
from gtcal.estimation import smooth_errors as module
from gtcal.estimation import solver
from gtcal.estimation.errors_in_variables import fit_mocap_noise, prior_information
from gtcal.estimation.frame_statistics import eliminate_noise, frame_moments, frames_of
from gtcal.estimation.mocap_noise import lower_factors
from gtcal.estimation.observations import Observations, synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.screening import screen
from gtcal.estimation.solver import calibrate_observations
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import MocapNoise, Simulation

OPTIONS = CalibrationOptions(intrinsics="exact")
NOISE = MocapNoise(translation_mm=0.2, rotation_deg=0.02)
SPOILT = {
    "clean": lambda simulation: simulation.recording,
    "joints": lambda simulation: systematic.joint_errors(simulation, 0.5),
    "slip": lambda simulation: systematic.slip("platform")(simulation, 0.7),
}


@cache
def simulation(seed: int) -> Simulation:
    return simulated(seed=seed, frames=60, mocap=NOISE)


@cache
def observed(what: str, seed: int) -> Observations:
    return synchronise(SPOILT[what](simulation(seed)))


@cache
def found(what: str, seed: int) -> Calibration:
    return calibrate_observations(observed(what, seed), OPTIONS)


def nees_per_dof(calibration: Calibration, seed: int) -> float:
    """Of the cameras."""
    squares = []
    for name, camera in calibration.cameras.items():
        apart_T = inverse(camera.camera_T_ref.a_T_b) @ simulation(seed).truth.camera_T_ref[name]
        xi = np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(apart_T)))
        squares.append(xi @ np.linalg.solve(camera.camera_T_ref.covariance, xi) / 6.0)
    return float(np.mean(squares))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_an_arms_joints_are_found_and_the_sigma_holds(seed: int) -> None:
    calibration = found("joints", seed)
    noise = calibration.mocap_noise
    assert noise is not None
    largest = noise.smooth[0]
    assert (largest.body, largest.over) == ("platform", "place")
    assert 0.2 < largest.translation_mm < 1.0
    assert nees_per_dof(calibration, seed) < 3.0
    (warning,) = (line for line in calibration.warnings if "not noise alone" in line)
    assert "those of 'platform' vary with where it is" in warning


@pytest.mark.long
def test_the_estimate_is_better_for_it() -> None:
    def off_mm(estimate: object, seed: int) -> float:
        true_T = simulation(seed).truth.camera_T_ref
        poses = estimate.camera_T_ref  # type: ignore[attr-defined]
        return float(
            np.mean([1e3 * np.linalg.norm((inverse(T) - inverse(true_T[n]))[:3, 3]) for n, T in poses.items()])
        )

    before, after = ([off_mm(found("joints", seed).estimates[stage], seed) for seed in range(3)] for stage in (3, 4))
    assert np.mean(after) < 0.7 * np.mean(before)


def test_a_slip_under_what_changes_can_be_told_by_is_in_the_sigma() -> None:
    calibration = found("slip", 0)
    assert calibration.mocap_noise is not None
    largest = calibration.mocap_noise.smooth[0]
    assert (largest.body, largest.over) == ("platform", "time")
    assert nees_per_dof(calibration, 0) < 3.0


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_taken_for_it(seed: int) -> None:
    calibration = found("clean", seed)
    assert calibration.mocap_noise is not None
    assert calibration.mocap_noise.smooth == ()
    assert not any("noise alone" in line for line in calibration.warnings)


def test_with_many_frames_the_estimate_stays_and_its_covariance_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "MOST_FRAMES", 10)
    kept = calibrate_observations(observed("joints", 0), OPTIONS)
    assert kept.mocap_noise is not None
    np.testing.assert_array_equal(kept.estimate.body_T_board, kept.estimates[kept.mocap_noise.stage].body_T_board)
    assert kept.mocap_noise.smooth == found("joints", 0).mocap_noise.smooth
    assert nees_per_dof(kept, 0) < 3.0


def test_it_survives_the_file(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.json", found("joints", 0))
    assert read_calibration(tmp_path / "calibration.json").mocap_noise == found("joints", 0).mocap_noise


# The sums


@cache
def problem() -> tuple[module._Problem, module._Process]:
    """Of every third frame, as stage 3 leaves it."""
    observations = observed("joints", 0)
    calibration = found("joints", 0)
    views, estimate = observations.views, calibration.estimates[3]
    noise = solver_noise()
    part = frame_moments(views, estimate, sigma_px=0.1, free_theta=False, frames=frames_of(views)[::3])
    information = prior_information(views, estimate, OPTIONS)
    split = module._Problem.of(part.moments, information)
    return split, module._Process.of(part.stamps_ns, noise, observations.motion)


def solver_noise() -> module.MocapNoiseModel:
    taken = found("joints", 0).mocap_noise
    assert taken is not None
    return replace(noise_model(taken), correlation_s=0.0)


def test_with_white_noise_alone_the_sums_are_those_of_the_filter() -> None:
    observations, estimate = observed("joints", 0), found("joints", 0).estimates[3]
    frames = frames_of(observations.views)[::3]
    part = frame_moments(observations.views, estimate, sigma_px=0.1, free_theta=False, frames=frames)
    split, process = problem()
    scales = np.array([1.0, *(0.0 for _ in process.names)])
    expected = np.zeros_like(split.rest)
    L = lower_factors(solver_noise().covariance(observations.motion, part.stamps_ns))
    eliminate_noise(part.moments, L, np.zeros(len(frames)), expected)
    whole = np.triu(expected) + np.triu(expected, 1).T
    np.testing.assert_allclose(split.marginal(process.covariance(scales)), whole, rtol=1e-6, atol=1e-7 * whole.max())


def test_the_likelihoods_slopes_are_its_derivatives() -> None:
    split, process = problem()
    measured = process.measured_by(split.root)
    at = np.array([0.5, *(0.3 for _ in process.names)])
    _, slopes = split.cost(at, measured)
    for i, slope in enumerate(slopes):
        step = np.zeros(len(at))
        step[i] = 1e-4
        numeric = (split.cost(at + step, measured)[0] - split.cost(at - step, measured)[0]) / 2e-4
        assert slope == pytest.approx(numeric, rel=1e-4, abs=1e-5)


def test_parts_are_as_alike_as_time_and_place_say() -> None:
    split, process = problem()
    n = len(split.root)
    assert set(process.names) == {(body, over) for body in ("platform", "board_body") for over in ("time", "place")}
    for term in process.terms:
        values = np.linalg.eigvalsh(term)
        assert values[0] > -1e-9 * values[-1]
    place = process.terms[1 + process.names.index(("board_body", "place"))].reshape(n, 6, n, 6)
    like = place[:, 3, :, 3] / place[0, 3, 0, 3]
    np.testing.assert_allclose(np.diag(like), 1.0)
    assert 0.0 < like[0, 1:].min() < 0.5


def test_the_estimate_is_where_its_likelihood_is_largest() -> None:
    """Another step would be a small part of a sigma; and the factor's linear form is that of its sums."""
    observations = observed("joints", 0)
    adjusted, fit = fitted(observations)
    smooth = module.find_smooth_errors(adjusted, fit, observations.motion, OPTIONS)
    assert smooth is not None
    settled = module.adjust_with_smooth_errors(adjusted, fit, smooth, observations.motion, OPTIONS)
    assert settled.graph.error(settled.values) < settled.graph.error(adjusted.values)
    linear = settled.graph.linearize(settled.values)
    marginals = gtsam.Marginals(settled.graph, settled.values)
    step = linear.optimize()
    for key in settled.values.keys():  # noqa: SIM118 (gtsam.Values is no mapping)
        assert np.abs(step.at(key) / np.sqrt(np.diag(marginals.marginalCovariance(key)))).max() < 0.05


def fitted(observations: Observations) -> tuple[solver.Adjusted, module.MocapNoiseFit]:
    """Stage 3, and the noise that it shows."""
    solution = calibrate_observations(observations, replace(OPTIONS, mocap="exact"))
    assert solution.solution is not None
    screened = screen(solution.solution.views, solution.estimate)
    adjusted = solver.Adjusted(
        solution.estimate, solution.sigma_px, screened, solution.solution.graph, solution.solution.values, ()
    )
    fitted = fit_mocap_noise(adjusted, observations.motion, OPTIONS)
    assert fitted is not None
    return fitted


def test_a_body_that_stands_still_has_no_errors_by_place() -> None:
    trajectory = simulation(0).recording.platform
    assert trajectory is not None
    still = replace(trajectory, world_T_body=np.repeat(trajectory.world_T_body[:1], trajectory.n_samples, axis=0))
    assert module._in_place(still, still.stamps_ns[:5]) is None
