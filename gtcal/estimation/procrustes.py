"""Stage 1: a sweep of closed-form (Procrustes) updates from many starting rotations, in constant time.

E_3D = sum over cameras c, views v and corners p of |Y_c A_v X p - That_v p|^2 with Y_c = camera_T_ref,
A_v = ref_T_body, X = body_T_board and That_v the PnP pose. With M_v = sum p p^T over homogeneous corners, each
alternate update needs only a 4 x 4 matrix H that is linear in the other unknown:

    Y_c given X:  H = sum_v (That_v M_v) (A_v X)^T       = K_c : X
    X given Y:    H = sum_v A_v^-1 Y_c^-1 (That_v M_v)   = L_c : Y_c^-1

One pass over the views builds K_c and L_c; then a sweep costs the same for ten views or a million, and all starting
rotations run as one batch of small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray

N_RANDOM_ROTATIONS = 300
N_STARTS = 30
N_SWEEPS = 10


@dataclass(frozen=True)
class AlignmentSums:
    """All that E_3D needs of one camera's views.

    K, L: (4, 4, 4, 4) as in the module's docstring: H_ik = K_ijkl X_lj, H_il = L_ijkl Yinv_jk.
    M: (4, 4) sum of M_v. constant: what of E_3D depends on neither X nor Y. n_corners: how many."""

    K: FloatArray
    L: FloatArray
    M: FloatArray
    constant: float
    n_corners: int


@dataclass(frozen=True)
class SweepResult:
    """The best of the starts: camera_T_ref (C, 4, 4), body_T_board (4, 4), rmse_m = sqrt(E_3D / corners), and
    the rmse of every start (S,). n_steps: of the start that took most."""

    camera_T_ref: FloatArray
    body_T_board: FloatArray
    rmse_m: float
    rmse_of_starts_m: FloatArray
    n_steps: int


def alignment_sums(ref_T_body: FloatArray, pnp_camera_T_board: FloatArray, moments: FloatArray) -> AlignmentSums:
    """One pass over a camera's views; all three arguments (V, 4, 4)."""
    weighted = (pnp_camera_T_board @ moments).reshape(-1, 16)
    body_T_ref = inverse(ref_T_body)
    K = (weighted.T @ ref_T_body.reshape(-1, 16)).reshape(4, 4, 4, 4)
    L = (body_T_ref.reshape(-1, 16).T @ weighted).reshape(4, 4, 4, 4)
    n_by_view = moments[:, 3, 3]
    measured = np.einsum("vij,vjk,vik->", pnp_camera_T_board[:, :3], moments, pnp_camera_T_board[:, :3])
    offsets = n_by_view @ (ref_T_body[:, :3, 3] ** 2).sum(axis=1)
    return AlignmentSums(K, L, moments.sum(axis=0), float(measured + offsets), round(n_by_view.sum()))


def _closest_rigid(H: FloatArray) -> FloatArray:
    """The rigid transform (B, 4, 4) that takes points q closest to points p, from H = sum p q^T (B, 4, 4) over
    homogeneous points (Umeyama 1991, without scale)."""
    n = H[:, 3:, 3:]
    p_mean, q_mean = H[:, :3, 3:] / n, H[:, 3:, :3] / n
    U, _, Vt = np.linalg.svd(H[:, :3, :3] - n * p_mean * q_mean)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    T = np.zeros(H.shape)
    T[:, :3, :3] = U @ Vt
    T[:, :3, 3:] = p_mean - T[:, :3, :3] @ np.swapaxes(q_mean, 1, 2)
    T[:, 3, 3] = 1.0
    return T


def solve_camera_T_ref(sums: AlignmentSums, body_T_board: FloatArray) -> FloatArray:
    """The best Y_c (B, 4, 4) for each X (B, 4, 4)."""
    return _closest_rigid(np.einsum("ijkl,blj->bik", sums.K, body_T_board))


def solve_body_T_board(sums: Sequence[AlignmentSums], camera_T_ref: FloatArray) -> FloatArray:
    """The best X (B, 4, 4) for each set of Y_c, camera_T_ref (B, C, 4, 4)."""
    ref_T_camera = inverse(camera_T_ref)
    by_camera = [np.einsum("ijkl,bjk->bil", s.L, ref_T_camera[:, c]) for c, s in enumerate(sums)]
    return _closest_rigid(np.sum(by_camera, axis=0))


def energy_m2(sums: Sequence[AlignmentSums], camera_T_ref: FloatArray, body_T_board: FloatArray) -> FloatArray:
    """E_3D (B,) in m^2 for camera_T_ref (B, C, 4, 4) and body_T_board (B, 4, 4), from the sums alone."""
    by_camera = [_energy_of_camera(s, camera_T_ref[:, c], body_T_board) for c, s in enumerate(sums)]
    return np.asarray(np.sum(by_camera, axis=0))


def _energy_of_camera(sums: AlignmentSums, Y: FloatArray, X: FloatArray) -> FloatArray:
    """|Y q|^2 - 2 That p . Y q + |That p|^2 with q = A X p, each summed over the corners."""
    H = np.einsum("ijkl,blj->bik", sums.K, X)
    q_sum, t = H[:, 3, :3], Y[:, :3, 3]
    in_body = np.einsum("bij,jk,bik->b", X[:, :3], sums.M, X[:, :3])
    # A^-1 has the translation -R_A^T t_A: L_i33l holds its sum with the corners
    turned = -2.0 * np.einsum("il,bil->b", sums.L[:3, 3, 3], X[:, :3])
    moved = 2.0 * np.einsum("bi,bij,bj->b", t, Y[:, :3, :3], q_sum) + sums.n_corners * (t**2).sum(axis=1)
    cross = np.einsum("bik,bik->b", H[:, :3], Y[:, :3])
    return in_body + turned + moved - 2.0 * cross + sums.constant


def starting_rotations(rng: np.random.Generator, n_starts: int = N_STARTS) -> FloatArray:
    """``n_starts`` of N_RANDOM_ROTATIONS random rotations, far apart: a greedy farthest-point pick in the Frobenius
    distance, (n_starts, 3, 3)."""
    rotations = Rotation.random(N_RANDOM_ROTATIONS, rng=rng).as_matrix()
    chosen = [0]
    distance = np.full(N_RANDOM_ROTATIONS, np.inf)
    while len(chosen) < n_starts:
        distance = np.minimum(distance, ((rotations - rotations[chosen[-1]]) ** 2).sum(axis=(1, 2)))
        chosen.append(int(distance.argmax()))
    return rotations[chosen]


def sweep(sums: Sequence[AlignmentSums], rng: np.random.Generator, n_starts: int = N_STARTS) -> SweepResult:
    """N_SWEEPS alternate updates from each starting rotation of X, X last; the start that ends lowest."""
    Y, X = swept(sums, rng, n_starts)
    energy = np.maximum(energy_m2(sums, Y, X), 0.0)
    rmse_m = np.sqrt(energy / sum(s.n_corners for s in sums))
    best = int(rmse_m.argmin())
    return SweepResult(Y[best], X[best], float(rmse_m[best]), rmse_m, N_SWEEPS)


def swept(sums: Sequence[AlignmentSums], rng: np.random.Generator, n_starts: int) -> tuple[FloatArray, FloatArray]:
    """Where ``sweep`` ends from each start: camera_T_ref (S, C, 4, 4) and body_T_board (S, 4, 4)."""
    X = np.zeros((n_starts, 4, 4))
    X[:, :3, :3], X[:, 3, 3] = starting_rotations(rng, n_starts), 1.0
    for _ in range(N_SWEEPS):
        Y = np.stack([solve_camera_T_ref(s, X) for s in sums], axis=1)
        X = solve_body_T_board(sums, Y)
    return Y, X
