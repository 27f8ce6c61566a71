"""The clock offset beside all the other unknowns, and its sigma.

A shift of the cameras' clock by dt moves every frame's ref_T_body along its own velocity: A_f * Exp(twist_f dt). To
first order that is one more unknown, whose column is that of A_f times the twist; the offset is where it stays zero
when all is solved again at the shifted times. Its sigma counts what X, Y_c and theta_c leave open, and the mocap's
noise: as stage 4 models it, or as the frames scatter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.clustered import clustered_covariance
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.frame_statistics import FrameMoments, eliminate_noise, frames_of, in_parts
from gtcal.estimation.mocap_noise import MocapNoiseModel, lower_factors
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.recordings.capture import RefMotion
from gtcal.results.calibration import Calibration, MocapNoise


@dataclass(frozen=True)
class OffsetEstimate:
    """What the data want of the cameras' stamps, beyond the times that they were taken at: in s, with its 1-sigma.

    drift, drift_sigma: by how much the offset grows per second, about the middle of the recording; 0 where it was not
        asked for."""

    offset_s: float
    sigma_s: float
    drift: float = 0.0
    drift_sigma: float = 0.0


def remaining_offset(
    calibration: Calibration, motion: RefMotion, options: CalibrationOptions, *, drift: bool = False
) -> OffsetEstimate:
    """Of a calibration that was just computed.

    Raises GtcalError for one that was read from a file, or where the motion does not tell."""
    solution = calibration.solution
    if solution is None:
        raise GtcalError("a calibration that was read from a file keeps no views to test the clock with")
    views, estimate = solution.views, solution.estimate
    frames = frames_of(views)
    information = _widened(prior_information(views, estimate, options), 1 + drift)
    parts = [
        _with_clock(part, motion, middle_ns(views), drift=drift)
        for part in in_parts(
            views, estimate, frames, sigma_px=calibration.sigma_px, free_theta=options.refine_intrinsics
        )
    ]
    noise = calibration.mocap_noise
    if noise is not None and noise.stage == 4:
        solved, covariance = _with_noise(parts, information, noise_model(noise), motion)
    else:
        solved, covariance = _as_they_scatter(parts, information, noise.correlation_s if noise else 0.0)
    first = len(solved) - 1 - drift
    sigmas = np.sqrt(np.diag(covariance))
    if not np.isfinite(sigmas[first]):
        raise GtcalError("the motion does not tell the clock offset: move faster")
    of_drift = (float(solved[-1]), float(sigmas[-1])) if drift else (0.0, 0.0)
    return OffsetEstimate(float(solved[first]), float(sigmas[first]), *of_drift)


def middle_ns(views: Mapping[str, Views]) -> int:
    """The middle of the views' times, whole ms."""
    first, last = (pick(int(v.stamps_ns[i]) for v in views.values()) for pick, i in ((min, 0), (max, -1)))
    return (first + last) // 2_000_000 * 1_000_000


def noise_model(noise: MocapNoise) -> MocapNoiseModel:
    """As stage 4 had it."""
    bodies = {name: MocapSigmas(mm, noise.rotation_sigma_deg[name]) for name, mm in noise.translation_sigma_mm.items()}
    return MocapNoiseModel(bodies, noise.correlation_s, noise.jitter_s, noise.estimated)


def _with_clock(frames: FrameMoments, motion: RefMotion, about_ns: int, *, drift: bool) -> FrameMoments:
    """The moments with a column for the offset, and one for its drift, before the residual's."""
    twist = motion.at(frames.stamps_ns).twist_per_s
    basis = [twist]
    if drift:
        basis.append(twist * (1e-9 * (frames.stamps_ns - about_ns))[:, None])
    n, size = len(frames.stamps_ns), frames.moments.shape[1]
    columns = np.zeros((n, size, size + len(basis)))
    columns[:, : size - 1, : size - 1] = np.eye(size - 1)
    columns[:, size - 1, -1] = 1.0
    for k, along in enumerate(basis):
        columns[:, :6, size - 1 + k] = np.nan_to_num(along)
    moments = np.swapaxes(columns, 1, 2) @ frames.moments @ columns
    return FrameMoments(
        frames.frame_index, frames.stamps_ns, moments, frames.sigma_px, frames.within_square, frames.within_dof
    )


def _widened(information: FloatArray, n: int) -> FloatArray:
    """(P + 1, P + 1) of the priors with ``n`` unknowns more, of which nothing is known."""
    size = len(information)
    wider = np.zeros((size + n, size + n))
    rows = np.r_[: size - 1, size + n - 1]
    wider[np.ix_(rows, rows)] = information
    return wider


def _with_noise(
    parts: list[FrameMoments], information: FloatArray, noise: MocapNoiseModel, motion: RefMotion
) -> tuple[FloatArray, FloatArray]:
    total = np.triu(information)
    for part in parts:
        L = lower_factors(noise.covariance(motion, part.stamps_ns))
        eliminate_noise(part.moments, L, noise.correlations(part.stamps_ns), total)
    whole = np.triu(total) + np.triu(total, 1).T
    return _solved(whole), _inverse(whole[:-1, :-1])


def _as_they_scatter(
    parts: list[FrameMoments], information: FloatArray, correlation_s: float
) -> tuple[FloatArray, FloatArray]:
    whole = information + np.sum([part.exact.sum(axis=0) for part in parts], axis=0)
    try:
        return _solved(whole), clustered_covariance(parts, information, correlation_s)
    except np.linalg.LinAlgError:
        return _solved(whole), np.full(whole[:-1, :-1].shape, np.nan)


def _solved(whole: FloatArray) -> FloatArray:
    """The step that the sums ask for."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole)[:-1], 1e-300))
    return -scale * np.linalg.lstsq(whole[:-1, :-1] * np.outer(scale, scale), whole[:-1, -1] * scale, rcond=1e-13)[0]


def _inverse(information: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    try:
        return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.full(information.shape, np.nan)
