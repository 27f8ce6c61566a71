"""A board that is not quite as stated: larger, longer along one axis, bowed or twisted, by five numbers.

A corner at (x, y), which is (u, v) in halves of the board's sides from its middle, moves by

    x (scale + stretch / 2),    y (scale - stretch / 2),    bow_x (1 - u^2) + bow_y (1 - v^2) + twist u v

along the board's axes; its origin stays where it is, in its plane. scale and stretch are shares; bow_x, bow_y and
twist are in m: by how much the middle stands out over the edges of that axis, and the board's corners over its middle.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.kernel import inlined, kernel

FloatArray = npt.NDArray[np.float64]

SHAPE_NAMES = ("scale", "stretch", "bow_x", "bow_y", "twist")
N_SHAPE = len(SHAPE_NAMES)

FLAT = np.zeros(N_SHAPE)
"""The shape of a board as stated."""

_LEAST_HALF_M = 1e-6  # a row of corners has no breadth


def outline_of(corners_m: FloatArray) -> FloatArray:
    """(4,) x and y of the middle of a board's corners (N, 3), and the halves of its sides along x and y, in m."""
    low, high = corners_m[:, :2].min(axis=0), corners_m[:, :2].max(axis=0)
    return np.concatenate([0.5 * (low + high), np.maximum(0.5 * (high - low), _LEAST_HALF_M)])


@inlined
def shaped_corner(outline_m: FloatArray, shape: FloatArray, X: float, Y: float, Z: float) -> tuple[float, float, float]:
    """Where the corner stated at (X, Y, Z) is on a board with this outline (4,) and shape (5,)."""
    u, v = (X - outline_m[0]) / outline_m[2], (Y - outline_m[1]) / outline_m[3]
    height_m = shape[2] * (1.0 - u * u) + shape[3] * (1.0 - v * v) + shape[4] * u * v
    return X * (1.0 + shape[0] + 0.5 * shape[1]), Y * (1.0 + shape[0] - 0.5 * shape[1]), Z + height_m


@kernel
def shaped(corners_m: FloatArray, outline_m: FloatArray, shape: FloatArray) -> FloatArray:
    """Corners (N, 3) of a flat board as stated, moved by its shape (5,). outline_m: (4,) of the board."""
    moved = np.empty_like(corners_m)
    for n in range(len(corners_m)):
        x, y, z = shaped_corner(outline_m, shape, corners_m[n, 0], corners_m[n, 1], corners_m[n, 2])
        moved[n, 0], moved[n, 1], moved[n, 2] = x, y, z
    return moved


@inlined
def shape_columns(
    outline_m: FloatArray, X: float, Y: float, gx: float, gy: float, gz: float, row: FloatArray, first: int
) -> None:
    """Write a residual's derivatives by the shape into ``row`` from ``first`` on, given those by the position of its
    corner, which is at (X, Y) on the board as stated."""
    u, v = (X - outline_m[0]) / outline_m[2], (Y - outline_m[1]) / outline_m[3]
    row[first] = gx * X + gy * Y
    row[first + 1] = 0.5 * (gx * X - gy * Y)
    row[first + 2], row[first + 3], row[first + 4] = gz * (1.0 - u * u), gz * (1.0 - v * v), gz * u * v
