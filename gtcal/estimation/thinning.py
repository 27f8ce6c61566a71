"""A part of a long recording, evenly spread: from its solution it is few steps to that of all views."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtcal.estimation.frame_statistics import frames_of
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import select_views
from gtcal.recordings.detections import IntArray

MOST_FRAMES = 1_000
"""So many determine all unknowns to a small part of a pixel."""

LEAST_VIEWS = 200
"""Of each camera, where it has as many: one that sees the board seldom must not be left with a handful."""


def is_long(views: Mapping[str, Views]) -> bool:
    """Whether ``thinned`` leaves much out."""
    return len(frames_of(views)) > 2 * MOST_FRAMES


def thinned(views: Mapping[str, Views]) -> dict[str, Views]:
    """By camera its views of every so many frames, the same for all cameras; or more of a camera that sees the board
    seldom."""
    frames = frames_of(views)
    chosen = frames[:: -(-len(frames) // MOST_FRAMES)]
    return {name: select_views(of_camera, _rows(of_camera, chosen)) for name, of_camera in views.items()}


def _rows(views: Views, chosen: IntArray) -> IntArray:
    rows = np.flatnonzero(np.isin(views.frame_index, chosen))
    enough = min(LEAST_VIEWS, views.n_views)
    return rows if len(rows) >= enough else np.linspace(0, views.n_views - 1, enough).round().astype(np.int64)
