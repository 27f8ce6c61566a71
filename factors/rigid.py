"""Rigid transforms as 4 x 4 matrices for compiled kernels. Tangents as in GTSAM: rotation first, T * Exp(xi)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel

if TYPE_CHECKING:
    import gtsam

FloatArray = npt.NDArray[np.float64]

_NOTHING = 1e-18


@kernel
def compose(a_T_b: FloatArray, b_T_c: FloatArray, a_T_c: FloatArray) -> None:
    """Write a_T_b * b_T_c into a_T_c (3, 4) or (4, 4); its last row is left alone."""
    for i in range(3):
        for j in range(4):
            a_T_c[i, j] = a_T_b[i, 0] * b_T_c[0, j] + a_T_b[i, 1] * b_T_c[1, j] + a_T_b[i, 2] * b_T_c[2, j]
        a_T_c[i, 3] += a_T_b[i, 3]


@kernel
def adjoint_of_inverse(a_T_b: FloatArray, adjoint: FloatArray) -> None:
    """Write Ad(a_T_b^-1) into adjoint (6, 6): a_T_b * Exp(Ad(a_T_b^-1) xi) = Exp(xi) * a_T_b."""
    for i in range(3):
        for j in range(3):
            adjoint[i, j] = adjoint[i + 3, j + 3] = a_T_b[j, i]
            adjoint[i, j + 3] = 0.0
        # the row R^T [-t]x, that is (t x R[:, i])^T
        x, y, z = a_T_b[0, i], a_T_b[1, i], a_T_b[2, i]
        tx, ty, tz = a_T_b[0, 3], a_T_b[1, 3], a_T_b[2, 3]
        adjoint[i + 3, 0] = ty * z - tz * y
        adjoint[i + 3, 1] = tz * x - tx * z
        adjoint[i + 3, 2] = tx * y - ty * x


def pose_at(values: gtsam.Values, key: int) -> FloatArray:
    """The Pose3 at ``key`` as a matrix (4, 4), row-major: GTSAM's own order would have every kernel compiled twice."""
    return np.ascontiguousarray(values.atPose3(key).matrix())


def inverse(a_T_b: FloatArray) -> FloatArray:
    """b_T_a of rigid transforms (..., 4, 4)."""
    b_T_a = np.zeros_like(a_T_b)
    rotation = np.swapaxes(a_T_b[..., :3, :3], -1, -2)
    b_T_a[..., :3, :3] = rotation
    b_T_a[..., :3, 3] = -(rotation @ a_T_b[..., :3, 3:])[..., 0]
    b_T_a[..., 3, 3] = 1.0
    return b_T_a


def skew(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) with skew(v) w = v x w, of vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vectors.shape[:-1], 3, 3)


def adjoint(a_T_b: FloatArray) -> FloatArray:
    """Ad(a_T_b), (N, 6, 6) of (N, 4, 4)."""
    R = a_T_b[:, :3, :3]
    found = np.zeros((len(a_T_b), 6, 6))
    found[:, :3, :3] = found[:, 3:, 3:] = R
    found[:, 3:, :3] = skew(a_T_b[:, :3, 3]) @ R
    return found


def exponential(xi: FloatArray) -> FloatArray:
    """Exp(xi), (N, 4, 4) of twists (N, 6), by its series."""
    hat = np.zeros((len(xi), 4, 4))
    hat[:, :3, :3], hat[:, :3, 3] = skew(xi[:, :3]), xi[:, 3:]
    return _series(hat, lambda k: 1.0 / k)


def right_jacobian(xi: FloatArray) -> FloatArray:
    """J_r(xi), (N, 6, 6) of twists (N, 6): Exp(xi + d) = Exp(xi) Exp(J_r(xi) d) to first order (Chirikjian 2012)."""
    ad = np.zeros((len(xi), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = skew(xi[:, :3])
    ad[:, 3:, :3] = skew(xi[:, 3:])
    return _series(ad, lambda k: -1.0 / (k + 1.0))


def _series(A: FloatArray, factor: Callable[[int], float]) -> FloatArray:
    """I + f(1) A + f(1) f(2) A^2 + ... of matrices (N, n, n), until nothing is added."""
    total = np.tile(np.eye(A.shape[1]), (len(A), 1, 1))
    term, k = total, 0
    while np.abs(term).max(initial=0.0) > _NOTHING:
        k += 1
        term = factor(k) * term @ A
        total = total + term
    return total
