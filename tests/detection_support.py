"""Views of boards whose corners are known, for the tests of detection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors import PINHOLE_RADTAN
from gtcal.board import Board
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.recordings.images import GreyImage
from gtcal.simulation import ImageOptions, quest3_like_rig
from gtcal.simulation.backdrop import room
from gtcal.simulation.rendering import Plate, lens_of, plate_of, render

FISHEYE = quest3_like_rig().scaled(0.5).cameras[0]
PINHOLE = Camera("pinhole", PINHOLE_RADTAN, np.array([600, 600, 320, 240, -0.1, 0.05, 0, 0, 0.0]), 640, 480)
SHARP = ImageOptions(vignetting_share=0.0, gradient_share=0.0, shade_share=0.0)


@dataclass(frozen=True)
class View:
    """An image and the truth. corners_px: (C, 2), NaN behind the lens's field. pitch_px: (C,) the board's pitch there,
    where it is narrowest."""

    image: GreyImage
    corners_px: FloatArray
    pitch_px: FloatArray

    def visible(self, least_pitch_px: float, margin_px: float = 5.0) -> BoolArray:
        """(C,) the corners well inside the image where the board's pitch is as wide as this."""
        height, width = self.image.shape
        inside = (self.corners_px > margin_px) & (self.corners_px < np.array([width, height]) - 1 - margin_px)
        return np.asarray(inside.all(axis=1) & (self.pitch_px >= least_pitch_px))


class Filmer:
    """Films boards from random sides with one camera."""

    def __init__(self, camera: Camera, options: ImageOptions = SHARP, seed: int = 0) -> None:
        self.camera, self.options = camera, options
        self.random = np.random.default_rng(seed)
        self.lens = lens_of(camera, options, self.random)
        self.backdrop = room(self.random)

    def view(
        self,
        board: Board,
        distance_m: float,
        *,
        towards_px: tuple[float, float] | None = None,
        tilt_deg: float = 40.0,
        turn_deg: float | None = None,
        plate: Plate | None = None,
    ) -> View:
        """The board's middle at this distance in the direction of a pixel (default: the image's middle), turned about
        its normal (default: by chance) and tilted about a random axis in its plane."""
        pose = self._camera_T_board(board, distance_m, towards_px, tilt_deg, turn_deg)
        shown = plate_of(board) if plate is None else plate
        image = render(self.lens, shown, self.backdrop, pose[None], np.eye(4), self.options, self.random)
        in_camera = board.corners_m @ pose[:3, :3].T + pose[:3, 3]
        corners_px, _ = self.camera.project(in_camera)
        step_m = 1e-4
        columns = [(self.camera.project(in_camera + step_m * pose[:3, i])[0] - corners_px) / step_m for i in (0, 1)]
        derivative = np.nan_to_num(np.stack(columns, axis=2))
        narrowest = np.linalg.svd(derivative, compute_uv=False)[:, 1]
        return View(image, corners_px, board.pitch_m * narrowest)

    def _camera_T_board(
        self,
        board: Board,
        distance_m: float,
        towards_px: tuple[float, float] | None,
        tilt_deg: float,
        turn_deg: float | None,
    ) -> FloatArray:
        width, height = self.camera.image_width_px, self.camera.image_height_px
        at_px = np.array([towards_px or ((width - 1) / 2, (height - 1) / 2)])
        bearing = self.camera.unproject(at_px)[0][0]
        facing = np.eye(3)
        facing[:, 2] = -bearing
        facing[:, 0] = np.cross([0.0, 1.0, 0.0], bearing)
        facing[:, 0] /= np.linalg.norm(facing[:, 0])
        facing[:, 1] = np.cross(facing[:, 2], facing[:, 0])
        turn = self.random.uniform(-180, 180) if turn_deg is None else turn_deg
        about = self.random.uniform(0, 2 * np.pi)
        tilt = Rotation.from_rotvec(np.deg2rad(tilt_deg) * np.array([np.cos(about), np.sin(about), 0]))
        pose = np.eye(4)
        pose[:3, :3] = facing @ (tilt * Rotation.from_euler("z", turn, degrees=True)).as_matrix()
        x_min, y_min, x_max, y_max = board.bounds_m
        pose[:3, 3] = distance_m * bearing - pose[:3, :3] @ np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0])
        return pose
