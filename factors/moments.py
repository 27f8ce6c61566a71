"""Sums of [J r]^T [J r], the form in which many residuals become one small factor.

To first order, moving camera_T_ref, ref_T_body or body_T_board moves camera_T_board = camera_T_ref * ref_T_body *
body_T_board. So a view is summed once in the tangent of its camera_T_board, and adjoint maps carry the sum over to
the variables. GTSAM gets the triangular factor R of the total: R^T R = [J r]^T [J r] has the same error, gradient
and Hessian as all the residuals it stands for.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel
from factors.rigid import adjoint_of_inverse, compose

FloatArray = npt.NDArray[np.float64]


@kernel
def _chain(
    camera_T_ref: FloatArray, ref_T_body: FloatArray, body_T_board: FloatArray, camera_T_board: FloatArray
) -> None:
    """Write camera_T_ref * ref_T_body[v] * body_T_board into camera_T_board[v], for every view."""
    ref_T_board = np.zeros((4, 4))
    for v in range(len(ref_T_body)):
        compose(ref_T_body[v], body_T_board, ref_T_board)
        compose(camera_T_ref, ref_T_board, camera_T_board[v])
        camera_T_board[v, 3] = (0.0, 0.0, 0.0, 1.0)


def chain(camera_T_ref: FloatArray, ref_T_body: FloatArray, body_T_board: FloatArray) -> FloatArray:
    """camera_T_board (V, 4, 4) of views with ref_T_body (V, 4, 4)."""
    camera_T_board = np.empty(ref_T_body.shape)
    _chain(camera_T_ref, ref_T_body, body_T_board, camera_T_board)
    return camera_T_board


@kernel
def transport_view(
    S: FloatArray, ref_T_body: FloatArray, body_T_board: FloatArray, free_body: bool, total: FloatArray
) -> None:
    """Add one view's moments S (d, d) to ``total`` in the tangents of the variables: camera_T_ref, ref_T_body where it
    is free, body_T_board, theta, and the residual. Fills the upper triangle."""
    rest = len(S) - 6  # theta and the residual
    n_blocks = 3 if free_body else 2
    ref_T_board, adjoint, product = np.zeros((4, 4)), np.zeros((n_blocks, 6, 6)), np.empty((6, 6))
    for i in range(6):
        adjoint[n_blocks - 1, i, i] = 1.0  # body_T_board moves camera_T_board directly
    if free_body:
        adjoint_of_inverse(body_T_board, adjoint[1])
    compose(ref_T_body, body_T_board, ref_T_board)
    adjoint_of_inverse(ref_T_board, adjoint[0])
    for q in range(n_blocks):
        for i in range(6):
            for j in range(6):
                value = 0.0
                for k in range(6):
                    value += S[i, k] * adjoint[q, k, j]
                product[i, j] = value
        for p in range(q + 1):
            for i in range(6):
                for j in range(6):
                    value = 0.0
                    for k in range(6):
                        value += adjoint[p, k, i] * product[k, j]
                    total[6 * p + i, 6 * q + j] += value
        for i in range(6):
            for j in range(rest):
                value = 0.0
                for k in range(6):
                    value += adjoint[q, k, i] * S[k, 6 + j]
                total[6 * q + i, 6 * n_blocks + j] += value
    for i in range(rest):
        for j in range(i, rest):
            total[6 * n_blocks + i, 6 * n_blocks + j] += S[6 + i, 6 + j]


@kernel
def _transport(
    moments: FloatArray, ref_T_body: FloatArray, body_T_board: FloatArray, free_body: bool, total: FloatArray
) -> None:
    for v in range(len(moments)):
        transport_view(moments[v], ref_T_body[v], body_T_board, free_body, total)


@kernel
def triangular_factor(moments: FloatArray) -> FloatArray:
    """Upper triangular R with R^T R = moments, from the upper triangle of a positive semidefinite matrix.

    Cholesky on the matrix scaled to a unit diagonal; a pivot lost in rounding makes a zero row, so that directions
    without information stay without."""
    n = len(moments)
    scale = np.empty(n)
    for i in range(n):
        scale[i] = math.sqrt(moments[i, i]) if moments[i, i] > 0.0 else 0.0
    R = np.zeros((n, n))
    for i in range(n):
        if scale[i] == 0.0:
            continue
        pivot = 1.0
        for k in range(i):
            pivot -= R[k, i] * R[k, i]
        if pivot <= 1e-15 * n:
            continue
        R[i, i] = math.sqrt(pivot)
        for j in range(i + 1, n):
            if scale[j] == 0.0:
                continue
            value = moments[i, j] / (scale[i] * scale[j])
            for k in range(i):
                value -= R[k, i] * R[k, j]
            R[i, j] = value / R[i, i]
    for j in range(n):
        for i in range(j + 1):
            R[i, j] *= scale[j]
    return R


def transport(
    moments: FloatArray, ref_T_body: FloatArray, body_T_board: FloatArray, *, free_body: bool = False
) -> FloatArray:
    """Add up the moments (V, D, D) of views in the tangent of camera_T_board, in the tangents of the variables:
    camera_T_ref, ref_T_body where ``free_body`` (one view only), body_T_board, then what the moments have beyond
    their first six columns (theta, the residual).

    ref_T_body: (V, 4, 4). Returns the total, (D + 6, D + 6) or (D + 12, D + 12); only its upper triangle counts."""
    n = moments.shape[1] + (12 if free_body else 6)
    total = np.zeros((n, n))
    _transport(moments, ref_T_body, body_T_board, free_body, total)
    return total
