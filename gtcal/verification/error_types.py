"""What is said of many errors: statistics, bias, curve, and their map over the image in the paper's colours."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from gtcal.camera import FloatArray
from gtcal.recordings.detections import IntArray

if TYPE_CHECKING:
    pass


class ErrorClass(IntEnum):
    """The paper's colours of an error in px, and NONE where nothing was measured."""

    NONE = -1
    GREEN = 0
    YELLOW = 1
    RED = 2
    MAGENTA = 3


ERROR_CLASS_LIMITS_PX = (0.5, 1.5, 3.0)
"""GREEN is below the first, YELLOW below the second, RED below the third, MAGENTA from there on."""


def error_classes(errors_px: FloatArray) -> npt.NDArray[np.int8]:
    """The ``ErrorClass`` of errors of any shape; NaN is NONE."""
    classes = np.digitize(errors_px, ERROR_CLASS_LIMITS_PX).astype(np.int8)
    classes[np.isnan(errors_px)] = ErrorClass.NONE
    return classes


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of error norms; ``unit`` is 'px' or 'mm'.

    rmse_low, rmse_high: two one-sided bounds on the RMSE of a recording without end, each at the stated confidence;
        NaN where there is too little data for any."""

    unit: Literal["px", "mm"]
    count: int
    rmse: float
    mean: float
    median: float
    p95: float
    worst: float
    rmse_low: float
    rmse_high: float


@dataclass(frozen=True)
class Bias:
    """Mean error in px, with the half width of its two-sided confidence interval, which accounts for the correlation
    of the errors in time; NaN where there is too little data.

    xy_px, xy_half_width_px: (2,) along the image's axes, image centre less mocap centre.
    radial_px, tangential_px: outwards from the principal point, and around it (from x towards y)."""

    xy_px: FloatArray
    xy_half_width_px: FloatArray
    radial_px: float
    radial_half_width_px: float
    tangential_px: float
    tangential_half_width_px: float


@dataclass(frozen=True)
class ErrorCurve:
    """Error against a quantity, in B bins.

    quantity: 'distance_m', 'viewing_angle_deg' or 'field_angle_deg'.
    edges: (B + 1,) in the quantity's unit. count: (B,).
    rmse_px, median_px, rmse_mm: (B,), NaN in an empty bin."""

    quantity: Literal["distance_m", "viewing_angle_deg", "field_angle_deg"]
    edges: FloatArray
    count: IntArray
    rmse_px: FloatArray
    median_px: FloatArray
    rmse_mm: FloatArray


@dataclass(frozen=True)
class HeatMap:
    """e_2D over the image, in bins by the place of the image centre. Row 0 is the image's top.

    x_edges_px: (W + 1,), y_edges_px: (H + 1,) of the bins, from -0.5.
    count: (H, W). rmse_px: (H, W), NaN in an empty bin. mean_error_px: (H, W, 2) the mean error vector."""

    x_edges_px: FloatArray
    y_edges_px: FloatArray
    count: IntArray
    rmse_px: FloatArray
    mean_error_px: FloatArray

    @property
    def classes(self) -> npt.NDArray[np.int8]:
        """(H, W) the paper's colours, as ``ErrorClass``."""
        return error_classes(self.rmse_px)
