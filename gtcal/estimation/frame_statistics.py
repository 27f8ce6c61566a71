"""What each frame says, as sums; and the sums of many frames with the mocap's noise integrated out.

To first order in the unknowns, all that the corners of frame f say is in its moments [J r]^T [J r], in the tangents of
A_f, of X, of every Y_c and theta_c, and of the board's shape. Stage 4's noise model, its hold-out error and the
frame-clustered covariance are computed from them; GTSAM's estimates are not.

The mocap's noise is integrated out of them by ``factors.noise_chain``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from factors import GAUSSIAN, AnyKernel
from factors.board_shape import N_SHAPE
from factors.cores import in_order
from factors.frames import add_views
from factors.moments import chain
from factors.noise_chain import NoiseChain
from factors.reprojection import view_moments
from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import corner_views, select_views, views_from_to
from gtcal.recordings.detections import IntArray

SMALLEST_CORRELATION = 1e-3
"""A correlation under this is none: the chain of frames is cut there."""

_MOST_AT_ONCE = 500
_OPEN = 1e-9  # of the diagonal: an open direction gets a sigma of ten thousand times the others'


@dataclass(frozen=True)
class FrameMoments:
    """The moments of n frames.

    frame_index: (n,) increasing, as in ``Views.frame_index``. stamps_ns: (n,).
    moments: (n, D, D) symmetric, whitened by sigma_px; columns A_f (6), then the P unknowns: those of a JointCovariance
        (X, Y_c, theta_c) and, where it is free, the board's shape (5); then the residual.
    sigma_px: the standard deviation of a pixel coordinate that they are whitened by.
    within_square, within_dof: what is left of the whitened squares when each view has a pose of its own, and its
        degrees of freedom."""

    frame_index: IntArray
    stamps_ns: IntArray
    moments: FloatArray
    sigma_px: float
    within_square: float
    within_dof: int

    @property
    def n_unknowns(self) -> int:
        """P."""
        return self.moments.shape[1] - 7

    @property
    def pixel_sigma_px(self) -> float:
        """The pixel noise that they show: the scatter of corners round the best pose of each view's own."""
        return self.sigma_px * math.sqrt(self.within_square / max(self.within_dof, 1))

    @property
    def exact(self) -> FloatArray:
        """(n, P + 1, P + 1) with the mocap taken as exact."""
        return self.moments[:, 6:, 6:]

    def whitened_by(self, sigma_px: float) -> FrameMoments:
        """The same with another pixel noise."""
        scale = (self.sigma_px / sigma_px) ** 2
        return FrameMoments(
            self.frame_index,
            self.stamps_ns,
            scale * self.moments,
            sigma_px,
            scale * self.within_square,
            self.within_dof,
        )

    def take(self, rows: IntArray) -> FrameMoments:
        """Only these frames; ``within_square`` and ``within_dof`` stay those of all."""
        return FrameMoments(
            self.frame_index[rows],
            self.stamps_ns[rows],
            self.moments[rows],
            self.sigma_px,
            self.within_square,
            self.within_dof,
        )


def frame_moments(
    views: Mapping[str, Views],
    estimate: Estimate,
    *,
    sigma_px: float,
    free_theta: bool,
    free_shape: bool = False,
    frames: IntArray | None = None,
    robust: AnyKernel = GAUSSIAN,
) -> FrameMoments:
    """The moments of the frames (all, or those at ``frames``, increasing) at the estimate and the mocap's poses.

    robust: weighs corners as an estimate did that takes the mocap as exact; for one that does not, what the mocap
        moves is no outlier."""
    stamps, index = _frames(views) if frames is None else _frames(_of_frames(views, frames))
    sizes = [of_camera.camera.model.n_parameters * free_theta for of_camera in views.values()]
    n_shape = N_SHAPE * free_shape
    n_columns = 13 + 6 * len(sizes) + sum(sizes) + n_shape
    total = np.zeros((len(index), n_columns, n_columns))
    square, dof = 0.0, 0
    for c, (name, all_views) in enumerate(views.items()):
        of_camera = all_views if frames is None else _those_of(all_views, frames)
        if of_camera.n_views == 0:
            continue
        poses = estimate.camera_T_ref[name], of_camera.ref_T_body, estimate.body_T_board
        found = view_moments(
            corner_views(of_camera, sigma_px),
            chain(*poses),
            of_camera.camera.model,
            estimate.theta[name],
            estimate.board_shape,
            with_theta=free_theta,
            with_shape=free_shape,
            robust=robust,
        )
        row = np.searchsorted(index, of_camera.frame_index)
        theta_column = 12 + 6 * len(sizes) + sum(sizes[:c])
        add_views(found.moments, row, *poses[1:], 12 + 6 * c, theta_column, n_shape, total)
        square += float(_within_views(found.moments).sum())
        dof += 2 * of_camera.n_corners - 6 * of_camera.n_views
    return FrameMoments(index, stamps, total, sigma_px, square, dof)


def in_parts(
    views: Mapping[str, Views],
    estimate: Estimate,
    frames: IntArray,
    *,
    sigma_px: float,
    free_theta: bool,
    free_shape: bool = False,
    robust: AnyKernel = GAUSSIAN,
) -> Iterator[FrameMoments]:
    """The moments of the frames at ``frames``, increasing, a few hundred at a time: a frame's take up to 60 kB."""

    def of(part: IntArray) -> FrameMoments:
        return frame_moments(
            views,
            estimate,
            sigma_px=sigma_px,
            free_theta=free_theta,
            free_shape=free_shape,
            frames=part,
            robust=robust,
        )

    return in_order(of, np.array_split(frames, -(-len(frames) // _MOST_AT_ONCE)))


def frames_of(views: Mapping[str, Views]) -> IntArray:
    """The frames that any camera saw, increasing, as in ``Views.frame_index``."""
    return np.unique(np.concatenate([of_camera.frame_index for of_camera in views.values()]))


def n_corners_of(views: Mapping[str, Views], frames: IntArray) -> int:
    """How many corners all cameras saw in these frames."""
    return sum(
        int(np.diff(of_camera.view_start)[np.isin(of_camera.frame_index, frames)].sum()) for of_camera in views.values()
    )


def evenly(frames: IntArray, most: int) -> IntArray:
    """At most so many of the frames, evenly spread."""
    return frames if len(frames) <= most else frames[np.linspace(0, len(frames) - 1, most).round().astype(np.int64)]


def _frames(views: Mapping[str, Views]) -> tuple[IntArray, IntArray]:
    index, first = np.unique(np.concatenate([v.frame_index for v in views.values()]), return_index=True)
    return np.concatenate([v.stamps_ns for v in views.values()])[first], index


def _of_frames(views: Mapping[str, Views], frames: IntArray) -> dict[str, Views]:
    return {name: _those_of(of_camera, frames) for name, of_camera in views.items()}


def _those_of(views: Views, frames: IntArray) -> Views:
    first = int(np.searchsorted(views.frame_index, frames[0]))
    end = int(np.searchsorted(views.frame_index, frames[-1], side="right"))
    between = views_from_to(views, first, end)
    wanted = np.isin(between.frame_index, frames)
    return between if wanted.all() else select_views(between, np.flatnonzero(wanted))


def _within_views(by_view: FloatArray) -> FloatArray:
    """(V,) squares left when each view has a pose of its own, from moments (V, d, d)."""
    pose, gradient, square = by_view[:, :6, :6], by_view[:, :6, -1], by_view[:, -1, -1]
    solved = np.linalg.solve(regular(pose), gradient[:, :, None])[:, :, 0]
    return square - np.einsum("vi,vi->v", gradient, solved)


def regular(information: FloatArray) -> FloatArray:
    """(N, 6, 6) made safe to invert: corners on one line leave a direction open, those without a pixel all of it."""
    blank = np.einsum("nii->ni", information) == 0.0
    return information * (1.0 + _OPEN * np.eye(6)) + blank[:, None, :] * np.eye(6)


def eliminate_noise(moments: FloatArray, L: FloatArray, rho: FloatArray, total: FloatArray) -> float:
    """Integrate the mocap's noise out of the frames' moments (n, D, D), in order of time.

    L: (n, 6, 6) lower factor of each frame's noise covariance. rho: (n,) correlation of a frame's noise with the next
    one's; 0 cuts the chain, as after the last. Adds the sums of the other unknowns and the residual to the upper
    triangle of total (D - 6, D - 6) and returns the log determinant of what was integrated out, relative to the
    noise's own."""
    total += np.triu(moments[:, 6:, 6:].sum(axis=0))
    return subtract_noise(moments, L, rho, total)


def subtract_noise(moments: FloatArray, L: FloatArray, rho: FloatArray, total: FloatArray) -> float:
    """``eliminate_noise`` where total holds the frames' own sums already; both its triangles are right after."""
    chain = NoiseChain.starting(len(moments), moments.shape[1] - 6)
    log_determinant = chain.eliminate(moments, L, rho)
    total -= chain.known_square
    return log_determinant
