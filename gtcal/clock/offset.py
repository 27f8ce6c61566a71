"""The clock offset beside all the other unknowns, and its sigma.

A shift of the cameras' clock by dt moves every frame's ref_T_body along its own velocity: A_f * Exp(twist_f dt). To
first order that is one more unknown, whose column is that of A_f times the twist; the offset is where it stays zero
when all is solved again at the shifted times. A rolling shutter's readout time is an unknown of the same kind, in
which each corner has its own share. Their sigmas count what X, Y_c and theta_c leave open, and the mocap's noise: as
stage 4 models it, or as the frames scatter.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from gtcal.camera import FloatArray
from gtcal.clock.local_motion import parabolas
from gtcal.clock.rolling_shutter import readout_columns_px_per_s
from gtcal.errors import GtcalError
from gtcal.estimation.clustered import ClusterSums, Priors
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.frame_statistics import FrameMoments, eliminate_noise, evenly, frames_of, in_parts
from gtcal.estimation.mocap_noise import MocapNoiseModel, lower_factors
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration, MocapNoise

MOST_FRAMES = 4_000
"""Evenly spread: so many tell the clock to a few us, and cost no more however long the recording is."""


@dataclass(frozen=True)
class OffsetEstimate:
    """What the data want of the cameras' stamps, beyond the times that they were taken at: in s, with its 1-sigma.

    drift, drift_sigma: by how much the offset grows per second, about the middle of the recording; 0 where it was not
        asked for.
    readout_s, readout_sigma_s: what is to be added to the readout times of the cameras that were asked for."""

    offset_s: float
    sigma_s: float
    drift: float = 0.0
    drift_sigma: float = 0.0
    readout_s: dict[str, float] = field(default_factory=dict)
    readout_sigma_s: dict[str, float] = field(default_factory=dict)


def remaining_offset(
    calibration: Calibration,
    motion: RefMotion,
    options: CalibrationOptions,
    *,
    drift: bool = False,
    readouts: tuple[str, ...] = (),
) -> OffsetEstimate:
    """Of a calibration that was just computed. readouts: the cameras whose readout time is an unknown too.

    Raises GtcalError for one that was read from a file, or where the motion does not tell."""
    solution = calibration.solution
    if solution is None:
        raise GtcalError("a calibration that was read from a file keeps no views to test the clock with")
    views = solution.views
    weight = solution.lens_weight
    information, scatter = (
        _widened(prior_information(views, solution.estimate, options, w), len(readouts) + 1 + drift)
        for w in (weight, weight**2)
    )
    parts = (
        _with_clock(part, motion, middle_ns(views), drift=drift)
        for part in _parts(calibration, motion, options, readouts)
    )
    noise = calibration.mocap_noise
    if noise is not None and noise.stage == 4:
        solved, covariance = _with_noise(parts, information, noise_model(noise), motion)
    else:
        solved, covariance = _as_they_scatter(parts, information, scatter, noise.correlation_s if noise else 0.0)
    first = len(solved) - 1 - drift
    sigmas = np.sqrt(np.diag(covariance))
    of_readouts = range(first - len(readouts), first)
    if not np.isfinite(sigmas[[*of_readouts, first]]).all():
        what = "clock offset and readout time" if readouts else "clock offset"
        raise GtcalError(f"the motion does not tell the {what}: move faster")
    of_drift = (float(solved[-1]), float(sigmas[-1])) if drift else (0.0, 0.0)
    return OffsetEstimate(
        float(solved[first]),
        float(sigmas[first]),
        *of_drift,
        readout_s={name: float(solved[i]) for name, i in zip(readouts, of_readouts, strict=True)},
        readout_sigma_s={name: float(sigmas[i]) for name, i in zip(readouts, of_readouts, strict=True)},
    )


def _parts(
    calibration: Calibration, motion: RefMotion, options: CalibrationOptions, readouts: tuple[str, ...]
) -> Iterator[FrameMoments]:
    """The moments, with a column for each of these readout times before the residual's."""
    assert calibration.solution is not None
    views, estimate = calibration.solution.views, calibration.solution.estimate

    def of(views: Mapping[str, Views]) -> Iterator[FrameMoments]:
        return in_parts(
            views,
            estimate,
            evenly(frames_of(views), MOST_FRAMES),
            sigma_px=calibration.sigma_px,
            free_theta=options.refine_intrinsics,
            free_shape=options.solves_board_shape,
        )

    columns_px = {name: readout_columns_px_per_s(views[name], estimate, motion) for name in readouts}
    plus = [of(_with_residuals_plus(views, name, column)) for name, column in columns_px.items()]
    minus = [of(_with_residuals_plus(views, name, -column)) for name, column in columns_px.items()]
    for part in of(views):
        yield _with_columns(part, [next(parts) for parts in plus], [next(parts) for parts in minus])


def _with_residuals_plus(views: Mapping[str, Views], name: str, column_px: FloatArray) -> dict[str, Views]:
    """The views with the residuals of one camera's corners larger by this."""
    return {**views, name: replace(views[name], corners_px=views[name].corners_px - column_px)}


def _with_columns(frames: FrameMoments, plus: list[FrameMoments], minus: list[FrameMoments]) -> FrameMoments:
    """The moments with a column c before the residual's for each pair of moments of residuals r + c and r - c: their
    differences are J^T c and 4 c^T r, their sum 2 r^T r + 2 c^T c. The corners of one column are not another's."""
    M, k = frames.moments, len(plus)
    size = M.shape[1]
    columns = np.array([*range(size - 1), size - 1 + k])
    moments = np.zeros((len(M), size + k, size + k))
    moments[:, columns[:, None], columns] = M
    for i, (more, less) in enumerate(zip(plus, minus, strict=True)):
        c = size - 1 + i
        moments[:, : size - 1, c] = moments[:, c, : size - 1] = more.moments[:, :-1, -1] - M[:, :-1, -1]
        moments[:, c, c] = 0.5 * (more.moments[:, -1, -1] + less.moments[:, -1, -1]) - M[:, -1, -1]
        moments[:, c, -1] = moments[:, -1, c] = 0.25 * (more.moments[:, -1, -1] - less.moments[:, -1, -1])
    return replace(frames, moments=moments)


class Stamped(Protocol):
    """What was seen at some times, increasing."""

    @property
    def stamps_ns(self) -> IntArray: ...


def middle_ns(views: Mapping[str, Stamped]) -> int:
    """The middle of the views' times, whole ms."""
    first, last = (pick(int(v.stamps_ns[i]) for v in views.values()) for pick, i in ((min, 0), (max, -1)))
    return (first + last) // 2_000_000 * 1_000_000


def noise_model(noise: MocapNoise) -> MocapNoiseModel:
    """As stage 4 had it."""
    bodies = {name: MocapSigmas(mm, noise.rotation_sigma_deg[name]) for name, mm in noise.translation_sigma_mm.items()}
    return MocapNoiseModel(bodies, noise.correlation_s, noise.jitter_s, noise.estimated)


def _with_clock(frames: FrameMoments, motion: RefMotion, about_ns: int, *, drift: bool) -> FrameMoments:
    """The moments with a column for the offset, and one for its drift, before the residual's."""
    twist = parabolas(motion, frames.stamps_ns)[:, 0]
    basis = [twist]
    if drift:
        basis.append(twist * (1e-9 * (frames.stamps_ns - about_ns))[:, None])
    M, k = frames.moments, len(basis)
    size = M.shape[1]
    columns = np.array([*range(size - 1), size - 1 + k])
    moments = np.zeros((len(M), size + k, size + k))
    moments[:, columns[:, None], columns] = M
    for i, along in enumerate(basis, start=size - 1):
        moved = np.einsum("fai,fi->fa", M[:, :, :6], along)
        moments[:, columns, i] = moments[:, i, columns] = moved
        for j, other in enumerate(basis, start=size - 1):
            moments[:, i, j] = np.einsum("fi,fi->f", moved[:, :6], other)
    return replace(frames, moments=moments)


def _widened(information: FloatArray, n: int) -> FloatArray:
    """(P + 1, P + 1) of the priors with ``n`` unknowns more, of which nothing is known."""
    size = len(information)
    wider = np.zeros((size + n, size + n))
    rows = np.r_[: size - 1, size + n - 1]
    wider[np.ix_(rows, rows)] = information
    return wider


def _with_noise(
    parts: Iterable[FrameMoments], information: FloatArray, noise: MocapNoiseModel, motion: RefMotion
) -> tuple[FloatArray, FloatArray]:
    total = np.triu(information)
    for part in parts:
        L = lower_factors(noise.covariance(motion, part.stamps_ns))
        eliminate_noise(part.moments, L, noise.correlations(part.stamps_ns), total)
    whole = np.triu(total) + np.triu(total, 1).T
    return _solved(whole), _inverse(whole[:-1, :-1])


def _as_they_scatter(
    parts: Iterable[FrameMoments], information: FloatArray, scatter: FloatArray, correlation_s: float
) -> tuple[FloatArray, FloatArray]:
    sums = ClusterSums.of(parts, correlation_s)
    whole = information.copy()
    whole[:-1, :-1] += sums.information
    whole[:-1, -1] += sums.gradients.sum(axis=0)
    try:
        return _solved(whole), sums.covariance(Priors(information[:-1, :-1], scatter[:-1, :-1]))
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
