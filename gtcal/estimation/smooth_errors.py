"""Errors of the mocap that are no noise: smooth in time (markers that creep or slip, a volume that warms), or in where
a body is (an arm's joints, a camera of the mocap that is off).

Such errors do not average out over frames, and what of them looks like another X or Y_c is in no residual at all. But
the rest is, and by its size and smoothness it tells of what is not: the errors of each body are taken for a Gaussian
process (Rasmussen and Williams 2006; as a model's discrepancy: Kennedy and O'Hagan 2001), with the covariance

    white noise + part in time * exp(-|dt| / (T / 2)) + part in place * exp(-d^2 / 2)

along and about the body's axes, in units of the noise that stage 4 estimated. T is the length of the recording, d the
distance of two poses in units of how far the body's poses are spread, turns and shifts alike. The sizes of the parts
are those of the largest restricted likelihood, which allows for what the unknowns take up; none is there unless the
likelihood gains more by it than chance lets it.

With few frames the estimate is that of the largest likelihood under these errors; with many, which would take too long,
it stays, and its covariance is what they make of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize

from factors.marginal import MarginalFactor
from gtcal.camera import FloatArray
from gtcal.estimation.adjustment import Adjusted
from gtcal.estimation.clustered import stamps_of
from gtcal.estimation.errors_in_variables import MocapNoiseFit, moments_of, prior_information, priors_graph, shared_keys
from gtcal.estimation.frame_statistics import evenly, frames_of
from gtcal.estimation.graph import minimise, to_values, updated
from gtcal.estimation.linear import scaled_inverse
from gtcal.estimation.mocap_noise import MocapNoiseModel, NoiseBases, lower_factors
from gtcal.estimation.options import CalibrationOptions
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory
from gtcal.results.calibration import SmoothError

LEAST_GAIN = 8.0
"""Twice the logarithm of the likelihood that smooth errors must gain. Of four variances that are zero, chance reaches
that once in forty (a mixture of chi-squared of 0 to 4 degrees of freedom: Self and Liang 1987); the mistake costs some
certainty, and no truth."""

MOST_FRAMES = 160
"""Up to which the estimate itself is that of the largest likelihood: a system of 960 numbers."""

TIME, PLACE = "time", "place"

_FRAMES_TO_FIND = 60
_FEWEST_FRAMES = 12
_TIMES = 0.5  # of the recording's length: over which an error in time forgets itself
_SMALL = 1e-3  # of the noise's variance: a part under this is none
_FIRST, _LARGEST, _LEAST_WHITE = 0.1, 400.0, 0.02
_MOST_STEPS = 40


@dataclass(frozen=True)
class SmoothErrors:
    """white: the variance of the noise, and shares: by body and by what it is smooth in, that of each part; in units of
    the noise that was estimated without them. gain: twice the logarithm of the likelihood's."""

    white: float
    shares: Mapping[tuple[str, str], float]
    gain: float

    def told(self, noise: MocapNoiseModel) -> tuple[SmoothError, ...]:
        """In mm and deg, largest first."""
        parts = [
            SmoothError(
                body,
                over,
                float(np.sqrt(share)) * noise.bodies[body].translation_mm,
                float(np.sqrt(share)) * noise.bodies[body].rotation_deg,
            )
            for (body, over), share in self.shares.items()
        ]
        return tuple(sorted(parts, key=lambda part: -part.translation_mm))


@dataclass(frozen=True)
class _Process:
    """What the errors of n frames may be: (6n, 6n) covariances of xi in ref_T_body * Exp(xi). terms: the white noise,
    then each part of ``names``."""

    names: tuple[tuple[str, str], ...]
    terms: FloatArray

    def measured_by(self, root: FloatArray) -> _Process:
        """The same in the coordinates in which each frame's corners measure its pose with unit covariance. root:
        (n, 6, 6) R with R^T R the information that they have of it."""
        return replace(self, terms=np.stack([_measured(root, term) for term in self.terms]))

    def covariance(self, scales: FloatArray) -> FloatArray:
        """(6n, 6n) by the scale of each term."""
        return np.asarray(np.tensordot(scales, self.terms, axes=1))

    @staticmethod
    def of(stamps_ns: IntArray, noise: MocapNoiseModel, motion: RefMotion) -> _Process:
        bases, since_s = NoiseBases.of(motion, stamps_ns), 1e-9 * (stamps_ns - stamps_ns[0])
        apart_s = np.abs(since_s[:, None] - since_s)
        in_time = np.exp(-apart_s / max(_TIMES * float(since_s[-1]), 1e-9))
        alike = np.exp(-apart_s / noise.correlation_s) if noise.correlation_s > 0.0 else np.eye(len(stamps_ns))
        names, terms = [], [_spread(lower_factors(noise.composed(bases)), alike)]
        for body, trajectory in motion.trajectories.items():
            sigmas = noise.bodies[body]
            unit = bases.carried[body] * np.repeat([np.deg2rad(sigmas.rotation_deg), 1e-3 * sigmas.translation_mm], 3)
            unit = np.broadcast_to(unit, (len(stamps_ns), 6, 6))
            for over, kernel in (
                (TIME, None if motion.numbered else in_time),
                (PLACE, _in_place(trajectory, stamps_ns)),
            ):
                if kernel is not None:
                    names.append((body, over))
                    terms.append(_spread(unit, kernel))
        return _Process(tuple(names), np.stack(terms))


def _spread(unit: FloatArray, kernel: FloatArray) -> FloatArray:
    """(6n, 6n) covariance of unit_f z_f, (n, 6, 6), for z_f whose components are correlated by kernel (n, n)."""
    stacked = unit.reshape(-1, 6)
    return np.asarray((stacked @ stacked.T) * np.repeat(np.repeat(kernel, 6, axis=0), 6, axis=1))


def _measured(root: FloatArray, covariance: FloatArray) -> FloatArray:
    """R covariance R^T, R (n, 6, 6) block by block."""
    n = len(root)
    half = (root @ covariance.reshape(n, 6, 6 * n)).reshape(6 * n, 6 * n)
    return np.asarray((root @ half.T.reshape(n, 6, 6 * n)).reshape(6 * n, 6 * n))


def _in_place(trajectory: Trajectory, stamps_ns: IntArray) -> FloatArray | None:
    """(n, n) how alike errors are that depend on the body's pose; None for one that stands still."""
    poses = trajectory.interpolate(stamps_ns, np.inf).world_T_body
    square = np.zeros((len(poses), len(poses)))
    for part in (poses[:, :3, :3].reshape(-1, 9), poses[:, :3, 3]):
        part = part - part.mean(axis=0)
        spread = float((part**2).sum(axis=1).mean())
        if not spread > _STANDS_STILL:
            return None
        square += ((part[:, None] - part) ** 2).sum(axis=2) / spread
    return np.asarray(np.exp(-0.5 * square))


_STANDS_STILL = 1e-8  # m^2, and of a rotation matrix's entries: 0.1 mm, 0.006 deg


@dataclass(frozen=True)
class _Problem:
    """Frames' moments with their poses' part split off.

    root: (n, 6, 6) R with R^T R the information that each frame's corners have of its pose. measured: (6n, P + 1) what
        they say of the unknowns by way of the pose, with unit covariance. rest: (P + 1, P + 1) what they say apart
        from that, priors included."""

    root: FloatArray
    measured: FloatArray
    rest: FloatArray

    @staticmethod
    def of(moments: FloatArray, information: FloatArray) -> _Problem:
        values, vectors = np.linalg.eigh(moments[:, :6, :6])
        root = np.sqrt(np.maximum(values, 0.0))
        known = values > _OPEN * values[:, -1:]
        inverse = np.where(known, 1.0 / np.where(known, root, 1.0), 0.0)
        turned = np.swapaxes(vectors, 1, 2)
        measured = (inverse[:, :, None] * turned @ moments[:, :6, 6:]).reshape(-1, moments.shape[1] - 6)
        rest = moments[:, 6:, 6:].sum(axis=0) + information - measured.T @ measured
        return _Problem(root[:, :, None] * turned, measured, rest)

    def marginal(self, errors: FloatArray) -> FloatArray:
        """(P + 1, P + 1) with errors of this covariance (6n, 6n) integrated out."""
        measured = _measured(self.root, errors)
        factor = cholesky(measured + np.eye(len(measured)), lower=True, check_finite=False)
        return np.asarray(self.rest + self.measured.T @ cho_solve((factor, True), self.measured, check_finite=False))

    def cost(self, scales: FloatArray, process: _Process) -> tuple[float, FloatArray]:
        """Minus the logarithm of the restricted likelihood, and its gradient by the scales of a process as of
        ``measured_by``."""
        factor = cholesky(process.covariance(scales) + np.eye(len(self.measured)), lower=True, check_finite=False)
        inverse = cho_solve((factor, True), np.eye(len(factor)), check_finite=False)
        solved = inverse @ self.measured
        sums = self.rest + self.measured.T @ solved
        scale = 1.0 / np.sqrt(np.diag(sums)[:-1])
        unit = np.linalg.cholesky(sums[:-1, :-1] * np.outer(scale, scale))
        white = np.linalg.solve(unit, scale[:, None] * solved[:, :-1].T)
        gradient = np.linalg.solve(unit, scale * sums[:-1, -1])
        left = solved[:, -1] - white.T @ gradient
        logarithm = np.log(np.diag(factor)).sum() + np.log(np.diag(unit) / scale).sum()
        projected = inverse - white.T @ white
        slopes = [0.5 * float((projected * term).sum() - left @ term @ left) for term in process.terms]
        return float(logarithm + 0.5 * (sums[-1, -1] - gradient @ gradient)), np.array(slopes)


_OPEN = 1e-9


def find_smooth_errors(
    adjusted: Adjusted, fit: MocapNoiseFit, motion: RefMotion, options: CalibrationOptions
) -> SmoothErrors | None:
    """Those that the frames show at an estimate; None where noise explains them as well."""
    frames = evenly(frames_of(adjusted.screened.views), _FRAMES_TO_FIND)
    if len(frames) < _FEWEST_FRAMES:
        return None
    part = moments_of(adjusted.screened.views, adjusted.estimate, options, fit.sigma_px, frames)
    problem = _Problem.of(part.moments, prior_information(adjusted.screened.views, adjusted.estimate, options))
    process = _Process.of(part.stamps_ns, fit.noise, motion).measured_by(problem.root)
    n = len(process.names)
    without = _most_likely(problem, process, np.array([1.0] + [0.0] * n), [(0.0, 0.0)] * n)
    found = _most_likely(problem, process, np.array([1.0] + [_FIRST] * n), [(0.0, _LARGEST)] * n)
    gain = 2.0 * (without[1] - found[1])
    if gain < LEAST_GAIN:
        return None
    white, *shares = found[0]
    named = {name: float(share) for name, share in zip(process.names, shares, strict=True) if share > _SMALL}
    return SmoothErrors(float(white), named, gain)


def _most_likely(
    problem: _Problem, process: _Process, start: FloatArray, bounds: list[tuple[float, float]]
) -> tuple[FloatArray, float]:
    found = minimize(
        problem.cost,
        start,
        args=(process,),
        jac=True,
        method="L-BFGS-B",
        bounds=[(_LEAST_WHITE, _LARGEST), *bounds],
        options={"maxiter": _MOST_STEPS, "ftol": 1e-5},
    )
    return found.x, float(found.fun)


def adjust_with_smooth_errors(
    adjusted: Adjusted, fit: MocapNoiseFit, smooth: SmoothErrors, motion: RefMotion, options: CalibrationOptions
) -> Adjusted:
    """The estimate of the largest likelihood under these errors, from ``adjusted`` on, on its views."""
    views = adjusted.screened.views
    frames = frames_of(views)
    sizes = shared_keys(views, options)
    nothing = np.zeros((1 + sum(sizes.values()),) * 2)
    process = _Process.of(stamps_of(views), fit.noise, motion)
    errors = process.covariance(_scales(process, smooth))

    def moments(values: gtsam.Values) -> FloatArray:
        part = moments_of(views, updated(adjusted.estimate, values), options, fit.sigma_px, frames)
        return _Problem.of(part.moments, nothing).marginal(errors)

    graph = gtsam.NonlinearFactorGraph()
    graph.add(MarginalFactor(list(sizes), list(sizes.values()), moments))
    graph.push_back(priors_graph(views, options))
    start = to_values(adjusted.estimate, with_theta=options.refine_intrinsics, with_shape=options.solves_board_shape)
    found = minimise(graph, start, eps=options.eps, max_iterations=options.max_iterations)
    estimate = updated(adjusted.estimate, found.values)
    return Adjusted(estimate, fit.sigma_px, adjusted.screened.under(estimate), graph, found.values, found.errors)


def covariance_under(
    adjusted: Adjusted,
    fit: MocapNoiseFit,
    smooth: SmoothErrors,
    motion: RefMotion,
    options: CalibrationOptions,
    *,
    models_noise: bool,
) -> FloatArray:
    """(P, P) covariance under these errors of an estimate that takes the mocap's noise for white (``models_noise``), or
    the mocap as exact: a sandwich.

    Raises numpy.linalg.LinAlgError where the data leave a direction open."""
    views = adjusted.screened.views
    every = frames_of(views)
    frames = evenly(every, MOST_FRAMES)
    share = len(every) / len(frames)
    weight = 1.0 if models_noise else adjusted.lens_weight * (adjusted.sigma_px / fit.sigma_px) ** 2
    information, scatter = (
        prior_information(views, adjusted.estimate, options, w)[:-1, :-1] for w in (weight, weight**2)
    )
    part = moments_of(views, adjusted.estimate, options, fit.sigma_px, frames)
    problem = _Problem.of(part.moments, np.zeros((part.n_unknowns + 1,) * 2))
    process = _Process.of(part.stamps_ns, fit.noise, motion).measured_by(problem.root)
    scales, unit = _scales(process, smooth), np.eye(len(problem.measured))
    weighed = np.linalg.solve(unit + float(models_noise) * process.terms[0], problem.measured[:, :-1])
    H = share * (problem.rest[:-1, :-1] + problem.measured[:, :-1].T @ weighed) + information
    white, parts = unit + scales[0] * process.terms[0], np.tensordot(scales[1:], process.terms[1:], axes=1)
    moved = share * (problem.rest[:-1, :-1] + weighed.T @ white @ weighed) + share**2 * weighed.T @ parts @ weighed
    inverse = scaled_inverse(H)
    return np.asarray(inverse @ (moved + scatter) @ inverse)


def _scales(process: _Process, smooth: SmoothErrors) -> FloatArray:
    return np.array([smooth.white, *(smooth.shares.get(name, 0.0) for name in process.names)])
