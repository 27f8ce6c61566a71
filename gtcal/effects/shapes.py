"""The board's shape: longer along one axis than along the other, or bowed. Each corner moves on the board in its own
way, so no tangent of a pose holds it: columns of its own are added to the frames' moments.

J^T j of a column j with all columns J of the moments is what J^T r changes by where the measured corners are moved by
-j: the residual is then r + j, and J the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.frame_statistics import FrameMoments, frame_moments
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import chain_residuals_px

_STEP = 1e-3  # of a share or, of a bow, m: a millimetre on a metre


@dataclass(frozen=True)
class Shape:
    """A way in which a board is not as stated. displacement: how far corners (N, 3), in m from the board's centre, move
    for a unit (a share, or a metre of bow), (N, 3), given the halves of its sides (3,). unit, scale: for people."""

    name: str
    what: str
    displacement: Callable[[FloatArray, FloatArray], FloatArray]
    unit: str
    scale: float


def _stretch(corners_m: FloatArray, half_m: FloatArray) -> FloatArray:
    return corners_m * [0.5, -0.5, 0.0]


def _bow_along(axis: int) -> Callable[[FloatArray, FloatArray], FloatArray]:
    def bow(corners_m: FloatArray, half_m: FloatArray) -> FloatArray:
        """The middle stands out by a metre over the edges."""
        height = 1.0 - (corners_m[:, axis] / half_m[axis]) ** 2
        return height[:, None] * np.array([0.0, 0.0, 1.0])

    return bow


SHAPES = (
    Shape("board stretch", "the board is longer along its x axis than along y, by a share", _stretch, "%", 100.0),
    Shape("board bow along x", "the board is bowed along its x axis", _bow_along(0), "mm", 1e3),
    Shape("board bow along y", "the board is bowed along its y axis", _bow_along(1), "mm", 1e3),
)


def with_shapes(raw: FrameMoments, views: Mapping[str, Views], estimate: Estimate) -> FrameMoments:
    """The moments (n, D, D), all intrinsics free and whitened by 1 px, with a column for each shape before the
    residual's."""
    n, D, count = len(raw.moments), raw.moments.shape[1], len(SHAPES)
    columns_px = [_columns_px(views, estimate, shape) for shape in SHAPES]
    whole = np.zeros((n, D + count, D + count))
    old = np.append(np.arange(D - 1), D + count - 1)
    whole[:, old[:, None], old] = raw.moments
    for s, column in enumerate(columns_px):
        crossed = _crossed(raw, views, estimate, column)
        whole[:, D - 1 + s, old] = whole[:, old, D - 1 + s] = crossed
        for t in range(count):
            whole[:, D - 1 + s, D - 1 + t] = _products(raw, views, column, columns_px[t])
    return replace(raw, moments=whole)


def _columns_px(views: Mapping[str, Views], estimate: Estimate, shape: Shape) -> dict[str, FloatArray]:
    """By camera, (N, 2) by how much a unit of the shape moves each corner in the image; 0 where it has no pixel."""
    all_m = np.concatenate([of_camera.corners_m for of_camera in views.values()])
    centre_m = 0.5 * (all_m.max(axis=0) + all_m.min(axis=0))
    half_m = np.maximum(0.5 * np.ptp(all_m, axis=0), 1e-6)
    found = {}
    for name, of_camera in views.items():
        step = _STEP * shape.displacement(of_camera.corners_m - centre_m, half_m)
        ends = (
            chain_residuals_px(replace(of_camera, corners_m=of_camera.corners_m + s * step), estimate) for s in (1, -1)
        )
        after, before = ends
        found[name] = np.nan_to_num((after - before) / (2.0 * _STEP))
    return found


def _crossed(
    raw: FrameMoments, views: Mapping[str, Views], estimate: Estimate, column_px: Mapping[str, FloatArray]
) -> FloatArray:
    """(n, D) of a column with the tangents and the residual."""
    moved = {
        name: replace(of_camera, corners_px=of_camera.corners_px - _STEP * column_px[name])
        for name, of_camera in views.items()
    }
    shifted = frame_moments(moved, estimate, sigma_px=1.0, free_theta=True, frames=raw.frame_index)
    crossed = (shifted.moments[:, :, -1] - raw.moments[:, :, -1]) / _STEP
    residuals_px = {name: np.nan_to_num(chain_residuals_px(of_camera, estimate)) for name, of_camera in views.items()}
    crossed[:, -1] = _products(raw, views, column_px, residuals_px)
    return np.asarray(crossed)


def _products(
    raw: FrameMoments, views: Mapping[str, Views], a_px: Mapping[str, FloatArray], b_px: Mapping[str, FloatArray]
) -> FloatArray:
    """(n,) sums over each frame's corners."""
    sums = np.zeros(len(raw.frame_index))
    for name, of_camera in views.items():
        of_view = np.add.reduceat((a_px[name] * b_px[name]).sum(axis=1), of_camera.view_start[:-1])
        chosen = np.isin(of_camera.frame_index, raw.frame_index)
        np.add.at(sums, np.searchsorted(raw.frame_index, of_camera.frame_index[chosen]), of_view[chosen])
    return sums
