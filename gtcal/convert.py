"""From the file of one tool to that of another: cameras and rigs, and trajectories."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from pathlib import Path

from gtcal.camera_files.export import made_by
from gtcal.camera_files.formats import CAMERA_FILE_READERS, CAMERA_FILE_WRITERS, read_rig, recognised, write_rig
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera, agreeing
from gtcal.errors import GtcalError
from gtcal.files import check_regular, fingerprint
from gtcal.readers import TRAJECTORY_READERS, TRAJECTORY_WRITERS
from gtcal.readers.poses import LengthUnit, PoseConventions, PoseDirection, TimeUnit
from gtcal.recordings.trajectory import QuaternionOrder, Trajectory

_BODY = "body"  # what a trajectory is called in messages


@dataclass(frozen=True)
class ConvertOptions:
    """What the file to convert leaves unsaid; None: nothing to add.

    name: of the one camera, or tracked body, to convert out of several.
    quaternion, time_unit, pose: of a trajectory. length_unit: of a trajectory, or of a rig's translations.
    model, image_size_px: of cameras. nearest: take the nearest lens where one can't be read or written as it is."""

    name: str | None = None
    quaternion: QuaternionOrder | None = None
    length_unit: LengthUnit | None = None
    time_unit: TimeUnit | None = None
    pose: PoseDirection | None = None
    model: str | None = None
    image_size_px: tuple[int, int] | None = None
    nearest: bool = False


def convert(path: Path, output: Path, to: str, *, as_format: str | None = None, options: ConvertOptions) -> str:
    """Read a camera file or a trajectory and write it in another format; says what it was read as, and what was lost.

    as_format: the format to read; by what is in the file where it is None.

    Raises GtcalError for what can't be read, or written, or is of another kind than ``to``."""
    if to not in CAMERA_FILE_WRITERS and to not in TRAJECTORY_WRITERS:
        raise GtcalError(
            f"{to!r} is no format to convert to; cameras: {', '.join(CAMERA_FILE_WRITERS)}; trajectories: "
            f"{', '.join(TRAJECTORY_WRITERS)}"
        )
    if as_format is not None and as_format not in CAMERA_FILE_READERS and as_format not in TRAJECTORY_READERS:
        raise GtcalError(
            f"{as_format!r} is no format to convert from; cameras: {', '.join(CAMERA_FILE_READERS)}; trajectories: "
            f"{', '.join(TRAJECTORY_READERS)}"
        )
    check_regular(path)
    if not path.exists():
        raise GtcalError(f"{path}: there is no such file")
    camera_format = recognised(path) if as_format is None else as_format if as_format in CAMERA_FILE_READERS else None
    if camera_format is not None:
        return _convert_cameras(path, camera_format, output, to, options)
    return _convert_trajectory(path, as_format, output, to, options)


def _convert_cameras(path: Path, format_name: str, output: Path, to: str, options: ConvertOptions) -> str:
    if to not in CAMERA_FILE_WRITERS:
        raise _other_kind(path, format_name, "a camera file", to, CAMERA_FILE_WRITERS)
    _refuse(options, ("quaternion", "time_unit", "pose"), "a camera file")
    read = ReadOptions(options.model, options.image_size_px, options.length_unit, options.nearest)
    rig = read_rig(path, format_name, read).rig
    cameras = tuple(agreeing(path, camera, read) for camera in _named(path, rig, options.name))
    rig = replace(rig, cameras=cameras)
    lost = write_rig(rig, output, to, made_by("convert", rig, fingerprint(path)), nearest=options.nearest)
    named = ", ".join(camera.name + _off(camera) for camera in cameras)
    where = f"in the frame of {rig.ref_words}" if rig.posed else f"without poses ({rig.unposed})"
    return "\n".join([f"read {path} as {format_name}: {named}; {where}", *lost])


def _off(camera: RigCamera) -> str:
    return f" (lens off by {camera.lens_off_px:.3g} px at most)" if camera.lens_off_px else ""


def _named(path: Path, rig: Rig, name: str | None) -> tuple[RigCamera, ...]:
    """The camera of this name, all where none is given."""
    if name is None:
        return rig.cameras
    found = tuple(camera for camera in rig.cameras if camera.name == name)
    if not found:
        raise GtcalError(f"{path}: there is no camera {name!r}; cameras: {', '.join(c.name for c in rig.cameras)}")
    return found


def _convert_trajectory(path: Path, as_format: str | None, output: Path, to: str, options: ConvertOptions) -> str:
    _refuse(options, ("model", "image_size_px"), "a trajectory")
    format_name, trajectory = _read_trajectory(path, as_format, options)
    if to not in TRAJECTORY_WRITERS:
        raise _other_kind(path, format_name, "a trajectory", to, TRAJECTORY_WRITERS)
    TRAJECTORY_WRITERS[to](output, trajectory)
    return f"read {path} as {format_name}: a trajectory of {trajectory.n_samples} poses"


def _read_trajectory(path: Path, as_format: str | None, options: ConvertOptions) -> tuple[str, Trajectory]:
    """The format and what is in the file; where no format is given, that of the only reader that takes it."""
    names = [as_format] if as_format is not None else list(TRAJECTORY_READERS)
    read: dict[str, Trajectory] = {}
    refused: dict[str, str] = {}
    for name in names:
        try:
            read[name] = TRAJECTORY_READERS[name](path, _BODY, _conventions(name, options))
        except GtcalError as error:
            refused[name] = _as_option(str(error))
    if len(read) == 1:
        return next(iter(read.items()))
    if read:
        raise GtcalError(f"{path}: may be {' or '.join(read)}; say which with --from")
    # a reader that names an option to give or to correct has found its way in the file
    asking = [message for message in refused.values() if "--" in message]
    if as_format is not None or len(asking) == 1:
        raise GtcalError((asking or list(refused.values()))[0])
    raise GtcalError(
        f"{path}: is no file that gtcal knows by what is in it; say what it is with --from: cameras "
        f"{', '.join(CAMERA_FILE_READERS)}; trajectories {', '.join(TRAJECTORY_READERS)}"
    )


def _conventions(format_name: str, options: ConvertOptions) -> PoseConventions:
    known = {field.name for field in fields(PoseConventions)}
    stated = {name: getattr(options, name) for name in ("name", "quaternion", "length_unit", "time_unit", "pose")}
    given = {name: value for name, value in stated.items() if value is not None}
    for name in given:
        if name not in known:
            raise GtcalError(f"a file of {format_name} has no use for --{name.replace('_', '-')}; leave it out")
    return PoseConventions(**given)


def _as_option(message: str) -> str:
    """A reader's message, which sends the reader to the manifest, for the command line."""
    asked = re.sub(rf"\badd {_BODY}\.(\w+) to the manifest", lambda found: f"give {_option(found[1])}", message)
    asked = re.sub(rf"the manifest says {_BODY}\.(\w+): (\S+?);", lambda m: f"{_option(m[1])} says {m[2]};", asked)
    return re.sub(rf"\b{_BODY}\.(\w+)", lambda found: _option(found[1]), asked)


def _option(field: str) -> str:
    return f"--{field.replace('_', '-')}"


def _refuse(options: ConvertOptions, names: tuple[str, ...], what: str) -> None:
    for name in names:
        if getattr(options, name) is not None:
            raise GtcalError(f"{_option(name)} says nothing about {what}; leave it out")


def _other_kind(path: Path, format_name: str, what: str, to: str, possible: dict) -> GtcalError:
    return GtcalError(
        f"{path}: is {what} ({format_name}), which {to} can't hold; give --to one of {', '.join(possible)}"
    )
