"""The formats of camera files by name: their readers, their writers, and which of them a file is of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gtcal.camera_files import aria, basalt, colmap, kalibr, numpy_file, opencv, ros, ros_bag, toml_rigs, umetrack
from gtcal.camera_files.gtcal_file import read_gtcal
from gtcal.camera_files.gtcal_file import recognises as recognises_gtcal
from gtcal.camera_files.lenses import difference_px
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera
from gtcal.documents import load_document
from gtcal.errors import GtcalError
from gtcal.files import check_regular, staged


class CameraFileReader(Protocol):
    """Reads a file (or folder) as cameras. Raises GtcalError naming file and field for anything that is wrong."""

    def __call__(self, path: Path, options: ReadOptions) -> Rig: ...


class CameraFileWriter(Protocol):
    """Writes cameras, whole or not at all, with the notes on how they were made. nearest: write the nearest lens where
    the format can't express a camera's, in place of raising GtcalError."""

    def __call__(self, rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None: ...


CAMERA_FILE_READERS: dict[str, CameraFileReader] = {
    "kalibr": kalibr.read_kalibr,
    "opencv": opencv.read_opencv,
    "basalt": basalt.read_basalt,
    "ros": ros.read_ros,
    "ros_bag": ros_bag.read_ros_bag,
    "colmap": colmap.read_colmap,
    "aria": aria.read_aria,
    "hot3d": aria.read_hot3d,
    "umetrack": umetrack.read_umetrack,
    "anipose": toml_rigs.read_anipose,
    "pose2sim": toml_rigs.read_pose2sim,
    "numpy": numpy_file.read_numpy,
    "gtcal": read_gtcal,
}
"""By name, the formats that cameras can be read from; gtcal is its own calibration.json."""

CAMERA_FILE_WRITERS: dict[str, CameraFileWriter] = {
    "kalibr": kalibr.write_kalibr,
    "opencv": opencv.write_opencv,
    "basalt": basalt.write_basalt,
    "ros": ros.write_ros,
    "ros_bag": ros_bag.write_ros_bag,
    "colmap": colmap.write_colmap,
    "aria": aria.write_aria,
    "hot3d": aria.write_hot3d,
    "umetrack": umetrack.write_umetrack,
    "anipose": toml_rigs.write_anipose,
    "pose2sim": toml_rigs.write_pose2sim,
    "numpy": numpy_file.write_numpy,
}
"""By name, the formats that cameras can be written in."""

FOLDER_FORMATS = ("ros", "ros_bag", "colmap")
"""The formats that are written as a folder."""

_BY_DOCUMENT: dict[str, Callable[[Any], bool]] = {
    "kalibr": kalibr.recognises,
    "basalt": basalt.recognises,
    "ros": ros.recognises,
    "colmap": colmap.recognises_rig,
    "aria": aria.recognises_aria,
    "hot3d": aria.recognises_hot3d,
    "umetrack": umetrack.recognises,
    "gtcal": recognises_gtcal,
}
_SAME_LENS_PX = 1e-6
_SAME_POSE = 1e-6  # of a rotation matrix's numbers, and metres
_DOCUMENTS = (".yaml", ".yml", ".json", ".jsonl", ".toml")


@dataclass(frozen=True)
class ReadRig:
    """Cameras, and the format that they were read as."""

    rig: Rig
    format_name: str


def read_rig(path: Path, format_name: str | None, options: ReadOptions | None = None) -> ReadRig:
    """The cameras in a file or folder, in the format of this name, or that which it is of where none is given.

    Raises GtcalError for a file that is missing, of no known format, or wrong."""
    check_regular(path)
    if not path.exists():
        raise GtcalError(f"{path}: there is no such file")
    if format_name is not None and format_name not in CAMERA_FILE_READERS:
        raise GtcalError(f"{format_name!r} is no format of camera files; formats: {', '.join(CAMERA_FILE_READERS)}")
    found = format_name or recognised(path)
    if found is None:
        raise GtcalError(f"{path}: is no camera file that gtcal knows; formats: {', '.join(CAMERA_FILE_READERS)}")
    try:
        return ReadRig(CAMERA_FILE_READERS[found](path, options or ReadOptions()), found)
    except GtcalError as error:
        if str(path) in str(error):
            raise
        raise GtcalError(f"{path}: {error}") from None  # of the cameras together, which know of no file


def write_rig(rig: Rig, path: Path, format_name: str, notes: Sequence[str], *, nearest: bool = False) -> list[str]:
    """Write cameras in the format of this name, whole or not at all. It is read again before it is put in place: a line
    is returned for each thing that the format could not hold.

    Raises GtcalError for an unknown format, a lens that it can't express, or where it can't be written or read again.
    """
    if format_name not in CAMERA_FILE_WRITERS:
        raise GtcalError(f"{format_name!r} is no format of an export; formats: {', '.join(CAMERA_FILE_WRITERS)}")
    if format_name == "ros_bag":
        ros_bag.check_new(path)
    with staged(path) as aside:
        CAMERA_FILE_WRITERS[format_name](rig, aside, notes, nearest)
        try:
            again = read_rig(aside, format_name).rig
        except GtcalError as error:
            said = str(error).replace(str(aside), path.name)
            raise GtcalError(f"{path}: not written, as {format_name} can't hold these cameras: {said}") from error
        return _losses(rig, again)


def _losses(rig: Rig, again: Rig) -> list[str]:
    """What is other in the cameras that were read again, a line each."""
    lines = [line for camera, read in _pairs(rig, again) for line in _differences(camera, read)]
    if len(again.cameras) != len(rig.cameras):
        lines.append(f"{len(again.cameras)} of {len(rig.cameras)} cameras can be read again")
    if rig.posed and not again.posed:
        lines.append(f"the cameras' poses can't be read again: {again.unposed}")
    return lines


def _pairs(rig: Rig, again: Rig) -> list[tuple[RigCamera, RigCamera]]:
    """Each camera with that of its name, else with those of other names in turn."""
    named = {camera.name: camera for camera in again.cameras}
    own = {camera.name for camera in rig.cameras}
    others = iter([camera for camera in again.cameras if camera.name not in own])
    paired = [(camera, named.get(camera.name) or next(others, None)) for camera in rig.cameras]
    return [(camera, read) for camera, read in paired if read is not None]


def _differences(camera: RigCamera, read: RigCamera) -> list[str]:
    lines = []
    if read.name != camera.name:
        lines.append(f"camera {camera.name!r} is called {read.name!r} there")
    rms_px, max_px = difference_px(camera.camera, read.camera)
    if max_px > _SAME_LENS_PX:
        model = read.camera.model.name
        lines.append(f"camera {camera.name!r} as {model}: off by {rms_px:.3g} px rms, {max_px:.3g} px at most")
    if camera.camera_T_ref is not None and read.camera_T_ref is not None:
        off = float(np.abs(camera.camera_T_ref - read.camera_T_ref).max())
        if off > _SAME_POSE:
            lines.append(f"camera {camera.name!r}: its pose is off by {off:.2g}")
    return lines


def recognised(path: Path) -> str | None:
    """The format that a file or folder is of by what is in it, None where it is of none.

    Raises GtcalError where it can't be read, or doesn't tell which of two it is."""
    if path.is_dir():
        return _folder(path)
    suffix = path.suffix.lower()
    if suffix in (".npz", ".bag"):
        return "numpy" if suffix == ".npz" else "ros_bag"
    start = _start(path)
    if opencv.recognises_text(start):
        return "opencv"
    if colmap.recognises_cameras(start):
        return "colmap"
    return _document(path) if suffix in _DOCUMENTS else None


def _folder(path: Path) -> str | None:
    if (path / colmap.CAMERAS).is_file():
        return "colmap"
    if ros_bag.recognises_folder(path):
        return "ros_bag"
    return "ros" if ros.recognises_folder(path) else None


def _document(path: Path) -> str | None:
    document = load_document(path)
    if toml_rigs.recognises(document):
        stated = toml_rigs.stated_format(document)
        if stated is None:
            raise GtcalError(
                f"{path}: aniposelib and Pose2Sim write the same fields; say which format it is: anipose, "
                "whose unit of length has to be given, or pose2sim, which is in metres"
            )
        return stated
    return next((name for name, recognises in _BY_DOCUMENT.items() if recognises(document)), None)


def _start(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(20_000).decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error
