"""UmeTrack's JSON: {"cameras": [...]} or one {"Camera": {...}}, with ImageSizeX, ImageSizeY, DistortionModel, fx, ...

Pixels: integer coordinates are pixel centres. FishEye62 has its own order, k1 k2 k3 k4 p1 p2 k5 k6, which are k0..k3 p0
p1 k4 k5 here; PinholePlane has no distortion. The data set keeps the cameras' poses per frame in the world, so that a
rig has none there; gtcal writes camera_T_ref, in m, in a field that UmeTrack's reader passes over.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field
from gtcal.camera_files.lenses import F62, PINHOLE, Expressed, express
from gtcal.camera_files.rig import Lens, ReadOptions, Rig, RigCamera, image_size, padded, rig_camera, with_pose
from gtcal.documents import load_document
from gtcal.files import write_text

TITLE = "UmeTrack's JSON"
ORDER = ("k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6")
_FROM_GTCAL = [0, 1, 2, 3, 6, 7, 4, 5]  # of k0..k5 p0 p1, in UmeTrack's order
_FOCAL_AND_CENTRE = ("fx", "fy", "cx", "cy")


def from_umetrack(coefficients: FloatArray) -> FloatArray:
    """k0..k5 p0 p1 (8,) of coefficients in UmeTrack's order (8,)."""
    return coefficients[np.argsort(_FROM_GTCAL)]


def recognises(document: object) -> bool:
    """Whether this is what UmeTrack's JSON looks like."""
    if not isinstance(document, dict):
        return False
    cameras = document.get("cameras")
    first = cameras[0] if isinstance(cameras, list) and cameras else document
    inner = first.get("Camera", first) if isinstance(first, dict) else None
    return isinstance(inner, dict) and "DistortionModel" in inner


def read_umetrack(path: Path, options: ReadOptions) -> Rig:
    """The cameras of UmeTrack's JSON, named cam0, cam1, ... where they have no name; in ref where gtcal wrote it.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = Field(path, "", load_document(path))
    entries = document["cameras"].entries() if "cameras" in document else [document]
    cameras = [_camera(i, entry.get("Camera") or entry, options) for i, entry in enumerate(entries)]
    unposed = "" if all(camera.camera_T_ref is not None for camera in cameras) else "UmeTrack keeps poses per frame"
    return Rig(tuple(cameras), "ref", "ref, as the file has it", unposed)


def write_umetrack(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write UmeTrack's JSON. Raises GtcalError for a lens that it doesn't know unless ``nearest``."""
    document = {"made_by": list(notes), "cameras": [{"Camera": _fields(camera, nearest)} for camera in rig.cameras]}
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def _fields(camera: RigCamera, nearest: bool) -> dict[str, object]:
    found = express(camera.camera, format_name=TITLE, forms=(PINHOLE, F62), nearest=nearest)
    fisheye = found.form == F62
    coefficients = found.theta[4:][_FROM_GTCAL].tolist() if fisheye else []
    pose = camera.camera_T_ref
    return {
        "name": camera.name,
        "lens_off_at_most_px": found.max_px,
        "ImageSizeX": camera.image_size_px[0],
        "ImageSizeY": camera.image_size_px[1],
        "DistortionModel": "FishEye62" if fisheye else "PinholePlane",
        **dict(zip(_FOCAL_AND_CENTRE, found.theta[:4].tolist(), strict=True)),
        **dict(zip(ORDER, coefficients, strict=False)),
        **({} if pose is None else {"camera_T_ref": pose.tolist()}),
    }


def _camera(i: int, entry: Field, options: ReadOptions) -> RigCamera:
    name = entry["name"].text() if "name" in entry else f"cam{i}"
    size = image_size(entry, [entry["ImageSizeX"], entry["ImageSizeY"]], options)
    camera = rig_camera(entry, name, _lens(entry), size, options)
    return with_pose(camera, entry["camera_T_ref"].rigid()) if "camera_T_ref" in entry else camera


def _lens(entry: Field) -> Lens:
    model = entry["DistortionModel"]
    middle = np.array([entry[name].number() for name in _FOCAL_AND_CENTRE])
    if model.text() == "PinholePlane":
        return padded(PINHOLE, middle)
    if model.text() != "FishEye62":
        raise model.error(f"is {model.text()!r}, and gtcal has no such lens; expected FishEye62 or PinholePlane")
    coefficients = np.array([entry[name].number() for name in ORDER])
    return Expressed(F62, np.concatenate([middle, from_umetrack(coefficients)]))
