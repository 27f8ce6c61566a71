"""Of rendered images what is done pixel by pixel, compiled."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel
from gtcal.camera import FloatArray
from gtcal.simulation.backdrop import GreyPicture, brightness_towards
from gtcal.simulation.pattern import (
    Pattern,
    black_share_of_any,
    black_share_of_small,
    cell_at,
)


@kernel
def expose_region(
    corner_bearings: npt.NDArray[np.float32],
    board_T_camera: FloatArray,
    pattern: Pattern,
    bounds_m: tuple[float, float, float, float],
    black_white: tuple[float, float],
    subdivisions: int,
    weight: float,
    region: tuple[int, int, int, int],
    shine: npt.NDArray[np.float32],
    cover: npt.NDArray[np.float32],
) -> None:
    x0, y0, x1, y1 = region
    upper, lower = np.empty((2, x1 - x0 + 1)), np.empty((2, x1 - x0 + 1))
    _meet_board(corner_bearings[y0, x0 : x1 + 1], board_T_camera, lower)
    for row in range(y0, y1):
        upper, lower = lower, upper
        _meet_board(corner_bearings[row + 1, x0 : x1 + 1], board_T_camera, lower)
        _expose_row(
            pattern,
            bounds_m,
            upper,
            lower,
            black_white,
            subdivisions,
            weight,
            shine[row, x0:x1],
            cover[row, x0:x1],
        )


@kernel
def _meet_board(bearings: npt.NDArray[np.float32], board_T_camera: FloatArray, points_m: FloatArray) -> None:
    """Where rays (N, 3) of the camera frame meet the board's plane: x and y in the board frame, written into
    points_m (2, N); NaN where they do not."""
    R, t = board_T_camera[:, :3], board_T_camera[:, 3]
    for i in range(len(bearings)):
        bx, by, bz = float(bearings[i, 0]), float(bearings[i, 1]), float(bearings[i, 2])
        distance = -t[2] / (R[2, 0] * bx + R[2, 1] * by + R[2, 2] * bz)
        if distance > 0.0:
            points_m[0, i] = t[0] + distance * (R[0, 0] * bx + R[0, 1] * by + R[0, 2] * bz)
            points_m[1, i] = t[1] + distance * (R[1, 0] * bx + R[1, 1] * by + R[1, 2] * bz)
        else:
            points_m[0, i] = points_m[1, i] = math.nan


@kernel
def _expose_row(
    pattern: Pattern,
    bounds_m: tuple[float, float, float, float],
    upper: FloatArray,
    lower: FloatArray,
    black_white: tuple[float, float],
    subdivisions: int,
    weight: float,
    shine: npt.NDArray[np.float32],
    cover: npt.NDArray[np.float32],
) -> None:
    """A row of N pixels, whose corners are on the board at upper and lower (2, N + 1)."""
    x_edges, y_edges, colours = pattern.x_edges_m, pattern.y_edges_m, pattern.black
    x_bins, y_bins = pattern.x_bins, pattern.y_bins
    x_min, y_min, x_max, y_max = bounds_m
    black, white = black_white
    column, level = 0, 0
    for i in range(len(shine)):
        xa, xb, xc, xd = upper[0, i], upper[0, i + 1], lower[0, i], lower[0, i + 1]
        ya, yb, yc, yd = upper[1, i], upper[1, i + 1], lower[1, i], lower[1, i + 1]
        if math.isnan(xa + xb + xc + xd):
            continue
        low_x, high_x = min(min(xa, xb), min(xc, xd)), max(max(xa, xb), max(xc, xd))
        low_y, high_y = min(min(ya, yb), min(yc, yd)), max(max(ya, yb), max(yc, yd))
        if high_x <= x_min or high_y <= y_min or low_x >= x_max or low_y >= y_max:
            continue
        if low_x < x_edges[column] or low_x >= x_edges[column + 1]:
            column = cell_at(x_edges, x_bins, low_x)
        if low_y < y_edges[level] or low_y >= y_edges[level + 1]:
            level = cell_at(y_edges, y_bins, low_y)
        one_cell = high_x <= x_edges[column + 1] and high_y <= y_edges[level + 1]
        if one_cell and low_x > x_min and low_y > y_min and high_x < x_max and high_y < y_max:
            shine[i] += weight * (white - colours[level, column] * (white - black))
            cover[i] += weight
        else:
            dark, covered = _mixed_pixel(pattern, bounds_m, xa, xb, xc, xd, ya, yb, yc, yd, subdivisions)
            shine[i] += weight * (white * covered - dark * (white - black))
            cover[i] += weight * covered


@kernel
def _mixed_pixel(
    pattern: Pattern,
    bounds_m: tuple[float, float, float, float],
    xa: float,
    xb: float,
    xc: float,
    xd: float,
    ya: float,
    yb: float,
    yc: float,
    yd: float,
    subdivisions: int,
) -> tuple[float, float]:
    """The shares of a pixel that are black, and that the plate covers. Its corners, upper left, upper right,
    lower left and lower right, are on the board at (xa, ya) to (xd, yd)."""
    x_edges, y_edges, colours = pattern.x_edges_m, pattern.y_edges_m, pattern.black
    x_bins, y_bins = pattern.x_bins, pattern.y_bins
    # The parts of the pixel are alike: half their extent on the board, along x and y.
    half_x = 0.25 * (abs(xb - xa + xd - xc) + abs(xc - xa + xd - xb)) / subdivisions
    half_y = 0.25 * (abs(yb - ya + yd - yc) + abs(yc - ya + yd - yb)) / subdivisions
    dark, covered = 0.0, 0.0
    for down in range(subdivisions):
        v = (down + 0.5) / subdivisions
        for along in range(subdivisions):
            u = (along + 0.5) / subdivisions
            x = (1.0 - v) * ((1.0 - u) * xa + u * xb) + v * ((1.0 - u) * xc + u * xd)
            y = (1.0 - v) * ((1.0 - u) * ya + u * yb) + v * ((1.0 - u) * yc + u * yd)
            x0, x1, y0, y1 = x - half_x, x + half_x, y - half_y, y + half_y
            share = black_share_of_small(x_edges, y_edges, colours, x_bins, y_bins, x0, y0, x1, y1)
            dark += share if share >= 0.0 else black_share_of_any(pattern, x0, y0, x1, y1)
            covered += _overlap(x0, x1, bounds_m[0], bounds_m[2]) * _overlap(y0, y1, bounds_m[1], bounds_m[3])
    parts = subdivisions * subdivisions
    return dark / parts, covered / parts


@kernel
def _overlap(low: float, high: float, least: float, most: float) -> float:
    """The share of low..high that is within least..most."""
    return max(min(high, most) - max(low, least), 0.0) / (high - low)


@kernel
def compose(
    shine: npt.NDArray[np.float32],
    cover: npt.NDArray[np.float32],
    corner_bearings: npt.NDArray[np.float32],
    camera_T_world: FloatArray,
    picture: GreyPicture,
    scene: npt.NDArray[np.float32],
) -> None:
    """The board in its light, in front of the room, in shares of white, into scene (H, W)."""
    R = camera_T_world
    for row in range(scene.shape[0]):
        for i in range(scene.shape[1]):
            light = float(shine[row, i])
            bx, by, bz = corner_bearings[row, i, 0], corner_bearings[row, i, 1], corner_bearings[row, i, 2]
            if cover[row, i] < 1.0 and not math.isnan(bz):
                x = R[0, 0] * bx + R[1, 0] * by + R[2, 0] * bz
                y = R[0, 1] * bx + R[1, 1] * by + R[2, 1] * bz
                z = R[0, 2] * bx + R[1, 2] * by + R[2, 2] * bz
                light += (1.0 - cover[row, i]) * brightness_towards(picture, x, y, z)
            scene[row, i] = light
