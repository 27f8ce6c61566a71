"""Project Aria's JSON of a device (CameraCalibrations), and HOT3D's two: camera_models.json and a clip's cameras.json.

Pixels: integer coordinates are pixel centres. Metres; T_Device_Camera takes coordinates in the camera to coordinates in
the device. The lens is Fisheye624 (FisheyeRadTanThinPrism): f cx cy k0..k5 p0 p1 s0..s3 with one focal length on Aria,
fx fy cx cy ... on Quest; with zero thin prism it is read as Fisheye62. Aria's own file states the images' sizes only
where it comes from an online calibration (ImageSizes), as gtcal's does; else they have to be given. The data sets of
the hand tracking toolkit use HOT3D's form with UmeTrack's lens, in UmeTrack's order.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, rigid_from_quaternion
from gtcal.camera_files.lenses import F62, F624, F624_ONE_FOCAL_LENGTH, KB4, PINHOLE, Expressed, Form, express
from gtcal.camera_files.rig import (
    Lens,
    ReadOptions,
    Rig,
    RigCamera,
    image_size,
    padded,
    rig_camera,
    with_pose,
)
from gtcal.camera_files.umetrack import from_umetrack
from gtcal.documents import load_document
from gtcal.files import write_text
from gtcal.recordings.trajectory import quaternions_from_poses

ARIA, HOT3D = "Project Aria's JSON", "HOT3D's camera_models.json"
_UNPOSED = "the file holds no T_Device_Camera"
_DEVICE = ("device", "the device")


def recognises_aria(document: object) -> bool:
    """Whether this is what the JSON of an Aria device looks like."""
    return isinstance(document, dict) and "CameraCalibrations" in document


def recognises_hot3d(document: object) -> bool:
    """Whether this is what either of HOT3D's files looks like."""
    entries = list(document.values()) if isinstance(document, dict) else document
    first = entries[0] if isinstance(entries, list) and entries else None
    if not isinstance(first, dict):
        return False
    return "projectionModelType" in first or "projection_model_type" in (first.get("calibration") or {})


def read_aria(path: Path, options: ReadOptions) -> Rig:
    """The cameras of an Aria device's JSON, in the device's frame.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = Field(path, "", load_document(path))
    entries = document["CameraCalibrations"].entries()
    sizes = document["ImageSizes"].entries() if "ImageSizes" in document else [None] * len(entries)
    if len(sizes) != len(entries):
        raise document["ImageSizes"].error(f"holds {len(sizes)} sizes for {len(entries)} cameras")
    cameras = [_aria_camera(entry, size, options) for entry, size in zip(entries, sizes, strict=True)]
    return Rig(tuple(cameras), *_DEVICE, "" if cameras[0].camera_T_ref is not None else _UNPOSED)


def write_aria(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write the JSON of an Aria device; the device is ref. Raises GtcalError without poses, or for a lens that is no
    Fisheye624 of one focal length unless ``nearest``."""
    poses = rig.poses(ARIA)
    document = {
        "made_by": list(notes),
        "CameraCalibrations": [_aria_fields(camera, poses[camera.name], nearest) for camera in rig.cameras],
        "ImageSizes": [list(camera.image_size_px) for camera in rig.cameras],
        "ImuCalibrations": [],
    }
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_hot3d(path: Path, options: ReadOptions) -> Rig:
    """The cameras of HOT3D's camera_models.json, or of one frame of a clip, in the device's frame.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = Field(path, "", load_document(path))
    named = document.items() if isinstance(document.value, dict) else [("", entry) for entry in document.entries()]
    cameras = [_hot3d_camera(key, entry["calibration"] if key else entry, options) for key, entry in named]
    if not cameras:
        raise document.error("there is no camera; expected entries with projectionModelType or calibration")
    return Rig(tuple(cameras), *_DEVICE, "" if cameras[0].camera_T_ref is not None else _UNPOSED)


def write_hot3d(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write HOT3D's camera_models.json, Fisheye624 with two focal lengths; the device is ref. Raises GtcalError without
    poses, or for a lens that is no Fisheye624 unless ``nearest``."""
    poses = rig.poses(HOT3D)
    document = [_hot3d_fields(camera, poses[camera.name], nearest) | {"made_by": list(notes)} for camera in rig.cameras]
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def fisheye624(values: FloatArray) -> Expressed:
    """Fisheye624's 15 or 16 parameters; Fisheye62 where the thin prism is zero."""
    theta = np.r_[values[0], values] if len(values) == 15 else values
    return Expressed(F624, theta) if theta[12:].any() else Expressed(F62, theta[:12])


def _aria_fields(camera: RigCamera, camera_T_ref: FloatArray, nearest: bool) -> dict[str, object]:
    found = express(camera.camera, format_name=ARIA, forms=(F624_ONE_FOCAL_LENGTH,), nearest=nearest)
    quat_wxyz, translation_m = _quaternion_and_translation(inverse(camera_T_ref))
    return {
        "Calibrated": True,
        "Label": camera.name,
        "lens_off_at_most_px": found.max_px,
        "Projection": {
            "Name": "FisheyeRadTanThinPrism",
            "Description": "f cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3; integer pixel coordinates are pixel centres",
            "Params": np.delete(found.theta, 1).tolist(),
        },
        "SerialNumber": "",
        "T_Device_Camera": {"Translation": translation_m, "UnitQuaternion": [quat_wxyz[0], quat_wxyz[1:]]},
    }


def _hot3d_fields(camera: RigCamera, camera_T_ref: FloatArray, nearest: bool) -> dict[str, object]:
    found = express(camera.camera, format_name=HOT3D, forms=(F624,), nearest=nearest)
    quat_wxyz, translation_m = _quaternion_and_translation(inverse(camera_T_ref))
    return {
        "label": camera.name,
        "lens_off_at_most_px": found.max_px,
        "imageWidth": camera.image_size_px[0],
        "imageHeight": camera.image_size_px[1],
        "projectionModelType": "CameraModelType.FISHEYE624",
        "projectionParams": found.theta.tolist(),
        "T_Device_Camera": {"quaternion_wxyz": quat_wxyz, "translation_xyz": translation_m},
        "maxSolidAngle": camera.camera.model.max_angle_rad(camera.camera.theta),
        "serialNumber": "",
    }


def _quaternion_and_translation(a_T_b: FloatArray) -> tuple[list[float], list[float]]:
    return quaternions_from_poses(a_T_b[None], "wxyz")[0].tolist(), a_T_b[:3, 3].tolist()


def _aria_camera(entry: Field, size: Field | None, options: ReadOptions) -> RigCamera:
    name = entry["Label"].text()
    if "Calibrated" in entry and not entry["Calibrated"].flag():
        raise entry["Calibrated"].error(f"is false: the file holds no calibration of {name!r}")
    sides = None if size is None else size.entries()
    if sides is not None and len(sides) != 2:
        raise entry.error("its ImageSizes are no width and height")
    lens = _lens(entry["Projection"]["Name"], entry["Projection"]["Params"])
    camera = rig_camera(entry, name, lens, image_size(entry, sides, options), options)
    if "T_Device_Camera" not in entry:
        return camera
    pose = entry["T_Device_Camera"]
    quat = pose["UnitQuaternion"].entries()
    if len(quat) != 2:
        raise pose["UnitQuaternion"].error("expected [w, [x, y, z]]")
    wxyz = Field(pose.path, f"{pose.where}.UnitQuaternion", [quat[0].number(), *quat[1].numbers(3).tolist()])
    device_T_camera = rigid_from_quaternion(wxyz.unit_quaternion(), pose["Translation"].numbers(3))
    return with_pose(camera, inverse(device_T_camera))


def _hot3d_camera(key: str, entry: Field, options: ReadOptions) -> RigCamera:
    name = entry["label"].text() if "label" in entry or not key else key
    lens = _lens(entry.first("projectionModelType", "projection_model_type"), _params(entry))
    sides = [entry.first("imageWidth", "image_width"), entry.first("imageHeight", "image_height")]
    camera = rig_camera(entry, name, lens, image_size(entry, sides, options), options)
    pose = entry.get("T_Device_Camera", "T_device_from_camera")
    if pose is None:
        return camera
    quat_wxyz, translation_m = pose["quaternion_wxyz"].unit_quaternion(), pose["translation_xyz"].numbers(3)
    return with_pose(camera, inverse(rigid_from_quaternion(quat_wxyz, translation_m)))


def _params(entry: Field) -> Field:
    return entry.first("projectionParams", "projection_params")


_LENSES: dict[str, tuple[int, ...]] = {
    "fisheye624": (15, 16),
    "fisheye62": (11, 12),
    "kannalabrandtk3": (8,),
    "linear": (4,),
    "pinholeplane": (4,),
    "oculusvisionfisheye62": (12,),
}
"""By a lens's name, letters and digits only: how many parameters it has."""
_OTHER_NAMES = {"fisheyeradtanthinprism": "fisheye624", "oculusvisionfisheye624": "fisheye624"}


def _lens(name: Field, params: Field) -> Lens:
    plain = "".join(letter for letter in name.text().split(".")[-1].split(":")[0].lower() if letter.isalnum())
    plain = _OTHER_NAMES.get(plain, plain)
    if plain not in _LENSES:
        raise name.error(
            f"is {name.text()!r}, and gtcal has no such lens; expected Fisheye624, Fisheye62, KannalaBrandtK3 or Linear"
        )
    values = params.numbers(*_LENSES[plain])
    if plain == "fisheye624":
        return fisheye624(values)
    if plain == "fisheye62":
        return Expressed(F62, np.r_[values[0], values] if len(values) == 11 else values)
    if plain == "oculusvisionfisheye62":
        return Expressed(F62, np.concatenate([values[:4], from_umetrack(values[4:])]))
    form: Form = KB4 if plain == "kannalabrandtk3" else PINHOLE
    return padded(form, values)
