"""basalt's calibration JSON: value0 with, by camera, T_imu_cam, intrinsics (camera_type and named numbers), resolution.

Pixels: integer coordinates are pixel centres. Metres. T_imu_cam takes coordinates in the camera to coordinates in the
IMU. The lens is ds (xi alpha), eucm (alpha beta), ucm (alpha: an eucm whose beta is 1), kb4 (k1..k4), pinhole, or
pinhole-radtan8 (k1 k2 p1 p2 k3 k4 k5 k6). Cameras have no names there; gtcal writes them, and which frame its poses are
in, in fields that basalt passes over.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, rigid_from_quaternion
from gtcal.camera_files.lenses import DS, EUCM, KB4, PINHOLE, RATIONAL, Expressed, Form, express
from gtcal.camera_files.rig import Lens, ReadOptions, Rig, RigCamera, image_size, rig_camera, with_pose
from gtcal.documents import load_document
from gtcal.files import write_text
from gtcal.recordings.trajectory import quaternions_from_poses

TITLE = "basalt's calibration JSON"
_NAMES: dict[str, Form] = {"pinhole": PINHOLE, "pinhole-radtan8": RATIONAL, "kb4": KB4, "ds": DS, "eucm": EUCM}
_POSITION, _QUATERNION = ("px", "py", "pz"), ("qw", "qx", "qy", "qz")
_UNPOSED = "the file holds no T_imu_cam"


def recognises(document: object) -> bool:
    """Whether this is what a calibration of basalt's looks like."""
    value = document.get("value0") if isinstance(document, dict) else None
    intrinsics = value.get("intrinsics") if isinstance(value, dict) else None
    return isinstance(intrinsics, list) and any(isinstance(i, dict) and "camera_type" in i for i in intrinsics)


def read_basalt(path: Path, options: ReadOptions) -> Rig:
    """The cameras of a calibration of basalt's, cam0, cam1, ... in the IMU's frame; where gtcal wrote it, by their
    names and in ref.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = Field(path, "", load_document(path))["value0"]
    lenses, sizes = document["intrinsics"].entries(), document["resolution"].entries()
    poses = document["T_imu_cam"].entries() if "T_imu_cam" in document else [None] * len(lenses)
    names = document["names"].entries() if "names" in document else [None] * len(lenses)
    if not len(lenses) == len(sizes) == len(poses) == len(names):
        raise document.error(
            f"holds {len(lenses)} intrinsics, {len(sizes)} resolutions, {len(poses)} T_imu_cam and {len(names)} names"
        )
    cameras = [
        _camera(f"cam{i}" if name is None else name.text(), lens, size, pose, options)
        for i, (name, lens, size, pose) in enumerate(zip(names, lenses, sizes, poses, strict=True))
    ]
    ref = ("imu", "the IMU") if "ref" not in document else ("ref", "ref, as the file has it")
    return Rig(tuple(cameras), *ref, "" if cameras[0].camera_T_ref is not None else _UNPOSED)


def write_basalt(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write a calibration of basalt's; its IMU is ref. Raises GtcalError without poses, or for a lens that it lacks
    unless ``nearest``."""
    poses = rig.poses(TITLE)
    document = {
        "made_by": list(notes),
        "names": [camera.name for camera in rig.cameras],
        "ref": rig.ref_words,
        "T_imu_cam": [_pose_fields(inverse(pose)) for pose in poses.values()],
        "intrinsics": [_lens_fields(camera, nearest) for camera in rig.cameras],
        "resolution": [list(camera.image_size_px) for camera in rig.cameras],
    }
    write_text(path, json.dumps({"value0": document}, indent=1, allow_nan=False) + "\n")


def _pose_fields(imu_T_camera: FloatArray) -> dict[str, float]:
    quat_wxyz = quaternions_from_poses(imu_T_camera[None], "wxyz")[0].tolist()
    return dict(zip((*_POSITION, *_QUATERNION), [*imu_T_camera[:3, 3].tolist(), *quat_wxyz], strict=True))


def _lens_fields(camera: RigCamera, nearest: bool) -> dict[str, object]:
    found = express(camera.camera, format_name=TITLE, forms=tuple(_NAMES.values()), nearest=nearest)
    name = next(name for name, form in _NAMES.items() if form == found.form)
    numbers = dict(zip(_parameters(found.form), found.theta.tolist(), strict=False))
    if found.form == RATIONAL:
        numbers["rpmax"] = 0.0  # basalt's radius of validity; zero for none
    return {"camera_type": name, "lens_off_at_most_px": found.max_px, "intrinsics": numbers}


def _parameters(form: Form) -> tuple[str, ...]:
    return form.model.parameter_names[: form.n_free]


def _camera(name: str, lens: Field, size: Field, pose: Field | None, options: ReadOptions) -> RigCamera:
    sides = size.entries()
    if len(sides) != 2:
        raise size.error(f"has {len(sides)} numbers; expected width and height")
    camera = rig_camera(lens, name, _lens(lens), image_size(size, sides, options), options)
    if pose is None:
        return camera
    quat = Field(pose.path, pose.where, [pose[key].number() for key in _QUATERNION]).unit_quaternion()
    position_m = np.array([pose[key].number() for key in _POSITION])
    return with_pose(camera, inverse(rigid_from_quaternion(quat, position_m)))


def _lens(entry: Field) -> Lens:
    model, numbers = entry["camera_type"], entry["intrinsics"]
    name = "eucm" if model.text() == "ucm" else model.text()
    if name not in _NAMES:
        raise model.error(f"is {name!r}, and gtcal has no such lens; expected one of {', '.join([*_NAMES, 'ucm'])}")
    form = _NAMES[name]
    theta = np.zeros(form.model.n_parameters)
    for i, parameter in enumerate(_parameters(form)):
        of_ucm = model.text() == "ucm" and parameter == "beta"
        theta[i] = 1.0 if of_ucm else numbers[parameter].number()
    return Expressed(form, theta)
