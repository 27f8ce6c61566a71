"""A calibration in the files of other tools: Kalibr's camchain, OpenCV's FileStorage, NumPy."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from factors.camera_models import KANNALA_BRANDT4
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.camera_files.expressible import express
from gtcal.errors import GtcalError
from gtcal.files import write_aside, write_text
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration, CameraCalibration


def export_calibration(calibration: Calibration, path: Path, format_name: str, *, nearest: bool = False) -> None:
    """Write a calibration in one of EXPORT_FORMATS, whole or not at all.

    nearest: write the nearest lens model that the format knows where it can't express a camera's.

    Raises GtcalError for an unknown format, a lens that it can't express, or a file that can't be written."""
    if format_name not in _WRITERS:
        raise GtcalError(f"{format_name!r} is no format of an export; formats: {', '.join(EXPORT_FORMATS)}")
    _WRITERS[format_name](calibration, path, nearest)


def _ref(calibration: Calibration) -> str:
    fixed = calibration.capture == Capture.FIXED_CAMERAS
    return "the mocap world" if fixed else "the tracked platform's body, as the mocap defines it"


def _notes(calibration: Calibration) -> list[str]:
    return [
        "made by gtcal export from a calibration of gtcal",
        f"ref is {_ref(calibration)}; camera_T_ref takes coordinates in ref to coordinates in the camera",
        "metres; camera frame x right, y down, z forward; integer pixel coordinates are pixel centres",
    ]


def _row(values: Iterable[float]) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _cameras(calibration: Calibration) -> list[CameraCalibration]:
    return list(calibration.cameras.values())


def _write_kalibr(calibration: Calibration, path: Path, nearest: bool) -> None:
    lines = [f"# {note}" for note in _notes(calibration)]
    lines.append("# T_cn_cnm1 takes coordinates in the camera before to coordinates in this one")
    previous: FloatArray | None = None
    for i, camera in enumerate(_cameras(calibration)):
        camera_T_ref = camera.camera_T_ref.a_T_b
        lines += _kalibr_camera(i, camera, nearest)
        if previous is not None:
            lines += ["  T_cn_cnm1:", *(f"  - {_row(row)}" for row in camera_T_ref @ inverse(previous))]
        lines += ["  camera_T_ref:", *(f"  - {_row(row)}" for row in camera_T_ref)]
        previous = camera_T_ref
    write_text(path, "\n".join(lines) + "\n")


def _kalibr_camera(i: int, calibrated: CameraCalibration, nearest: bool) -> list[str]:
    camera = calibrated.camera
    found = express(camera, format_name="Kalibr's camchain", radtan_coefficients=4, nearest=nearest)
    return [
        f"cam{i}:  # {camera.name}; lens off by {found.max_px:.3g} px at most over the image",
        "  camera_model: pinhole",
        f"  distortion_model: {'equidistant' if found.model == KANNALA_BRANDT4 else 'radtan'}",
        f"  intrinsics: {_row(found.theta[:4])}",
        f"  distortion_coeffs: {_row(found.theta[4:8])}",
        f"  resolution: [{camera.image_width_px}, {camera.image_height_px}]",
        f"  rostopic: /{camera.name}/image_raw",
    ]


def _write_opencv(calibration: Calibration, path: Path, nearest: bool) -> None:
    lines = ["%YAML:1.0", "---", *(f"# {note}" for note in _notes(calibration))]
    for i, camera in enumerate(_cameras(calibration)):
        lines += _opencv_camera(i, camera, nearest)
    write_text(path, "\n".join(lines) + "\n")


def _opencv_camera(i: int, calibrated: CameraCalibration, nearest: bool) -> list[str]:
    camera = calibrated.camera
    found = express(camera, format_name="OpenCV's FileStorage", radtan_coefficients=5, nearest=nearest)
    fx, fy, cx, cy = found.theta[:4]
    return [
        f"cam{i}:",
        f'   name: "{camera.name}"',
        f"   fisheye: {int(found.model == KANNALA_BRANDT4)}",
        f"   lens_off_at_most_px: {found.max_px!r}",
        f"   image_width: {camera.image_width_px}",
        f"   image_height: {camera.image_height_px}",
        *_opencv_matrix("camera_matrix", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])),
        *_opencv_matrix("distortion_coefficients", found.theta[4:].reshape(1, -1)),
        *_opencv_matrix("camera_T_ref", calibrated.camera_T_ref.a_T_b),
    ]


def _opencv_matrix(name: str, matrix: FloatArray) -> list[str]:
    rows, columns = matrix.shape
    return [
        f"   {name}: !!opencv-matrix",
        f"      rows: {rows}",
        f"      cols: {columns}",
        "      dt: d",
        f"      data: {_row(matrix.ravel())}",
    ]


def _write_numpy(calibration: Calibration, path: Path, nearest: bool) -> None:
    cameras = _cameras(calibration)
    arrays = {f"theta_{camera.camera.name}": camera.camera.theta for camera in cameras}
    with write_aside(path, binary=True) as file:
        np.savez(
            file,
            notes=np.array(_notes(calibration)),
            names=np.array([camera.camera.name for camera in cameras]),
            models=np.array([camera.camera.model.name for camera in cameras]),
            image_size_px=np.array([[c.camera.image_width_px, c.camera.image_height_px] for c in cameras]),
            camera_T_ref=np.array([camera.camera_T_ref.a_T_b for camera in cameras]),
            body_T_board=calibration.body_T_board.a_T_b,
            **arrays,  # type: ignore[arg-type]
        )


_WRITERS: dict[str, Callable[[Calibration, Path, bool], None]] = {
    "kalibr": _write_kalibr,
    "opencv": _write_opencv,
    "numpy": _write_numpy,
}
EXPORT_FORMATS = tuple(_WRITERS)
"""The formats that a calibration can be written in."""
