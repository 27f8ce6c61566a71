"""What a detector makes of a camera's views: the corners it can read, with noise, misses and mistakes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gtcal.board import Board
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import CameraDetections, IntArray
from gtcal.simulation.transforms import apply
from gtcal.simulation.visibility import Features, ViewLimits, features_of, visible_features

_SMALLEST_MISTAKE_PX, _LARGEST_MISTAKE_PX = 5.0, 50.0
_FEWEST_CORNERS = 4  # fewer do not make a view
_ROW_ROUNDS = 4  # to find the row that a corner is seen in: each brings it a hundred times nearer


@dataclass(frozen=True)
class CornerNoise:
    """How a detector measures corners.

    pixel_px: 1-sigma of each coordinate.
    missed_share: share of the readable tags (ChArUco: corners) that it misses.
    wrong_tag_share: share of the tags that it takes for another: their corners lie where those of another
        tag are.
    wrong_corner_share: share of the single corners that it puts 5 to 50 px aside.
    """

    pixel_px: float = 0.1
    missed_share: float = 0.0
    wrong_tag_share: float = 0.0
    wrong_corner_share: float = 0.0


@dataclass(frozen=True)
class MeasuredCorners:
    """The detections of one camera, and which of them are wrong.

    detections: N corners in views that show at least four.
    wrong: (N,) whether the corner is a mistake, not a measurement.
    """

    detections: CameraDetections
    wrong: BoolArray


PosesAfter = Callable[[FloatArray], FloatArray]
"""camera_T_board (V, C, 4, 4) of V views, each at C times (V, C) in seconds after its stamp."""


def measured_corners(
    camera: Camera,
    camera_T_board_after: PosesAfter,
    stamps_ns: IntArray,
    board: Board,
    limits: ViewLimits,
    noise: CornerNoise,
    rng: np.random.Generator,
) -> MeasuredCorners:
    """Detect the board in views stamped ``stamps_ns`` (V,)."""
    features = features_of(board)
    camera_T_board = camera_T_board_after(np.zeros((len(stamps_ns), 1)))[:, 0]
    exact_px, valid = _exact_px(camera, camera_T_board, camera_T_board_after, board)
    read = visible_features(camera, camera_T_board, features, limits)
    read &= rng.random(read.shape) >= noise.missed_share
    seen = read[:, features.of_corner] & valid
    seen &= seen.sum(axis=1, keepdims=True) >= _FEWEST_CORNERS

    seen_px, wrong = _misread_tags(exact_px, read, features, noise.wrong_tag_share, rng)
    seen_px = seen_px + noise.pixel_px * rng.standard_normal(seen_px.shape)
    seen_px, astray = _stray(seen_px, noise.wrong_corner_share, rng)
    wrong |= astray
    detections = _in_columns(seen, _clipped(camera, seen_px), stamps_ns)
    return MeasuredCorners(detections, wrong[seen])


def _exact_px(
    camera: Camera, camera_T_board: FloatArray, camera_T_board_after: PosesAfter, board: Board
) -> tuple[FloatArray, BoolArray]:
    """(V, C, 2) and (V, C) whether there is a pixel: of every corner, at the exposure of its own row."""
    shape = (len(camera_T_board), board.n_corners)
    pixels, valid = camera.project(apply(camera_T_board, board.corners_m).reshape(-1, 3))
    shutter = camera.rolling_shutter
    if shutter is not None:
        if shutter.readout_s is None:
            raise GtcalError(f"camera {camera.name!r}: a rolling shutter needs its readout_s to be simulated")
        for _ in range(_ROW_ROUNDS):
            shares = np.nan_to_num(shutter.readout_shares(pixels[:, 1], camera.image_height_px))
            T = camera_T_board_after(shutter.readout_s * shares.reshape(shape))
            in_camera_m = np.einsum("vcij,cj->vci", T[..., :3, :3], board.corners_m) + T[..., :3, 3]
            pixels, valid = camera.project(in_camera_m.reshape(-1, 3))
    return pixels.reshape(*shape, 2), valid.reshape(shape)


def _misread_tags(
    exact_px: FloatArray, read: BoolArray, features: Features, share: float, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Pixels (V, C, 2) with some tags where another readable tag of the same view is, and which (V, C) these
    are. A view that shows a single tag has no other to take it for."""
    order = np.argsort(np.where(read, rng.random(read.shape), 2.0), axis=1)  # the readable ones first, shuffled
    n_read = read.sum(axis=1, keepdims=True)
    rank = np.argsort(order, axis=1)
    taken_for = np.take_along_axis(order, (rank + 1) % np.maximum(n_read, 1), axis=1)
    misread = (rng.random(read.shape) < share) & read & (n_read > 1)
    taken_for = np.where(misread, taken_for, np.arange(features.n_features))
    corner_of_other = _corners_in_order(features)[taken_for[:, features.of_corner], _rank_in_feature(features)]
    elsewhere_px = np.take_along_axis(exact_px, corner_of_other[..., None], axis=1)
    wrong = misread[:, features.of_corner]
    return np.where(wrong[..., None], elsewhere_px, exact_px), wrong


def _corners_in_order(features: Features) -> IntArray:
    """(G, K) the corner ids of each feature; all features have as many."""
    return np.argsort(features.of_corner, kind="stable").reshape(features.n_features, -1)


def _rank_in_feature(features: Features) -> IntArray:
    """(C,) which of its feature's corners each corner is."""
    corners = _corners_in_order(features)
    rank = np.empty(corners.size, dtype=np.int64)
    rank[corners] = np.arange(corners.shape[1])
    return rank


def _stray(pixels_px: FloatArray, share: float, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
    """Pixels (V, C, 2) with some moved well aside, and which (V, C) these are."""
    shape = pixels_px.shape[:2]
    astray = rng.random(shape) < share
    distance_px = rng.uniform(_SMALLEST_MISTAKE_PX, _LARGEST_MISTAKE_PX, shape)
    direction = rng.uniform(-np.pi, np.pi, shape)
    aside_px = distance_px[..., None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    return np.where(astray[..., None], pixels_px + aside_px, pixels_px), astray


def _clipped(camera: Camera, pixels_px: FloatArray) -> FloatArray:
    """A detector finds nothing outside the image."""
    high = np.array([camera.image_width_px, camera.image_height_px]) - 0.5
    return np.clip(pixels_px, -0.5, high)


def _in_columns(seen: BoolArray, pixels_px: FloatArray, stamps_ns: IntArray) -> CameraDetections:
    """The detections ``seen`` (V, C) in columns; views that show nothing are left out."""
    shown = seen.any(axis=1)
    view_start = np.concatenate([[0], np.cumsum(seen[shown].sum(axis=1))]).astype(np.int64)
    corner_ids = np.nonzero(seen)[1].astype(np.int64)
    return CameraDetections(stamps_ns[shown], view_start, corner_ids, pixels_px[seen])
