"""How dark the printed board is, on average, over any small rectangle of it: exactly, at any resolution."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from factors.kernel import kernel
from gtcal.board import Board
from gtcal.camera import FloatArray
from gtcal.recordings.detections import IntArray

_SAME_EDGE_M = 1e-9
_FAR_M = 1e3  # beyond the print all is white: the outermost cells reach this far


class Pattern(NamedTuple):
    """The print as a grid of black and white cells, of any widths: every edge of the print is on a grid line. A
    named tuple, which compiled code takes as it is.

    x_edges_m (A,), y_edges_m (B,): the grid lines in the board frame, increasing.
    black: (B - 1, A - 1) 1.0 where a cell is black, 0.0 where white; the outermost cells are white.
    black_area_m2: (B, A) the black area to the left of and below each crossing of grid lines.
    x_bins, y_bins: evenly spaced over the print, the cell that each bin's low end lies in. A bin is narrower than
        any cell.
    """

    x_edges_m: FloatArray
    y_edges_m: FloatArray
    black: FloatArray
    black_area_m2: FloatArray
    x_bins: IntArray
    y_bins: IntArray


def pattern_of(board: Board) -> Pattern:
    """The print of a board."""
    rectangles = board.black_rectangles_m
    x_edges, y_edges = _edges(rectangles[:, [0, 2]]), _edges(rectangles[:, [1, 3]])
    columns, rows = _index(x_edges, rectangles[:, [0, 2]]), _index(y_edges, rectangles[:, [1, 3]])
    black = np.zeros((len(y_edges) - 1, len(x_edges) - 1))
    for (left, right), (low, high) in zip(columns, rows, strict=True):
        black[low:high, left:right] = 1.0
    area = np.zeros((len(y_edges), len(x_edges)))
    cells_m2 = black * np.diff(y_edges)[:, None] * np.diff(x_edges)
    area[1:, 1:] = cells_m2.cumsum(axis=0).cumsum(axis=1)
    return Pattern(x_edges, y_edges, black, area, _bins(x_edges), _bins(y_edges))


def _edges(values: FloatArray) -> FloatArray:
    ordered = np.sort(values.ravel())
    distinct = ordered[np.concatenate([[True], np.diff(ordered) > _SAME_EDGE_M])]
    return np.concatenate([[-_FAR_M], distinct, [_FAR_M]])


def _index(edges: FloatArray, values: FloatArray) -> IntArray:
    return np.searchsorted(edges, values - 2 * _SAME_EDGE_M).astype(np.int64)


def _bins(edges: FloatArray) -> IntArray:
    inner = edges[1:-1]
    n = int(np.ceil((inner[-1] - inner[0]) / np.diff(inner).min())) + 1
    low_ends = inner[0] + (inner[-1] - inner[0]) * np.arange(n) / n
    return np.clip(np.searchsorted(edges, low_ends, side="right") - 1, 1, len(edges) - 3).astype(np.int64)


@kernel
def cell_at(edges: FloatArray, bins: IntArray, value: float) -> int:
    """The cell that a coordinate lies in."""
    share = (value - edges[1]) / (edges[-2] - edges[1])
    if not share >= 0.0:
        return 0
    if share >= 1.0:
        return len(edges) - 2
    cell = bins[int(share * len(bins))]
    if value >= edges[cell + 1]:
        cell += 1
    return cell


@kernel
def _black_area(pattern: Pattern, x: float, y: float) -> float:
    """Black area to the left of x and below y: bilinear within a cell."""
    column = cell_at(pattern.x_edges_m, pattern.x_bins, x)
    row = cell_at(pattern.y_edges_m, pattern.y_bins, y)
    left, below = pattern.x_edges_m[column], pattern.y_edges_m[row]
    across = (x - left) / (pattern.x_edges_m[column + 1] - left)
    up = (y - below) / (pattern.y_edges_m[row + 1] - below)
    area = pattern.black_area_m2
    low = area[row, column] * (1.0 - across) + area[row, column + 1] * across
    high = area[row + 1, column] * (1.0 - across) + area[row + 1, column + 1] * across
    return low * (1.0 - up) + high * up


@kernel
def black_share_of_any(pattern: Pattern, x0: float, y0: float, x1: float, y1: float) -> float:
    """The share of the rectangle x0 < x1, y0 < y1 (m, board frame) that is black."""
    area = _black_area(pattern, x1, y1) - _black_area(pattern, x0, y1)
    area += _black_area(pattern, x0, y0) - _black_area(pattern, x1, y0)
    return area / ((x1 - x0) * (y1 - y0))


@kernel
def black_share_of_small(
    x_edges: FloatArray,
    y_edges: FloatArray,
    black: FloatArray,
    x_bins: IntArray,
    y_bins: IntArray,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
) -> float:
    """The same where it crosses one grid line each way at most; -1 where it crosses more. The parts of the pattern
    come one by one, which compiled code takes three times as fast."""
    i, j = cell_at(x_edges, x_bins, x0), cell_at(y_edges, y_bins, y0)
    right, above = x_edges[i + 1], y_edges[j + 1]
    across, up = x1 > right, y1 > above
    if (across and x1 > x_edges[i + 2]) or (up and y1 > y_edges[j + 2]):
        return -1.0
    share = black[j, i]
    if across:
        share += (x1 - right) / (x1 - x0) * (black[j, i + 1] - share)
    if up:
        upper = black[j + 1, i]
        if across:
            upper += (x1 - right) / (x1 - x0) * (black[j + 1, i + 1] - upper)
        share += (y1 - above) / (y1 - y0) * (upper - share)
    return share
