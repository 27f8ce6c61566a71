"""The moments that effects are looked for in: those of all views, gross ones too, as a slip makes many views gross."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from factors.board_shape import N_SHAPE
from gtcal.camera import BoolArray, FloatArray
from gtcal.effects.isolated import without_isolated
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.frame_statistics import FrameMoments, evenly, frame_moments, frames_of, n_corners_of
from gtcal.estimation.mocap_noise import MocapNoiseModel, Whiteness, estimate_noise, innovations, spread_blocks
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

MOST_NUMBERS = 2e7
"""Of all the frames' moments: 160 MB."""

_FEWEST_FRAMES, _MOST_FRAMES = 200, 2000
_CLUSTERS = 24
_FEWEST_OF_A_CLUSTER = 3
_LARGEST_LAG = 0.5  # more is no noise, but what is looked for


@dataclass(frozen=True)
class Frames:
    """The frames' moments at an estimate, in the tangents of A_f, X, each Y_c, each theta_c, by the board's
    shapes, then the residual: D columns.

    moments: (n, D, D) with the mocap exact. marginal: (n, D, D) with its noise integrated out, frame by frame: a
        quadratic form of the columns that holds for whatever is a linear image of them, A_f's too.
    free: the columns (of D) that the calibration solved for. information: (F + 1, F + 1) of its priors.
    seen: by camera, (n,) whether it saw the board. cluster: (n,) which stretch of time a frame is in.
    theta_sizes: by camera, the number of its intrinsics' columns.
    views: those that the moments are of."""

    views: Mapping[str, Views]
    theta_sizes: dict[str, int]
    motion: RefMotion
    estimate: Estimate
    stamps_ns: IntArray
    start_ns: int
    moments: FloatArray
    marginal: FloatArray
    sigma_px: float
    n_corners: int
    free: IntArray
    information: FloatArray
    seen: dict[str, BoolArray]
    cluster: IntArray
    noise: MocapNoiseModel
    of_frames: FrameMoments

    @property
    def n_columns(self) -> int:
        """D - 1: the tangents."""
        return self.moments.shape[1] - 1

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.theta_sizes)

    @property
    def ref_T_body(self) -> FloatArray:
        """(n, 4, 4) by the mocap."""
        return self.motion.at(self.stamps_ns).ref_T_body

    def columns_of_camera(self, name: str) -> slice:
        """Of Y_c."""
        start = 12 + 6 * self.cameras.index(name)
        return slice(start, start + 6)

    def columns_of_theta(self, name: str) -> slice:
        sizes = list(self.theta_sizes.values())
        index = self.cameras.index(name)
        start = 12 + 6 * len(sizes) + sum(sizes[:index])
        return slice(start, start + sizes[index])

    def seconds(self, stamps_ns: IntArray) -> FloatArray:
        """Since the recording's first image."""
        return np.asarray(1e-9 * (stamps_ns - self.start_ns), dtype=np.float64)

    def shifted_noise(self, shift: FloatArray) -> Frames | None:
        """The same with the noise integrated out that the frames show once their tangents are shifted by (n, D - 1);
        None where it can't be told, as of ``estimate_noise``."""
        moved = self.moments.copy()
        change = np.einsum("fij,fj->fi", self.moments[:, :, :-1], shift)
        moved[:, :, -1] += change
        moved[:, -1, :] += change
        moved[:, -1, -1] += np.einsum("fi,fi->f", change[:, :-1], shift)
        kept = np.concatenate([np.arange(6), self.free, [self.n_columns]])
        rows = spread_blocks(np.arange(len(moved)))
        chosen = replace(self.of_frames, moments=moved[:, kept][:, :, kept]).take(rows)
        noise = estimate_noise(chosen, self.motion, self.information)
        if noise is None:
            return None
        lag_1 = lag_of(Whiteness.of(innovations(chosen, noise, self.motion)))
        return replace(self, noise=noise, marginal=_marginal(self.of_frames, noise, self.motion, lag_1))

    @staticmethod
    def of(
        observations: Observations,
        estimate: Estimate,
        noise: MocapNoiseModel,
        options: CalibrationOptions,
        lag_1: float = 0.0,
    ) -> Frames | None:
        """Of all views but isolated gross ones; None where these leave too few. lag_1: correlation of the noise from
        frame to frame that its model misses."""
        views = without_isolated(observations.views, estimate)
        if any(of_camera.n_views == 0 for of_camera in views.values()):
            return None
        frames = _chosen(views)
        raw = frame_moments(views, estimate, sigma_px=1.0, free_theta=True, free_shape=True, frames=frames)
        raw = raw.whitened_by(options.sigma_px or max(raw.pixel_sigma_px, 1e-6))
        cluster = clusters(len(frames))
        if cluster[-1] < 9:
            return None
        return Frames(
            views=views,
            theta_sizes={name: of_camera.camera.model.n_parameters for name, of_camera in views.items()},
            motion=observations.motion,
            estimate=estimate,
            stamps_ns=raw.stamps_ns,
            start_ns=int(observations.frame_stamps_ns[0]),
            moments=raw.moments,
            marginal=_marginal(raw, noise, observations.motion, lag_1),
            sigma_px=raw.sigma_px,
            n_corners=n_corners_of(views, frames),
            free=_free(raw, len(views), options),
            information=prior_information(views, estimate, options),
            seen={name: np.isin(frames, of_camera.frame_index) for name, of_camera in views.items()},
            cluster=cluster,
            noise=noise,
            of_frames=raw,
        )


def _free(raw: FrameMoments, n_cameras: int, options: CalibrationOptions) -> IntArray:
    """The columns that the calibration solved for."""
    if not options.refine_intrinsics:
        return np.arange(6, 12 + 6 * n_cameras)
    return np.arange(6, 6 + raw.n_unknowns - (0 if options.solves_board_shape else N_SHAPE))


def _chosen(views: Mapping[str, Views]) -> IntArray:
    """The frames, or as many of them, evenly, as memory allows."""
    width = 13 + sum(6 + of_camera.camera.model.n_parameters for of_camera in views.values())
    most = int(np.clip(MOST_NUMBERS / width**2, _FEWEST_FRAMES, _MOST_FRAMES))
    return evenly(frames_of(views), most)


def clusters(n: int) -> IntArray:
    """(n,) stretches of neighbouring frames, within which they may scatter together."""
    count = max(min(_CLUSTERS, n // _FEWEST_OF_A_CLUSTER), 1)
    return np.arange(n) * count // n


def lag_of(whiteness: Whiteness) -> float:
    """The correlation from frame to frame that a model misses, one sigma of chance allowed for."""
    return float(np.clip(whiteness.lag_1 + whiteness.lag_1_sigma, 0.0, _LARGEST_LAG))


def _marginal(frames: FrameMoments, noise: MocapNoiseModel, motion: RefMotion, lag_1: float) -> FloatArray:
    """(n, D, D) with the noise integrated out of each frame by itself. What lasts, as effects do, sees noise that is
    correlated in time as white noise of its long-run variance, (1 + rho) / (1 - rho) times as large."""
    M, rho = frames.moments, max(_typical_correlation(noise, frames.stamps_ns), lag_1)
    covariance = (1.0 + rho) / (1.0 - rho) * noise.covariance(motion, frames.stamps_ns)
    gain = np.linalg.solve(M[:, :6, :6] + np.linalg.inv(covariance), M[:, :6])
    return np.asarray(M - np.swapaxes(M[:, :6], 1, 2) @ gain)


def _typical_correlation(noise: MocapNoiseModel, stamps_ns: IntArray) -> float:
    """Of the noise of a frame and the next."""
    return float(np.median(noise.correlations(stamps_ns)[:-1]))
