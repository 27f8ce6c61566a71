"""Images of the board, by following each pixel's rays through the camera model to the print.

A pixel is the mean light over its square, blurred by the lens, integrated over the exposure, with noise. The
corners of the pixels are unprojected once per camera. For an image each corner's ray meets the board's plane;
the four corners of a pixel span a quadrilateral on the board, and the print's mean darkness over it is summed
exactly over a few small rectangles that cover it. No texture is sampled: edges are as sharp as the print's at any
distance, and a corner of the print lies where the camera model projects it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from factors.kernel import kernel
from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.recordings.images import GreyImage
from gtcal.simulation.backdrop import GreyPicture, brightness_towards
from gtcal.simulation.pattern import (
    Pattern,
    black_share_of_any,
    black_share_of_small,
    cell_at,
    pattern_of,
)
from gtcal.simulation.transforms import apply

_OUTLINE_POINTS = 65  # along each side of the plate, to find where it is in the image
_MARGIN_MODULES = 3.0  # of white around the pattern
_STEP_PX = 0.5  # of motion between two sub-exposures
_MOST_SUB_EXPOSURES = 24
_BAND_STEP_PX = 0.05  # of motion between two bands of rows that a rolling shutter exposes one after the other
_BACK = 0.3  # brightness of the board's unprinted side


@dataclass(frozen=True)
class ImageOptions:
    """How images come about.

    subdivisions: a pixel's square is divided into this many parts each way.
    blur_px: 1-sigma of the lens's Gaussian blur.
    exposure_s: how long the shutter is open, around the time stamp; the board's motion blurs.
    black_grey, white_grey: grey levels (0 to 255) of the print in full light, in the middle of the image.
    dark_noise_grey, light_noise_grey: 1-sigma of the sensor's noise: the part that is always there, and the part
        that grows with the root of the light, for white.
    vignetting_share: light lost at the border of the lens's field.
    gradient_share: change of the light from the middle of the image to its edge, in some direction.
    shade_share: light lost by a board that faces away from the lamp.
    """

    subdivisions: int = 3
    blur_px: float = 0.6
    exposure_s: float = 0.001
    black_grey: float = 25.0
    white_grey: float = 215.0
    dark_noise_grey: float = 1.0
    light_noise_grey: float = 1.5
    vignetting_share: float = 0.4
    gradient_share: float = 0.15
    shade_share: float = 0.3


@dataclass(frozen=True)
class Plate:
    """The printed board as a thing: the pattern on a white plate. bounds_m: x_min, y_min, x_max, y_max."""

    pattern: Pattern
    bounds_m: tuple[float, float, float, float]


def plate_of(board: Board) -> Plate:
    """The plate of a board, with a white margin around the pattern."""
    margin_m = _MARGIN_MODULES * board.module_m
    x_min, y_min, x_max, y_max = board.bounds_m
    bounds = (x_min - margin_m, y_min - margin_m, x_max + margin_m, y_max + margin_m)
    return Plate(pattern_of(board), bounds)


@dataclass(frozen=True)
class Lens:
    """What a camera's images have in common.

    corner_bearings: (H + 1, W + 1, 3) towards the corners of the pixels, in the camera frame; NaN where the
        model has no bearing.
    light: (H, W) share of the light that reaches each pixel; 0 outside the lens's field.
    """

    camera: Camera
    corner_bearings: npt.NDArray[np.float32]
    light: npt.NDArray[np.float32]


def lens_of(camera: Camera, options: ImageOptions, rng: np.random.Generator) -> Lens:
    """Prepare a camera. The light's gradient has a random direction."""
    height, width = camera.image_height_px, camera.image_width_px
    x, y = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
    bearings, _ = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
    corner_bearings = bearings.reshape(height + 1, width + 1, 3).astype(np.float32)
    middle = corner_bearings[:-1, :-1, 2]  # half a pixel does not matter to the light
    angle_share = np.arccos(np.clip(middle, -1.0, 1.0)) / camera.model.max_angle_rad(camera.theta)
    direction = rng.uniform(-np.pi, np.pi)
    across = np.linspace(-1.0, 1.0, width) * np.cos(direction)
    down = np.linspace(-1.0, 1.0, height)[:, None] * np.sin(direction)
    light = (1.0 - options.vignetting_share * angle_share**2) * (1.0 + options.gradient_share * (across + down))
    return Lens(camera, corner_bearings, np.nan_to_num(light, nan=0.0).astype(np.float32))


@dataclass(frozen=True)
class Shown:
    """A plate before a camera.

    camera_T_board: (R, S, 4, 4) its poses in S sub-exposures of each of R bands of rows, from the upper one on: one
        band where all rows are exposed at once."""

    plate: Plate
    camera_T_board: FloatArray

    @property
    def middle(self) -> FloatArray:
        """(4, 4) amid the exposure."""
        n_bands, n_steps = self.camera_T_board.shape[:2]
        return np.asarray(self.camera_T_board[n_bands // 2, n_steps // 2])

    @property
    def nearness(self) -> tuple[bool, float]:
        """Of two plates the larger one hides the other: a printed side hides backs, what is near what is far."""
        return bool(inverse(self.middle)[2, 3] > 0.0), -float(np.linalg.norm(self.middle[:3, 3]))


def render(
    lens: Lens,
    plate: Plate,
    picture: GreyPicture,
    camera_T_board: FloatArray,
    camera_T_world: FloatArray,
    options: ImageOptions,
    rng: np.random.Generator,
) -> GreyImage:
    """One image, uint8 (H, W), of the board at camera_T_board (S, 4, 4), the poses of the sub-exposures, in
    front of the room as seen from camera_T_world (4, 4). ``rng`` makes the sensor's noise."""
    return render_all(lens, [Shown(plate, camera_T_board[None])], picture, camera_T_world, options, rng)


def render_all(
    lens: Lens,
    plates: Sequence[Shown],
    picture: GreyPicture,
    camera_T_world: FloatArray,
    options: ImageOptions,
    rng: np.random.Generator,
) -> GreyImage:
    """... of several plates, of which the nearer ones hide the others."""
    shape = lens.light.shape
    shine, cover = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    for shown in sorted(plates, key=lambda one: one.nearness):
        shade = _shade(inverse(camera_T_world)[:3, :3] @ shown.middle[:3, 2], options)
        own_shine, own_cover = _exposed(lens, shown, options)
        shine = (1.0 - own_cover) * shine + np.float32(shade) * own_shine
        cover += (1.0 - cover) * own_cover
    scene = np.empty(shape, dtype=np.float32)
    _compose(shine, cover, lens.corner_bearings, camera_T_world, picture, scene)
    scene *= lens.light
    if options.blur_px > 0.0:
        cv2.GaussianBlur(scene, (0, 0), options.blur_px, dst=scene, borderType=cv2.BORDER_REPLICATE)
    return _developed(scene, options, rng)


def sub_exposures(camera: Camera, plate: Plate, camera_T_board: FloatArray) -> int:
    """How many poses stand for an exposure that begins and ends at camera_T_board (2, 4, 4): so many that the
    plate moves by half a pixel between two."""
    return int(np.clip(np.ceil(_moved_px(camera, plate, camera_T_board) / _STEP_PX), 1, _MOST_SUB_EXPOSURES))


def bands(camera: Camera, plate: Plate, camera_T_board: FloatArray) -> int:
    """How many bands of rows stand for a readout that begins and ends at camera_T_board (2, 4, 4)."""
    moved_px = _moved_px(camera, plate, camera_T_board)
    return int(np.clip(np.ceil(moved_px / _BAND_STEP_PX), 1, camera.image_height_px))


def band_edges(n_bands: int, height_px: int) -> npt.NDArray[np.int64]:
    """(R + 1,) the first row of each band, and the number of rows."""
    return np.arange(n_bands + 1, dtype=np.int64) * height_px // n_bands


def _moved_px(camera: Camera, plate: Plate, camera_T_board: FloatArray) -> float:
    """By how much the plate moves in the image between two poses (2, 4, 4), where it moves most."""
    outline = _outline(plate)
    (start_px, _), (end_px, _) = (camera.project(apply(pose, outline)) for pose in camera_T_board)
    moved_px = np.linalg.norm(end_px - start_px, axis=1)
    return float(np.nanmax(moved_px)) if np.isfinite(moved_px).any() else 0.0


def _shade(normal_in_world: FloatArray, options: ImageOptions) -> float:
    """Share of the light that a board with this normal throws back: the lamp hangs above, a little aside."""
    lamp = np.array([0.3, 0.2, 0.93])
    return float(1.0 - options.shade_share * 0.5 * (1.0 - normal_in_world @ lamp))


def _developed(scene: npt.NDArray[np.float32], options: ImageOptions, rng: np.random.Generator) -> GreyImage:
    """Shares of white to grey levels, with noise."""
    noise = rng.standard_normal(scene.shape, dtype=np.float32)
    noise *= np.sqrt(options.dark_noise_grey**2 + options.light_noise_grey**2 * np.maximum(scene, 0.0))
    grey = options.white_grey * scene + noise
    return np.asarray(np.clip(np.rint(grey), 0, 255), dtype=np.uint8)


def _outline(plate: Plate) -> FloatArray:
    """(P, 3) points around the plate, in the board frame."""
    x_min, y_min, x_max, y_max = plate.bounds_m
    x, y = np.linspace(x_min, x_max, _OUTLINE_POINTS), np.linspace(y_min, y_max, _OUTLINE_POINTS)
    sides = [(x, np.full_like(x, y_min)), (x, np.full_like(x, y_max)), (np.full_like(y, x_min), y)]
    sides.append((np.full_like(y, x_max), y))
    return np.concatenate([np.stack([a, b, np.zeros_like(a)], axis=1) for a, b in sides])


def _region(camera: Camera, plate: Plate, camera_T_board: FloatArray) -> tuple[int, int, int, int]:
    """Columns and rows x0, y0, x1, y1 (ends excluded) in which the plate is: the whole image where a part of its
    outline has no pixel."""
    pixels, valid = camera.project(apply(camera_T_board, _outline(plate)))
    width, height = camera.image_width_px, camera.image_height_px
    if not valid.all():
        return 0, 0, width, height
    low, high = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 2
    x0, y0 = np.clip(low, 0, (width, height)).astype(int)
    x1, y1 = np.clip(high, 0, (width, height)).astype(int)
    return int(x0), int(y0), int(x1), int(y1)


def _exposed(
    lens: Lens, shown: Shown, options: ImageOptions
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """The light of a plate, and the share of each pixel that it takes, both (H, W)."""
    shape = lens.light.shape
    shine, cover = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    n_bands, n_steps = shown.camera_T_board.shape[:2]
    for rows, poses in zip(pairwise(band_edges(n_bands, shape[0]).tolist()), shown.camera_T_board, strict=True):
        for pose in poses:
            _expose(lens, shown.plate, pose, options, rows, 1.0 / n_steps, shine, cover)
    return shine, cover


def _expose(
    lens: Lens,
    plate: Plate,
    camera_T_board: FloatArray,
    options: ImageOptions,
    rows: tuple[int, int],
    weight: float,
    shine: npt.NDArray[np.float32],
    cover: npt.NDArray[np.float32],
) -> None:
    """Add one sub-exposure of the board to ``shine``, its light, and ``cover``, the share of each pixel that it
    takes, both (H, W), in the rows from the first on to before the second."""
    x0, y0, x1, y1 = _region(lens.camera, plate, camera_T_board)
    y0, y1 = max(y0, rows[0]), min(y1, rows[1])
    if y0 >= y1:
        return
    board_T_camera = inverse(camera_T_board)
    from_front = board_T_camera[2, 3] > 0.0
    black_white = (options.black_grey / options.white_grey, 1.0) if from_front else (_BACK, _BACK)
    _expose_region(
        lens.corner_bearings,
        board_T_camera,
        plate.pattern,
        plate.bounds_m,
        black_white,
        options.subdivisions,
        weight,
        (x0, y0, x1, y1),
        shine,
        cover,
    )


@kernel
def _expose_region(
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
def _compose(
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
