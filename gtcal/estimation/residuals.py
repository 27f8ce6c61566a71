"""Reprojection residuals of views, and views picked by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors import CornerViews
from factors.kernel import kernel
from factors.moments import chain
from factors.reprojection import residuals_px as _residuals_px
from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.recordings.detections import IntArray


def corner_views(views: Views, sigma_px: float = 1.0) -> CornerViews:
    """The views as the factors know them."""
    return CornerViews(views.view_start, views.corners_m, views.corners_px, sigma_px, views.outline_m)


def chain_residuals_px(views: Views, estimate: Estimate) -> FloatArray:
    """Projection through the chain less measurement, (N, 2); NaN where a corner has no pixel."""
    name, model = views.camera.name, views.camera.model
    camera_T_board = chain(estimate.camera_T_ref[name], views.ref_T_body, estimate.body_T_board)
    return _residuals_px(corner_views(views), camera_T_board, model, estimate.theta[name], estimate.board_shape)


def residual_norms_px(views: Views, camera_T_board: FloatArray) -> FloatArray:
    """Distance (N,) of each corner to its projection at camera_T_board (V, 4, 4); infinite where it has none."""
    residuals = _residuals_px(corner_views(views), camera_T_board, views.camera.model, views.camera.theta)
    return norms(residuals)


def norms(residuals_px: FloatArray) -> FloatArray:
    """(N,) norms of residuals (N, 2), infinite for NaN."""
    lengths = np.sqrt(residuals_px[:, 0] ** 2 + residuals_px[:, 1] ** 2)
    lengths[np.isnan(lengths)] = np.inf
    return lengths


@kernel
def _median_by_group(values: FloatArray, start: IntArray, medians: FloatArray) -> None:
    for g in range(len(start) - 1):
        medians[g] = np.median(values[start[g] : start[g + 1]])


def median_by_view(views: Views, values: FloatArray) -> FloatArray:
    """Median (V,) of the values (N,) of each view's corners, where NaN, as of a corner without a pixel, ranks above all
    numbers. Every view needs a corner."""
    medians = np.empty(views.n_views)
    _median_by_group(np.where(np.isnan(values), np.inf, values), views.view_start, medians)
    return medians


def offsets_from_view(views: Views, residuals_px: FloatArray) -> FloatArray:
    """Length (N,) of each residual (N, 2) less its view's median one: mocap noise, which moves a view as a whole, drops
    out. Infinite for NaN."""
    shift = np.stack([median_by_view(views, residuals_px[:, axis]) for axis in range(2)], axis=1)
    return norms(residuals_px - np.repeat(shift, np.diff(views.view_start), axis=0))


def select_views(views: Views, index: IntArray) -> Views:
    """The views at ``index``, in that order."""
    counts = np.diff(views.view_start)[index]
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rows = np.repeat(views.view_start[index] - start[:-1], counts) + np.arange(start[-1])
    return replace(
        views,
        stamps_ns=views.stamps_ns[index],
        frame_index=views.frame_index[index],
        ref_T_body=views.ref_T_body[index],
        view_start=start,
        corner_ids=views.corner_ids.take(rows),
        corners_m=views.corners_m.take(rows, axis=0),
        corners_px=views.corners_px.take(rows, axis=0),
    )


def views_from_to(views: Views, first: int, end: int) -> Views:
    """The views ``first`` to ``end - 1``; nothing is copied."""
    start = views.view_start[first : end + 1]
    rows = slice(int(start[0]), int(start[-1]))
    return replace(
        views,
        stamps_ns=views.stamps_ns[first:end],
        frame_index=views.frame_index[first:end],
        ref_T_body=views.ref_T_body[first:end],
        view_start=start - start[0],
        corner_ids=views.corner_ids[rows],
        corners_m=views.corners_m[rows],
        corners_px=views.corners_px[rows],
    )


def select_corners(views: Views, keep: BoolArray) -> Views:
    """The corners where ``keep`` (N,) is True, and the views that have one left."""
    counts = np.add.reduceat(keep, views.view_start[:-1], dtype=np.int64)
    rows = np.flatnonzero(keep)
    trimmed = replace(
        views,
        view_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        corner_ids=views.corner_ids.take(rows),
        corners_m=views.corners_m.take(rows, axis=0),
        corners_px=views.corners_px.take(rows, axis=0),
    )
    return trimmed if counts.all() else select_views(trimmed, np.flatnonzero(counts))
