"""Which corners of the board a camera can measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.rigid import inverse
from gtcal.board import Board, TagGrid
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.recordings.detections import IntArray
from gtcal.simulation.transforms import apply


@dataclass(frozen=True)
class ViewLimits:
    """What a detector still reads.

    max_incidence_deg: angle between the line of sight and the printed side's normal.
    min_feature_px: shortest side of a tag (ChArUco: of a chessboard square) in the image.
    border_px: distance of every corner from the image's border.
    """

    max_incidence_deg: float = 70.0
    min_feature_px: float = 12.0
    border_px: float = 4.0


@dataclass(frozen=True)
class Features:
    """What is read or missed as a whole: a tag with its four corners, or one chessboard corner.

    outlines_m: (G, 4, 3) four points around each feature, in the board frame.
    of_corner: (C,) the feature each corner of the board belongs to.
    """

    outlines_m: FloatArray
    of_corner: IntArray

    @property
    def n_features(self) -> int:
        return len(self.outlines_m)


def features_of(board: Board) -> Features:
    """The features of a board: of a tag grid its tags; of a ChArUco board its corners, each with half a square
    around it, as of the others."""
    if isinstance(board, TagGrid):
        return Features(board.corners_m.reshape(-1, 4, 3), np.arange(board.n_corners) // 4)
    half_m = 0.5 * board.clear_reach_m
    around = half_m * np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
    return Features(board.corners_m[:, None] + around, np.arange(board.n_corners))


def visible_features(camera: Camera, camera_T_board: FloatArray, features: Features, limits: ViewLimits) -> BoolArray:
    """(V, G) whether each feature can be measured in views from camera_T_board (V, 4, 4)."""
    n_views, n_features = len(camera_T_board), features.n_features
    points_m = features.outlines_m.reshape(-1, 3)
    pixels, valid = camera.project(apply(camera_T_board, points_m).reshape(-1, 3))
    corners = pixels.reshape(n_views, n_features, 4, 2)
    with np.errstate(invalid="ignore"):
        inside = valid & _within(camera, pixels, limits.border_px)
        sides_px = np.linalg.norm(corners - np.roll(corners, 1, axis=2), axis=3).min(axis=2)
        large = sides_px >= limits.min_feature_px
    facing = _cos_incidence(camera_T_board, points_m) >= np.cos(np.deg2rad(limits.max_incidence_deg))
    readable = inside.reshape(n_views, -1) & facing
    return readable.reshape(n_views, n_features, 4).all(axis=2) & large


def _within(camera: Camera, pixels_px: FloatArray, border_px: float) -> BoolArray:
    low = border_px - 0.5
    high = np.array([camera.image_width_px, camera.image_height_px]) - 0.5 - border_px
    return np.asarray(((pixels_px >= low) & (pixels_px <= high)).all(axis=1))


def _cos_incidence(camera_T_board: FloatArray, points_m: FloatArray) -> FloatArray:
    """(V, P) cosine of the angle between the board's normal and the direction from a point to the camera;
    negative behind the board."""
    camera_in_board_m = inverse(camera_T_board)[:, :3, 3]
    sight_m = camera_in_board_m[:, None] - points_m
    return np.asarray(sight_m[..., 2] / np.linalg.norm(sight_m, axis=2))
