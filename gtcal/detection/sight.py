"""A plane in which the board's image is a homography, at least locally, and the way there from pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from gtcal.camera import Camera, FloatArray
from gtcal.detection.lens_guess import guess_lens

# A bearing further than 87 degrees from the virtual camera's axis has no use in its image plane.
_LEAST_COSINE = 0.05


class Plane(Protocol):
    def to_pixels(self, plane: FloatArray) -> FloatArray:
        """(N, 2) points of the plane to (N, 2) pixels, NaN where there is none."""


class Sight(Plane, Protocol):
    def to_plane(self, pixels_px: FloatArray) -> FloatArray:
        """(N, 2) pixels to (N, 2) points of the plane, NaN where there is none."""


class PixelSight:
    """Intrinsics unknown: the image itself. The lens distortion stays in it."""

    def to_plane(self, pixels_px: FloatArray) -> FloatArray:
        return pixels_px

    def to_pixels(self, plane: FloatArray) -> FloatArray:
        return plane


@dataclass(frozen=True)
class BearingSight:
    """Intrinsics known: the image plane of a virtual pinhole camera of focal length 1 turned towards what is seen.

    virtual_R_camera: (3, 3), takes bearings in the camera frame to the virtual camera's.
    """

    camera: Camera
    virtual_R_camera: FloatArray

    def to_plane(self, pixels_px: FloatArray) -> FloatArray:
        bearings, valid = self.camera.unproject(pixels_px)
        in_virtual = bearings @ self.virtual_R_camera.T
        ahead = valid & (in_virtual[:, 2] > _LEAST_COSINE)
        return np.where(ahead[:, None], in_virtual[:, :2] / np.where(ahead, in_virtual[:, 2], 1.0)[:, None], np.nan)

    def to_pixels(self, plane: FloatArray) -> FloatArray:
        in_virtual = np.column_stack([plane, np.ones(len(plane))])
        return self.camera.project(in_virtual @ self.virtual_R_camera)[0]


@dataclass(frozen=True)
class BoardSight:
    """Intrinsics and the board's pose known: the board's own plane z = 0. camera_T_board: (4, 4)."""

    camera: Camera
    camera_T_board: FloatArray

    def to_pixels(self, plane: FloatArray) -> FloatArray:
        R, t = self.camera_T_board[:3, :3], self.camera_T_board[:3, 3]
        return self.camera.project(plane @ R[:, :2].T + t)[0]


def sight_of(camera: Camera | None, image_shape: tuple[int, int], board_m: FloatArray, seen_px: FloatArray) -> Sight:
    """The plane to compare corners in, for known points (N, 2) of the board and their pixels (N, 2). Where the
    intrinsics are unknown, the lens is guessed."""
    if camera is not None and camera.parameters is not None:
        return _facing(camera, seen_px) or PixelSight()
    guess = guess_lens(image_shape, board_m, seen_px)
    return (_facing(guess, seen_px) if guess is not None else None) or PixelSight()


def _facing(camera: Camera, seen_px: FloatArray) -> BearingSight | None:
    """The virtual camera that looks at the pixels, None where not all of them can be in its image."""
    bearings, valid = camera.unproject(seen_px)
    if not valid.all():
        return None
    axis = bearings.mean(axis=0)
    sight = BearingSight(camera, _rotation_to_z(axis / np.linalg.norm(axis)))
    return sight if np.isfinite(sight.to_plane(seen_px)).all() else None


@dataclass(frozen=True)
class BoardImage:
    """Where N points of the board are in the image, and how it runs there.

    pixels_px: (N, 2). px_per_m: (N, 2, 2) the derivative to the board's x (first column) and y. px_per_m2: (N, 2, 2)
    the second derivatives along x and along y: how the lens bends the board's straight lines.
    NaN where a point has no pixel."""

    pixels_px: FloatArray
    px_per_m: FloatArray
    px_per_m2: FloatArray

    def at(self, which: npt.NDArray[np.bool_]) -> BoardImage:
        """Some of the points, by mask or index."""
        return BoardImage(self.pixels_px[which], self.px_per_m[which], self.px_per_m2[which])


def board_image(sight: Plane, plane: FloatArray, plane_per_m: FloatArray, step_m: float) -> BoardImage:
    """Of the board's points that lie at ``plane`` (N, 2), which has the derivative ``plane_per_m`` (N, 2, 2) to the
    board point in metres; by differences over ``step_m``."""
    steps = step_m * np.moveaxis(plane_per_m, 2, 0)
    around = sight.to_pixels(np.concatenate([plane[None], plane + steps, plane - steps]).reshape(-1, 2))
    here, x_ahead, y_ahead, x_behind, y_behind = around.reshape(5, -1, 2)
    first = np.stack([x_ahead - x_behind, y_ahead - y_behind], axis=2) / (2 * step_m)
    second = np.stack([x_ahead - 2 * here + x_behind, y_ahead - 2 * here + y_behind], axis=2) / step_m**2
    return BoardImage(here, first, second)


def _rotation_to_z(axis: FloatArray) -> FloatArray:
    """The shortest rotation that takes the unit vector ``axis`` to z."""
    x, y, z = axis
    if z < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)
