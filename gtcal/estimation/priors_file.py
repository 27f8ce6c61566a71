"""A file of priors: YAML or JSON, in mm and deg as people state them.

gtcal_priors: 1
body_T_board: {position_mm: [12, 0, 40], rotvec_deg: [0, 0, 90], sigma_mm: 2, sigma_deg: 1}
cameras:
  front_left:
    ref_T_camera: {position_mm: [...], quat_wxyz: [...], sigma_mm: 0.5, sigma_deg: 0.2}
    intrinsics: {fx: {value: 503.2, sigma: 1.5}}
between_cameras:
  - {camera: front_right, seen_from: front_left, position_mm: [...], quat_wxyz: [...], sigma_mm: 0.2, sigma_deg: 0.05}
rig: {file: camchain.yaml, sigma_mm: 0.5, sigma_deg: 0.1}   # the same of all cameras of a camera file
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera_files.formats import read_rig
from gtcal.camera_files.rig import LengthUnit, ReadOptions
from gtcal.errors import GtcalError
from gtcal.estimation.priors import PosePrior, Priors
from gtcal.recordings.manifest import Entry, load_fields
from gtcal.recordings.trajectory import quaternions_from_poses

Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Sigmas = float | Annotated[list[float | None], Field(min_length=3, max_length=3)]


class PoseEntry(Entry):
    """Where one frame is in another."""

    position_mm: Triple = Field(description="Position of its origin in the other frame.")
    quat_wxyz: Quaternion | None = Field(None, description="Its rotation, as a quaternion.")
    rotvec_deg: Triple | None = Field(None, description="Its rotation, as axis times angle.")
    sigma_mm: Sigmas | None = Field(None, description="1-sigma along its axes, one or three; null: nothing is known.")
    sigma_deg: Sigmas | None = Field(None, description="1-sigma about its axes, one or three; null: nothing is known.")


class BetweenEntry(PoseEntry):
    """Where a camera is, seen from another."""

    camera: str = Field(description="The camera whose pose is stated.")
    seen_from: str = Field(description="The camera in whose frame it is stated.")


class ParameterEntry(Entry):
    """What is known of an intrinsic parameter."""

    value: float = Field(description="In px, or without unit.")
    sigma: float = Field(description="1-sigma, in the same unit.")


class CameraEntry(Entry):
    """What is known of a camera."""

    ref_T_camera: PoseEntry | None = Field(None, description="Its pose in ref, as from the rig's drawing.")
    intrinsics: dict[str, ParameterEntry] = Field(default_factory=dict, description="By parameter.")


class RigEntry(Entry):
    """Where the cameras are to each other, in a camera file of any format that holds poses."""

    file: str = Field(description="The file, relative to this one.")
    format: str | None = Field(None, description="Its format, where the file doesn't tell.")
    length_unit: LengthUnit | None = Field(None, description="Its unit of length, where the file doesn't state it.")
    sigma_mm: float = Field(description="1-sigma of each camera's place in the first camera's frame.")
    sigma_deg: float = Field(description="1-sigma of each camera's rotation in the first camera's frame.")


class PriorsEntry(Entry):
    """The file."""

    gtcal_priors: Literal[1] = Field(description="Version of the file.")
    body_T_board: PoseEntry | None = Field(None, description="The board in its body, X.")
    cameras: dict[str, CameraEntry] = Field(default_factory=dict, description="By camera.")
    between_cameras: list[BetweenEntry] = Field(default_factory=list, description="Cameras in each other's frames.")
    rig: RigEntry | None = Field(None, description="Cameras in each other's frames, as a camera file places them.")


def read_priors(path: Path | str) -> Priors:
    """Read a file of priors.

    Raises GtcalError naming the file and the first field that is wrong."""
    path = Path(path)
    where = f"{path}: "
    try:
        entry = PriorsEntry.model_validate(load_fields(path))
        return Priors(
            body_T_board=_pose(entry.body_T_board, f"{where}body_T_board") if entry.body_T_board else None,
            ref_T_camera={
                name: _pose(camera.ref_T_camera, f"{where}cameras.{name}.ref_T_camera")
                for name, camera in entry.cameras.items()
                if camera.ref_T_camera
            },
            camera_a_T_camera_b=_between(path, entry),
            intrinsics={
                name: {parameter: (known.value, known.sigma) for parameter, known in camera.intrinsics.items()}
                for name, camera in entry.cameras.items()
                if camera.intrinsics
            },
        )
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        raise GtcalError(f"{path}: {field}: {first['msg'][0].lower()}{first['msg'][1:]}") from None


def _between(path: Path, entry: PriorsEntry) -> dict[tuple[str, str], PosePrior]:
    """Where a camera (the second) is in the frame of another (the first)."""
    stated = {
        (between.seen_from, between.camera): _pose(between, f"{path}: between_cameras.{i}")
        for i, between in enumerate(entry.between_cameras)
    }
    from_file = {} if entry.rig is None else _rig(path, entry.rig)
    for seen_from, camera in stated:
        if (seen_from, camera) in from_file or (camera, seen_from) in from_file:
            raise GtcalError(f"{path}: rig: it and between_cameras both relate {camera!r} to {seen_from!r}; keep one")
    return from_file | stated


def _rig(path: Path, entry: RigEntry) -> dict[tuple[str, str], PosePrior]:
    """Every camera of the file in the frame of its first."""
    try:
        rig = read_rig(path.parent / entry.file, entry.format, ReadOptions(length_unit=entry.length_unit)).rig
        (first, first_T_ref), *others = rig.poses("a prior on a rig").items()
        if not others:
            raise GtcalError(f"{entry.file}: holds one camera only, and a prior on a rig is of two or more")
        sigma_m, sigma_rad = _three(entry.sigma_mm, 1e-3), _three(entry.sigma_deg, float(np.deg2rad(1.0)))
        priors = {}
        for name, camera_T_ref in others:
            first_T_camera = first_T_ref @ inverse(camera_T_ref)
            w, qx, qy, qz = quaternions_from_poses(first_T_camera[None], "wxyz")[0].tolist()
            x, y, z = first_T_camera[:3, 3].tolist()
            priors[first, name] = PosePrior((x, y, z), (w, qx, qy, qz), sigma_m, sigma_rad)
    except GtcalError as error:
        raise GtcalError(f"{path}: rig: {error}") from None
    return priors


def _pose(entry: PoseEntry, where: str) -> PosePrior:
    sigma_m, sigma_rad = _three(entry.sigma_mm, 1e-3), _three(entry.sigma_deg, float(np.deg2rad(1.0)))
    if entry.sigma_mm is None and entry.sigma_deg is None:
        raise GtcalError(f"{where}: neither sigma_mm nor sigma_deg is given: how sure is this pose?")
    x, y, z = (1e-3 * value for value in entry.position_mm)
    try:
        return PosePrior((x, y, z), _quaternion(entry, where), sigma_m, sigma_rad)
    except GtcalError as error:
        raise GtcalError(f"{where}: {error}") from None


def _quaternion(entry: PoseEntry, where: str) -> tuple[float, float, float, float]:
    if entry.quat_wxyz is not None and entry.rotvec_deg is not None:
        raise GtcalError(f"{where}: quat_wxyz and rotvec_deg both state the rotation: give one")
    if entry.quat_wxyz is not None:
        w, x, y, z = entry.quat_wxyz
        return w, x, y, z
    if entry.rotvec_deg is None:
        raise GtcalError(f"{where}: the rotation is missing: give quat_wxyz or rotvec_deg")
    x, y, z, w = Rotation.from_rotvec(entry.rotvec_deg, degrees=True).as_quat().tolist()
    return w, x, y, z


def _three(sigmas: Sigmas | None, unit: float) -> tuple[float | None, float | None, float | None]:
    x, y, z = sigmas if isinstance(sigmas, list) else (sigmas, sigmas, sigmas)
    return (
        None if x is None else unit * x,
        None if y is None else unit * y,
        None if z is None else unit * z,
    )
