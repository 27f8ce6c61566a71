"""The kernels of the reprojection error: templates, compiled for each camera model
(``factors.camera_models.projection``)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from factors.board_shape import N_SHAPE, shape_columns, shaped_corner
from factors.camera_models import CameraModel
from factors.camera_models.parts import Function
from factors.kernel import inlined, inlined_with, kernel_with, unbound
from factors.rigid import adjoint_of_inverse, compose
from factors.robust import CALLED_BACK, MEASURED, robust_loss_and_weight

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Names that ``view_kernels`` binds
field_end: Function = unbound
project_point: Function = unbound
corner_residual: Function = unbound


@inlined
def _moved(T: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


def _corner_residual(
    theta: FloatArray,
    end: FloatArray,
    T: FloatArray,
    stated_X: float,
    stated_Y: float,
    stated_Z: float,
    outline_m: FloatArray,
    shape: FloatArray,
    measured_x: float,
    measured_y: float,
    rows: FloatArray,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
    with_shape: bool,
) -> bool:
    """Write [J r] of the corner stated at (X, Y, Z) in the board frame, in px, into rows (2, D); columns as in
    ViewMoments, T = camera_T_board. Whether the corner has a pixel."""
    X, Y, Z = shaped_corner(outline_m, shape, stated_X, stated_Y, stated_Z)
    x, y, z = _moved(T, X, Y, Z)
    px, py, valid = project_point(theta, end, x, y, z, J_point, J_theta, with_theta)
    last = rows.shape[1] - 1
    if math.isnan(px):
        rows[:] = 0.0
        rows[0, last] = rows[1, last] = 2.0 * theta[0]
        return False
    for i in range(2):
        a, b, c = J_point[i, 0], J_point[i, 1], J_point[i, 2]
        gx = a * T[0, 0] + b * T[1, 0] + c * T[2, 0]
        gy = a * T[0, 1] + b * T[1, 1] + c * T[2, 1]
        gz = a * T[0, 2] + b * T[1, 2] + c * T[2, 2]
        rows[i, 0], rows[i, 1], rows[i, 2] = Y * gz - Z * gy, Z * gx - X * gz, X * gy - Y * gx
        rows[i, 3], rows[i, 4], rows[i, 5] = gx, gy, gz
        if with_theta:
            for k in range(len(theta)):
                rows[i, 6 + k] = J_theta[i, k]
        if with_shape:
            shape_columns(outline_m, stated_X, stated_Y, gx, gy, gz, rows[i], last - N_SHAPE)
    rows[0, last], rows[1, last] = px - measured_x, py - measured_y
    return valid


_ROWS = 4
"""Two corners' rows are multiplied out at a time: each sum is then loaded and stored half as often."""


@inlined
def _add_products(rows: FloatArray, total: FloatArray) -> None:
    """rows^T rows onto the upper triangle of total."""
    for a in range(rows.shape[1]):
        p, q, r, s = rows[0, a], rows[1, a], rows[2, a], rows[3, a]
        for b in range(a, rows.shape[1]):
            total[a, b] += p * rows[0, b] + q * rows[1, b] + r * rows[2, b] + s * rows[3, b]


def _sum_views(
    theta: FloatArray,
    camera_T_board: FloatArray,
    view_start: IntArray,
    corners_m: FloatArray,
    corners_px: FloatArray,
    outline_m: FloatArray,
    shape: FloatArray,
    sigma_px: float,
    kernel_id: int,
    kernel_parameter: float,
    with_theta: bool,
    with_shape: bool,
    with_moments: bool,
    first_view: int,
    end_view: int,
    called_back: FloatArray,
    moments: FloatArray,
    loss: FloatArray,
    n_invalid: IntArray,
) -> None:
    """``called_back`` (N, 2): loss and weight of each corner where the kernel is ``CALLED_BACK``; where it is
    ``MEASURED``, its whitened distance is written into the first column."""
    end = field_end(theta, with_theta)
    J_point, J_theta = np.empty((2, 3)), np.empty((2, len(theta)))
    columns = 7 + (len(theta) if with_theta else 0) + (N_SHAPE if with_shape else 0)
    rows, total = np.empty((_ROWS, columns)), np.empty((columns, columns))
    last = columns - 1
    for v in range(first_view, end_view):
        T = camera_T_board[v]
        total[:] = 0.0
        loss_of_view, invalid = 0.0, 0
        filled = 0
        for n in range(view_start[v], view_start[v + 1]):
            own = rows[filled : filled + 2]
            invalid += not corner_residual(
                theta,
                end,
                T,
                corners_m[n, 0],
                corners_m[n, 1],
                corners_m[n, 2],
                outline_m,
                shape,
                corners_px[n, 0],
                corners_px[n, 1],
                own,
                J_point,
                J_theta,
                with_theta,
                with_shape,
            )
            distance = math.sqrt(own[0, last] ** 2 + own[1, last] ** 2) / sigma_px
            if kernel_id == CALLED_BACK:
                rho, weight = called_back[n, 0], called_back[n, 1]
            elif kernel_id == MEASURED:
                rho, weight, called_back[n, 0] = 0.0, 0.0, distance
            else:
                rho, weight = robust_loss_and_weight(kernel_id, kernel_parameter, distance)
            loss_of_view += rho
            if with_moments:
                own *= math.sqrt(weight) / sigma_px
                filled += 2
                if filled == _ROWS:
                    _add_products(rows, total)
                    filled = 0
        if filled:
            rows[filled:] = 0.0
            _add_products(rows, total)
        loss[v], n_invalid[v] = loss_of_view, invalid
        if with_moments:
            for a in range(columns):
                for b in range(a, columns):
                    moments[v, a, b] = moments[v, b, a] = total[a, b]


def _residuals(
    theta: FloatArray,
    camera_T_board: FloatArray,
    view_start: IntArray,
    corners_m: FloatArray,
    corners_px: FloatArray,
    outline_m: FloatArray,
    shape: FloatArray,
    first_view: int,
    end_view: int,
    residuals_px: FloatArray,
) -> None:
    end = field_end(theta, False)
    J_point, J_theta = np.empty((2, 3)), np.empty((2, len(theta)))
    for v in range(first_view, end_view):
        T = camera_T_board[v]
        for n in range(view_start[v], view_start[v + 1]):
            X, Y, Z = shaped_corner(outline_m, shape, corners_m[n, 0], corners_m[n, 1], corners_m[n, 2])
            x, y, z = _moved(T, X, Y, Z)
            px, py, valid = project_point(theta, end, x, y, z, J_point, J_theta, False)
            if valid:
                residuals_px[n, 0], residuals_px[n, 1] = px - corners_px[n, 0], py - corners_px[n, 1]
            else:
                residuals_px[n] = math.nan


def _corner_rows(
    theta: FloatArray,
    camera_T_ref: FloatArray,
    ref_T_body: FloatArray,
    body_T_board: FloatArray,
    corner_m: FloatArray,
    corner_px: FloatArray,
    outline_m: FloatArray,
    shape: FloatArray,
    free_body: bool,
    free_theta: bool,
    free_shape: bool,
) -> FloatArray:
    """[J r] of one corner in px, shape (2, n + 1), in the variables' tangents as in ``reprojection_moments``."""
    ref_T_board, camera_T_board = np.zeros((4, 4)), np.zeros((4, 4))
    compose(ref_T_body, body_T_board, ref_T_board)
    compose(camera_T_ref, ref_T_board, camera_T_board)
    rest = 1 + (len(theta) if free_theta else 0) + (N_SHAPE if free_shape else 0)
    n_blocks = 3 if free_body else 2
    local = np.empty((2, 6 + rest))
    corner_residual(
        theta,
        field_end(theta, free_theta),
        camera_T_board,
        corner_m[0],
        corner_m[1],
        corner_m[2],
        outline_m,
        shape,
        corner_px[0],
        corner_px[1],
        local,
        np.empty((2, 3)),
        np.empty((2, len(theta))),
        free_theta,
        free_shape,
    )
    adjoint = np.empty((2, 6, 6))
    adjoint_of_inverse(ref_T_board, adjoint[0])
    adjoint_of_inverse(body_T_board, adjoint[1])
    rows = np.empty((2, 6 * n_blocks + rest))
    for i in range(2):
        for p in range(n_blocks - 1):
            for j in range(6):
                value = 0.0
                for k in range(6):
                    value += local[i, k] * adjoint[p, k, j]
                rows[i, 6 * p + j] = value
        rows[i, 6 * (n_blocks - 1) :] = local[i]
    return rows


@dataclass(frozen=True)
class ViewKernels:
    """Of one model, compiled when first called."""

    sum_views: Function
    residuals: Function
    corner_rows: Function


@cache
def view_kernels(model: CameraModel) -> ViewKernels:
    """The kernels of a camera model."""
    bound = dict(model.kernels.bound)
    bound["corner_residual"] = inlined_with(_corner_residual, model.name, bound)

    def called(template: Function) -> Function:
        return kernel_with(template, model.name, bound, cache=model.kernels.cached)

    return ViewKernels(called(_sum_views), called(_residuals), called(_corner_rows))
