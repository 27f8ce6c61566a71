"""The shape that a board was found to have."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from factors.board_shape import SHAPE_NAMES
from gtcal.camera import FloatArray

IN_WORDS = {
    "scale": ("larger than stated", "%"),
    "stretch": ("longer along x than along y", "%"),
    "bow_x": ("bow along x", "mm"),
    "bow_y": ("bow along y", "mm"),
    "twist": ("twist", "mm"),
}
"""By its name, what each number of a shape is, and the unit that people use."""

UNITS = {"%": 100.0, "mm": 1e3}
"""By how many times a number is larger in a unit that people use."""

FAR_SIGMAS = 4.0
"""From here on a board is said to be another than it was expected to be."""


@dataclass(frozen=True)
class ShapePart:
    """One of the shape's five numbers, in ``unit``. stated_sigma: how well it was known beforehand, to be 0."""

    what: str
    unit: str
    value: float
    sigma: float
    stated_sigma: float

    @property
    def in_stated_sigmas(self) -> float:
        """How far it is from what was known."""
        return abs(self.value) / self.stated_sigma


@dataclass(frozen=True)
class BoardShape:
    """Of a board whose shape was solved for, as in ``factors.board_shape``.

    shape: (5,). covariance: (5, 5). stated_sigmas: (5,) of a flat board as stated, beforehand."""

    shape: FloatArray
    covariance: FloatArray
    stated_sigmas: FloatArray

    @property
    def parts(self) -> Iterator[ShapePart]:
        """In the units that people use."""
        columns = self.shape, np.sqrt(np.diag(self.covariance)), self.stated_sigmas
        for name, value, sigma, stated in zip(SHAPE_NAMES, *columns, strict=True):
            what, unit = IN_WORDS[name]
            times = UNITS[unit]
            yield ShapePart(what, unit, times * value, times * sigma, times * stated)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A line where it is far from what was expected, on what is furthest."""
        worst = max(self.parts, key=lambda part: part.in_stated_sigmas)
        if worst.in_stated_sigmas < FAR_SIGMAS:
            return ()
        return (
            f"the board is not as it was expected to be: {worst.what} by {worst.value:.2g} {worst.unit} "
            f"± {worst.sigma:.1g}, {worst.in_stated_sigmas:.1f} sigma of what was known; it counts in the result, but "
            "measure the print, mount it flat, or state board.scale_sigma and board.flatness_mm",
        )
