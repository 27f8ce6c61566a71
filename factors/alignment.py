"""The 3-D alignment error of stage 2: board corners through the chain against the PnP pose of their view.

    E_3D = sum over views and corners |(camera_T_ref * ref_T_body * body_T_board - camera_T_board_pnp) corner|^2

Of a view's corners only the moment matrix M = sum p p^T of the homogeneous corners p enters, so a view costs the
same for four corners or four hundred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
import numpy.typing as npt

from factors.kernel import kernel
from factors.moments import chain, transport, triangular_factor
from factors.rigid import pose_at

FloatArray = npt.NDArray[np.float64]


@kernel
def _alignment_moments(
    camera_T_board: FloatArray,
    measured_camera_T_board: FloatArray,
    corner_moments: FloatArray,
    out: FloatArray,
) -> None:
    N, Q = np.empty((3, 4)), np.empty((3, 4))
    for v in range(len(camera_T_board)):
        T, M = camera_T_board[v], corner_moments[v]
        off = T[:3] - measured_camera_T_board[v, :3]
        squared = 0.0
        for i in range(3):
            for j in range(4):
                N[i, j] = off[i, 0] * M[0, j] + off[i, 1] * M[1, j] + off[i, 2] * M[2, j] + off[i, 3] * M[3, j]
                squared += N[i, j] * off[i, j]
        S = out[v]
        S[:] = 0.0
        trace = M[0, 0] + M[1, 1] + M[2, 2]
        for i in range(3):
            for j in range(3):
                S[i, j] = -M[i, j]  # sum of [p]x^T [p]x
            S[i, i] += trace
            S[3 + i, 3 + i] = M[3, 3]
        # sum of [p]x = ([J] rotation)^T ([J] translation), rotated into the board frame
        x, y, z = M[0, 3], M[1, 3], M[2, 3]
        S[0, 4], S[0, 5], S[1, 3], S[1, 5], S[2, 3], S[2, 4] = -z, y, z, -x, -y, x
        for i in range(3):  # sum of (residual in the board frame) p^T
            for j in range(4):
                Q[i, j] = T[0, i] * N[0, j] + T[1, i] * N[1, j] + T[2, i] * N[2, j]
        S[0, 6], S[1, 6], S[2, 6] = Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]
        S[3, 6], S[4, 6], S[5, 6] = Q[0, 3], Q[1, 3], Q[2, 3]
        S[6, 6] = squared
        for i in range(7):
            for j in range(i):
                S[i, j] = S[j, i]


def corner_moments(view_start: npt.NDArray[np.int64], corners_m: FloatArray) -> FloatArray:
    """Sum of p p^T over the homogeneous corners of each view, (V, 4, 4).

    view_start: (V + 1,) first row of each view, and the number of rows. corners_m: (N, 3) in the board frame.

    Raises ValueError for a view without corners: there is no PnP pose to align it with."""
    if (np.diff(view_start) <= 0).any() or view_start[0] != 0 or view_start[-1] != len(corners_m):
        raise ValueError(f"view_start must rise from 0 to N={len(corners_m)}: every view needs a corner")
    homogeneous = np.concatenate([corners_m, np.ones((len(corners_m), 1))], axis=1)
    outer = homogeneous[:, :, None] * homogeneous[:, None, :]
    return np.add.reduceat(outer, view_start[:-1], axis=0)


def squared_distances(
    camera_T_board: FloatArray, measured_camera_T_board: FloatArray, moments: FloatArray
) -> FloatArray:
    """Sum over the corners of each view of the squared distance in m^2 between the two poses' corners, (V,)."""
    off = (camera_T_board - measured_camera_T_board)[:, :3]
    squared: FloatArray = np.einsum("vij,vjk,vik->v", off, moments, off)
    return squared


@dataclass(frozen=True)
class _AlignmentResidual:
    camera_T_ref_key: int
    body_T_board_key: int
    ref_T_body: FloatArray
    measured_camera_T_board: FloatArray
    corner_moments: FloatArray
    sigma_m: float

    def __call__(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: object) -> FloatArray:
        camera_T_ref = pose_at(values, self.camera_T_ref_key)
        body_T_board = pose_at(values, self.body_T_board_key)
        camera_T_board = chain(camera_T_ref, self.ref_T_body, body_T_board)
        if jacobians is None:
            squared = squared_distances(camera_T_board, self.measured_camera_T_board, self.corner_moments)
            return np.array([math.sqrt(max(0.0, squared.sum())) / self.sigma_m])
        by_view = np.empty((len(camera_T_board), 7, 7))
        _alignment_moments(camera_T_board, self.measured_camera_T_board, self.corner_moments, by_view)
        triangle = triangular_factor(transport(by_view, self.ref_T_body, body_T_board)) / self.sigma_m
        jacobians[0] = np.asfortranarray(triangle[:, :6])  # type: ignore[index]
        jacobians[1] = np.asfortranarray(triangle[:, 6:12])  # type: ignore[index]
        return triangle[:, 12]


class PointAlignmentFactor(gtsam.CustomFactor):
    """E_3D of one camera's views as one factor on the Pose3 variables camera_T_ref and body_T_board.

    ref_T_body, measured_camera_T_board: (V, 4, 4) mocap poses and PnP poses.
    corner_moments: (V, 4, 4) as ``corner_moments`` makes them.
    sigma_m: standard deviation of one coordinate of a corner placed by PnP.

    Raises ValueError where the shapes differ or sigma_m is not positive."""

    def __init__(
        self,
        camera_T_ref_key: int,
        body_T_board_key: int,
        *,
        ref_T_body: FloatArray,
        measured_camera_T_board: FloatArray,
        corner_moments: FloatArray,
        sigma_m: float = 1.0,
    ) -> None:
        if not ref_T_body.shape == measured_camera_T_board.shape == corner_moments.shape:
            raise ValueError(
                f"{ref_T_body.shape=}, {measured_camera_T_board.shape=}, {corner_moments.shape=}, "
                "expected one shape (V, 4, 4)"
            )
        if not sigma_m > 0.0:
            raise ValueError(f"{sigma_m=}, expected a positive standard deviation")
        residual = _AlignmentResidual(
            camera_T_ref_key, body_T_board_key, ref_T_body, measured_camera_T_board, corner_moments, sigma_m
        )
        # no noise model: the rows come whitened, and a value-only call returns fewer of them
        super().__init__(None, [camera_T_ref_key, body_T_board_key], residual)  # type: ignore[call-overload]
