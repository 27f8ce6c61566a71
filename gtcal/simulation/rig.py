"""Camera rigs: which cameras there are and where they sit.

The rig frame is the rig's own: the device frame of a headset, the middle of the volume for cameras around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from factors import CAMERA_MODELS, FISHEYE62, CameraModel
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.simulation.quest3 import HEADSET_CAMERAS, IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, HeadsetCamera
from gtcal.simulation.transforms import transform


@dataclass(frozen=True)
class Rig:
    """Cameras that keep their place to each other.

    rig_T_camera: (C, 4, 4), one for each of ``cameras``.
    up_in_rig: (3,) the direction that points up in the room while the rig is level.
    nearest_m, farthest_m: from how far the cameras are shown the board.
    """

    cameras: tuple[Camera, ...]
    rig_T_camera: FloatArray
    up_in_rig: FloatArray
    nearest_m: float
    farthest_m: float

    def scaled(self, factor: float) -> Rig:
        """The same rig with images of ``factor`` times the width and height, rounded down to whole pixels.

        Raises GtcalError where that leaves no image."""
        if not 0.02 <= factor <= 10.0:
            raise GtcalError(f"the images' scale is {factor}; expected 0.02 to 10")
        return replace(self, cameras=tuple(scaled_camera(camera, factor) for camera in self.cameras))


def scaled_camera(camera: Camera, factor: float) -> Camera:
    """The same lens over an image of ``factor`` times the size. Pixel centres are integers, so the image
    begins at -0.5."""
    theta = camera.theta.copy()
    theta[:2] *= factor
    theta[2:4] = (theta[2:4] + 0.5) * factor - 0.5
    return replace(
        camera,
        parameters=theta,
        image_width_px=int(camera.image_width_px * factor),
        image_height_px=int(camera.image_height_px * factor),
    )


def quest3_like_rig() -> Rig:
    """A headset with four Fisheye62 cameras, 1280x1024, two in front and two on the sides."""
    return Rig(
        cameras=tuple(_headset_camera(camera) for camera in HEADSET_CAMERAS),
        rig_T_camera=np.stack([_device_T_camera(camera) for camera in HEADSET_CAMERAS]),
        up_in_rig=np.array([0.0, 1.0, 0.0]),
        nearest_m=0.3,
        farthest_m=1.0,
    )


def _headset_camera(camera: HeadsetCamera) -> Camera:
    return Camera(camera.name, FISHEYE62, np.array(camera.theta), IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX)


def _device_T_camera(camera: HeadsetCamera) -> FloatArray:
    w, *xyz = camera.device_q_camera_wxyz
    return transform(Rotation.from_quat([*xyz, w]), np.array(camera.device_t_camera_m))


def fixed_cameras_rig(
    n_cameras: int = 4,
    *,
    models: Sequence[str] = ("pinhole_radtan", "kannala_brandt4"),
    radius_m: float = 1.3,
    arc_deg: float = 180.0,
) -> Rig:
    """Cameras evenly spaced on an arc around a volume, looking in, high and low by turns, 1280x1024.

    ``models`` names the cameras' models, in turn. Of cameras on half a circle (the default) about
    half can read the board at a time, of cameras all around a third.

    Raises GtcalError for a model that does not exist."""
    azimuth = np.deg2rad(arc_deg) * (np.arange(n_cameras) - 0.5 * (n_cameras - 1)) / n_cameras
    height_m = np.where(np.arange(n_cameras) % 2 == 0, 0.35, -0.2) * radius_m
    positions_m = np.stack([radius_m * np.cos(azimuth), radius_m * np.sin(azimuth), height_m], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    return Rig(
        cameras=tuple(_fixed_camera(index, models[index % len(models)]) for index in range(n_cameras)),
        rig_T_camera=np.stack([_looking_at_origin(position, up) for position in positions_m]),
        up_in_rig=up,
        nearest_m=0.4 * radius_m,
        farthest_m=1.1 * radius_m,
    )


def _fixed_camera(index: int, model_name: str) -> Camera:
    model = _known_model(model_name)
    focal_px, *distortion = model.usual
    focal_px *= 1.0 + 0.006 * ((3 * index) % 7 - 3)  # no two lenses are the same
    centre_px = (639.5 + 2.3 * ((2 * index) % 5 - 2), 511.5 - 1.7 * ((3 * index) % 5 - 2))
    theta = np.array([focal_px, 1.0007 * focal_px, *centre_px, *distortion])
    return Camera(f"cam{index}", model, theta, 1280, 1024)


def _known_model(name: str) -> CameraModel:
    if name not in CAMERA_MODELS:
        raise GtcalError(f"camera model {name!r} is not known; models: {', '.join(CAMERA_MODELS)}")
    return CAMERA_MODELS[name]


def _looking_at_origin(position_m: FloatArray, up: FloatArray) -> FloatArray:
    forward = -position_m / np.linalg.norm(position_m)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return transform(Rotation.from_matrix(axes), position_m)
