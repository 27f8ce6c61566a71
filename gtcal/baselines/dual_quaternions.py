"""Daniilidis' closed form: rotation and translation of X together, by dual quaternions.

A screw X carries A X = X B into q_A q_X = q_X q_B for unit dual quaternions q = r + eps t r / 2. Their vector parts
give six linear equations for each motion in the eight numbers of q_X; the two singular vectors of the smallest values
are combined so that its norm is one (Daniilidis 1999)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import skew
from gtcal.baselines.hand_eye import cameras_given_board, rigid
from gtcal.baselines.pose_pairs import PosePairs, relative_motions
from gtcal.baselines.quaternions import left_product, right_product
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError


def daniilidis(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref.

    Raises GtcalError where no combination of the two singular vectors is a rotation."""
    A, B = relative_motions(pairs, np.random.default_rng(0))
    (a, a_dual), (b, b_dual) = _dual_quaternions(A), _dual_quaternions(B)
    same = np.sign(np.sum(a[:, 0] * b[:, 0])) or 1.0  # screws that agree have equal scalar parts
    b, b_dual = same * b, same * b_dual
    T = np.zeros((len(A), 6, 8))
    T[:, :3, 0], T[:, :3, 1:4] = (a - b)[:, 1:], skew((a + b)[:, 1:])
    T[:, 3:, 0], T[:, 3:, 1:4] = (a_dual - b_dual)[:, 1:], skew((a_dual + b_dual)[:, 1:])
    T[:, 3:, 4], T[:, 3:, 5:] = T[:, :3, 0], T[:, :3, 1:4]
    *_, first, second = np.linalg.svd(T.reshape(-1, 8), full_matrices=False)[2]
    r, dual = _unit(first, second)
    turned = Rotation.from_quat(np.roll(r, -1)).as_matrix()
    t = 2.0 * (right_product(_conjugate(r)) @ dual)[1:]
    X = rigid(turned, t)
    return X, cameras_given_board(X, pairs)


def _dual_quaternions(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 4) each, wxyz with w >= 0: the rotation's, and half of its product with the translation."""
    r = np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True), 1, axis=1)
    t = np.hstack([np.zeros((len(poses), 1)), poses[:, :3, 3]])
    return r, 0.5 * np.einsum("nij,nj->ni", left_product(t), r)


def _unit(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rotation's quaternion and its dual, of a first + b second with norm 1 and no norm's dual part."""
    u1, v1, u2, v2 = first[:4], first[4:], second[:4], second[4:]
    roots = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2])
    roots = roots[np.isreal(roots)].real
    if not len(roots):
        raise GtcalError("no dual quaternion fits the motions: they leave a direction open, or are too noisy")
    squares = [s**2 * (u1 @ u1) + 2 * s * (u1 @ u2) + u2 @ u2 for s in roots]
    s, square = roots[int(np.argmax(squares))], max(squares)
    b = 1.0 / np.sqrt(square)
    return b * (s * u1 + u2), b * (s * v1 + v2)


def _conjugate(quat: FloatArray) -> FloatArray:
    return quat * np.array([1.0, -1.0, -1.0, -1.0])
