"""The board's size and shape, where the calibration took it as flat and as stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.board_shape import N_SHAPE, SHAPE_NAMES
from gtcal.camera import FloatArray
from gtcal.effects.effect import single
from gtcal.effects.frames import Frames
from gtcal.results.board_shape import IN_WORDS, UNITS
from gtcal.results.effect_finding import Moment, Quantity

_FLAT_AND_STIFF = "measure the printed board, and mount it on something flat and stiff"
_PARTS = (
    (
        "scale",
        "the board is larger than stated, or the mocap's lengths smaller than true, by a share",
        "measure the printed board and state its true size; if it is right, calibrate the mocap's volume again",
    ),
    (
        "board stretch",
        "the board is longer along its x axis than along y, by a share",
        "measure the printed board along both axes: printers stretch the paper",
    ),
    ("board bow along x", "the board is bowed along its x axis", _FLAT_AND_STIFF),
    ("board bow along y", "the board is bowed along its y axis", _FLAT_AND_STIFF),
    ("board twist", "the board is twisted: two of its corners stand out", _FLAT_AND_STIFF),
)
"""Of each number of a shape, in order: its name, what it is, and what to do."""


@dataclass(frozen=True)
class BoardShapePart:
    """One of the numbers of ``factors.board_shape``, by its place. Views and mocap can't tell whether the scale is the
    board's or that of the mocap's lengths, as each body's offset from what it carries is unknown."""

    index: int
    moment: Moment | None = None

    @property
    def name(self) -> str:
        return _PARTS[self.index][0]

    @property
    def what(self) -> str:
        return _PARTS[self.index][1]

    @property
    def advice(self) -> str:
        return _PARTS[self.index][2]

    def columns(self, frames: Frames) -> FloatArray:
        columns = np.zeros((len(frames.stamps_ns), frames.n_columns, 1))
        columns[:, frames.n_columns - N_SHAPE + self.index] = 1.0
        return columns

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        _, unit = IN_WORDS[SHAPE_NAMES[self.index]]
        return single(estimate, covariance, UNITS[unit], unit)
