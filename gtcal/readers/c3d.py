"""C3D: markers by frame, read with ezc3d. Frame 1 is the start of the take.

ezc3d takes a file at its word, so the file's own counts are first held against its length.
"""

from __future__ import annotations

import struct
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gtcal.errors import GtcalError
from gtcal.files import TABLE_BYTES, check_regular
from gtcal.readers.body_trajectory import trajectory_of
from gtcal.readers.c3d_parameters import DEC, INTEL, MIPS, Parameter, read_parameters
from gtcal.readers.mocap_take import MocapTake, frame_stamps_ns, metres_per_unit, stated_rate_hz
from gtcal.readers.poses import PoseConventions
from gtcal.readers.selection import WHOLE_FILE, BodySelection
from gtcal.recordings.trajectory import Trajectory

FORMAT = "c3d"
_BLOCK = 512
_KEY = 0x50
_LAST_FRAME_OF_HEADER = 65535


def read_c3d(path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE) -> Trajectory:
    """Read a body that is given by markers of a C3D file.

    Raises GtcalError naming the file, or the field to state, for anything that can't be read for sure."""
    return trajectory_of(read_c3d_take(path), body, declared, selection, {"name", "markers", "rate_hz"})


def is_c3d(head: bytes) -> bool:
    """Whether a file that starts so is a C3D."""
    return len(head) >= _BLOCK and head[1] == _KEY and 2 <= head[0] < 100


def read_c3d_take(path: Path) -> MocapTake:
    """The markers of a C3D file. Raises GtcalError naming the file for anything that is wrong with it."""
    _check_length(path)
    parsed = _parsed(path)
    try:
        parameters = parsed["parameters"]["POINT"]
        points = np.asarray(parsed["data"]["points"], dtype=np.float64)
        residuals = np.asarray(parsed["data"]["meta_points"]["residuals"])[0]
        first_frame = int(parsed["header"]["points"]["first_frame"])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise GtcalError(f"{path}: is a damaged C3D file: it has no {error}") from error
    labels = _labels(path, parameters, points.shape[1])
    positions = np.moveaxis(points[:3], 0, 2)  # (markers, N, 3)
    lost = (residuals < 0) | ~np.isfinite(positions).all(axis=2) | (positions == 0).all(axis=2)
    positions[lost] = np.nan
    rate_hz = stated_rate_hz(f"{path}: POINT:RATE", _text(parameters, "RATE"))
    frames = first_frame + np.arange(points.shape[2])
    return MocapTake(
        path=path,
        format=FORMAT,
        frames=frames,
        stamps_ns=None if rate_hz is None else frame_stamps_ns(frames, rate_hz),
        rate_hz=rate_hz,
        metres_per_unit=metres_per_unit(f"{path}: POINT:UNITS", _text(parameters, "UNITS")),
        bodies={},
        markers=dict(zip(labels, positions, strict=True)),
        stated=_stated(parsed["parameters"]),
    )


def _check_length(path: Path) -> None:
    """Raises GtcalError where the file is missing, no C3D, or shorter than its header says."""
    check_regular(path, TABLE_BYTES)
    try:
        with path.open("rb") as file:
            head = file.read(_BLOCK)
            size = file.seek(0, 2)
            if not is_c3d(head):
                raise GtcalError(f"{path}: is no C3D file")
            start = (head[0] - 1) * _BLOCK
            file.seek(start)
            parameters = file.read(4)
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error
    if len(parameters) < 4 or parameters[3] not in (INTEL, DEC, MIPS):
        raise GtcalError(f"{path}: is a damaged C3D file: its parameters don't say how numbers are written")
    processor, n_blocks = parameters[3], parameters[2]
    if size < start + n_blocks * _BLOCK:
        raise GtcalError(f"{path}: the C3D file is cut off within its parameters")
    with path.open("rb") as file:
        file.seek(start)
        section = file.read(n_blocks * _BLOCK)
    _check_header(path, head, read_parameters(path, section), size, processor)


def _check_header(path: Path, head: bytes, parameters: dict[str, Parameter], size: int, processor: int) -> None:
    """Raises GtcalError where the header and the parameters, which state most things twice, contradict each other, or
    the file is shorter than they say."""
    order = ">" if processor == MIPS else "<"
    n_points, n_analog, first, last = struct.unpack(f"{order}4H", head[2:10])
    data_block, per_frame = struct.unpack(f"{order}2H", head[16:20])
    if last < first or data_block < 2:
        raise GtcalError(f"{path}: is a damaged C3D file: frames {first} to {last}, data from block {data_block}")
    n_frames = last - first + 1
    scale, rate_hz = (Parameter(4, (), head[at : at + 4]).numbers(processor)[0] for at in (12, 20))
    stated = {
        "POINT:USED": n_points,
        "POINT:DATA_START": data_block,
        "POINT:SCALE": scale,
        "ANALOG:USED": n_analog / per_frame if per_frame else 0.0,
    }
    if rate_hz:  # some writers leave the header's at 0
        stated["POINT:RATE"] = rate_hz
    if last < _LAST_FRAME_OF_HEADER:
        stated["POINT:FRAMES"] = n_frames
    for name, in_header in stated.items():
        numbers = parameters[name].numbers(processor)[:1] if name in parameters else []
        if numbers and numbers[0] != in_header:
            raise GtcalError(
                f"{path}: is a damaged C3D file: {name} is {numbers[0]:g}, but the header says {in_header:g}"
            )
    needed = n_frames * (4 * n_points + n_analog) * (4 if scale < 0 else 2)
    if size < (data_block - 1) * _BLOCK + needed and last < _LAST_FRAME_OF_HEADER:
        raise GtcalError(
            f"{path}: the C3D file is cut off: {n_frames} frames of {n_points} markers need {needed} bytes, there are "
            f"{max(0, size - (data_block - 1) * _BLOCK)}"
        )


def _parsed(path: Path) -> Any:
    try:
        ezc3d = import_module("ezc3d")
    except ImportError:
        raise GtcalError(f"{path}: reading C3D needs ezc3d; pip install 'gtcal[c3d]'") from None
    try:
        return ezc3d.c3d(str(path))
    except Exception as error:  # ezc3d raises what its C++ does
        raise GtcalError(f"{path}: is a damaged C3D file: {' '.join(str(error).split())}") from error


def _labels(path: Path, parameters: Any, n_points: int) -> list[str]:
    """POINT:LABELS, continued in LABELS2 and so on beyond 255 markers."""
    labels: list[str] = []
    for key in ("LABELS", *(f"LABELS{i}" for i in range(2, 100))):
        if key in parameters:
            labels += [str(label).strip() for label in parameters[key]["value"]]
    if len(labels) < n_points:
        raise GtcalError(f"{path}: the C3D file has {n_points} markers, but labels for {len(labels)}")
    labels = labels[:n_points]
    return [label if labels.index(label) == i and label else f"{label} [{i}]" for i, label in enumerate(labels)]


def _text(parameters: Any, key: str) -> str | None:
    """The first value of a parameter as text, None where there is none."""
    values = parameters[key]["value"] if key in parameters else []
    return str(values[0]).strip() if len(values) else None


def _stated(groups: Any) -> dict[str, str]:
    if "MANUFACTURER" not in groups:
        return {}
    found = {key: _text(groups["MANUFACTURER"], key) for key in ("COMPANY", "SOFTWARE", "VERSION_LABEL")}
    return {key: value for key, value in found.items() if value}
