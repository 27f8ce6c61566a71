"""OpenCV's FileStorage: YAML, XML or JSON with !!opencv-matrix.

Pixels: integer coordinates are pixel centres. The lens is OpenCV's pinhole (k1 k2 p1 p2 k3, and k4 k5 k6 where it is
rational), its fisheye (k1..k4), or its omnidir: k1 k2 p1 p2, with xi beside them as OpenCV's sample writes it. gtcal
writes one entry per camera, with its name, fisheye 0 or 1, and camera_T_ref in m. It reads these, and files of a single
camera as OpenCV's calibration samples write them. Four coefficients alone may be either lens: then the file (or the
manifest) must say which.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from factors.camera_models import CAMERA_MODELS, KANNALA_BRANDT4, MEI_OMNI, PINHOLE_RADTAN
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, float_text, quoted, row_text
from gtcal.camera_files.lenses import KB4, OMNI, OPENCV_FORMS, PINHOLE, Expressed, express
from gtcal.camera_files.rig import (
    OPENCV_COUNTS,
    Lens,
    ReadOptions,
    Rig,
    RigCamera,
    image_size,
    opencv_pinhole,
    padded,
    rig_camera,
    with_pose,
)
from gtcal.documents import read_text
from gtcal.errors import GtcalError
from gtcal.files import write_text
from gtcal.own_process import EndedError, OwnProcess, RefusedError

TITLE = "OpenCV's FileStorage"
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "Distortion_Coefficients", "D")
_WIDTH, _HEIGHT = ("image_width", "image_Width"), ("image_height", "image_Height")
_FISHEYE = ("fisheye", "fisheye_model")
_SKEW_PX = 1e-6
_UNPOSED = "the file holds no camera_T_ref with its length_unit"


def recognises_text(start: str) -> bool:
    """Whether a text file that begins like this is a FileStorage with matrices."""
    return start.startswith("%YAML:1.0") or "!!opencv-matrix" in start or "opencv-matrix" in start


def read_opencv(path: Path, options: ReadOptions) -> Rig:
    """The cameras of a FileStorage; in ref where gtcal wrote it, else without poses.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = Field(path, "", _load(path))
    if any(name in document for name in _MATRIX):
        return Rig((_camera("camera", document, options),), "ref", "not known", _UNPOSED)
    entries = [(key, entry) for key, entry in document.items() if isinstance(entry.value, dict) and "data" not in entry]
    if not entries:
        raise document.error(f"there is no camera; expected {_MATRIX[0]} and {_DISTORTION[0]}")
    cameras = [_camera(key, entry, options) for key, entry in entries]
    unposed = "" if all(camera.camera_T_ref is not None for camera in cameras) else _UNPOSED
    return Rig(tuple(cameras), "ref", "ref, as the file has it", unposed)


def write_opencv(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write a FileStorage in YAML. Raises GtcalError for a lens that OpenCV doesn't know unless ``nearest``."""
    lines = ["%YAML:1.0", "---", *(f"# {note}" for note in notes)]
    for i, camera in enumerate(rig.cameras):
        lines += _camera_lines(i, camera, nearest)
    write_text(path, "\n".join(lines) + "\n")


def _camera_lines(i: int, camera: RigCamera, nearest: bool) -> list[str]:
    found = express(camera.camera, format_name=TITLE, forms=(*OPENCV_FORMS, OMNI), nearest=nearest)
    fx, fy, cx, cy = found.theta[:4]
    omnidir = found.model == MEI_OMNI
    lines = [
        f"cam{i}:  # {found.said(camera.camera)}",
        f"   name: {quoted(camera.name)}",
        f"   fisheye: {int(found.model == KANNALA_BRANDT4)}",
        f"   lens_off_at_most_px: {float_text(found.max_px)}",
        f"   image_width: {camera.image_size_px[0]}",
        f"   image_height: {camera.image_size_px[1]}",
        *_matrix("camera_matrix", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])),
        *_matrix("distortion_coefficients", found.theta[4 : 8 if omnidir else None].reshape(1, -1)),
    ]
    if omnidir:
        lines.append(f"   xi: {float_text(found.theta[8])}")
    if camera.camera_T_ref is not None:
        lines += ['   length_unit: "m"', *_matrix("camera_T_ref", camera.camera_T_ref)]
    return lines


def _matrix(name: str, matrix: FloatArray) -> list[str]:
    rows, columns = matrix.shape
    return [
        f"   {name}: !!opencv-matrix",
        f"      rows: {rows}",
        f"      cols: {columns}",
        "      dt: d",
        f"      data: {row_text(matrix.ravel())}",
    ]


def _camera(key: str, entry: Field, options: ReadOptions) -> RigCamera:
    name = entry["name"].text() if "name" in entry else key
    lens = _lens(entry, options)
    sizes = [entry.get(*names) for names in (_WIDTH, _HEIGHT)]
    stated = [size for size in sizes if size is not None]
    if len(stated) == 1:
        raise entry.error("states one side of the image only; give image_width and image_height")
    camera = rig_camera(entry, name, lens, image_size(entry, stated, options), options)
    if "camera_T_ref" not in entry:
        return camera
    pose = entry["camera_T_ref"].rigid()
    length_m = options.length_m(entry.get("length_unit"))
    if length_m is None:
        return camera
    pose[:3, 3] *= length_m
    return with_pose(camera, pose)


def focal_and_centre(field: Field) -> FloatArray:
    """(4,) fx fy cx cy of a camera matrix. Raises GtcalError where it is none, or has skew."""
    K = field.matrix(3, 3)
    if abs(K[0, 1]) > _SKEW_PX:
        raise field.error(f"has a skew of {K[0, 1]:g} px, and gtcal has no such lens")
    if np.abs(K[[1, 2, 2], [0, 0, 1]]).max() > 0 or K[2, 2] != 1:
        raise field.error("is no camera matrix; expected fx 0 cx / 0 fy cy / 0 0 1")
    return K[[0, 1, 0, 1], [0, 1, 2, 2]]


def _lens(entry: Field, options: ReadOptions) -> Lens:
    middle = focal_and_centre(entry.first(*_MATRIX))
    stated = entry.get(*_DISTORTION)
    coefficients = np.zeros(0) if stated is None else stated.numbers(*OPENCV_COUNTS)
    if "xi" in entry:
        if len(coefficients) not in (0, 4):
            raise entry.first(*_DISTORTION).error(f"has {len(coefficients)} numbers; OpenCV's omnidir has 4")
        k_and_p = coefficients if len(coefficients) else np.zeros(4)
        return Expressed(OMNI, np.concatenate([middle, k_and_p, _xi(entry["xi"])]))
    fisheye = _is_fisheye(entry, options, len(coefficients))
    if fisheye and len(coefficients) not in (0, 4):
        raise entry.first(*_DISTORTION).error(f"has {len(coefficients)} numbers; OpenCV's fisheye has 4")
    if fisheye:
        return padded(KB4, np.concatenate([middle, coefficients]))
    return padded(PINHOLE, middle) if stated is None else opencv_pinhole(middle, coefficients)


def _xi(field: Field) -> FloatArray:
    """(1,): a number, or a matrix of one."""
    return field.numbers(1) if isinstance(field.value, np.ndarray) else np.array([field.number()])


def _is_fisheye(entry: Field, options: ReadOptions, n_coefficients: int) -> bool:
    stated = entry.get(*_FISHEYE)
    if stated is not None:
        return stated.flag()
    if options.model is not None:
        return not CAMERA_MODELS[options.model].perspective
    if n_coefficients == 4:
        raise entry.error(
            "four coefficients are those of OpenCV's fisheye or of its pinhole, and the file doesn't say which; give "
            f"the model: {KANNALA_BRANDT4.name} or {PINHOLE_RADTAN.name}"
        )
    return False


def _load(path: Path) -> Any:
    read_text(path)  # which refuses what is no text, or too long
    process = _processes.pop(os.getpid(), None) or OwnProcess(_READER)
    try:
        document = process.ask("document", str(path))
    except RefusedError as error:
        raise GtcalError(f"{path}: OpenCV can't read it: {error}") from None
    except EndedError:
        raise GtcalError(f"{path}: is damaged: OpenCV does not survive reading it; write it again") from None
    _processes[os.getpid()] = process
    return document


_processes: dict[int, OwnProcess] = {}
"""One that stands ready, of this process: those that were forked from it have their own."""

_READER = Path(__file__).with_name("opencv_reader.py")
