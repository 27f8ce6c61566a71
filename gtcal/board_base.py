"""What all boards have in common, and the checks of their fields."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np

from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

# Nothing printed leaves this range; a side of 59 is millimetres written where metres belong.
_SMALLEST_SIDE_M, _LARGEST_SIDE_M = 0.002, 2.0
_SAME_PLACE = 1e-6  # of the pitch


class BoardBase:
    """What follows from the essentials in the same way for every board."""

    corners_m: Any
    bounds_m: Any
    black_rectangles_m: Any
    pitch_m: Any

    @property
    def n_corners(self) -> int:
        return len(self.corners_m)

    @property
    def width_m(self) -> float:
        return self.bounds_m[2] - self.bounds_m[0]

    @property
    def height_m(self) -> float:
        return self.bounds_m[3] - self.bounds_m[1]

    @property
    def discs_m(self) -> FloatArray:
        return np.empty((0, 3))

    @property
    def turns(self) -> IntArray:
        return np.arange(self.n_corners)[None]

    @cached_property
    def corner_quadrants(self) -> BoolArray:
        step = 1e-3 * self.clear_band_m * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
        return self._is_black((self.corners_m[:, None, :2] + step).reshape(-1, 2)).reshape(-1, 4)

    @property
    def clear_band_m(self) -> float:
        raise NotImplementedError

    def _is_black(self, points_m: FloatArray) -> BoolArray:
        black = np.zeros(len(points_m), dtype=bool)
        for x_min, y_min, x_max, y_max in self.black_rectangles_m:
            x, y = points_m[:, 0], points_m[:, 1]
            black |= (x > x_min) & (x < x_max) & (y > y_min) & (y < y_max)
        return black


def quarter_turns(corners_m: FloatArray, pitch_m: float) -> dict[int, IntArray]:
    """By the number of quarter turns (counter-clockwise, 0 to 3) that take the corners (C, 3) to one another: (C,) the
    corner that each comes to lie on."""
    middle = 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))[:2]
    xy = corners_m[:, :2] - middle
    found = {}
    for n in range(4):
        turned = xy @ np.linalg.matrix_power(np.array([[0.0, 1.0], [-1.0, 0.0]]), n)
        apart = np.linalg.norm(turned[:, None] - xy[None], axis=2)
        if (apart.min(axis=1) < _SAME_PLACE * pitch_m).all():
            found[n] = apart.argmin(axis=1)
    return found


def check_count(board: Any, name: str, least: int) -> None:
    """Raises GtcalError where the field is no plausible number of things."""
    value = getattr(board, name)
    if not least <= value <= 10_000:
        raise GtcalError(f"board field {name!r} is {value}; expected {least} or more")


def check_side(board: Any, name: str) -> None:
    """Raises GtcalError where the field is no plausible length in metres."""
    value = getattr(board, name)
    if math.isfinite(value) and _SMALLEST_SIDE_M <= value <= _LARGEST_SIDE_M:
        return
    hint = f"; {value:g} mm is {value / 1000:g} m" if value > _LARGEST_SIDE_M else ""
    raise GtcalError(
        f"board field {name!r} is {value:g}; expected {_SMALLEST_SIDE_M:g} to {_LARGEST_SIDE_M:g} metres{hint}"
    )


def mm(length_m: float) -> str:
    """As people read it."""
    return f"{1000 * length_m:g} mm"
