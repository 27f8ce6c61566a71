"""A board as a picture: an exact raster for the simulator, and prints to scale as PDF, SVG and PNG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gtcal.board import Board
from gtcal.camera import FloatArray

# A texel grid is aligned with an edge when the edge is off by less than this fraction of a texel.
_ALIGNED_TEXELS = 1e-6


@dataclass(frozen=True)
class BoardTexture:
    """The printed board as a raster, white margin included.

    image: uint8 (H, W), 0 black, 255 white; row 0 is the top of the print.
    texel_m: side of a texel.
    origin_m: (x, y) in the board frame of the centre of texel (column 0, row 0).
    """

    image: npt.NDArray[np.uint8]
    texel_m: float
    origin_m: tuple[float, float]

    def texels_of(self, points_m: FloatArray) -> FloatArray:
        """(N, 2) column and row, texel centres at integers, of points (N, 2 or 3) in the board frame."""
        offset = points_m[:, :2] - np.array(self.origin_m)
        return offset * np.array([1.0, -1.0]) / self.texel_m


def board_texture(board: Board, *, texels_per_module: int = 8, margin_m: float | None = None) -> BoardTexture:
    """The print as an exact raster.

    A texel is a module over ``texels_per_module``, or over up to four times as many where that puts every
    edge of the pattern on the border between two texels. Where no such number is found, the texels that an
    edge cuts are grey by the area that is black. The white margin is ``margin_m`` (default: four modules),
    rounded up to whole texels.
    """
    edges_m = _edges(board)
    per_module = _aligned_texels_per_module(edges_m, board.module_m, texels_per_module)
    texel_m = board.module_m / per_module
    x_min, y_min, x_max, y_max = board.bounds_m
    margin = int(np.ceil((4 * board.module_m if margin_m is None else margin_m) / texel_m - _ALIGNED_TEXELS))
    width = int(np.ceil((x_max - x_min) / texel_m - _ALIGNED_TEXELS)) + 2 * margin
    height = int(np.ceil((y_max - y_min) / texel_m - _ALIGNED_TEXELS)) + 2 * margin
    left_m, top_m = x_min - margin * texel_m, y_max + margin * texel_m
    black = np.zeros((height, width))
    for x0, y0, x1, y1 in board.black_rectangles_m:
        columns, across = _coverage((x0 - left_m) / texel_m, (x1 - left_m) / texel_m)
        rows, down = _coverage((top_m - y1) / texel_m, (top_m - y0) / texel_m)
        black[rows, columns] += down[:, None] * across
    image = np.rint(255 * (1 - np.minimum(black, 1))).astype(np.uint8)
    return BoardTexture(image, texel_m, (left_m + texel_m / 2, top_m - texel_m / 2))


def _edges(board: Board) -> FloatArray:
    """(N,) distances of all edges, upright and level, from the pattern's upper-left corner."""
    x_min, _, _, y_max = board.bounds_m
    rectangles = board.black_rectangles_m
    return np.concatenate([rectangles[:, [0, 2]].ravel() - x_min, y_max - rectangles[:, [1, 3]].ravel()])


def _aligned_texels_per_module(edges_m: FloatArray, module_m: float, least: int) -> int:
    for per_module in range(least, 4 * least + 1):
        texels = edges_m * per_module / module_m
        if np.abs(texels - np.rint(texels)).max() < _ALIGNED_TEXELS * per_module:
            return per_module
    return least


def _coverage(start: float, end: float) -> tuple[slice, FloatArray]:
    """Which cells [i, i + 1] the interval touches, and how much of each it covers."""
    start, end = _snapped(start), _snapped(end)
    first, last = int(np.floor(start)), int(np.ceil(end))
    cells = np.arange(first, last)
    return slice(first, last), np.minimum(cells + 1, end) - np.maximum(cells, start)


def _snapped(value: float) -> float:
    nearest = round(value)
    return float(nearest) if abs(value - nearest) < 1e-4 else value
