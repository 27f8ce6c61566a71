"""From columns of numbers to a trajectory: what the file says, what the user says, and whether that can be."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.readers.text_export import cut_note
from gtcal.recordings.detections import IntArray
from gtcal.recordings.text_table import TextTable
from gtcal.recordings.trajectory import QuaternionOrder, Trajectory, poses_from_quaternions

LengthUnit = Literal["m", "mm"]
TimeUnit = Literal["ns", "us", "ms", "s"]
PoseDirection = Literal["world_T_body", "body_T_world"]

LENGTHS_M: dict[LengthUnit, float] = {"m": 1.0, "mm": 1e-3}
"""Metres in each unit."""

# What printing a unit quaternion with three decimals can do to its norm: sqrt(4) * 0.0005.
_NORM_TOLERANCE = 1e-3
# The halls of the largest mocap systems are some tens of metres long; a room in millimetres read as metres
# puts a body thousands of metres away.
_FARTHEST_MEDIAN_M = 100.0
_FARTHEST_M = 1000.0
# The fastest mocap cameras take 10,000 images a second, at a fraction of their resolution.
_HIGHEST_RATE_HZ = 20_000.0


@dataclass(frozen=True)
class PoseConventions:
    """How poses are written in a file. None: not stated.

    quaternion: the order of its four numbers.
    length_unit, time_unit: of positions and time stamps.
    pose: whether a row holds the body's pose in the world or its inverse.
    """

    quaternion: QuaternionOrder | None = None
    length_unit: LengthUnit | None = None
    time_unit: TimeUnit | None = None
    pose: PoseDirection | None = None


@dataclass(frozen=True)
class SettledConventions:
    """``PoseConventions`` with nothing left open."""

    quaternion: QuaternionOrder
    length_unit: LengthUnit
    time_unit: TimeUnit
    pose: PoseDirection


_CHOICES = {
    "quaternion": "xyzw or wxyz",
    "length_unit": "m or mm",
    "time_unit": "ns, us, ms or s",
    "pose": "world_T_body or body_T_world",
}


def settle(path: Path, body: str, in_file: PoseConventions, declared: PoseConventions) -> SettledConventions:
    """What the file says and what the manifest declares for ``body``, together. Where neither tells the direction
    of the poses it is world_T_body, the pose of the body in the world, as mocap software exports it.

    Raises GtcalError where they contradict each other, or both leave the quaternion order or a unit open."""
    settled = {field.name: _settle_one(path, body, field.name, in_file, declared) for field in fields(PoseConventions)}
    return SettledConventions(**settled)


def _settle_one(path: Path, body: str, name: str, in_file: PoseConventions, declared: PoseConventions) -> Any:
    said, claimed = getattr(in_file, name), getattr(declared, name)
    default = "world_T_body" if name == "pose" else None
    return stated_once(path, body, name, said, claimed or (None if said else default), _CHOICES[name])


def stated_once(path: Path, body: str, name: str, said: str | None, claimed: str | None, choices: str) -> str:
    """What the file says of a convention, or the manifest.

    Raises GtcalError where they contradict each other, or neither says it."""
    if said and claimed and said != claimed:
        raise GtcalError(
            f"{path}: the file's header says {name} {said}, but the manifest says {body}.{name}: {claimed}; "
            "correct the one that is wrong"
        )
    if not said and not claimed:
        raise GtcalError(
            f"{path}: the file doesn't state its {name}, and gtcal doesn't guess it; "
            f"add {body}.{name} to the manifest: {choices}"
        )
    return said or claimed or ""


def trajectory_from_rows(table: TextTable, body: str, rows: npt.NDArray, conventions: SettledConventions) -> Trajectory:
    """The trajectory of a table read with the columns stamp, x, y, z and q0..q3.

    Raises GtcalError with file and line where a time stamp repeats or goes backward, a quaternion is not of unit
    length, or a position or the sampling rate is out of this world."""
    notes: tuple[str, ...] = ()
    if len(rows) > 1 and table.last_line_has_no_end():
        rows = rows[:-1]
        notes = (f"{body}: {cut_note(table.path)}",)
    if not len(rows):
        raise GtcalError(f"{table.path}: there are no poses in the file")
    stamps_ns = table.stamps_ns(rows["stamp"], conventions.time_unit)
    table.check_strictly_increasing(stamps_ns)
    check_rate(table.path, stamps_ns, body, conventions.time_unit)
    quats = unit_quaternions(table, np.stack([rows[f"q{i}"] for i in range(4)], axis=1))
    positions_m = np.stack([rows[axis] for axis in "xyz"], axis=1) * LENGTHS_M[conventions.length_unit]
    poses = poses_from_quaternions(quats, conventions.quaternion, positions_m)
    world_T_body = poses if conventions.pose == "world_T_body" else inverse(poses)
    check_distance(table.path, world_T_body[:, :3, 3], body, conventions.length_unit)
    if (row := farthest_row(world_T_body[:, :3, 3])) is not None:
        distance_m = float(np.linalg.norm(world_T_body[row, :3, 3]))
        raise table.error(row, f"the position is {distance_m:.6g} m from the mocap origin")
    return Trajectory(body, stamps_ns, world_T_body, notes)


def unit_quaternions(table: TextTable, quats: FloatArray) -> FloatArray:
    """Quaternions (N, 4) of length 1. Raises GtcalError with file and line where one is far from that."""
    with np.errstate(over="ignore"):  # of damaged numbers, which are then told
        norms = np.linalg.norm(quats, axis=1)
    bad = np.flatnonzero(np.abs(norms - 1.0) > _NORM_TOLERANCE)
    if len(bad):
        row = int(bad[0])
        zero = norms[row] == 0.0
        raise table.error(
            row,
            "the quaternion is zero; expected unit length (remove the rows where the body was not seen)"
            if zero
            else f"the quaternion's length is {norms[row]:.6g}; expected 1 (are these columns the quaternion?)",
        )
    return quats / norms[:, None]


def check_rate(path: Path, stamps_ns: IntArray, body: str, time_unit: TimeUnit) -> None:
    """Raises GtcalError where the stamps mean a rate that no mocap has."""
    if len(stamps_ns) < 2:
        return
    rate_hz = 1e9 / float(np.median(np.diff(stamps_ns)))
    if rate_hz > _HIGHEST_RATE_HZ:
        raise GtcalError(
            f"{path}: as {time_unit}, the time stamps mean {rate_hz:.6g} poses a second, and no mocap is faster "
            f"than {_HIGHEST_RATE_HZ:g}; check {body}.time_unit"
        )


def check_distance(path: Path, positions_m: FloatArray, body: str, unit: LengthUnit) -> None:
    """Raises GtcalError where the positions, read in ``unit``, are mostly out of this world."""
    with np.errstate(over="ignore"):  # of damaged numbers, which are then told
        typical_m = float(np.median(np.linalg.norm(positions_m, axis=1)))
    if typical_m > _FARTHEST_MEDIAN_M:
        hint = "are they millimetres? then set" if unit == "m" else "check"
        value = f"{body}.length_unit: mm" if unit == "m" else f"{body}.length_unit"
        raise GtcalError(
            f"{path}: as {unit}, the positions are {typical_m:.6g} m from the mocap origin (median), "
            f"more than {_FARTHEST_MEDIAN_M:g} m; {hint} {value}"
        )


def farthest_row(positions_m: FloatArray) -> int | None:
    """The first row whose position no mocap reaches."""
    with np.errstate(over="ignore"):
        far = np.flatnonzero(np.linalg.norm(positions_m, axis=1) > _FARTHEST_M)
    return int(far[0]) if len(far) else None
