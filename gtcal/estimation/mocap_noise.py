"""How noisy the mocap and the pixels are: given, or estimated from the recording.

Variance components: what moves all corners of a frame together, in all cameras, is the mocap's noise; what scatters the
corners of a view is the pixels'. The noise sits at each tracked body, world_T_body * Exp(noise), with a sigma of its
translation and one of its rotation; jitter of the clock moves ref_T_body along its own velocity. Composed and
interpolated they become the covariance of each frame's ref_T_body. Their sizes and the time over which the noise is
correlated are those of the largest restricted likelihood (REML: Patterson and Thompson 1971), which allows for the
unknowns that the same frames determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from factors.rigid import adjoint, inverse
from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.frame_statistics import SMALLEST_CORRELATION, FrameMoments, regular, subtract_noise
from gtcal.estimation.linear import scaled_inverse
from gtcal.estimation.options import MocapSigmas
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

MOST_FRAMES = 200
"""Frames that the noise is estimated from: 1,200 numbers for a handful of sigmas, good to some 5 %."""

FEWEST_NUMBERS = 3
"""Least surplus of the mocap's numbers over the unknowns that they determine, from which a variance is estimated."""

GROSS_PROBABILITY = 1e-6
"""A frame whose mocap pose is off by what noise reaches once in a million frames is gross."""

_BLOCKS = 10
_HARDLY_ANYTHING = 1e-6  # information, where the noise itself has 1: on a direction that a frame leaves open
_WIDE = 3.0  # of the logarithm of a sigma: hardly a prior, but a component that the data do not show stays finite
_TYPICAL_JITTER_S, _TYPICAL_CORRELATION_S = 1e-4, 0.02
_ACCURACY = {"ftol": 1e-7}  # of a cost of some ten thousands: a thousandth of a likelihood's unit
_NOTHING_KNOWN = 1e4  # times the noise's sigmas: the mocap as good as gone
_SMALLEST, _LARGEST = 1e-2, 1e2  # of a component, as a multiple of its first guess


@dataclass(frozen=True)
class MocapNoiseModel:
    """The mocap's noise in a recording.

    bodies: by tracked body, 'platform' and 'board_body'.
    correlation_s: time over which the noise of a body is correlated (to 1/e); 0 for white noise.
    jitter_s: 1-sigma of the time at which the mocap measured a body, independent from sample to sample.
    estimated: from the recording, else given.
    degrees_of_freedom: of the numbers that it was estimated from; infinite where it was given."""

    bodies: dict[str, MocapSigmas]
    correlation_s: float = 0.0
    jitter_s: float = 0.0
    estimated: bool = False
    degrees_of_freedom: float = np.inf

    @property
    def small_sample_factor(self) -> float:
        """By how much a variance that rests on this noise is to be larger, for the noise is itself an estimate: that
        of Student's t over a Gaussian's."""
        return 1.0 / (1.0 - 2.0 / self.degrees_of_freedom)

    def covariance(self, motion: RefMotion, stamps_ns: IntArray) -> FloatArray:
        """(N, 6, 6) of xi in ref_T_body * Exp(xi) at ``stamps_ns`` (N,), rotation first, in rad and m.

        ref_T_body = world_T_platform^-1 * world_T_board_body: the board body's noise acts where it is, the platform's
        is carried over by the adjoint. Interpolation between two samples averages what they do not share."""
        return self.composed(NoiseBases.of(motion, stamps_ns))

    def composed(self, bases: NoiseBases) -> FloatArray:
        """(N, 6, 6), as ``covariance``."""
        variances = [bases.jitter * self.jitter_s**2]
        for name, sigmas in self.bodies.items():
            share = bases.share(name, self.correlation_s)[:, None, None]
            variances.append(share * (1e-3 * sigmas.translation_mm) ** 2 * bases.translation[name])
            variances.append(share * np.deg2rad(sigmas.rotation_deg) ** 2 * bases.rotation[name])
        return np.sum(variances, axis=0)

    def correlations(self, stamps_ns: IntArray) -> FloatArray:
        """(N,) correlation of the noise at each of N increasing times with that at the next; 0 for the last."""
        return correlations(stamps_ns, self.correlation_s)


def lower_factors(covariance: FloatArray) -> FloatArray:
    """(N, 6, 6) L with L L^T = covariance."""
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def correlations(stamps_ns: IntArray, correlation_s: float) -> FloatArray:
    """(N,) exp(-dt / correlation_s) from each of N increasing times to the next; 0 where there is hardly any."""
    rho = np.zeros(len(stamps_ns))
    if correlation_s > 0.0:
        rho[:-1] = np.exp(-1e-9 * np.diff(stamps_ns) / correlation_s)
    return np.where(rho < SMALLEST_CORRELATION, 0.0, rho)


def spread_blocks(frames: IntArray) -> IntArray:
    """At most MOST_FRAMES of the frames, in blocks of neighbours, so that correlation in time shows."""
    if len(frames) <= MOST_FRAMES:
        return frames
    length = MOST_FRAMES // _BLOCKS
    starts = np.linspace(0, len(frames) - length, _BLOCKS).astype(np.int64)
    return frames[(starts[:, None] + np.arange(length)).ravel()]


@dataclass(frozen=True)
class NoiseBases:
    """What a unit of each noise does to ref_T_body at N times: (N, 6, 6) each, by tracked body, and for the jitter.

    carried: by tracked body, what takes an error in the body's own frame to one of ref_T_body; (1, 6, 6) where that is
        the same at all times."""

    motion: RefMotion
    stamps_ns: IntArray
    carried: dict[str, FloatArray]
    translation: dict[str, FloatArray]
    rotation: dict[str, FloatArray]
    jitter: FloatArray

    @staticmethod
    def of(motion: RefMotion, stamps_ns: IntArray) -> NoiseBases:
        unit = {"rotation": np.diag([1.0, 1, 1, 0, 0, 0]), "translation": np.diag([0.0, 0, 0, 1, 1, 1])}
        ref_T_body = motion.at(stamps_ns).ref_T_body
        carried, translation, rotation, jitter = {}, {}, {}, np.zeros((len(stamps_ns), 6, 6))
        for name, trajectory in motion.trajectories.items():
            to_board = np.eye(6)[None] if name == "board_body" else adjoint(inverse(ref_T_body))
            carried[name] = to_board
            if not motion.numbered:
                twist = np.nan_to_num(trajectory.twist_per_s(stamps_ns))
                moved = (to_board @ twist[:, :, None])[:, :, 0]
                share = trajectory.interpolated_variance(stamps_ns, 0.0)
                jitter += share[:, None, None] * np.einsum("ni,nj->nij", moved, moved)
            translation[name], rotation[name] = (
                to_board @ unit[kind] @ np.swapaxes(to_board, 1, 2) for kind in ("translation", "rotation")
            )
        return NoiseBases(motion, stamps_ns, carried, translation, rotation, jitter)

    def take(self, rows: IntArray) -> NoiseBases:
        """Only these times."""

        def of_times(bases: dict[str, FloatArray]) -> dict[str, FloatArray]:
            return {name: base[rows] if len(base) > 1 else base for name, base in bases.items()}

        return NoiseBases(
            self.motion,
            self.stamps_ns[rows],
            of_times(self.carried),
            of_times(self.translation),
            of_times(self.rotation),
            self.jitter[rows],
        )

    def share(self, body: str, correlation_s: float) -> FloatArray:
        """(N,) variance of the body's interpolated pose, as a share of a sample's."""
        return self.motion.trajectories[body].interpolated_variance(self.stamps_ns, correlation_s)


def estimate_noise(frames: FrameMoments, motion: RefMotion, information: FloatArray) -> MocapNoiseModel | None:
    """The mocap's noise that the frames show, gross ones left aside. information: (P + 1, P + 1) what else is known of
    the unknowns (priors).

    None where the frames are too few to tell, or leave an unknown open."""
    try:
        found = _estimated(frames, motion, information)
    except np.linalg.LinAlgError:
        return None
    return found if found.degrees_of_freedom >= FEWEST_NUMBERS else None


def _estimated(frames: FrameMoments, motion: RefMotion, information: FloatArray) -> MocapNoiseModel:
    problem = _Likelihood.of(frames, motion, information)
    sigmas = problem.first_guess
    gross = np.zeros(len(frames.frame_index), dtype=bool)
    for allowance in (10.0, 1.0):
        step = None
        if allowance == 1.0:
            step = shared_step(frames.take(np.flatnonzero(~gross)), problem.noise(sigmas), motion, information)
        now = gross_frames(frames, problem.covariance(sigmas), allowance, step)
        if allowance == 1.0 and (now == gross).all():
            break
        gross = now
        sigmas = problem.most_likely(sigmas, np.flatnonzero(~gross))
    surplus = problem.degrees_of_freedom(sigmas, np.flatnonzero(~gross))
    return replace(problem.noise(sigmas), degrees_of_freedom=surplus)


def innovations(frames: FrameMoments, noise: MocapNoiseModel, motion: RefMotion) -> FloatArray:
    """(n, 6) by how much the noise of each frame differs from what the frames before it let expect, whitened: where the
    model holds, independent and of unit variance."""
    L = np.linalg.cholesky(noise.covariance(motion, frames.stamps_ns))
    rho = noise.correlations(frames.stamps_ns)
    pose = np.swapaxes(L, 1, 2) @ frames.moments[:, :6, :6] @ L + _HARDLY_ANYTHING * np.eye(6)
    gradient = (np.swapaxes(L, 1, 2) @ frames.moments[:, :6, -1:])[:, :, 0]
    mean, covariance, found = np.zeros(6), np.eye(6), np.empty((len(L), 6))
    for f in range(len(L)):
        measured = np.linalg.inv(pose[f])
        scatter = covariance + measured
        difference = -measured @ gradient[f] - mean
        found[f] = np.linalg.solve(np.linalg.cholesky(scatter), difference)
        gain = covariance @ np.linalg.inv(scatter)
        mean = rho[f] * (mean + gain @ difference)
        covariance = rho[f] ** 2 * (covariance - gain @ covariance) + (1.0 - rho[f] ** 2) * np.eye(6)
    return found


@dataclass(frozen=True)
class Whiteness:
    """Whether the noise model explains the frames' offsets.

    variance: of the whitened innovations; 1 where the sigmas are right.
    lag_1: their correlation from a frame to the next; 0 where nothing systematic is left. lag_1_sigma: of chance."""

    variance: float
    lag_1: float
    lag_1_sigma: float

    @staticmethod
    def of(innovations: FloatArray) -> Whiteness:
        square = float((innovations**2).sum())
        product = float((innovations[1:] * innovations[:-1]).sum())
        n = innovations[1:].size
        return Whiteness(
            square / innovations.size, product / square if square else 0.0, float(1.0 / np.sqrt(max(n, 1)))
        )


@dataclass(frozen=True)
class SharedStep:
    """By how much the unknowns that all frames share move once the mocap's noise is modelled: mean (P,), covariance
    (P, P)."""

    mean: FloatArray
    covariance: FloatArray


def shared_step(frames: FrameMoments, noise: MocapNoiseModel, motion: RefMotion, information: FloatArray) -> SharedStep:
    """Of these frames and what else is known (P + 1, P + 1). Raises numpy.linalg.LinAlgError where both leave an
    unknown open."""
    total = information + frames.exact.sum(axis=0)
    L = lower_factors(noise.covariance(motion, frames.stamps_ns))
    subtract_noise(frames.moments, L, noise.correlations(frames.stamps_ns), total)
    if not (np.diag(total)[:-1] > 0.0).all():
        raise np.linalg.LinAlgError("an unknown is open")
    covariance = scaled_inverse(np.triu(total[:-1, :-1]) + np.triu(total[:-1, :-1], 1).T)
    return SharedStep(-covariance @ total[:-1, -1], covariance)


def gross_frames(
    frames: FrameMoments, covariance: FloatArray, allowance: float = 1.0, step: SharedStep | None = None
) -> BoolArray:
    """(n,) the frames whose mocap pose is off by more than noise of this covariance (n, 6, 6), with pixel noise,
    explains; ``allowance`` multiplies the covariance. Off from where the chain puts it: after ``step``, whose own
    uncertainty is allowed for, since of few frames an estimate that took the mocap as exact is off itself."""
    pose, gradient = regular(frames.moments[:, :6, :6]), frames.moments[:, :6, -1:]
    scatter = np.linalg.inv(pose) + allowance * covariance
    if step is not None:
        across = frames.moments[:, :6, 6:-1]
        gradient = gradient + across @ step.mean[:, None]
        moved = np.linalg.solve(pose, across)
        scatter = scatter + moved @ step.covariance @ np.swapaxes(moved, 1, 2)
    offset = np.linalg.solve(pose, gradient)
    distance2 = np.einsum("nik,nik->n", offset, np.linalg.solve(scatter, offset))
    return distance2 > special.chdtri(6, GROSS_PROBABILITY)


@dataclass(frozen=True)
class _Likelihood:
    """The restricted likelihood of the sigmas: logarithms of, for each tracked body, its translation (m) and rotation
    (rad), then of the jitter and the time of correlation (s).

    typical: (k,) of each, its first guess."""

    frames: FrameMoments
    bases: NoiseBases
    information: FloatArray
    bodies: tuple[str, ...]

    @staticmethod
    def of(frames: FrameMoments, motion: RefMotion, information: FloatArray) -> _Likelihood:
        bases = NoiseBases.of(motion, frames.stamps_ns)
        return _Likelihood(frames, bases, information, tuple(motion.trajectories))

    @cached_property
    def first_guess(self) -> FloatArray:
        """From the median offset of the frames that the pixels alone show, shared out among the bodies alike."""
        offset = np.linalg.solve(regular(self.frames.moments[:, :6, :6]), self.frames.moments[:, :6, -1:])[:, :, 0]
        median_of_norm = np.sqrt(special.chdtri(3, 0.5) * len(self.bodies))
        rotation, translation = (np.median(np.linalg.norm(part, axis=1)) for part in np.split(offset, 2, axis=1))
        each = [max(translation / median_of_norm, 1e-6), max(rotation / median_of_norm, 1e-7)]
        return np.log([*each * len(self.bodies), _TYPICAL_JITTER_S, _TYPICAL_CORRELATION_S])

    def noise(self, logs: FloatArray) -> MocapNoiseModel:
        values = np.exp(logs)
        bodies = {
            name: MocapSigmas(float(1e3 * values[2 * i]), float(np.rad2deg(values[2 * i + 1])))
            for i, name in enumerate(self.bodies)
        }
        if self.bases.motion.numbered:  # there is no time to jitter, or to be alike in
            return MocapNoiseModel(bodies, correlation_s=0.0, jitter_s=0.0, estimated=True)
        return MocapNoiseModel(bodies, correlation_s=float(values[-1]), jitter_s=float(values[-2]), estimated=True)

    def covariance(self, logs: FloatArray) -> FloatArray:
        """(n, 6, 6) of the frames' noise."""
        return self.noise(logs).composed(self.bases)

    def most_likely(self, start: FloatArray, rows: IntArray) -> FloatArray:
        """The sigmas of the largest likelihood on the frames at ``rows``."""
        part = replace(self, frames=self.frames.take(rows), bases=self.bases.take(rows))
        bounds = [(value + np.log(_SMALLEST), value + np.log(_LARGEST)) for value in self.first_guess]
        found = minimize(
            part.cost, np.clip(start, *np.transpose(bounds)), method="L-BFGS-B", bounds=bounds, options=_ACCURACY
        )
        return np.asarray(found.x)

    def degrees_of_freedom(self, logs: FloatArray, rows: IntArray) -> float:
        """The numbers of the mocap in the frames at ``rows``, less those that the unknowns take from them: these are
        the trace of what of the unknowns' information would be lost if the mocap said nothing."""
        part = replace(self, frames=self.frames.take(rows), bases=self.bases.take(rows))
        known, alone = (part.eliminated(logs, noise)[0][:-1, :-1] for noise in (1.0, _NOTHING_KNOWN))
        scale = 1.0 / np.sqrt(np.diag(known))
        taken = np.linalg.solve(known * np.outer(scale, scale), (known - alone) * np.outer(scale, scale))
        return float(6 * len(rows) - np.trace(taken))

    @cached_property
    def _of_frames_and_priors(self) -> FloatArray:
        return self.information + self.frames.exact.sum(axis=0)

    def eliminated(self, logs: FloatArray, times: float = 1.0) -> tuple[FloatArray, float]:
        """(P + 1, P + 1) sums of the unknowns, the priors' among them, with the mocap's noise integrated out, and the
        log determinant; with its sigmas so many ``times`` as large."""
        total = self._of_frames_and_priors.copy()
        L = times * lower_factors(self.covariance(logs))
        rho = self.noise(logs).correlations(self.frames.stamps_ns)
        log_determinant = subtract_noise(self.frames.moments, L, rho, total)
        return np.triu(total) + np.triu(total, 1).T, log_determinant

    def cost(self, logs: FloatArray) -> float:
        """Minus the logarithm of the restricted likelihood, and of a prior so wide that it only keeps finite what the
        data do not show."""
        total, log_determinant = self.eliminated(logs)
        R = np.linalg.cholesky(total[:-1, :-1])
        explained = solve_triangular(R, total[:-1, -1], lower=True)
        square = total[-1, -1] - explained @ explained
        log_determinant += 2.0 * np.log(np.diag(R)).sum()
        return float(0.5 * (log_determinant + square + (((logs - self.first_guess) / _WIDE) ** 2).sum()))
