"""The ground truth of a simulated recording: what a calibration should find, and what was spoilt on purpose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray


@dataclass(frozen=True)
class CameraTruth:
    """The truth about one camera, over all F frames it took, seen board or not.

    camera: with the true intrinsics.
    camera_T_ref: (4, 4).
    clock_offset_s: the camera's stamps run ahead of the mocap's clock by this.
    stamps_ns: (F,) of the frames, camera clock.
    ref_T_body: (F, 4, 4) at the moments of the frames.
    swapped: (F,) whether a mocap swap spoils the recorded pose at the frame's stamp.
    wrong_corners: (N,) whether each row of the camera's detections is a mistake.
    """

    camera: Camera
    camera_T_ref: FloatArray
    clock_offset_s: float
    stamps_ns: IntArray
    ref_T_body: FloatArray
    swapped: BoolArray
    wrong_corners: BoolArray

    def frames_of(self, stamps_ns: IntArray) -> IntArray:
        """(V,) the frame of each stamp (V,). Raises GtcalError for a stamp that no frame has."""
        frames = np.minimum(np.searchsorted(self.stamps_ns, stamps_ns), len(self.stamps_ns) - 1)
        if (self.stamps_ns[frames] != stamps_ns).any():
            raise GtcalError(f"camera {self.camera.name!r}: the ground truth has no frame at some of the stamps")
        return np.asarray(frames, dtype=np.int64)


@dataclass(frozen=True)
class GroundTruth:
    """What a calibration should find. body_T_board: (4, 4)."""

    cameras: dict[str, CameraTruth]
    body_T_board: FloatArray

    @property
    def camera_T_ref(self) -> dict[str, FloatArray]:
        """(4, 4) by camera."""
        return {name: truth.camera_T_ref for name, truth in self.cameras.items()}

    @property
    def intrinsics(self) -> dict[str, FloatArray]:
        """(K,) by camera, in the order of its model's ``parameter_names``."""
        return {name: truth.camera.theta for name, truth in self.cameras.items()}
