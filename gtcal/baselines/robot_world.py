"""Two more closed forms of A X = Z B, of all cameras at once: Zhuang's by quaternions, Li's by Kronecker products."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.baselines.hand_eye import nearest_rotation, rigid, shah, translations
from gtcal.baselines.pose_pairs import PosePairs
from gtcal.baselines.quaternions import left_product, right_product
from gtcal.camera import FloatArray


def zhuang(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref: a x = z b for the rotations' quaternions, linear in x and every z, then linear least
    squares for the translations (Zhuang, Roth and Sudhakar 1994; solved for a null vector, so that no part of z need
    differ from zero). A rotation has two quaternions: which of b's goes with a's, Shah's rotations tell."""
    X, cameras = shah(pairs)
    x, rows = _quaternions(X[None, :3, :3])[0], []
    for c, (name, pair) in enumerate(pairs.items()):
        z = _quaternions(inverse(cameras[name])[None, :3, :3])[0]
        left, right = (
            left_product(_quaternions(pair.ref_T_body[:, :3, :3])),
            right_product(_quaternions(pair.camera_T_board[:, :3, :3])),
        )
        same = np.sign(np.einsum("vi,vi->v", left @ x, right @ z))
        block = np.zeros((len(left), 4, 4 + 4 * len(pairs)))
        block[:, :, :4], block[:, :, 4 + 4 * c : 8 + 4 * c] = left, -same[:, None, None] * right
        rows.append(block.reshape(-1, block.shape[2]))
    found = np.linalg.svd(np.concatenate(rows), full_matrices=False)[2][-1].reshape(-1, 4)
    R_X, *R_Z = Rotation.from_quat(np.roll(found, -1, axis=1)).as_matrix()
    return translations(pairs, R_X, R_Z)


def li(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref: rotations and translations at once, as 12 free numbers each, by linear least squares;
    then the rotations are made such (Li, Wang and Wu 2010)."""
    rows, sides = [], []
    for c, pair in enumerate(pairs.values()):
        n = len(pair.ref_T_body)
        A, B = pair.ref_T_body, pair.camera_T_board
        block = np.zeros((n, 12, 12 + 12 * len(pairs)))
        own = slice(12 + 12 * c, 21 + 12 * c)
        # vec stacks rows: vec(R_A R_X) = (R_A x I) vec(R_X), vec(R_Z R_B) = (I x R_B^T) vec(R_Z)
        block[:, :9, :9] = np.einsum("vij,kl->vikjl", A[:, :3, :3], np.eye(3)).reshape(n, 9, 9)
        block[:, :9, own] = -np.einsum("ij,vlk->vikjl", np.eye(3), B[:, :3, :3]).reshape(n, 9, 9)
        block[:, 9:, 9:12] = A[:, :3, :3]
        block[:, 9:, own] = -np.einsum("ij,vk->vijk", np.eye(3), B[:, :3, 3]).reshape(n, 3, 9)
        block[:, 9:, 21 + 12 * c : 24 + 12 * c] = -np.eye(3)
        rows.append(block.reshape(-1, block.shape[2]))
        sides.append(np.concatenate([np.zeros((n, 9)), -A[:, :3, 3]], axis=1).ravel())
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(sides), rcond=None)[0].reshape(-1, 12)
    X, *Z = (rigid(nearest_rotation(part[:9].reshape(3, 3)), part[9:]) for part in found)
    return X, {name: inverse(z) for name, z in zip(pairs, Z, strict=True)}


def _quaternions(rotations: FloatArray) -> FloatArray:
    """(N, 4) wxyz."""
    return np.roll(Rotation.from_matrix(rotations).as_quat(), 1, axis=1)
