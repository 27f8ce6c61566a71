"""The Lollypop in images where there is no time to search all of them, as at the capture volume.

Calibration and mocap say where the device should be in every image. Of each camera ten images a second are looked at,
those in which it should be seen, and only near where it should be: some ten times faster than to search all. Where it
is not found there as a rule, the calibration is no guide: then whole images are searched, so that a calibration that is
far off is found to be so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtcal.camera import BoolArray, FloatArray
from gtcal.detection.corner_search import PredictedBoard, SeenBoard
from gtcal.detection.detect import kept_detections
from gtcal.detection.many_images import Looking, Seen, look_at
from gtcal.errors import GtcalError
from gtcal.files import fingerprint
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import CameraDetections, IntArray
from gtcal.recordings.images import Images, left_out
from gtcal.results.calibration import Calibration, CameraCalibration
from gtcal.verification.clock import SightingTimes
from gtcal.verification.lollypop import Lollypop
from gtcal.verification.lollypop_recording import LollypopRecording

LOOKED_AT_HZ = 10.0

_FOUND_OF_EXPECTED = 0.5
_PROBED = 24  # whole images of a camera that are searched before all of them are
_STEEPEST_RAD, _SMALLEST_PX, _BORDER_PX = np.deg2rad(65.0), 16.0, 8.0  # of a tag that is expected to be read


def detected_where_expected(
    recording: LollypopRecording, calibration: Calibration, times: SightingTimes, *, progress: Progress = silent
) -> tuple[LollypopRecording, tuple[str, ...]]:
    """The recording with detections for every camera, and what to say of images that can't be read.

    Of cameras that come as images, those that the calibration does not have are left as they are.

    Raises GtcalError where too many images can't be read, or one isn't of the camera's size."""
    names = [n for n in recording.images if n not in recording.detections and n in calibration.cameras]
    if names and recording.path is None:
        raise GtcalError("a recording that is not on disk needs its detections given")
    found, said = {}, []
    for done, name in enumerate(names):
        progress("looking for the device", done, len(names))
        found[name], warning = _detected(recording, name, calibration.cameras[name], times)
        said += [warning] if warning else []
    progress("looking for the device", len(names), len(names))
    folders = sorted({path for name in names for path in recording.images[name].inputs})
    used = tuple(fingerprint(path) for path in folders)
    whole = replace(recording, detections=recording.detections | found, inputs=recording.inputs + used)
    return whole, tuple(said)


def _detected(
    recording: LollypopRecording, name: str, calibrated: CameraCalibration, times: SightingTimes
) -> tuple[CameraDetections, str]:
    assert recording.path is not None
    camera, images, device = calibrated.camera, recording.images[name], recording.device
    images = images.expecting(camera.image_width_px, camera.image_height_px)
    kept = kept_detections(recording.path.parent, name, images, device, camera)
    if kept is not None:
        return kept, ""
    chosen = spread(images.stamps_ns)
    predicted = _predicted(recording, calibrated, times, images.stamps_ns, chosen)
    looking = Looking(device, camera)
    seen = dict(look_at(images, list(predicted), looking, predicted=predicted))
    if _shown(seen) < _FOUND_OF_EXPECTED * len(predicted) or not predicted:
        seen |= _searched(images, [index for index in chosen.tolist() if not _shows(seen.get(index))], looking)
    unread = [view for view in seen.values() if isinstance(view, GtcalError)]
    return _detections(images, seen), left_out(name, unread, len(seen))


def spread(stamps_ns: IntArray) -> IntArray:
    """The places of stamps, every n-th of which there are ``LOOKED_AT_HZ`` or somewhat more a second."""
    if len(stamps_ns) < 2:
        return np.arange(len(stamps_ns))
    rate_hz = 1e9 / float(np.median(np.diff(stamps_ns)))
    return np.arange(0, len(stamps_ns), max(int(rate_hz / LOOKED_AT_HZ), 1))


def _predicted(
    recording: LollypopRecording,
    calibrated: CameraCalibration,
    times: SightingTimes,
    stamps_ns: IntArray,
    chosen: IntArray,
) -> dict[int, PredictedBoard]:
    """Of the images chosen, those in which a tag should be read, and where the device's body should be."""
    camera = calibrated.camera
    poses = recording.motion.at(times.mocap_ns(camera, stamps_ns[chosen]))
    camera_T_body = calibrated.camera_T_ref.a_T_b @ poses.ref_T_body
    legible = poses.ok.copy()
    legible[poses.ok] = _legible(recording.device, calibrated, camera_T_body[poses.ok])
    return {
        index: PredictedBoard(camera, pose)
        for index, pose in zip(chosen[legible].tolist(), camera_T_body[legible], strict=True)
    }


def _legible(device: Lollypop, calibrated: CameraCalibration, camera_T_body: FloatArray) -> BoolArray:
    """(N,) whether a face is wholly in the image, turned to the camera, and large enough."""
    legible = np.zeros(len(camera_T_body), dtype=bool)
    for face, first in zip(device.faces, device.face_start[:-1].tolist(), strict=True):
        camera_T_face = camera_T_body @ face.body_T_face
        centre, normal = camera_T_face[:, :3, 3], camera_T_face[:, :3, 2]
        facing = -(centre * normal).sum(axis=1) > np.cos(_STEEPEST_RAD) * np.linalg.norm(centre, axis=1)
        corners_m = device.corners_m[first : first + face.board.n_corners]
        points = corners_m @ np.swapaxes(camera_T_body[:, :3, :3], 1, 2) + camera_T_body[:, None, :3, 3]
        legible |= facing & _in_view(calibrated, points)
    return legible


def _in_view(calibrated: CameraCalibration, points: FloatArray) -> BoolArray:
    """(N,) whether all points (N, C, 3) have a pixel in the image, and how far they are apart is enough to be read."""
    camera = calibrated.camera
    pixels, valid = camera.project(points.reshape(-1, 3))
    pixels, valid = pixels.reshape(*points.shape[:2], 2), valid.reshape(points.shape[:2])
    pixels = np.where(valid[..., None], pixels, -np.inf)
    size_px = np.array([camera.image_width_px, camera.image_height_px])
    inside = ((pixels >= _BORDER_PX) & (pixels <= size_px - 1 - _BORDER_PX)).all(axis=(1, 2))
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    large = np.zeros(len(points), dtype=bool)
    large[inside] = (high[inside] - low[inside]).max(axis=1) >= _SMALLEST_PX
    return inside & large


def _searched(images: Images, indices: list[int], looking: Looking) -> dict[int, Seen]:
    """What whole images show: all of them, where some of them show the device."""
    if not indices:
        return {}
    probed = [indices[place] for place in np.unique(np.linspace(0, len(indices) - 1, _PROBED).astype(int))]
    seen = dict(look_at(images, probed, looking))
    if _shown(seen):
        seen |= dict(look_at(images, [index for index in indices if index not in seen], looking))
    return seen


def _shows(view: Seen | None) -> bool:
    return isinstance(view, SeenBoard) and len(view.corner_ids) > 0


def _shown(seen: dict[int, Seen]) -> int:
    return sum(_shows(view) for view in seen.values())


def _detections(images: Images, seen: dict[int, Seen]) -> CameraDetections:
    return CameraDetections.from_views(
        (int(images.stamps_ns[index]), view.corner_ids, view.corners_px)
        for index, view in sorted(seen.items(), key=lambda item: item[0])
        if isinstance(view, SeenBoard) and _shows(view)
    )
