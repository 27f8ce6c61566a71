"""What methods on poses take: for each view the mocap's ref_T_body and PnP's camera_T_board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Views
from gtcal.estimation.pnp import solve_pnp

LEAST_TURN_RAD = np.deg2rad(5.0)
"""Relative motions that turn less say little of X, and much of the noise."""

MOST_PAIRS = 2_000


@dataclass(frozen=True)
class PosePairs:
    """Of one camera: (V, 4, 4) each."""

    ref_T_body: FloatArray
    camera_T_board: FloatArray


def pose_pairs(views: Mapping[str, Views]) -> dict[str, PosePairs]:
    """By camera, for all views that PnP solves.

    Raises GtcalError where PnP solves fewer than three views of a camera."""
    found = {}
    for name, of_camera in views.items():
        solved = solve_pnp(of_camera, max_views=of_camera.n_views)
        if len(solved.view_index) < 3:
            raise GtcalError(f"camera {name!r}: PnP solves {len(solved.view_index)} of its views; 3 are needed")
        found[name] = PosePairs(of_camera.ref_T_body[solved.view_index], solved.camera_T_board[:, 0])
    return found


def relative_motions(pairs: Mapping[str, PosePairs], rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """(M, 4, 4) each: A = A_i^-1 A_j of the body and B = B_i^-1 B_j of the board, between views of the same camera, so
    that A X = X B.

    Raises GtcalError where no two views differ by a turn."""
    bodies, boards = [], []
    for of_camera in pairs.values():
        i, j = np.triu_indices(len(of_camera.ref_T_body), 1)
        if len(i) > MOST_PAIRS:
            chosen = rng.choice(len(i), MOST_PAIRS, replace=False)
            i, j = i[chosen], j[chosen]
        bodies.append(inverse(of_camera.ref_T_body[i]) @ of_camera.ref_T_body[j])
        boards.append(inverse(of_camera.camera_T_board[i]) @ of_camera.camera_T_board[j])
    A, B = np.concatenate(bodies), np.concatenate(boards)
    turned = Rotation.from_matrix(A[:, :3, :3]).magnitude() > LEAST_TURN_RAD
    turned &= Rotation.from_matrix(A[:, :3, :3]).magnitude() < np.pi - LEAST_TURN_RAD
    if turned.sum() < 2:
        raise GtcalError("no two views differ by a turn of 5 deg or more: X cannot be found from relative motions")
    return A[turned], B[turned]
