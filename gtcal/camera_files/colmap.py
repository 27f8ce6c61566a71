"""COLMAP: a folder with a sparse model in text (cameras.txt, rigs.txt, ...) and rig_config.json; either file alone too.

COLMAP's pixel centres are half a pixel away: the first pixel's is (0.5, 0.5) there and (0, 0) here, so that cx and cy
are 0.5 larger in its files. cam_from_rig takes coordinates in the rig to coordinates in the camera; the rig's frame is
its first camera's. COLMAP knows no unit of length: gtcal writes metres, and says so, with the first camera's pose in
ref, in fields of rig_config.json that COLMAP passes over.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.camera_files.aria import fisheye624
from gtcal.camera_files.fields import Field, float_text, rigid_from_quaternion
from gtcal.camera_files.lenses import (
    EUCM,
    F624,
    KB4,
    PINHOLE,
    RADTAN4,
    RADTAN5,
    RATIONAL,
    Expressed,
    ForeignLens,
    express,
)
from gtcal.camera_files.rig import (
    OUR_PIXELS,
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
from gtcal.documents import load_document, read_text
from gtcal.errors import GtcalError
from gtcal.files import write_folder
from gtcal.recordings.trajectory import quaternions_from_poses

TITLE = "COLMAP"
CAMERAS, RIG_CONFIG = "cameras.txt", "rig_config.json"
_HALF_PX = 0.5
_UNPOSED = "a COLMAP rig states no unit of length; give length_unit"

# How gtcal's lenses are written, the simplest first, and the number of parameters there.
_FORMS = {
    PINHOLE: ("PINHOLE", 4),
    RADTAN4: ("OPENCV", 8),
    RADTAN5: ("FULL_OPENCV", 12),
    RATIONAL: ("FULL_OPENCV", 12),
    KB4: ("OPENCV_FISHEYE", 8),
    F624: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    EUCM: ("EUCM", 6),
}
# By model: the number of focal lengths and of coefficients.
_MODELS = {
    "SIMPLE_PINHOLE": (1, 0),
    "PINHOLE": (2, 0),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (1, 2),
    "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8),
    "SIMPLE_FISHEYE": (1, 0),
    "FISHEYE": (2, 0),
    "SIMPLE_RADIAL_FISHEYE": (1, 1),
    "RADIAL_FISHEYE": (1, 2),
    "OPENCV_FISHEYE": (2, 4),
    "THIN_PRISM_FISHEYE": (2, 8),
    "RAD_TAN_THIN_PRISM_FISHEYE": (2, 12),
    "FOV": (2, 1),
    "EUCM": (2, 2),
}


def recognises_rig(document: object) -> bool:
    """Whether this is what a rig_config.json looks like."""
    first = document[0] if isinstance(document, list) and document else None
    cameras = first.get("cameras") if isinstance(first, dict) else None
    return isinstance(cameras, list) and bool(cameras) and isinstance(cameras[0], dict) and "image_prefix" in cameras[0]


def recognises_cameras(start: str) -> bool:
    """Whether a text file that begins like this is a cameras.txt."""
    rows = [line.split() for line in start.splitlines() if line.strip() and not line.startswith("#")]
    return bool(rows) and len(rows[0]) >= 4 and rows[0][0].isdigit() and rows[0][1].isupper() and rows[0][2].isdigit()


def read_colmap(path: Path, options: ReadOptions) -> Rig:
    """The cameras of a folder with cameras.txt, of a cameras.txt, or of a rig_config.json. They are named as the rig's
    image prefixes, else by their id; in ref where gtcal wrote the rig, else in the first camera's frame, and without
    poses where no unit of length is stated.

    Raises GtcalError naming file, line and field for what is missing, wrong or no lens of gtcal's."""
    folder = path if path.is_dir() else path.parent
    if path.is_dir() and not (path / CAMERAS).is_file():
        raise GtcalError(f"{path}: there is no {CAMERAS}; COLMAP writes one with --output_type TXT")
    config = path if path.is_file() and path.suffix.lower() == ".json" else folder / RIG_CONFIG
    if path.is_file() and config != path:
        return _unposed(_read_cameras(path, options))
    known = _read_cameras(folder / CAMERAS, options) if (folder / CAMERAS).is_file() else {}
    if not config.is_file():
        return _unposed(known)
    return _read_rig(Field(config, "", load_document(config)), known, options)


def write_colmap(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write the folder. Fisheye62 and Fisheye624 are held as RAD_TAN_THIN_PRISM_FISHEYE, which only newer versions of
    COLMAP know, as EUCM is. Raises GtcalError without poses, or for a lens that it lacks unless ``nearest``."""
    poses, names = rig.poses(TITLE), rig.file_names()
    first_T_ref = poses[rig.cameras[0].name]
    notes = [note.replace(OUR_PIXELS, "the first pixel's centre is (0.5, 0.5), as COLMAP has it") for note in notes]
    comments = "".join(f"# {note}\n" for note in notes)
    found = [express(c.camera, format_name=TITLE, forms=tuple(_FORMS), nearest=nearest) for c in rig.cameras]
    placed = [_quaternion_and_translation(pose @ inverse(first_T_ref)) for pose in poses.values()]
    cameras = [_cameras_lines(i, *parts) for i, parts in enumerate(zip(rig.cameras, found, strict=True), start=1)]
    entries = [
        _config_entry(i, f"{names[camera.name]}/", lens, pose)
        for i, (camera, lens, pose) in enumerate(zip(rig.cameras, found, placed, strict=True), start=1)
    ]
    sensors = [f" CAMERA {i} 1 {_row([*quat, *t])}" for i, (quat, t) in enumerate(placed, start=1) if i > 1]
    rigs = f"1 {len(cameras)} CAMERA 1{''.join(sensors)}"
    config = {"cameras": entries, "length_unit": "m", "ref_camera_T_ref": first_T_ref.tolist(), "made_by": notes}
    write_folder(
        path,
        {
            CAMERAS: f"{comments}# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n{''.join(cameras)}",
            "rigs.txt": f"{comments}# RIG_ID NUM_SENSORS REF_SENSOR SENSORS[]\n{rigs}\n",
            "frames.txt": "# no frames\n",
            "images.txt": "# no images\n",
            "points3D.txt": "# no points\n",
            RIG_CONFIG: json.dumps([config], indent=1, allow_nan=False) + "\n",
        },
    )


def _cameras_lines(i: int, camera: RigCamera, found: Expressed) -> str:
    """Of cameras.txt."""
    model, params = _written(found)
    width, height = camera.image_size_px
    return f"# {camera.name}: {found.said(camera.camera)}\n{i} {model} {width} {height} {_row(params)}\n"


def _config_entry(i: int, prefix: str, found: Expressed, placed: tuple[list[float], list[float]]) -> dict[str, object]:
    """Of rig_config.json."""
    model, params = _written(found)
    pose = (
        {"cam_from_rig_rotation": placed[0], "cam_from_rig_translation": placed[1]} if i > 1 else {"ref_sensor": True}
    )
    return {"image_prefix": prefix, **pose, "camera_model_name": model, "camera_params": params, "camera_id": i}


def _quaternion_and_translation(a_T_b: FloatArray) -> tuple[list[float], list[float]]:
    return quaternions_from_poses(a_T_b[None], "wxyz")[0].tolist(), a_T_b[:3, 3].tolist()


def _row(values: Sequence[float]) -> str:
    return " ".join(map(float_text, values))


def _written(found: Expressed) -> tuple[str, list[float]]:
    model, n_parameters = _FORMS[found.form]
    params = np.concatenate([found.theta, np.zeros(n_parameters)])[:n_parameters]
    params[2:4] += _HALF_PX
    return model, params.tolist()


def _unposed(known: dict[int, RigCamera]) -> Rig:
    return Rig(tuple(known.values()), "rig", "the rig", f"there is no {RIG_CONFIG}")


def _read_cameras(path: Path, options: ReadOptions) -> dict[int, RigCamera]:
    """By camera id."""
    cameras = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        words = line.replace(",", " ").split()
        row = Field(path, f"line {number}", words)
        if len(words) < 5:
            raise row.error(f"has {len(words)} words; expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        numbers = Field(path, f"line {number}", [_number(row, word) for word in [words[0], *words[2:]]])
        camera_id, *sides = (Field(path, row.where, value).size() for value in numbers.value[:3])
        lens = read_lens(Field(path, row.where, words[1]), Field(path, row.where, numbers.value[3:]))
        size = image_size(row, [Field(path, row.where, side) for side in sides], options)
        if camera_id in cameras:
            raise row.error(f"there is a camera {camera_id} already")
        cameras[camera_id] = rig_camera(row, str(camera_id), lens, size, options)
    if not cameras:
        raise GtcalError(f"{path}: there is no camera in it")
    return cameras


def _number(row: Field, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise row.error(f"{word!r} is no number; expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]") from None


def _read_rig(document: Field, known: dict[int, RigCamera], options: ReadOptions) -> Rig:
    rigs = document.entries()
    if len(rigs) != 1:
        raise document.error(f"holds {len(rigs)} rigs; keep one")
    entries = rigs[0]["cameras"].entries()
    cameras = [_rig_config_camera(entry, known, options) for entry in entries]
    length_m = options.length_m(rigs[0].get("length_unit"))
    if length_m is None:
        return Rig(tuple(cameras), "rig", "the rig", _UNPOSED)
    ours = "ref_camera_T_ref" in rigs[0]
    rig_T_ref = rigs[0]["ref_camera_T_ref"].rigid() if ours else np.eye(4)
    poses = [_cam_from_rig(entry, length_m) for entry in entries]
    if any(pose is None for pose in poses):
        return Rig(tuple(cameras), "rig", "the rig", "the rig_config.json has no cam_from_rig for every camera")
    placed = [
        with_pose(camera, pose @ rig_T_ref) for camera, pose in zip(cameras, poses, strict=True) if pose is not None
    ]
    ref = ("ref", "ref, as the file has it") if ours else ("rig", "the rig, its first camera")
    return Rig(tuple(placed), *ref)


def _cam_from_rig(entry: Field, length_m: float) -> FloatArray | None:
    if "ref_sensor" in entry and entry["ref_sensor"].flag():
        return np.eye(4)
    if "cam_from_rig_rotation" not in entry and "cam_from_rig_translation" not in entry:
        return None
    quat_wxyz = entry["cam_from_rig_rotation"].unit_quaternion()
    return rigid_from_quaternion(quat_wxyz, length_m * entry["cam_from_rig_translation"].numbers(3))


def _rig_config_camera(entry: Field, known: dict[int, RigCamera], options: ReadOptions) -> RigCamera:
    prefix = entry["image_prefix"]
    name = prefix.text().rstrip("/").split("/")[-1]
    listed = known.get(entry["camera_id"].size()) if "camera_id" in entry else None
    if "camera_params" in entry:
        lens = read_lens(entry["camera_model_name"], entry["camera_params"])
        stated = None if listed is None else [Field(entry.path, entry.where, side) for side in listed.image_size_px]
        return rig_camera(entry, name, lens, image_size(entry, stated, options), options)
    if listed is None:
        raise entry.error(f"has neither camera_params nor a camera_id of {CAMERAS}")
    return replace(listed, camera=replace(listed.camera, name=name))


def read_lens(model: Field, params: Field) -> Lens:
    """A lens of COLMAP's, its half pixel taken off. Raises GtcalError for one that gtcal has nothing near to."""
    if model.text() not in _MODELS:
        raise model.error(f"{model.text()!r} is no lens that gtcal has; expected one of {', '.join(_MODELS)}")
    n_focal, n_coefficients = _MODELS[model.text()]
    values = params.numbers(n_focal + 2 + n_coefficients)
    focal, centre = values[:n_focal], values[n_focal : n_focal + 2]
    middle = np.concatenate([np.broadcast_to(focal, 2), centre - _HALF_PX])
    return _lens(model.text(), middle, values[n_focal + 2 :])


def _lens(model: str, middle: FloatArray, coefficients: FloatArray) -> Lens:
    if model == "RAD_TAN_THIN_PRISM_FISHEYE":
        return fisheye624(np.concatenate([middle, coefficients]))
    if model == "THIN_PRISM_FISHEYE":
        return _thin_prism(middle, coefficients)
    if model == "EUCM":
        return padded(EUCM, np.concatenate([middle, coefficients]))
    if model == "FOV":
        return _fov(middle, float(coefficients[0]))
    if "FISHEYE" in model:
        return padded(KB4, np.concatenate([middle, coefficients]))
    if model in ("SIMPLE_RADIAL", "RADIAL"):
        return padded(RADTAN5, np.concatenate([middle, coefficients]))
    return opencv_pinhole(middle, coefficients)


def _thin_prism(middle: FloatArray, coefficients: FloatArray) -> Lens:
    """Its tangential and thin-prism terms are of the undistorted coordinates, Fisheye624's of the distorted ones."""
    k1, k2, p1, p2, k3, k4, sx, sy = coefficients
    radial = np.concatenate([middle, [k1, k2, k3, k4]])
    if not any((p1, p2, sx, sy)):
        return padded(KB4, radial)

    def project(bearings: FloatArray) -> FloatArray:
        r = np.hypot(bearings[:, 0], bearings[:, 1])
        u, v = np.arctan2(r, bearings[:, 2]) / r * bearings[:, :2].T
        w = u * u + v * v
        stretched = 1 + w * (k1 + w * (k2 + w * (k3 + w * k4)))
        x = u * stretched + 2 * p1 * u * v + p2 * (w + 2 * u * u) + sx * w
        y = v * stretched + 2 * p2 * u * v + p1 * (w + 2 * v * v) + sy * w
        return middle[:2] * np.stack([x, y], axis=1) + middle[2:]

    return ForeignLens("COLMAP's THIN_PRISM_FISHEYE", F624, np.concatenate([radial, np.zeros(8)]), project)


def _fov(middle: FloatArray, omega: float) -> Lens:
    def project(bearings: FloatArray) -> FloatArray:
        r = np.hypot(bearings[:, 0], bearings[:, 1]) / bearings[:, 2]
        scale = np.arctan(2 * r * np.tan(omega / 2)) / (omega * r)
        return middle[:2] * (scale * bearings[:, :2].T / bearings[:, 2]).T + middle[2:]

    if not omega:
        return padded(PINHOLE, middle)
    return ForeignLens("COLMAP's FOV", RADTAN5, np.concatenate([middle, np.zeros(5)]), project)
