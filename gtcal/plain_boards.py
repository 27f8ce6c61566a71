"""Boards without codes: chessboards and grids of dots. Which of their corners is which, a detector tells only up to the
turns under which the print looks the same (``turns``); those the chain with the mocap tells apart
(``gtcal.estimation.board_turns``)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gtcal.board_base import BoardBase, check_count, check_side, mm, quarter_turns
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

_STRIPS = 48
"""Rectangles that stand for a dot, where all is rectangles: each as long as the dot is wide there, on average."""


@dataclass(frozen=True)
class Chessboard(BoardBase):
    """A plain chessboard whose upper-left square is black. The corners are the inner ones, numbered row by row from the
    upper-left of the upright print, as OpenCV does. It looks the same turned by half a turn where both counts of
    squares are even, or both odd; a board of even by odd squares has one way up.

    square_columns, square_rows: squares across and down. square_side_m: of a square.
    Raises GtcalError where a field is out of range."""

    square_columns: int
    square_rows: int
    square_side_m: float

    def __post_init__(self) -> None:
        check_count(self, "square_columns", 4)
        check_count(self, "square_rows", 4)
        check_side(self, "square_side_m")

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        return 0.0, 0.0, self.square_columns * self.square_side_m, self.square_rows * self.square_side_m

    @property
    def pitch_m(self) -> float:
        return self.square_side_m

    @property
    def module_m(self) -> float:
        """There is no code; a quarter of a square serves where a picture needs a small unit."""
        return self.square_side_m / 4

    @property
    def clear_band_m(self) -> float:
        return self.square_side_m

    @property
    def clear_reach_m(self) -> float:
        return self.square_side_m

    @cached_property
    def corners_m(self) -> FloatArray:
        row, column = np.divmod(np.arange((self.square_columns - 1) * (self.square_rows - 1)), self.square_columns - 1)
        grid = np.stack([column + 1, self.square_rows - 1 - row, np.zeros(len(row))], axis=1)
        return np.asarray(grid * self.square_side_m)

    @cached_property
    def black_rectangles_m(self) -> FloatArray:
        row, column = np.divmod(np.arange(self.square_columns * self.square_rows), self.square_columns)
        black = (row + column) % 2 == 0
        lower_left = np.stack([column[black], self.square_rows - 1 - row[black]], axis=1) * self.square_side_m
        return np.column_stack([lower_left, lower_left + self.square_side_m])

    @cached_property
    def turns(self) -> IntArray:
        """By a quarter turn black squares lie on black ones where the corners' quadrants say so."""
        alike = [
            corners
            for n, corners in quarter_turns(self.corners_m, self.pitch_m).items()
            if np.array_equal(np.roll(self.corner_quadrants, n, axis=1), self.corner_quadrants[corners])
        ]
        return np.stack(alike)

    def corner_name(self, corner_id: int) -> str:
        return f"chessboard corner {corner_id}"

    def describe(self) -> str:
        return f"chessboard {self.square_columns} x {self.square_rows}, squares {mm(self.square_side_m)}"

    def to_manifest(self) -> dict[str, Any]:
        return {"type": "chessboard", **asdict(self)}


@dataclass(frozen=True)
class DotGrid(BoardBase):
    """A grid of black dots, symmetric (columns and rows) or asymmetric (every other row is shifted by half the pitch,
    and rows are half the pitch apart: OpenCV's asymmetric circles grid). What is measured are the dots' centres,
    numbered row by row from the upper-left of the upright print, as OpenCV does. The board frame has its origin at the
    lower-left dot's centre.

    dot_columns, dot_rows: dots in a row, and rows. dot_pitch_m: from a dot to the next of its row, centre to centre.
    dot_diameter_m: of a dot; 0 for half the pitch (symmetric) or a quarter (asymmetric).
    Raises GtcalError where a field is out of range."""

    dot_columns: int
    dot_rows: int
    dot_pitch_m: float
    asymmetric: bool = False
    dot_diameter_m: float = 0.0

    def __post_init__(self) -> None:
        check_count(self, "dot_columns", 2)
        check_count(self, "dot_rows", 2)
        check_side(self, "dot_pitch_m")
        if not 0.0 <= self.dot_diameter_m < self._closest_m:
            raise GtcalError(
                f"board field 'dot_diameter_m' is {self.dot_diameter_m:g}; expected less than the "
                f"{self._closest_m:g} m between two dots, or 0 where it is not known"
            )

    @property
    def _closest_m(self) -> float:
        return self.dot_pitch_m * (np.sqrt(0.5) if self.asymmetric else 1.0)

    @property
    def radius_m(self) -> float:
        """Of a dot."""
        usual_m = self.dot_pitch_m / (4 if self.asymmetric else 2)
        return 0.5 * (self.dot_diameter_m or usual_m)

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        r = self.radius_m
        x_max, y_max = self.corners_m[:, :2].max(axis=0)
        return -r, -r, float(x_max) + r, float(y_max) + r

    @property
    def pitch_m(self) -> float:
        return self.dot_pitch_m

    @property
    def module_m(self) -> float:
        """There is no code; a quarter of the pitch serves where a picture needs a small unit."""
        return self.dot_pitch_m / 4

    @property
    def clear_band_m(self) -> float:
        return self.radius_m

    @property
    def clear_reach_m(self) -> float:
        return 2.0 * self.radius_m

    @cached_property
    def corners_m(self) -> FloatArray:
        row, column = np.divmod(np.arange(self.dot_columns * self.dot_rows), self.dot_columns)
        up = self.dot_rows - 1 - row
        shifted = 0.5 * (row % 2) if self.asymmetric else 0.0
        grid = np.stack([column + shifted, up * (0.5 if self.asymmetric else 1.0), np.zeros(len(row))], axis=1)
        return np.asarray(grid * self.dot_pitch_m)

    @cached_property
    def discs_m(self) -> FloatArray:
        return np.column_stack([self.corners_m[:, :2], np.full(self.n_corners, self.radius_m)])

    @cached_property
    def black_rectangles_m(self) -> FloatArray:
        edges = self.radius_m * np.linspace(-1.0, 1.0, _STRIPS + 1)
        # the integral of the half chord: (y sqrt(r^2 - y^2) + r^2 asin(y / r)) / 2
        r2 = self.radius_m**2
        area = 0.5 * (edges * np.sqrt(np.maximum(r2 - edges**2, 0.0)) + r2 * np.arcsin(edges / self.radius_m))
        half = np.diff(area) / np.diff(edges)
        strips = np.column_stack([-half, edges[:-1], half, edges[1:]])
        return np.asarray((np.tile(self.corners_m[:, :2], 2)[:, None] + strips).reshape(-1, 4))

    @cached_property
    def turns(self) -> IntArray:
        return np.stack(list(quarter_turns(self.corners_m, self.pitch_m).values()))

    def corner_name(self, corner_id: int) -> str:
        row, column = divmod(corner_id, self.dot_columns)
        return f"dot {corner_id} (row {row}, column {column})"

    def describe(self) -> str:
        kind = "asymmetric" if self.asymmetric else "symmetric"
        return (
            f"{kind} dot grid {self.dot_columns} x {self.dot_rows}, pitch {mm(self.dot_pitch_m)}, "
            f"dots {mm(2 * self.radius_m)}"
        )

    def to_manifest(self) -> dict[str, Any]:
        return {"type": "dot_grid", **asdict(self)}
