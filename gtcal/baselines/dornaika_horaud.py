"""Nonlinear least squares on poses: rotation and translation of X and of every camera together.

Dornaika and Horaud (1998): minimise |R_A R_X - R_Z R_B|^2 and |R_A t_X + t_A - R_Z t_B - t_Z|^2, summed, A X = Z B.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.baselines.hand_eye import shah
from gtcal.baselines.pose_pairs import PosePairs
from gtcal.camera import FloatArray


def dornaika_horaud(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref, from where the closed form of Shah starts it. Lengths count in m, as published."""
    X, cameras = shah(pairs)
    start = [X, *(inverse(pose) for pose in cameras.values())]

    def poses(x: FloatArray) -> list[FloatArray]:
        return [pose @ _moved(step) for pose, step in zip(start, x.reshape(-1, 6), strict=True)]

    def residuals(x: FloatArray) -> FloatArray:
        X, *Z = poses(x)
        both = zip(pairs.values(), Z, strict=True)
        return np.concatenate([(pair.ref_T_body @ X - z @ pair.camera_T_board)[:, :3] for pair, z in both]).ravel()

    X, *Z = poses(least_squares(residuals, np.zeros(6 * len(start)), x_scale="jac").x)
    return X, {name: inverse(z) for name, z in zip(pairs, Z, strict=True)}


def _moved(step: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
    return matrix
