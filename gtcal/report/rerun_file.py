"""A calibration for rerun's viewer: an .rrd with cameras, board and bodies over time, images with detections and
residuals, and the Lollypop's errors.

ref is the root. What changes stands on the timeline "time", the stamps of the recording. Residuals are drawn enlarged.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.files import staged
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import Images
from gtcal.recordings.recording import Recording
from gtcal.report.evidence import CameraEvidence, gather_evidence
from gtcal.results.calibration import Calibration
from gtcal.verification.verification import Sightings, Verification

SUFFIX = ".rrd"
ENLARGED = 50.0
"""Residuals are drawn so many times as long."""

_FRUSTUM_M = 0.05
_JPEG_QUALITY = 80
_DETECTED, _PROJECTED, _RESIDUAL = (230, 159, 0), (0, 114, 178), (213, 94, 0)


def write_rerun(
    path: Path,
    calibration: Calibration,
    *,
    recording: Recording | None = None,
    verification: Verification | None = None,
    images: bool = True,
    progress: Progress = silent,
) -> None:
    """Write an .rrd, whole or not at all. recording: one of the calibrated rig, whose views are shown with their
    residuals, and with their ``images`` where it has any. verification: as ``verify`` returns it.

    Raises GtcalError where rerun is not installed, the recording is of another rig, or the file can't be written."""
    rr = _rerun()
    evidence = None if recording is None else gather_evidence(calibration, recording, progress=progress)
    with staged(path) as aside, _in_one_line(path), rr.RecordingStream("gtcal") as stream:
        stream.save(aside)
        for name, camera in calibration.cameras.items():
            _camera(rr, stream, _of_camera(name), camera.camera, camera.camera_T_ref.a_T_b)
        if recording is not None and evidence is not None:
            _board(rr, stream, recording.board)
            _bodies(rr, stream, calibration, list(evidence.cameras.values()))
            for done, (name, seen) in enumerate(evidence.cameras.items()):
                progress("writing", done, len(evidence.cameras))
                _views(rr, stream, _of_camera(name), seen)
                if images and name in recording.images:
                    _images(rr, stream, _of_camera(name), recording.images[name], seen.views.stamps_ns)
        for name, sightings in ({} if verification is None else verification.sightings).items():
            _sightings(rr, stream, name, sightings)
        stream.flush()
        stream.disconnect()


@contextmanager
def _in_one_line(path: Path) -> Iterator[None]:
    """What rerun raises where its thread can't write."""
    try:
        yield
    except RuntimeError as error:
        raise GtcalError(f"{path}: can't be written: {error}") from error


def _rerun() -> Any:
    try:
        import rerun
    except ImportError:
        raise GtcalError("a file for rerun needs the library rerun-sdk: pip install 'gtcal[rerun]'") from None
    return rerun


def _of_camera(name: str) -> str:
    return f"ref/cameras/{name}"


def _times(rr: Any, stamps_ns: IntArray) -> list[Any]:
    return [rr.TimeColumn("time", timestamp=stamps_ns.astype("datetime64[ns]"))]


def _camera(rr: Any, stream: Any, entity: str, camera: Camera, camera_T_ref: FloatArray) -> None:
    """Its place, and a frustum of its focal length; the lens's distortion, which rerun does not know, is in the pixels
    that are shown."""
    pose = inverse(camera_T_ref)
    fx, fy, cx, cy = camera.theta[:4]
    stream.log(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), static=True)
    stream.log(
        f"{entity}/image",
        rr.Pinhole(
            focal_length=[fx, fy],
            principal_point=[cx + 0.5, cy + 0.5],  # rerun's first pixel has its centre at 0.5
            resolution=[camera.image_width_px, camera.image_height_px],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=_FRUSTUM_M,
        ),
        static=True,
    )


def _board(rr: Any, stream: Any, board: Board) -> None:
    stream.log("ref/body/board/corners", rr.Points3D(board.corners_m, radii=0.002), static=True)


def _bodies(rr: Any, stream: Any, calibration: Calibration, seen: list[CameraEvidence]) -> None:
    """The tracked body by the mocap, and the board on it."""
    stamps_ns, first = np.unique(np.concatenate([one.views.stamps_ns for one in seen]), return_index=True)
    poses = np.concatenate([one.views.ref_T_body for one in seen])[first]
    rr.send_columns("ref/body", _times(rr, stamps_ns), _transforms(rr, poses), recording=stream)
    stream.log("ref/body", rr.TransformAxes3D(0.1), static=True)
    X = calibration.body_T_board.a_T_b
    stream.log("ref/body/board", rr.Transform3D(translation=X[:3, 3], mat3x3=X[:3, :3]), static=True)


def _transforms(rr: Any, poses: FloatArray) -> Any:
    return rr.Transform3D.columns(translation=poses[:, :3, 3], mat3x3=poses[:, :3, :3])


def _views(rr: Any, stream: Any, entity: str, seen: CameraEvidence) -> None:
    """Detected corners, the residuals from them, and each view's RMSE."""
    views, starts = seen.views, seen.views.view_start
    times, lengths = _times(rr, views.stamps_ns), np.diff(starts)
    corners_px = views.corners_px + 0.5
    stream.log(f"{entity}/image/corners", rr.Points2D.from_fields(colors=[_DETECTED], radii=[2.0]), static=True)
    points = rr.Points2D.columns(positions=corners_px)
    rr.send_columns(f"{entity}/image/corners", times, points.partition(lengths), recording=stream)
    stream.log(f"{entity}/image/residuals", rr.Arrows2D.from_fields(colors=[_RESIDUAL]), static=True)
    arrows = rr.Arrows2D.columns(origins=corners_px, vectors=ENLARGED * np.nan_to_num(seen.residuals_px))
    rr.send_columns(f"{entity}/image/residuals", times, arrows.partition(lengths), recording=stream)
    finite = np.isfinite(seen.rmse_of_views_px)
    _scalars(rr, stream, f"rmse_px/{entity.split('/')[-1]}", views.stamps_ns[finite], seen.rmse_of_views_px[finite])


def _scalars(rr: Any, stream: Any, entity: str, stamps_ns: IntArray, values: FloatArray) -> None:
    rr.send_columns(entity, _times(rr, stamps_ns), rr.Scalars.columns(scalars=values), recording=stream)


def _images(rr: Any, stream: Any, entity: str, images: Images, stamps_ns: IntArray) -> None:
    """Those of the views, as JPEG."""
    for index in np.flatnonzero(np.isin(images.stamps_ns, stamps_ns)).tolist():
        _, encoded = cv2.imencode(".jpg", images.read(index), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        stream.set_time("time", timestamp=np.datetime64(int(images.stamps_ns[index]), "ns"))
        stream.log(f"{entity}/image", rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg"))
    stream.reset_time()


def _sightings(rr: Any, stream: Any, name: str, seen: Sightings) -> None:
    """The Lollypop's centre as the image and as the mocap has it, and the errors."""
    entity, times, lengths = f"{_of_camera(name)}/image/lollypop", _times(rr, seen.stamps_ns), np.ones(len(seen), int)
    for what, centres_px, colour in (
        ("image", seen.image_centre_px, _DETECTED),
        ("mocap", seen.mocap_centre_px, _PROJECTED),
    ):
        stream.log(f"{entity}/{what}", rr.Points2D.from_fields(colors=[colour], radii=[3.0]), static=True)
        points = rr.Points2D.columns(positions=centres_px + 0.5)
        rr.send_columns(f"{entity}/{what}", times, points.partition(lengths), recording=stream)
    _scalars(rr, stream, f"lollypop/e_2d_px/{name}", seen.stamps_ns, seen.e_2d_px)
    _scalars(rr, stream, f"lollypop/e_3d_mm/{name}", seen.stamps_ns, seen.e_3d_mm)
