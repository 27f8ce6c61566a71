"""Stage 4: the same pixels with the mocap's noise modelled, each frame's ref_T_body a variable under its prior.

Stage 3 takes the mocap as exact, as the paper does. But its noise moves all corners of a frame together, in all
cameras; freeing every A_t under a prior of the mocap's own sigmas (errors in variables) makes the estimate more
accurate and its covariance true. The noise sits at each tracked body, world_T_body * Exp(noise); composed and
interpolated it becomes the covariance of ref_T_body.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from factors import CornerViews, FusedReprojectionFactor
from factors.moments import chain
from factors.reprojection import residuals_px
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.adjustment import MEDIAN_LENGTH, Adjusted, intrinsics_priors
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import BODY_T_BOARD, camera_T_ref_key, minimise, theta_key, to_values, updated
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.estimation.residuals import chain_residuals_px, corner_views, offsets_from_view
from gtcal.progress import Progress, silent
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

MAX_ROUNDS = 5
"""Of solving and estimating the pixel noise anew; two or three do."""


def ref_T_body_key(frame_index: int) -> int:
    """Key of A_t, frames counted as in ``Views.frame_index``."""
    key: int = gtsam.symbol("a", frame_index)
    return key


def ref_T_body_covariance(motion: RefMotion, stamps_ns: IntArray, sigmas: MocapSigmas) -> FloatArray:
    """(N, 6, 6) of xi in ref_T_body * Exp(xi) at ``stamps_ns`` (N,), rotation first, in rad and m.

    ref_T_body = world_T_platform^-1 * world_T_board_body: the board body's noise acts where it is, the platform's is
    carried over by the adjoint. Interpolation between two samples averages their noise."""
    of_sample = np.diag(np.repeat([np.deg2rad(sigmas.rotation_deg), 1e-3 * sigmas.translation_mm], 3) ** 2)
    total = np.zeros((len(stamps_ns), 6, 6))
    if motion.board_body is not None:
        total += motion.board_body.interpolated_variance(stamps_ns)[:, None, None] * of_sample
    if motion.platform is not None:
        adjoint = _adjoint(inverse(motion.at(stamps_ns).ref_T_body))
        shares = motion.platform.interpolated_variance(stamps_ns)[:, None, None]
        total += shares * (adjoint @ of_sample @ np.swapaxes(adjoint, 1, 2))
    return total


def _adjoint(a_T_b: FloatArray) -> FloatArray:
    """Ad(a_T_b), (N, 6, 6)."""
    R, (x, y, z) = a_T_b[:, :3, :3], a_T_b[:, :3, 3].T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    adjoint = np.zeros((len(a_T_b), 6, 6))
    adjoint[:, :3, :3] = adjoint[:, 3:, 3:] = R
    adjoint[:, 3:, :3] = skew @ R
    return adjoint


@dataclass(frozen=True)
class _Frames:
    """The frames that the views were taken at: index (F,) as in ``Views.frame_index``, mocap pose, its covariance."""

    index: IntArray
    ref_T_body: FloatArray
    covariance: FloatArray


def _frames(views: Mapping[str, Views], motion: RefMotion, sigmas: MocapSigmas) -> _Frames:
    index, first = np.unique(np.concatenate([v.frame_index for v in views.values()]), return_index=True)
    stamps_ns = np.concatenate([v.stamps_ns for v in views.values()])[first]
    ref_T_body = np.concatenate([v.ref_T_body for v in views.values()])[first]
    return _Frames(index, ref_T_body, ref_T_body_covariance(motion, stamps_ns, sigmas))


def adjust_with_mocap_noise(
    adjusted: Adjusted, motion: RefMotion, options: CalibrationOptions, progress: Progress = silent
) -> Adjusted:
    """Go on from stage 3 with every A_t free, on the views and corners that it used.

    Raises GtcalError where the options name no mocap sigmas."""
    if options.mocap is None:
        raise GtcalError("mocap noise can be modelled only where its sigmas are given")
    views = adjusted.screened.views
    frames = _frames(views, motion, options.mocap)
    values = to_values(adjusted.estimate, with_theta=options.refine_intrinsics)
    for index, pose in zip(frames.index, frames.ref_T_body, strict=True):
        values.insert(ref_T_body_key(int(index)), gtsam.Pose3(pose))
    estimate, sigma_px = adjusted.estimate, options.sigma_px or _scatter_px(views, adjusted.estimate)
    errors: tuple[float, ...] = ()
    for done in range(MAX_ROUNDS):
        progress("stage 4: mocap noise", done, MAX_ROUNDS)
        graph = _graph(views, estimate, frames, sigma_px, options)
        found = minimise(graph, values, eps=options.eps, max_iterations=options.max_iterations)
        values, estimate = found.values, updated(estimate, found.values)
        errors += found.errors[1:] if errors else found.errors
        before, sigma_px = sigma_px, options.sigma_px or _sigma_px(views, estimate, values, len(frames.index))
        if abs(sigma_px - before) < 0.02 * before:
            break
    progress("stage 4: mocap noise", MAX_ROUNDS, MAX_ROUNDS)
    graph = _graph(views, estimate, frames, sigma_px, options)
    return Adjusted(estimate, sigma_px, adjusted.screened.under(estimate), graph, values, errors)


def _graph(
    views: Mapping[str, Views], estimate: Estimate, frames: _Frames, sigma_px: float, options: CalibrationOptions
) -> gtsam.NonlinearFactorGraph:
    """A factor per view, and a prior per frame."""
    graph = gtsam.NonlinearFactorGraph()
    free_theta = options.refine_intrinsics
    for index, (name, of_camera) in enumerate(views.items()):
        theta = theta_key(index) if free_theta else estimate.theta[name]
        for view, frame in enumerate(of_camera.frame_index):
            graph.add(
                FusedReprojectionFactor(
                    camera_T_ref_key(index),
                    BODY_T_BOARD,
                    views=_one_view(of_camera, view, sigma_px),
                    model=of_camera.camera.model,
                    ref_T_body=ref_T_body_key(int(frame)),
                    theta=theta,
                    robust=options.robust,
                )
            )
        if free_theta:
            graph.add(intrinsics_priors(views, options)[name].factor(theta_key(index), of_camera.camera))
    for frame, pose, covariance in zip(frames.index, frames.ref_T_body, frames.covariance, strict=True):
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.PriorFactorPose3(ref_T_body_key(int(frame)), gtsam.Pose3(pose), noise))
    return graph


def _one_view(views: Views, index: int, sigma_px: float) -> CornerViews:
    rows = slice(views.view_start[index], views.view_start[index + 1])
    start = np.array([0, rows.stop - rows.start], dtype=np.int64)
    return CornerViews(start, views.corners_m[rows], views.corners_px[rows], sigma_px)


def _scatter_px(views: Mapping[str, Views], estimate: Estimate) -> float:
    """A first guess of the pixel noise: the scatter of corners round the median residual of their view, which mocap
    noise moves as a whole."""
    lengths = [offsets_from_view(of_camera, chain_residuals_px(of_camera, estimate)) for of_camera in views.values()]
    return max(float(np.median(np.concatenate(lengths))) / MEDIAN_LENGTH, 1e-6)


def _sigma_px(views: Mapping[str, Views], estimate: Estimate, values: gtsam.Values, n_frames: int) -> float:
    """Pixel noise by the mean square of the residuals at the free A_t, six degrees of freedom spent on each frame."""
    squares, n_coordinates = 0.0, 0
    for name, of_camera in views.items():
        ref_T_body = np.stack([values.atPose3(ref_T_body_key(int(f))).matrix() for f in of_camera.frame_index])
        camera_T_board = chain(estimate.camera_T_ref[name], ref_T_body, estimate.body_T_board)
        found = residuals_px(corner_views(of_camera), camera_T_board, of_camera.camera.model, estimate.theta[name])
        squares += float(np.nansum(found**2))
        n_coordinates += found.size
    return max(float(np.sqrt(squares / max(n_coordinates - 6 * n_frames, 1))), 1e-6)
