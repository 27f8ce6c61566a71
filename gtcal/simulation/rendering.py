"""Images of the board, by following each pixel's rays through the camera model to the print.

A pixel is the mean light over its square, blurred by the lens, integrated over the exposure, with noise. The
corners of the pixels are unprojected once per camera. For an image each corner's ray meets the board's plane;
the four corners of a pixel span a quadrilateral on the board, and the print's mean darkness over it is summed
exactly over a few small rectangles that cover it. No texture is sampled: edges are as sharp as the print's at any
distance, and a corner of the print lies where the camera model projects it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.recordings.images import GreyImage
from gtcal.simulation.backdrop import GreyPicture
from gtcal.simulation.pattern import (
    Pattern,
    pattern_of,
)
from gtcal.simulation.rendering_kernels import compose, expose_region
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
    compose(shine, cover, lens.corner_bearings, camera_T_world, picture, scene)
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
    expose_region(
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
