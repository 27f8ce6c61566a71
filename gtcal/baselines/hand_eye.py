"""Closed forms: from poses alone, without a first guess and without weights.

With A = ref_T_body, B = camera_T_board, X = body_T_board and Z = ref_T_camera: A X = Z B. Between two views of a camera
A' X = X B' (hand-eye), A' = A_i^-1 A_j, B' = B_i^-1 B_j.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse, skew
from gtcal.baselines.pose_pairs import PosePairs, relative_motions
from gtcal.camera import FloatArray


def tsai_lenz(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref. Rotation by modified Rodrigues vectors, then translation (Tsai and Lenz 1989)."""
    A, B = relative_motions(pairs, np.random.default_rng(0))
    a, b = (_half_sine_axes(motions[:, :3, :3]) for motions in (A, B))
    rows, right = skew(a + b).reshape(-1, 3), (b - a).ravel()
    tangent = np.linalg.lstsq(rows, right, rcond=None)[0]  # tan(angle / 2) times the axis
    x, y, z, w = *tangent, 1.0
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    return _with_cameras(_with_translation(rotation, A, B), pairs)


def park_martin(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref. Rotation by least squares on logarithms, then translation (Park and Martin 1994)."""
    A, B = relative_motions(pairs, np.random.default_rng(0))
    alpha, beta = (Rotation.from_matrix(motions[:, :3, :3]).as_rotvec() for motions in (A, B))
    rotation = nearest_rotation(alpha.T @ beta)
    return _with_cameras(_with_translation(rotation, A, B), pairs)


def shah(pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref, of all cameras at once: A X = Z_c B by Kronecker products and a singular value
    decomposition for the rotations, then linear least squares for the translations (Shah 2013)."""
    K = np.concatenate(
        [
            np.einsum("vij,vkl->ikjl", pair.camera_T_board[:, :3, :3], pair.ref_T_body[:, :3, :3]).reshape(9, 9)
            for pair in pairs.values()
        ]
    )
    left, _, right = np.linalg.svd(K, full_matrices=False)
    parts = [right[0], *np.split(left[:, 0], len(pairs))]
    rotations = [part.reshape(3, 3).T for part in parts]  # vec stacks columns
    sign = np.sign(np.linalg.det(rotations[0]))
    R_X, *R_Z = (nearest_rotation(sign * rotation) for rotation in rotations)
    return translations(pairs, R_X, R_Z)


def translations(
    pairs: Mapping[str, PosePairs], R_X: FloatArray, R_Z: Sequence[FloatArray]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """X and each camera_T_ref of A X = Z_c B for known rotations, by linear least squares."""
    rows, sides = [], []
    for c, (pair, rotation) in enumerate(zip(pairs.values(), R_Z, strict=True)):
        block = np.zeros((len(pair.ref_T_body), 3, 3 + 3 * len(pairs)))
        block[:, :, :3] = pair.ref_T_body[:, :3, :3]
        block[:, :, 3 + 3 * c : 6 + 3 * c] = -np.eye(3)
        rows.append(block.reshape(-1, block.shape[2]))
        sides.append((pair.camera_T_board[:, :3, 3] @ rotation.T - pair.ref_T_body[:, :3, 3]).ravel())
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(sides), rcond=None)[0].reshape(-1, 3)
    cameras = {name: inverse(rigid(R_Z[c], found[1 + c])) for c, name in enumerate(pairs)}
    return rigid(R_X, found[0]), cameras


def cameras_given_board(body_T_board: FloatArray, pairs: Mapping[str, PosePairs]) -> dict[str, FloatArray]:
    """Each camera_T_ref as the mean over its views of B (A X)^-1: rotations averaged by the chordal mean."""
    cameras = {}
    for name, pair in pairs.items():
        ref_T_camera = pair.ref_T_body @ body_T_board @ inverse(pair.camera_T_board)
        rotation = nearest_rotation(np.asarray(ref_T_camera[:, :3, :3].sum(axis=0), dtype=np.float64))
        position_m = np.asarray(np.median(ref_T_camera[:, :3, 3], axis=0), dtype=np.float64)
        cameras[name] = inverse(rigid(rotation, position_m))
    return cameras


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The rotation (3, 3) of the largest trace with ``matrix`` (Kabsch)."""
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _with_cameras(body_T_board: FloatArray, pairs: Mapping[str, PosePairs]) -> tuple[FloatArray, dict[str, FloatArray]]:
    return body_T_board, cameras_given_board(body_T_board, pairs)


def _with_translation(rotation: FloatArray, A: FloatArray, B: FloatArray) -> FloatArray:
    """X with (R_A - I) t_X = R_X t_B - t_A in least squares."""
    rows = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (B[:, :3, 3] @ rotation.T - A[:, :3, 3]).ravel()
    return rigid(rotation, np.linalg.lstsq(rows, right, rcond=None)[0].astype(np.float64))


def _half_sine_axes(rotations: FloatArray) -> FloatArray:
    """(N, 3) 2 sin(angle / 2) times the axis."""
    vectors = Rotation.from_matrix(rotations).as_rotvec()
    angles = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(2.0 * np.sin(0.5 * angles) * vectors / angles)


def rigid(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """(4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix
