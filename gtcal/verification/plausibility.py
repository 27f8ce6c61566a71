"""Whether a Lollypop recording and a calibration can belong together at all: what no fault of a camera explains."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration
from gtcal.verification.lollypop import Lollypop
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.sightings import Path3D

# Where every camera is off by more than this in the median, nothing fits: a headset worn anew is off by half a degree.
_GROSS_RAD = np.deg2rad(3.0)
_SAME_SIZE = 0.1
_STILL_M = 0.005
_FEWEST = 10
# Of the spread of the device's path: what a rigid alignment may leave where body and device are the same thing.
_RELATED = 0.25


def check_fitting(recording: LollypopRecording, calibration: Calibration) -> tuple[str, ...]:
    """Check what can be told before any image is looked at; returns warnings.

    Raises GtcalError where the calibration is of another rig, capture or image size, or the recording is empty."""
    common = [name for name in recording.cameras if name in calibration.cameras]
    if not common:
        raise GtcalError(
            f"the calibration is of another rig: it has the cameras {', '.join(calibration.cameras)}, the recording "
            f"{', '.join(recording.cameras)}"
        )
    if _ref(recording.capture) != _ref(calibration.capture):
        raise GtcalError(
            f"the calibration is of capture {calibration.capture.value}, with camera poses against "
            f"{_ref(calibration.capture)}; the recording's is {recording.capture.value}, against "
            f"{_ref(recording.capture)}"
        )
    for name in common:
        _check_camera(recording, calibration, name)
    extra = [name for name in recording.cameras if name not in calibration.cameras]
    return tuple(f"camera {name!r} is in the recording but not in the calibration; it is left out" for name in extra)


def check_seen(recording: LollypopRecording, names: list[str]) -> None:
    """Raises GtcalError where the device is in no image, or in a single frame only."""
    stamps = [recording.detections[name].stamps_ns for name in names]
    frames = np.unique(np.concatenate(stamps))
    if len(frames) == 0:
        n_images = sum(len(recording.images[name]) for name in names if name in recording.images)
        where = f"none of {n_images} images" if n_images else "no frame"
        raise GtcalError(
            f"the device is not in the recording: {where} shows it ({recording.device.describe()}); check the tag's "
            "dictionary and id"
        )
    if len(frames) == 1:
        raise GtcalError(
            "the device is in a single frame of the recording; a verification needs it moved through the cameras' "
            "views, some 30 s of it"
        )


def check_related(paths: Mapping[str, Path3D], device: Lollypop) -> None:
    """Raises GtcalError where the tag's size can't be what the device states, or where everything is so far off that
    the mocap's body is another one or the calibration is of another rig."""
    seen = [path for path in paths.values() if len(path)]
    if sum(len(path) for path in seen) < _FEWEST:
        return
    if not all(path.angle_apart_rad > _GROSS_RAD for path in seen):
        _check_size(np.concatenate([path.distance_ratios for path in seen]), device)
        return
    name, largest = max(paths.items(), key=lambda entry: len(entry[1]))
    scale, misfit = _similarity(largest)
    if misfit > _RELATED:
        raise GtcalError(
            f"the mocap's body does not move as the device does in camera {name!r}, not even about: was 'device_body' "
            "exported from another rigid body, or is the clock another?"
        )
    _check_size(np.array([scale]), device)
    off_deg = np.rad2deg(np.median([path.angle_apart_rad for path in seen]))
    raise GtcalError(
        f"all cameras are off by about {off_deg:.0f} deg, although the mocap's body moves as the device does: the "
        "calibration is of another rig, or the platform's rigid body was defined anew since"
    )


def _ref(capture: Capture) -> str:
    return "the mocap's world" if capture is Capture.FIXED_CAMERAS else "the platform's body"


def _check_camera(recording: LollypopRecording, calibration: Calibration, name: str) -> None:
    recorded, calibrated = recording.cameras[name], calibration.cameras[name].camera
    sizes = [(camera.image_width_px, camera.image_height_px) for camera in (recorded, calibrated)]
    if sizes[0] != sizes[1]:
        raise GtcalError(
            f"camera {name!r} has images of {sizes[0][0]} x {sizes[0][1]} in the recording, but was calibrated with "
            f"{sizes[1][0]} x {sizes[1][1]}; intrinsics hold for one image size only"
        )
    if recorded.model.name != calibrated.model.name:
        raise GtcalError(
            f"camera {name!r} is {recorded.model.name} in the recording, but {calibrated.model.name} in the "
            "calibration: is it of another rig?"
        )


def _check_size(ratios: FloatArray, device: Lollypop) -> None:
    ratio = float(np.median(ratios))
    if abs(np.log(ratio)) < np.log1p(_SAME_SIZE):
        return
    side_mm = 1e3 * device.faces[0].board.tag_side_m
    raise GtcalError(
        f"the tag looks {ratio:.2f} times as large as the device states: at the mocap's distance its side is about "
        f"{side_mm * ratio:.1f} mm, not {side_mm:g} mm; measure the print and set tag_side_m"
    )


def _similarity(path: Path3D) -> tuple[float, float]:
    """The scale of the similarity that best takes the path by tag size and image to the mocap's (Umeyama 1991), and
    what it leaves, as a share of the path's spread; infinite where the mocap's hardly moves."""
    by_image, by_mocap = (points - np.median(points, axis=0) for points in (path.by_image_m, path.by_mocap_m))
    if np.sqrt((by_mocap**2).sum(axis=1).mean()) < _STILL_M:
        return 1.0, np.inf
    U, singular, Vt = np.linalg.svd(by_mocap.T @ by_image)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = float((singular * sign).sum() / (by_image**2).sum())
    left = by_mocap - scale * by_image @ (U * sign @ Vt).T
    return max(scale, 1e-6), float(np.sqrt((left**2).sum() / (by_mocap**2).sum()))
