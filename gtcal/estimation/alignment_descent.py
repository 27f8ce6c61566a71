"""The minimum of E_3D from a start, to convergence: Newton's method over the rotations, translations eliminated.

The closed-form updates of stage 1 (``gtcal.estimation.procrustes``) change X and the Y_c in turns. Where rotations and
levers trade, as on an arm whose base is metres from the board, each turn goes a small way, and how far depends on where
the world's origin is. But E_3D is a fixed polynomial in the entries of X and Y_c, whose sums K_c, L_c, M are there
already: its gradient and Hessian cost the same for ten views or a million. Given all rotations it is quadratic in all
translations, which are solved for in closed form (variable projection: Golub and Pereyra 1973), so that no origin
matters. Steps over the rotations are Newton's on what is left, with the eigenvalues of the Hessian made positive and a
damping that grows until E_3D falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.procrustes import N_STARTS, AlignmentSums, SweepResult, energy_m2, swept
from gtcal.recordings.detections import IntArray

STEP_RAD = 1e-9
"""Converged where a step turns nothing by more; the next one would turn by its square."""

MOST_STEPS = 200
_FIRST_DAMPING, _LARGEST_DAMPING, _FACTOR = 1e-4, 1e12, 8.0
_OPEN = 1e-12  # of the largest eigenvalue: a translation that the motion does not tell stays where it is
_FLAT = 1e-10  # likewise, of a rotation
_LONGEST_RAD = 0.5  # of a step
_TOGETHER = 1e-3  # rad: far within the basin of any minimum
_ROUNDING = 1e-12  # of the largest terms of E_3D


def _generators() -> tuple[FloatArray, FloatArray]:
    """d T * Exp(xi) at xi = 0, T factored out: first (6, 4, 4) and second (6, 6, 4, 4) derivatives."""
    first = np.zeros((6, 4, 4))
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        first[i, k, j], first[i, j, k] = 1.0, -1.0
        first[3 + i, i, 3] = 1.0
    products = first[:, None] @ first[None, :]
    return first, 0.5 * (products + np.swapaxes(products, 0, 1))


_FIRST, _SECOND = _generators()


@dataclass(frozen=True)
class Descended:
    """Where the descents ended: camera_T_ref (B, C, 4, 4), body_T_board (B, 4, 4), energy_m2 (B,), converged (B,), and
    the steps of the longest."""

    camera_T_ref: FloatArray
    body_T_board: FloatArray
    energy_m2: FloatArray
    converged: BoolArray
    n_steps: int


def descend(sums: Sequence[AlignmentSums], camera_T_ref: FloatArray, body_T_board: FloatArray) -> Descended:
    """The minimum of E_3D below each of the starts, camera_T_ref (B, C, 4, 4) and body_T_board (B, 4, 4), whose
    translations do not matter."""
    Y, X = _with_best_translations(sums, camera_T_ref, body_T_board)
    energy = energy_m2(sums, Y, X)
    rounding_m2 = _ROUNDING * sum(s.constant for s in sums)
    damping = np.full(len(X), _FIRST_DAMPING)
    active = np.ones(len(X), dtype=bool)
    n_steps = 0
    while active.any() and n_steps < MOST_STEPS:
        n_steps += 1
        rows = np.flatnonzero(active)
        turn = _turn(sums, Y[rows], X[rows], damping[rows])
        tried = _with_best_translations(sums, *_turned(Y[rows], X[rows], turn))
        lower = energy_m2(sums, *tried)
        taken = lower <= energy[rows] + rounding_m2
        size_rad = np.abs(turn).max(axis=1)
        went = rows[taken]
        Y[went], X[went] = tried[0][taken], tried[1][taken]
        energy[went] = np.minimum(lower[taken], energy[went])
        damping[rows] = np.where(taken, damping[rows] / _FACTOR, damping[rows] * _FACTOR)
        active[rows] = (size_rad > STEP_RAD) & (damping[rows] < _LARGEST_DAMPING)
    return Descended(Y, X, np.maximum(energy, 0.0), ~active, n_steps)


def converged_sweep(
    sums: Sequence[AlignmentSums],
    rng: np.random.Generator,
    n_starts: int = N_STARTS,
    *,
    more: tuple[FloatArray, FloatArray] | None = None,
) -> SweepResult:
    """From each start the sweep of closed-form updates, and on to the minimum below; the start that ends lowest. Starts
    that the sweep has brought together go on as one. more: camera_T_ref (k, C, 4, 4) and body_T_board (k, 4, 4) of
    other starts, which are not swept."""
    Y, X = swept(sums, rng, n_starts)
    if more is not None:
        Y, X = np.concatenate([Y, more[0]]), np.concatenate([X, more[1]])
    chosen, leader = _apart(Y, X)
    found = descend(sums, Y[chosen], X[chosen])
    rmse_m = np.sqrt(found.energy_m2 / sum(s.n_corners for s in sums))
    best = int(rmse_m.argmin())
    pose = found.camera_T_ref[best], found.body_T_board[best]
    return SweepResult(*pose, float(rmse_m[best]), rmse_m[leader], found.n_steps)


def _apart(Y: FloatArray, X: FloatArray) -> tuple[IntArray, IntArray]:
    """The starts that are apart in some rotation, and of each start its place among them."""
    turns = np.concatenate([X[:, None, :3, :3], Y[:, :, :3, :3]], axis=1).reshape(len(X), -1)
    together = np.abs(turns[:, None] - turns).max(axis=2) < _TOGETHER
    return np.unique(together.argmax(axis=1), return_inverse=True)


def _turned(Y: FloatArray, X: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each pose's rotation times Exp of its part of turn (B, 3 + 3 C): X's, then each Y_c's."""
    Y, X = Y.copy(), X.copy()
    turns = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(len(X), -1, 3, 3)
    X[:, :3, :3] = X[:, :3, :3] @ turns[:, 0]
    Y[:, :, :3, :3] = Y[:, :, :3, :3] @ turns[:, 1:]
    return Y, X


def _turn(sums: Sequence[AlignmentSums], Y: FloatArray, X: FloatArray, damping: FloatArray) -> FloatArray:
    """(B, 3 + 3 C) Newton's step over the rotations, translations following. Directions of negative curvature are gone
    down as if it were positive, flat ones are left alone."""
    gradient, hessian = derivatives(sums, Y, X)
    turns, shifts = _columns(Y.shape[1])
    across = hessian[:, turns[:, None], shifts]
    follow = _pseudo_inverse(hessian[:, shifts[:, None], shifts]) @ np.swapaxes(across, 1, 2)
    reduced = hessian[:, turns[:, None], turns] - across @ follow
    slope = gradient[:, turns] - np.einsum("bts,bs->bt", np.swapaxes(follow, 1, 2), gradient[:, shifts])
    values, vectors = np.linalg.eigh(0.5 * (reduced + np.swapaxes(reduced, 1, 2)))
    size = np.abs(values)
    largest = size.max(axis=1, keepdims=True)
    along = np.einsum("bij,bi->bj", vectors, slope)
    step = -along / np.maximum(size + damping[:, None] * largest, 1e-300)
    step[size < _FLAT * largest] = 0.0
    turn = np.einsum("bij,bj->bi", vectors, step)
    longest = np.abs(turn).max(axis=1, keepdims=True)
    return np.asarray(turn / np.maximum(longest / _LONGEST_RAD, 1.0))


def _with_best_translations(
    sums: Sequence[AlignmentSums], Y: FloatArray, X: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The poses with the translations that minimise E_3D, their rotations as they are.

    Given X's, n t_c = sum q - R_c (sum A X p); with these, X's t solves a system of 3 x 3 that no rotation changes:
    (n I - sum_c N_c^T N_c / n_c) t = b, N_c the sum of the bodies' rotations over the corners."""
    Y, X = Y.copy(), X.copy()
    X[:, :3, 3] = 0.0
    n = sum(s.n_corners for s in sums)
    system = n * np.eye(3) - sum(s.K[3, 3, :3, :3].T @ s.K[3, 3, :3, :3] / s.n_corners for s in sums)
    wanted = -X[:, :3, :3] @ np.sum([s.M[:3, 3] for s in sums], axis=0)
    placed, seen = [], []
    for c, s in enumerate(sums):
        R, N = Y[:, c, :3, :3], s.K[3, 3, :3, :3]
        H = _product(s.K, X)
        placed.append(H[:, 3, :3])
        seen.append(np.einsum("bij,bi->bj", R, H[:, :3, 3]))
        wanted += s.L[:3, 3, 3, 3] + np.einsum("bik,ikl->bl", R, s.K[:3, 3, :3, :3])
        wanted -= (seen[-1] - placed[-1]) @ N / s.n_corners
    X[:, :3, 3] = wanted @ _pseudo_inverse(system[None])[0]
    for c, s in enumerate(sums):
        in_ref = (seen[c] - placed[c] - X[:, :3, 3] @ s.K[3, 3, :3, :3].T) / s.n_corners
        Y[:, c, :3, 3] = np.einsum("bij,bj->bi", Y[:, c, :3, :3], in_ref)
    return Y, X


def _product(K: FloatArray, X: FloatArray) -> FloatArray:
    """H (..., 4, 4) with H_ik = K_ijkl X_lj, of X (..., 4, 4)."""
    as_matrix = K.transpose(3, 1, 0, 2).reshape(16, 16)
    return np.asarray((X.reshape(-1, 16) @ as_matrix).reshape(X.shape))


def _columns(n_cameras: int) -> tuple[IntArray, IntArray]:
    """Which of the 6 + 6 C tangents turn, and which shift."""
    columns = np.arange(6 + 6 * n_cameras, dtype=np.int64).reshape(-1, 6)
    return columns[:, :3].ravel(), columns[:, 3:].ravel()


def _pseudo_inverse(H: FloatArray) -> FloatArray:
    """Of symmetric matrices (B, n, n), open directions left out."""
    values, vectors = np.linalg.eigh(0.5 * (H + np.swapaxes(H, 1, 2)))
    told = values > _OPEN * values[:, -1:]
    inverse = np.where(told, 1.0 / np.where(told, values, 1.0), 0.0)
    return np.asarray((vectors * inverse[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def derivatives(
    sums: Sequence[AlignmentSums], camera_T_ref: FloatArray, body_T_board: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gradient (B, 6 + 6 C) and Hessian (B, 6 + 6 C, 6 + 6 C) of E_3D in m^2, in the tangents of body_T_board
    (B, 4, 4), then of each camera_T_ref (B, C, 4, 4): T * Exp(xi), rotation first.

    With H = K_c : X as in ``gtcal.estimation.procrustes`` and Y_c = [R t], E_3D is, up to a constant and terms of X
    alone, the sum over cameras of C : H + n t^2 where C = [-2 Y_c; 2 t^T R]: linear in X, quadratic in Y_c."""
    n_cameras = camera_T_ref.shape[1]
    n = 6 + 6 * n_cameras
    gradient, hessian = np.zeros((len(body_T_board), n)), np.zeros((len(body_T_board), n, n))
    X_a, X_ab = body_T_board[:, None] @ _FIRST, body_T_board[:, None, None] @ _SECOND
    by_X = np.zeros_like(body_T_board)  # dE / dX of all that is linear in X
    M = np.sum([s.M for s in sums], axis=0)
    for c, s in enumerate(sums):
        columns = slice(6 + 6 * c, 12 + 6 * c)
        Y = camera_T_ref[:, c]
        C, C_a, C_ab = _weights(Y)
        H, H_a = _product(s.K, body_T_board), _product(s.K, X_a)
        Y_a, Y_ab = (Y[:, None] @ _FIRST)[..., :3, 3], (Y[:, None, None] @ _SECOND)[..., :3, 3]
        t = Y[:, :3, 3]
        gradient[:, columns] = _dots(C_a, H) + 2.0 * s.n_corners * np.einsum("bai,bi->ba", Y_a, t)
        hessian[:, columns, columns] = _dots(C_ab, H) + 2.0 * s.n_corners * (
            np.einsum("bai,bci->bac", Y_a, Y_a) + np.einsum("baci,bi->bac", Y_ab, t)
        )
        hessian[:, :6, columns] = _flat(H_a) @ np.swapaxes(_flat(C_a), 1, 2)
        hessian[:, columns, :6] = np.swapaxes(hessian[:, :6, columns], 1, 2)
        by_X += (C.reshape(-1, 16) @ s.K.transpose(0, 2, 3, 1).reshape(16, 16)).reshape(C.shape)
        by_X[:, :3] -= 2.0 * s.L[:3, 3, 3]
    slope = by_X + 2.0 * body_T_board @ M
    slope[:, 3] = 0.0
    gradient[:, :6] = _dots(X_a, slope)
    hessian[:, :6, :6] = _dots(X_ab, slope) + 2.0 * _flat(X_a @ M) @ np.swapaxes(_flat(X_a), 1, 2)
    return gradient, hessian


def _flat(matrices: FloatArray) -> FloatArray:
    return matrices.reshape(*matrices.shape[:-2], 16)


def _dots(many: FloatArray, one: FloatArray) -> FloatArray:
    """(B, ...) products, summed over the entries, of matrices (B, ..., 4, 4) with one (B, 4, 4)."""
    flat = many.reshape(len(one), -1, 16) @ one.reshape(-1, 16, 1)
    return np.asarray(flat.reshape(many.shape[:-2]))


def _weights(Y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """C (B, 4, 4), and its first (B, 6, 4, 4) and second (B, 6, 6, 4, 4) derivatives along Y's tangents."""
    Y_a, Y_ab = Y[:, None] @ _FIRST, Y[:, None, None] @ _SECOND
    R, t = Y[:, :3, :3], Y[:, :3, 3]
    R_a, t_a, R_ab, t_ab = Y_a[..., :3, :3], Y_a[..., :3, 3], Y_ab[..., :3, :3], Y_ab[..., :3, 3]
    C, C_a, C_ab = np.zeros(Y.shape), np.zeros(Y_a.shape), np.zeros(Y_ab.shape)
    C[:, :3], C_a[..., :3, :], C_ab[..., :3, :] = -2.0 * Y[:, :3], -2.0 * Y_a[..., :3, :], -2.0 * Y_ab[..., :3, :]
    C[:, 3, :3] = 2.0 * np.einsum("bi,bij->bj", t, R)
    C_a[..., 3, :3] = 2.0 * (np.einsum("bai,bij->baj", t_a, R) + np.einsum("bi,baij->baj", t, R_a))
    both = np.einsum("bai,bcij->bacj", t_a, R_a)
    C_ab[..., 3, :3] = 2.0 * (
        np.einsum("baci,bij->bacj", t_ab, R) + np.einsum("bi,bacij->bacj", t, R_ab) + both + np.swapaxes(both, 1, 2)
    )
    return C, C_a, C_ab
