"""Rigid transforms as 4 x 4 matrices for compiled kernels. Tangents as in GTSAM: rotation first, T * Exp(xi)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel

if TYPE_CHECKING:
    import gtsam

FloatArray = npt.NDArray[np.float64]


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
