"""What a mocap export holds, whatever its format: frames, bodies as the file writes them, and markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.readers.text_export import number_in
from gtcal.recordings.detections import IntArray

RotationKind = Literal[
    "quaternion_xyzw",
    "helical",
    "matrix_by_columns",
    "matrix_by_rows",
    "euler_xyz_intrinsic",
    "euler_xzy_intrinsic",
    "euler_yxz_intrinsic",
    "euler_yzx_intrinsic",
    "euler_zxy_intrinsic",
    "euler_zyx_intrinsic",
    "euler_xyz_extrinsic",
    "euler_xzy_extrinsic",
    "euler_yxz_extrinsic",
    "euler_yzx_extrinsic",
    "euler_zxy_extrinsic",
    "euler_zyx_extrinsic",
]
"""helical: the rotation vector, angle times axis. euler_xyz_intrinsic: about x, then the new y, then the new z;
extrinsic: about x, y, z of the world. matrix_by_columns: nine numbers of world_R_body, column after column."""

METRES_PER_UNIT = {
    "m": 1.0,
    "meters": 1.0,
    "metres": 1.0,
    "cm": 1e-2,
    "centimeters": 1e-2,
    "centimetres": 1e-2,
    "mm": 1e-3,
    "millimeters": 1e-3,
    "millimetres": 1e-3,
}
"""Metres per unit of length, by the names that exports give them."""

# What printing a unit quaternion, or a rotation matrix, with three decimals can do to it.
_UNIT_TOLERANCE = 1e-3
_MATRIX_TOLERANCE = 5e-3


@dataclass(frozen=True)
class BodyColumns:
    """A tracked body as its file writes it, NaN where it was not seen.

    positions: (N, 3) in the file's unit of length.
    rotations: (N, 3), (N, 4) or (N, 9) numbers; ``rotation`` says what they are, None where the user has to.
    degrees: whether angles are degrees; None where the file doesn't say, or there are none.
    markers: labels of the measured markers that are this body's.
    expected: (N, 3) per label, where the software puts those markers by its own pose, in the file's unit.
    """

    positions: FloatArray
    rotations: FloatArray
    rotation: RotationKind | None
    degrees: bool | None = None
    markers: tuple[str, ...] = ()
    expected: dict[str, FloatArray] = field(default_factory=dict)

    def seen(self) -> np.ndarray:
        """(N,) whether the body has a pose. One with some of its numbers has none."""
        complete = np.isfinite(self.positions).all(axis=1) & np.isfinite(self.rotations).all(axis=1)
        return np.asarray(complete)


@dataclass(frozen=True)
class MocapTake:
    """A file of mocap software.

    format: its name in ``TRAJECTORY_READERS``.
    stamps_ns: (N,) from the start of the take, or None where the file has frame numbers and no rate.
    frames: (N,) counted from 0 at the start of the take.
    rate_hz: as the header states it.
    metres_per_unit: the unit of length; None where the file doesn't state it.
    bodies: by name. markers: (N, 3) by label, in the file's unit, NaN where occluded.
    stated: what else the header states, for people to read.
    notes: what is odd about the file, one sentence each.
    time_unit: of the file's time stamps.
    """

    path: Path
    format: str
    frames: IntArray
    stamps_ns: IntArray | None
    rate_hz: float | None
    metres_per_unit: float | None
    bodies: dict[str, BodyColumns]
    markers: dict[str, FloatArray]
    stated: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    time_unit: str = "s"

    @property
    def n_frames(self) -> int:
        return len(self.frames)

    def markers_of(self, name: str) -> tuple[str, ...]:
        """The labels that belong to a body or, in files of labels with a prefix ('box:left'), to that prefix. Those of
        a prefix are in the order of the alphabet: the order decides the body's axes, and files differ in theirs."""
        if name in self.bodies:
            return self.bodies[name].markers
        return tuple(sorted(label for label in self.markers if label.startswith(f"{name}:")))

    @property
    def prefixes(self) -> tuple[str, ...]:
        """The prefixes of labels that have three markers or more."""
        found = [label.split(":")[0] for label in self.markers if ":" in label]
        return tuple(name for name in dict.fromkeys(found) if found.count(name) >= 3)


def frame_stamps_ns(frames: IntArray, rate_hz: float) -> IntArray:
    """Frames counted from 0, in nanoseconds."""
    return np.rint(frames * (1e9 / rate_hz)).astype(np.int64)


def settled_stamps(
    path: Path, first_line: int, frames: IntArray, times_s: FloatArray, decimals: int, rate_hz: float | None
) -> IntArray:
    """(N,) the stamps of rows that have a frame number and a time of that many decimals. Where a time is the frame's by
    the rate, rounded, the rate's is taken: a time of 0.003 s stands for 0.0027778.

    Raises GtcalError where times don't increase, or contradict the rate."""
    bad = np.flatnonzero(~(np.diff(times_s) > 0))
    if len(bad):
        line = first_line + int(bad[0]) + 1
        raise GtcalError(f"{path}:{line}: the time does not increase from the row before")
    if rate_hz is None or not len(frames):
        return np.rint(times_s * 1e9).astype(np.int64)
    tolerance_s = 0.5001 * 10.0**-decimals + 1e-9
    for zero in (0, 1):
        expected_s = (frames - zero) / rate_hz
        if np.all(np.abs(times_s - expected_s) <= tolerance_s):
            return frame_stamps_ns(frames - zero, rate_hz)
    offsets_s = times_s - frames / rate_hz
    if float(np.ptp(offsets_s)) <= 2 * tolerance_s:  # exported from the middle of a take
        middle_s = float(offsets_s.min() + offsets_s.max()) / 2
        return frame_stamps_ns(frames, rate_hz) + round(middle_s * 1e9)
    if len(frames) > 1:
        step_s = float((times_s[-1] - times_s[0]) / (frames[-1] - frames[0]))
        slack_s = 2 * tolerance_s / float(frames[-1] - frames[0])
        if abs(step_s * rate_hz - 1.0) > 0.01 + slack_s * rate_hz:
            raise GtcalError(
                f"{path}: the header says {rate_hz:g} frames a second, but the times of the rows mean "
                f"{1.0 / step_s:.6g}; correct the one that is wrong"
            )
    return np.rint(times_s * 1e9).astype(np.int64)


def whole_frames(path: Path, first_line: int, column: FloatArray) -> IntArray:
    """(N,) a column of frame numbers. Raises GtcalError with the line where one is no whole number or repeats."""
    bad = np.flatnonzero(~(np.rint(column) == column))
    if len(bad):
        line = first_line + int(bad[0])
        raise GtcalError(f"{path}:{line}: the frame number is {column[bad[0]]:g}; expected a whole number")
    frames = column.astype(np.int64)
    bad = np.flatnonzero(np.diff(frames) <= 0)
    if len(bad):
        row = int(bad[0]) + 1
        raise GtcalError(
            f"{path}:{first_line + row}: frame {frames[row]} follows frame {frames[row - 1]}; frame numbers must "
            "increase from row to row"
        )
    return frames


def metres_per_unit(where: str, unit: str | None) -> float | None:
    """Metres per unit of length as a header names it; None where it doesn't. Raises GtcalError, beginning with
    ``where``, for a unit that isn't known."""
    if not unit:
        return None
    if unit.lower() not in METRES_PER_UNIT:
        raise GtcalError(f"{where} is {unit!r}; expected metres, centimetres or millimetres")
    return METRES_PER_UNIT[unit.lower()]


def stated_rate_hz(where: str, text: str | None) -> float | None:
    """Frames a second as a header states them; None where it doesn't. Raises GtcalError, beginning with ``where``, for
    what is no positive number."""
    if not text:
        return None
    rate_hz = number_in(text)
    if rate_hz is None:
        raise GtcalError(f"{where} is {text!r}; expected frames a second")
    return rate_hz


def triple(values: FloatArray, columns: Sequence[int]) -> FloatArray:
    """(N, len(columns)) of the rows' values; a view where the columns are neighbours."""
    first, n = columns[0], len(columns)
    if list(columns) == list(range(first, first + n)):
        return values[:, first : first + n]
    return values[:, list(columns)]


@np.errstate(over="ignore", invalid="ignore")  # of damaged numbers, which are then told
def rotations(kind: RotationKind, numbers: FloatArray, degrees: bool, where: str) -> FloatArray:
    """(N, 3, 3) world_R_body of numbers without NaN, in the notation ``kind``.

    Raises GtcalError, beginning with ``where``, where the numbers can't be of that kind."""
    if not len(numbers):
        return np.empty((0, 3, 3))
    if kind == "quaternion_xyzw":
        norms = np.linalg.norm(numbers, axis=1)
        _check(np.abs(norms - 1.0) <= _UNIT_TOLERANCE, where, norms, "a quaternion's length is {:.6g}; expected 1")
        return Rotation.from_quat(numbers).as_matrix()
    if kind in ("matrix_by_columns", "matrix_by_rows"):
        world_R_body = numbers.reshape(-1, 3, 3)
        if kind == "matrix_by_columns":
            world_R_body = np.swapaxes(world_R_body, 1, 2)
        return _proper(world_R_body, where)
    angles = np.deg2rad(numbers) if degrees else numbers
    if not degrees:
        largest = np.abs(angles).max(axis=1)
        _check(largest <= 4 * np.pi, where, largest, "an angle is {:.6g} rad, more than two turns; are they degrees?")
    if kind == "helical":
        return Rotation.from_rotvec(angles).as_matrix()
    _, order, frame = kind.split("_")
    return Rotation.from_euler(order.upper() if frame == "intrinsic" else order, angles).as_matrix()


def _proper(world_R_body: FloatArray, where: str) -> FloatArray:
    off = np.abs(world_R_body @ np.swapaxes(world_R_body, 1, 2) - np.eye(3)).max(axis=(1, 2))
    _check(off <= _MATRIX_TOLERANCE, where, off, "a rotation matrix is off orthonormal by {:.3g}")
    determinants = np.linalg.det(world_R_body)
    _check(determinants > 0, where, determinants, "a rotation matrix has determinant {:.3g}: the axes are left-handed")
    return Rotation.from_matrix(world_R_body).as_matrix()


def _check(good: np.ndarray, where: str, values: FloatArray, message: str) -> None:
    bad = np.flatnonzero(~good)
    if len(bad):
        raise GtcalError(f"{where}: {message.format(values[bad[0]])}")


def check_rotation_kind(kind: str) -> bool:
    """Whether this is a notation of rotations."""
    return kind in get_args(RotationKind)
