"""What the cameras saw and when: the corners of each camera's views, each view with the mocap's ref_T_body."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.recordings.detections import IntArray, ViewRows


@dataclass(frozen=True)
class Views(ViewRows):
    """The views of one camera that have a mocap pose.

    frame_index: (V,) the view's place in ``Observations.frame_stamps_ns``: views of one frame share ref_T_body.
    ref_T_body: (V, 4, 4) by the mocap.
    corners_m: (N, 3) the corners in the board frame, as stated. outline_m: (4,) of the board, and shape_sigmas: (5,)
        1-sigma of its shape beforehand, both as in ``factors.board_shape``.
    board_turns: (G, 4, 4) the turns of the board, the identity first, that may lie between each view's corners and the
        true ones: several where the print looks the same after them, and the views were not told apart yet.
    """

    camera: Camera
    frame_index: IntArray
    ref_T_body: FloatArray
    corners_m: FloatArray
    outline_m: FloatArray
    shape_sigmas: FloatArray
    board_turns: FloatArray = field(default_factory=lambda: np.eye(4)[None])


@dataclass(frozen=True)
class Dropped:
    """Views of one camera that were left out, and why."""

    camera: str
    reason: str
    n_views: int
    n_corners: int


def pooled(dropped: Iterable[Dropped]) -> tuple[Dropped, ...]:
    """What was left out of each camera for each reason, in one entry each, in the order of the first."""
    counts: dict[tuple[str, str], tuple[int, int]] = {}
    for part in dropped:
        n_views, n_corners = counts.get((part.camera, part.reason), (0, 0))
        counts[part.camera, part.reason] = n_views + part.n_views, n_corners + part.n_corners
    return tuple(Dropped(*which, *count) for which, count in counts.items())


@dataclass(frozen=True)
class Observations:
    """All views of a recording that have a mocap pose, by camera.

    frame_stamps_ns: (F,) the distinct time stamps of the views of all cameras, increasing.
    motion: ref_T_body as a function of time, for other times than the views' own (a clock offset).
    dropped: the views that were left out.
    """

    views: dict[str, Views]
    capture: Capture
    board: Board
    dropped: tuple[Dropped, ...]
    frame_stamps_ns: IntArray
    motion: RefMotion

    @property
    def n_frames(self) -> int:
        return len(self.frame_stamps_ns)
