"""Which views agree on one chain, where up to nearly half of them are wrong in one and the same way.

Medians of residuals tell gross views while a fit of all views lies near the good ones. Poses that are off by one large
shift, bodies that swap, or boards seen turned by half a turn pull it to somewhere between. So chains are proposed from
a few views each (random sample consensus: Fischler and Bolles 1981) and judged by the median over all views (least
median of squares: Rousseeuw 1984), which breaks down at one half.

From a few views of one camera a chain follows in closed form: the turns between views give the rotation of X (Park and
Martin 1994), then that of Y_c, then both translations. With X known, every view of another camera gives a Y_c; the one
that most other views agree with is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.alignment import squared_distances
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.recordings.detections import IntArray

N_SAMPLES = 300
"""Of each camera. Of 45 % gross views, 300 samples of 4 hold 27 without one, and none but once in 10^12."""

SAMPLE = 4

_BEST = 3  # proposals of each camera that are carried on to the others
_MOST_MEDOIDS = 60


@dataclass(frozen=True)
class ViewPoses:
    """What consensus needs of a camera's views: ref_T_body, camera_T_board by PnP and the corner moments, (V, 4, 4)."""

    ref_T_body: FloatArray
    pnp_camera_T_board: FloatArray
    moments: FloatArray

    def rms_m(self, camera_T_ref: FloatArray, body_T_board: FloatArray) -> FloatArray:
        """(B, V) of each chain, camera_T_ref and body_T_board (B, 4, 4): rms distance of the corners."""
        chains = camera_T_ref[:, None] @ self.ref_T_body @ body_T_board[:, None]
        shape = chains.shape
        squared = squared_distances(
            chains.reshape(-1, 4, 4),
            np.broadcast_to(self.pnp_camera_T_board, shape).reshape(-1, 4, 4),
            np.broadcast_to(self.moments, shape).reshape(-1, 4, 4),
        ).reshape(shape[:2])
        return np.asarray(np.sqrt(np.maximum(squared / self.moments[:, 3, 3], 0.0)))


def consensus(
    views: Mapping[str, ViewPoses], rng: np.random.Generator
) -> tuple[dict[str, FloatArray], FloatArray] | None:
    """camera_T_ref by camera and body_T_board (4, 4) of the proposal with the smallest median over all views; None
    where no camera has views enough that turn."""
    best, best_m = None, np.inf
    for of_camera in views.values():
        for body_T_board in _proposals(of_camera, rng):
            camera_T_ref = {other: _medoid(poses, body_T_board) for other, poses in views.items()}
            rms = [poses.rms_m(camera_T_ref[other][None], body_T_board[None])[0] for other, poses in views.items()]
            median_m = float(np.median(np.concatenate(rms)))
            if median_m < best_m:
                best, best_m = (camera_T_ref, body_T_board), median_m
    return best


def _proposals(views: ViewPoses, rng: np.random.Generator) -> FloatArray:
    """(b, 4, 4) the body_T_board of the best chains by the median over the camera's views."""
    n_views = len(views.ref_T_body)
    if n_views < SAMPLE:
        return np.zeros((0, 4, 4))
    samples = np.argsort(rng.random((N_SAMPLES, n_views)), axis=1)[:, :SAMPLE]
    camera_T_ref, body_T_board = _chains(views, samples)
    median_m = np.median(views.rms_m(camera_T_ref, body_T_board), axis=1)
    return body_T_board[np.argsort(median_m)[:_BEST]]


def _chains(views: ViewPoses, samples: IntArray) -> tuple[FloatArray, FloatArray]:
    """camera_T_ref and body_T_board (B, 4, 4) from samples (B, s) of a camera's views."""
    A, That = views.ref_T_body[samples], views.pnp_camera_T_board[samples]
    R_X = rotation_by_turns(A[..., :3, :3], That[..., :3, :3])
    R_Y = rotation_between(A[..., :3, :3] @ R_X[:, None], That[..., :3, :3])
    middle = views.moments[samples][..., :3, 3] / views.moments[samples][..., 3:, 3]
    seen = np.einsum("bvij,bvj->bvi", That[..., :3, :3], middle) + That[..., :3, 3]
    placed = np.einsum("bvij,bjk,bvk->bvi", A[..., :3, :3], R_X, middle) + A[..., :3, 3]
    wanted = np.einsum("bji,bvj->bvi", R_Y, seen) - placed  # = A t_X + R_Y^T t_Y
    n = samples.shape[1]
    left = np.concatenate([A[..., :3, :3], np.broadcast_to(np.eye(3), A[..., :3, :3].shape)], axis=-1)
    solved = np.linalg.pinv(left.reshape(-1, 3 * n, 6), rcond=1e-6) @ wanted.reshape(-1, 3 * n, 1)
    X, Y = np.tile(np.eye(4), (2, len(samples), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = R_X, solved[:, :3, 0]
    Y[:, :3, :3], Y[:, :3, 3] = R_Y, np.einsum("bij,bj->bi", R_Y, solved[:, 3:, 0])
    return Y, X


def rotation_by_turns(ref_R_body: FloatArray, camera_R_board: FloatArray) -> FloatArray:
    """(B, 3, 3) rotations of X that take the turns between a camera's views, (B, v, 3, 3), from the board's axes to the
    body's (Park and Martin 1994)."""
    first, second = np.triu_indices(ref_R_body.shape[1], 1)
    by_body, by_board = (_turns(R[:, first], R[:, second]) for R in (ref_R_body, camera_R_board))
    return _closest_rotation(np.einsum("bpi,bpj->bij", by_body, by_board))


def rotation_between(from_R: FloatArray, to_R: FloatArray) -> FloatArray:
    """(B, 3, 3) rotations R with R from_R closest to to_R, (B, v, 3, 3)."""
    return _closest_rotation(np.einsum("bvij,bvkj->bik", to_R, from_R))


def _turns(from_R: FloatArray, to_R: FloatArray) -> FloatArray:
    """(B, p, 3) rotation vectors of from_R^T to_R."""
    relative = np.swapaxes(from_R, -1, -2) @ to_R
    return np.asarray(Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec().reshape(relative.shape[:-1]))


def _closest_rotation(H: FloatArray) -> FloatArray:
    """(B, 3, 3) that maximises tr(R^T H)."""
    U, _, Vt = np.linalg.svd(H)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    return np.asarray(U @ Vt)


def _medoid(views: ViewPoses, body_T_board: FloatArray) -> FloatArray:
    """The camera_T_ref (4, 4) by one view that has the smallest median over all views."""
    chosen = np.linspace(0, len(views.moments) - 1, min(len(views.moments), _MOST_MEDOIDS)).round().astype(np.int64)
    camera_T_ref = views.pnp_camera_T_board[chosen] @ inverse(views.ref_T_body[chosen] @ body_T_board)
    median_m = np.median(views.rms_m(camera_T_ref, np.broadcast_to(body_T_board, camera_T_ref.shape)), axis=1)
    return np.asarray(camera_T_ref[np.argmin(median_m)])
