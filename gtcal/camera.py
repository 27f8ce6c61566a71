"""A camera of the rig: its model, its parameters and the size of its image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from factors import CameraModel
from gtcal.errors import GtcalError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


StampedRow = Literal["first", "middle"]
"""The row at whose exposure the image is stamped."""


@dataclass(frozen=True)
class RollingShutter:
    """A sensor that exposes its rows one after the other, the upper one first.

    readout_s: time from the first row's exposure to the last one's; None where it is still to be found."""

    readout_s: float | None
    stamped_row: StampedRow

    def readout_shares(self, rows_px: FloatArray, height_px: int) -> FloatArray:
        """(N,) what share of the readout lies between the image's stamp and the exposure of these rows (N,)."""
        return rows_px / (height_px - 1.0) - (0.5 if self.stamped_row == "middle" else 0.0)


@dataclass(frozen=True)
class Camera:
    """A named camera. ``parameters`` is in the order of ``model.parameter_names``, or None where the
    intrinsics are still to be found. Integer pixel coordinates are pixel centres. ``rolling_shutter`` is None for a
    sensor that exposes all rows at once.

    theta_sigmas: (K,) 1-sigma of each parameter, as stated with it; NaN where it is not."""

    name: str
    model: CameraModel
    parameters: FloatArray | None
    image_width_px: int
    image_height_px: int
    rolling_shutter: RollingShutter | None = None
    theta_sigmas: FloatArray | None = None

    @property
    def theta(self) -> FloatArray:
        """The intrinsic parameters, shape (K,).

        Raises GtcalError where the camera has none."""
        if self.parameters is None:
            raise GtcalError(
                f"camera {self.name!r} has no intrinsics: give its 'parameters' in the recording's manifest "
                "or let gtcal find them with --calibrate-intrinsics"
            )
        return self.parameters

    def project(self, points_in_camera: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Project points (N, 3) in the camera frame to pixels (N, 2). The mask (N,) is False, and the pixel
        NaN, where the model has no pixel for the point; a valid pixel may still lie outside the image."""
        return self.model.project(points_in_camera, self.theta)

    def unproject(self, pixels_px: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Unit bearings (N, 3) in the camera frame of pixels (N, 2), with a mask (N,) as in ``project``."""
        return self.model.unproject(pixels_px, self.theta)

    def in_image(self, pixels_px: FloatArray) -> BoolArray:
        """Mask (N,) of the pixels (N, 2) that lie on the sensor."""
        x, y = pixels_px[:, 0], pixels_px[:, 1]
        return (x >= -0.5) & (x <= self.image_width_px - 0.5) & (y >= -0.5) & (y <= self.image_height_px - 0.5)
