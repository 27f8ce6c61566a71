"""Which way up: views of a print that looks the same after some turns (``Board.turns``), told apart by the mocap.

How far the board turned between two views of a camera, the mocap says too, whatever X and Y_c are (screw congruence,
Chen 1991). With the wrong turn of the print between the two, it is off by a quarter or a half of a circle. One turn
that all views share is no error: it belongs to the board's frame.
"""

from __future__ import annotations

import numpy as np

from gtcal.camera import FloatArray
from gtcal.recordings.detections import IntArray

_MOST_RAD = 0.3
"""Mismatches beyond count alike: a gross view must not decide."""

_REFERENCES, _SWEEPS = 20, 20


def turn_mismatches_rad(camera_T_board: FloatArray, ref_T_body: FloatArray, board_turns: FloatArray) -> FloatArray:
    """(V, V, G) by how much the turn from view i to view j differs between PnP and mocap, where the print was turned by
    h of G between the two: camera_T_board and ref_T_body (V, 4, 4), board_turns (G, 4, 4)."""
    R, A, S = camera_T_board[:, :3, :3], ref_T_body[:, :3, :3], board_turns[:, :3, :3]
    between = np.einsum("vki,wkj->vwij", R, R)
    by_pnp = _angle(np.einsum("vwij,gji->vwg", between, S))
    by_mocap = _angle(np.einsum("vki,wki->vw", A, A))
    return np.abs(by_pnp - by_mocap[:, :, None])


def turns_in_common(camera_T_board: FloatArray, ref_T_body: FloatArray, board_turns: FloatArray) -> IntArray:
    """(V,) the turn of each view, but for one that all share: camera_T_board[v] @ inverse(board_turns[turn[v]]) are
    poses of one and the same frame on the board. The turns are a cyclic group, in order."""
    n = len(board_turns)
    mismatch = np.minimum(turn_mismatches_rad(camera_T_board, ref_T_body, board_turns), _MOST_RAD)
    references = np.unique(np.linspace(0, len(mismatch) - 1, min(len(mismatch), _REFERENCES)).round().astype(np.int64))
    starts = [(-mismatch[r].argmin(axis=1)) % n for r in references]
    settled = [_descended(mismatch, start) for start in starts]
    return min(settled, key=lambda turns: _cost(mismatch, turns))


def _angle(trace: FloatArray) -> FloatArray:
    return np.asarray(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))


def _descended(mismatch: FloatArray, turns: IntArray) -> IntArray:
    """View by view the turn that agrees best with the others, until none changes."""
    n_views, _, n = mismatch.shape
    turns, others = turns.copy(), np.arange(n_views)
    for _ in range(_SWEEPS):
        before = turns.copy()
        for v in range(n_views):
            costs = [mismatch[v, others, (g - turns) % n].sum() - mismatch[v, v, (g - turns[v]) % n] for g in range(n)]
            turns[v] = int(np.argmin(costs))
        if np.array_equal(turns, before):
            break
    return turns


def _cost(mismatch: FloatArray, turns: IntArray) -> float:
    n = mismatch.shape[2]
    between = (turns[:, None] - turns) % n
    return float(np.take_along_axis(mismatch, between[:, :, None], axis=2).sum())
