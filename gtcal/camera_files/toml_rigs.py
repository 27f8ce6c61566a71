"""TOML of aniposelib and of Pose2Sim: a table per camera with name, size, matrix, distortions, rotation, translation.

Pixels: integer coordinates are pixel centres (OpenCV's). rotation is the Rodrigues vector of camera_R_world and
translation that of camera_T_world. Pose2Sim means metres; aniposelib means whatever the board's squares were given in,
so that the unit has to be stated. The lens is OpenCV's pinhole, or its fisheye where fisheye = true. Pose2Sim's tools
hand on four coefficients of a pinhole (k1 k2 p1 p2), aniposelib what OpenCV takes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from factors.camera_models import KANNALA_BRANDT4
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, quoted, rigid_from_matrix, row_text
from gtcal.camera_files.lenses import KB4, OPENCV_FORMS, RADTAN4, Form, express
from gtcal.camera_files.opencv import focal_and_centre
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
from gtcal.documents import load_toml, read_text
from gtcal.files import write_text

ANIPOSE, POSE2SIM = "aniposelib's TOML", "Pose2Sim's TOML"
_NO_CAMERAS = ("metadata", "capture_volume", "charuco", "checkerboard")
_UNSTATED = "aniposelib's files state no unit of length; give length_unit, that of the board's squares: m or mm"


def recognises(document: object) -> bool:
    """Whether this is what a TOML of either looks like."""
    return isinstance(document, dict) and any(
        isinstance(table, dict) and {"matrix", "distortions"} <= set(table) for table in document.values()
    )


def stated_format(document: object) -> str | None:
    """Which of the two it is, where the file says: only those that gtcal wrote do."""
    metadata = document.get("metadata") if isinstance(document, dict) else None
    said = metadata.get("format") if isinstance(metadata, dict) else None
    return said if said in ("anipose", "pose2sim") else None


def read_anipose(path: Path, options: ReadOptions) -> Rig:
    """The cameras of aniposelib's TOML, in its world; without poses where no unit of length is stated.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = _document(path)
    metadata = document.get("metadata")
    length_m = options.length_m(None if metadata is None else metadata.get("length_unit"))
    return _rig(document, options, length_m, "" if length_m else _UNSTATED)


def read_pose2sim(path: Path, options: ReadOptions) -> Rig:
    """The cameras of Pose2Sim's Calib.toml, in its world.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    return _rig(_document(path), options, options.length_m(None) or 1.0, "")


def write_anipose(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write aniposelib's TOML. Raises GtcalError without poses, or for a lens that it lacks unless ``nearest``."""
    keys = [f"cam_{i}" for i in range(len(rig.cameras))]
    _write(rig, path, notes, _tables(rig, keys, ANIPOSE, OPENCV_FORMS, nearest), "anipose")


def write_pose2sim(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write Pose2Sim's Calib.toml. Raises GtcalError without poses, or for a lens that it lacks unless ``nearest``."""
    keys = [_key(camera.name) for camera in rig.cameras]
    _write(rig, path, notes, _tables(rig, keys, POSE2SIM, (RADTAN4, KB4), nearest), "pose2sim")


def _write(rig: Rig, path: Path, notes: Sequence[str], tables: list[str], format_name: str) -> None:
    metadata = ["[metadata]", "adjusted = false", "error = 0.0", f'format = "{format_name}"', 'length_unit = "m"']
    write_text(path, "\n".join([*(f"# {note}" for note in notes), "", *tables, *metadata]) + "\n")


def _tables(rig: Rig, keys: Sequence[str], title: str, forms: Sequence[Form], nearest: bool) -> list[str]:
    """Every camera's lines. forms: with as many coefficients as the format's tools take."""
    lines = []
    for key, camera, camera_T_ref in zip(keys, rig.cameras, rig.poses(title).values(), strict=True):
        found = express(camera.camera, format_name=title, forms=forms, nearest=nearest)
        fx, fy, cx, cy = found.theta[:4]
        lines += [
            f"[{key}]  # {found.said(camera.camera)}",
            f"name = {quoted(camera.name)}",
            f"size = [{camera.image_size_px[0]}, {camera.image_size_px[1]}]",
            f"matrix = [{row_text([fx, 0, cx])}, {row_text([0, fy, cy])}, {row_text([0, 0, 1])}]",
            f"distortions = {row_text(found.theta[4 : found.form.n_free])}",
            f"rotation = {row_text(Rotation.from_matrix(camera_T_ref[:3, :3]).as_rotvec())}",
            f"translation = {row_text(camera_T_ref[:3, 3])}",
            f"fisheye = {'true' if found.model == KANNALA_BRANDT4 else 'false'}",
            "",
        ]
    return lines


def _document(path: Path) -> Field:
    return Field(path, "", load_toml(path, read_text(path)))


def _rig(document: Field, options: ReadOptions, length_m: float | None, unposed: str) -> Rig:
    tables = [(key, table) for key, table in document.items() if key not in _NO_CAMERAS]
    if not tables:
        raise document.error("there is no camera; expected tables with name, size, matrix, distortions")
    cameras = [_camera(key, table, options, length_m) for key, table in tables]
    if not unposed and any(camera.camera_T_ref is None for camera in cameras):
        unposed = "the file holds no rotation and translation for every camera"
        cameras = [with_pose(camera, None) for camera in cameras]
    return Rig(tuple(cameras), "world", "the world of the file", unposed)


def _camera(key: str, table: Field, options: ReadOptions, length_m: float | None) -> RigCamera:
    name = table["name"].text() if "name" in table else key
    size = table["size"].entries()
    if len(size) != 2:
        raise table["size"].error(f"has {len(size)} numbers; expected width and height")
    camera = rig_camera(table, name, _lens(table), image_size(table, size, options), options)
    if length_m is None or "rotation" not in table or "translation" not in table:
        return camera
    return with_pose(camera, _pose(table, length_m))


def _pose(table: Field, length_m: float) -> FloatArray:
    rotation = Rotation.from_rotvec(table["rotation"].numbers(3)).as_matrix()
    return rigid_from_matrix(rotation, length_m * table["translation"].numbers(3))


def _lens(table: Field) -> Lens:
    middle = focal_and_centre(table["matrix"])
    if "fisheye" in table and table["fisheye"].flag():
        return padded(KB4, np.concatenate([middle, table["distortions"].numbers(4)]))
    return opencv_pinhole(middle, table["distortions"].numbers(*OPENCV_COUNTS))


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else quoted(name)
