"""Kalibr's camchain: YAML, one entry per camera, cam0, cam1, ...

Pixels: integer coordinates are pixel centres. Metres. The lens is pinhole (fu fv pu pv) with radtan (k1 k2 p1 p2) or
equidistant (k1..k4), ds (xi alpha fu fv pu pv), eucm (alpha beta fu fv pu pv), or omni (xi fu fv pu pv) with radtan.
T_cn_cnm1 takes coordinates in the camera before to coordinates in this one, T_cam_imu coordinates in the IMU to
coordinates in the camera. What gtcal writes says beside them, in fields that Kalibr doesn't read, the camera's name and
its camera_T_ref.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, quoted, row_text
from gtcal.camera_files.lenses import DS, EUCM, KB4, OMNI, RADTAN4, Expressed, Form, express
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera, image_size, rig_camera, with_pose
from gtcal.documents import load_document
from gtcal.files import write_text

TITLE = "Kalibr's camchain"
# Chains are printed with eight decimals or more.
_SAME_POSE = 1e-5


@dataclass(frozen=True)
class _Written:
    """How a lens stands in a camchain. intrinsics, coefficients: columns of theta."""

    form: Form
    camera_model: str
    distortion_model: str
    intrinsics: tuple[int, ...]
    coefficients: tuple[int, ...]


_LENSES = (
    _Written(RADTAN4, "pinhole", "radtan", (0, 1, 2, 3), (4, 5, 6, 7)),
    _Written(KB4, "pinhole", "equidistant", (0, 1, 2, 3), (4, 5, 6, 7)),
    _Written(DS, "ds", "none", (4, 5, 0, 1, 2, 3), ()),
    _Written(EUCM, "eucm", "none", (4, 5, 0, 1, 2, 3), ()),
    _Written(OMNI, "omni", "radtan", (8, 0, 1, 2, 3), (4, 5, 6, 7)),
)
_OTHER_NAMES = {"radial-tangential": "radtan"}


def recognises(document: object) -> bool:
    """Whether this is what a camchain looks like."""
    return isinstance(document, dict) and any(
        isinstance(entry, dict) and "camera_model" in entry and "intrinsics" in entry for entry in document.values()
    )


def read_kalibr(path: Path, options: ReadOptions) -> Rig:
    """The cameras of a camchain, in the IMU's frame where T_cam_imu is given, else in the first camera's; where gtcal
    wrote it, in ref.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    document = Field(path, "", load_document(path))
    entries = [(key, entry) for key, entry in document.items() if isinstance(entry.value, dict)]
    if not entries:
        raise document.error("there is no camera; expected cam0, cam1, ... with camera_model and intrinsics")
    cameras = [_camera(key, entry, options) for key, entry in entries]
    ref, words, poses = _poses([entry for _, entry in entries], [camera.name for camera in cameras])
    unposed = "" if poses else "the chain has no T_cn_cnm1"
    placed = [with_pose(camera, poses[i] if poses else None) for i, camera in enumerate(cameras)]
    return Rig(tuple(placed), ref, words, unposed)


def write_kalibr(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write a camchain. Raises GtcalError for a lens that Kalibr doesn't know unless ``nearest``."""
    lines = [f"# {note}" for note in notes]
    lines.append("# T_cn_cnm1 takes coordinates in the camera before to coordinates in this one")
    previous: FloatArray | None = None
    for i, camera in enumerate(rig.cameras):
        lines += _camera_lines(i, camera, nearest)
        pose = camera.camera_T_ref
        if pose is not None and previous is not None:
            lines += ["  T_cn_cnm1:", *(f"  - {row_text(row)}" for row in pose @ inverse(previous))]
        if pose is not None:
            lines += ["  camera_T_ref:", *(f"  - {row_text(row)}" for row in pose)]
        previous = pose
    write_text(path, "\n".join(lines) + "\n")


def _camera_lines(i: int, camera: RigCamera, nearest: bool) -> list[str]:
    found = express(camera.camera, format_name=TITLE, forms=[lens.form for lens in _LENSES], nearest=nearest)
    written = next(lens for lens in _LENSES if lens.form == found.form)
    return [
        f"cam{i}:  # {found.said(camera.camera)}",
        f"  name: {quoted(camera.name)}",
        f"  camera_model: {written.camera_model}",
        f"  distortion_model: {written.distortion_model}",
        f"  intrinsics: {row_text(found.theta[list(written.intrinsics)])}",
        f"  distortion_coeffs: {row_text(found.theta[list(written.coefficients)])}",
        f"  resolution: [{camera.image_size_px[0]}, {camera.image_size_px[1]}]",
        f"  rostopic: {quoted(f'/{camera.name}/image_raw')}",
    ]


def _camera(key: str, entry: Field, options: ReadOptions) -> RigCamera:
    name = entry["name"].text() if "name" in entry else key
    resolution = entry.get("resolution")
    stated = None if resolution is None else resolution.entries()
    if stated is not None and len(stated) != 2:
        raise entry["resolution"].error(f"has {len(stated)} numbers; expected width and height")
    return rig_camera(entry, name, lens_of(entry), image_size(entry, stated, options), options)


def lens_of(entry: Field) -> Expressed:
    """The lens of a block like those of a camchain, or of ASL's sensor.yaml, which spells some words out.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    model, distortion = entry["camera_model"], entry["distortion_model"]
    stated = _OTHER_NAMES.get(distortion.text(), distortion.text())
    of_model = [lens for lens in _LENSES if lens.camera_model == model.text()]
    if not of_model:
        known = ", ".join(dict.fromkeys(lens.camera_model for lens in _LENSES))
        raise model.error(f"is {model.text()!r}, and gtcal has no such lens; expected one of {known}")
    found = next((lens for lens in of_model if stated in (lens.distortion_model, "none")), None)
    if found is None:
        known = ", ".join(dict.fromkeys([*(lens.distortion_model for lens in of_model), "none"]))
        raise distortion.error(f"is {distortion.text()!r}, and gtcal has no such lens; expected one of {known}")
    theta = np.zeros(found.form.model.n_parameters)
    theta[list(found.intrinsics)] = entry["intrinsics"].numbers(len(found.intrinsics))
    if stated != "none":
        coefficients = entry.first("distortion_coeffs", "distortion_coefficients")
        theta[list(found.coefficients)] = coefficients.numbers(len(found.coefficients))
    return Expressed(found.form, theta)


def _poses(entries: Sequence[Field], names: Sequence[str]) -> tuple[str, str, list[FloatArray]]:
    """The frame that the cameras are in, its description, and the poses; none where the chain is not linked."""
    for field, ref, words in (("camera_T_ref", "ref", "ref, as the file has it"), ("T_cam_imu", "imu", "the IMU")):
        if field in entries[0] and (poses := _chain(entries, entries[0][field].rigid(), field)):
            return ref, words, poses
    linked = _chain(entries, np.eye(4), "T_cn_cnm1") if len(entries) > 1 else []
    return "first_camera", f"the camera {names[0]!r}", linked


def _chain(entries: Sequence[Field], first: FloatArray, field: str) -> list[FloatArray]:
    """Every camera's pose: as stated in the field, else from the camera before; none where a link is missing."""
    poses = [first]
    for entry in entries[1:]:
        step = entry.get("T_cn_cnm1")
        stated = entry[field].rigid() if field in entry and field != "T_cn_cnm1" else None
        linked = stated if step is None else step.rigid() @ poses[-1]
        if linked is None:
            return []
        if step is not None and stated is not None and np.abs(linked - stated).max() > _SAME_POSE:
            raise step.error(f"contradicts {field} beside it; which is right?")
        poses.append(linked if stated is None else stated)
    return poses
