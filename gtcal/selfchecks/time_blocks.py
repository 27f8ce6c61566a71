"""A recording cut by time. Neighbouring frames share mocap noise and nearly the same view: odd against even ones would
agree about errors that they have in common. Blocks of time share them at their edges only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtcal.camera import BoolArray
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.residuals import select_views
from gtcal.recordings.detections import IntArray


def time_blocks(observations: Observations, n_blocks: int) -> IntArray:
    """(F,) the block of each frame: blocks follow one another in time and have as many frames as each other, or one
    more.

    Raises GtcalError where there are fewer frames than blocks."""
    if observations.n_frames < n_blocks:
        raise GtcalError(f"{observations.n_frames} frames can't be cut into {n_blocks} blocks of time: record longer")
    sizes = [len(part) for part in np.array_split(np.arange(observations.n_frames), n_blocks)]
    return np.repeat(np.arange(n_blocks), sizes)


def only_frames(observations: Observations, keep: BoolArray) -> Observations:
    """The observations with the frames of a mask (F,) only.

    Raises GtcalError where a camera keeps no view."""
    views = {name: views_in(of_camera, keep) for name, of_camera in observations.views.items()}
    for name, kept in views.items():
        if kept is None:
            raise GtcalError(f"camera {name!r} sees the board in a part of the recording only: record it throughout")
    return replace(observations, views={name: kept for name, kept in views.items() if kept is not None})


def views_in(views: Views, keep: BoolArray) -> Views | None:
    """The views in the frames of a mask (F,); None where there are none."""
    rows = np.flatnonzero(keep[views.frame_index])
    return select_views(views, rows) if rows.size else None
