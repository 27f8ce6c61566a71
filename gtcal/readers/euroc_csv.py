"""The EuRoC/ASL CSV: a time stamp, a position and a quaternion on each row, with the columns named in the header.

ASL's own files name their columns ``#timestamp [ns], p_RS_R_x [m], ... q_RS_w [], q_RS_x [] ...``. Many programs
write the like with the quaternion in another order, other units or no header at all: what the header doesn't say,
the user must.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import numpy as np

from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.readers.poses import (
    LengthUnit,
    PoseConventions,
    TimeUnit,
    settle,
    trajectory_from_rows,
)
from gtcal.readers.selection import WHOLE_FILE, BodySelection, refuse_unused, shifted
from gtcal.recordings.text_table import Kind, TextTable, open_table
from gtcal.recordings.trajectory import QuaternionOrder, Trajectory, quaternions_from_poses

_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:[\[(](?P<bracketed>[^\])]*)[\])]|_(?P<suffix>ns|us|ms|s|m|mm))?$")
_STAMP = re.compile(r"^(timestamp|time|stamp|ts|t)$")
_POSITION = re.compile(r"^(p_rs_r_|p_?|t_?|pos_?|position_?|)(?P<axis>[xyz])$")
_QUATERNION = re.compile(r"^(q_rs_|q_?|quat_?|quaternion_?)(?P<axis>[wxyz])$")
_HEADER = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
# Where nothing names the columns: the time stamp, the position, the quaternion in the declared order.
_POSITIONAL = ("stamp", "x", "y", "z", "q0", "q1", "q2", "q3")


def read_euroc_csv(
    path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE
) -> Trajectory:
    """Read an EuRoC/ASL CSV as the trajectory of ``body``. ``declared`` is what the manifest states.

    Raises GtcalError naming file and line (or the field to state) for anything that can't be read for sure."""
    refuse_unused(path, body, selection, {"stamp_offset_ns"}, "euroc_csv")
    table, columns, stated = open_euroc_csv(path)
    conventions = settle(path, body, stated, declared)
    trajectory = trajectory_from_rows(table, body, table.read(columns), conventions)
    return shifted(trajectory, selection.stamp_offset_ns)


def open_euroc_csv(path: Path) -> tuple[TextTable, list[tuple[str, Kind]], PoseConventions]:
    """The file's table, its columns, and what the header states. Raises GtcalError where the columns are others."""
    table = open_table(path, ",")
    header = table.header()
    columns = _named_columns(table, header) if header else _positional_columns(table)
    return table, columns, _stated(path, header)


def write_euroc_csv(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as ASL does: nanoseconds, metres, quaternion wxyz, every digit."""
    quats_wxyz = quaternions_from_poses(trajectory.world_T_body, "wxyz")
    numbers = np.concatenate([trajectory.world_T_body[:, :3, 3], quats_wxyz], axis=1).tolist()
    with write_aside(path) as file:
        file.write(_HEADER + "\n")
        for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), numbers, strict=True):
            file.write(f"{stamp_ns},{','.join(map(repr, row))}\n")


def _named_columns(table: TextTable, header: tuple[str, ...]) -> list[tuple[str, Kind]]:
    """Name and kind of each column for the table: stamp, x, y, z, q0..q3, the first of each; others ignored."""
    columns: list[tuple[str, Kind]] = []
    quaternion = 0
    for index, column in enumerate(header):
        role = _role(column)
        taken = [name for name, _ in columns]
        if index == 0 and role == "stamp":
            columns.append(("stamp", "stamp"))
        elif role in ("x", "y", "z") and role not in taken:
            columns.append((role, "number"))
        elif role.startswith("q") and quaternion < 4:
            columns.append((f"q{quaternion}", "number"))
            quaternion += 1
        else:
            columns.append((f"ignored_{index}", "ignored"))
    missing = set(_POSITIONAL) - {name for name, _ in columns}
    if missing or _order(header) is None:
        raise GtcalError(
            f"{table.path}:{table.skip_lines}: the header names the columns {_shown(header)}; expected a "
            "timestamp first, then x, y, z and the quaternion as qx, qy, qz, qw or qw, qx, qy, qz"
        )
    return columns


def _shown(header: tuple[str, ...]) -> str:
    return ", ".join(header[:12]) + (f" and {len(header) - 12} more" if len(header) > 12 else "")


def _positional_columns(table: TextTable) -> list[tuple[str, Kind]]:
    if table.n_columns < len(_POSITIONAL):
        raise GtcalError(
            f"{table.path}:{table.skip_lines + 1}: fields separated by commas in the row: {table.n_columns}, "
            "expected 8: time stamp, x, y, z and a quaternion"
        )
    names = [*_POSITIONAL, *(f"ignored_{i}" for i in range(8, table.n_columns))]
    return [(name, _kind(name)) for name in names]


def _kind(name: str) -> Kind:
    if name == "stamp":
        return "stamp"
    return "ignored" if name.startswith("ignored") else "number"


def _split_unit(column: str) -> tuple[str, str]:
    """The column's name in lower case, and its unit: 'p_RS_R_x [m]' is ('p_rs_r_x', 'm')."""
    match = _UNIT.match(column.lower())
    assert match  # the pattern takes any text
    return match["name"], (match["bracketed"] or match["suffix"] or "").strip()


def _role(column: str) -> str:
    """stamp, x, y, z, qw, qx, qy, qz, or nothing."""
    name, _ = _split_unit(column)
    if _STAMP.match(name):
        return "stamp"
    if match := _POSITION.match(name):
        return match["axis"]
    match = _QUATERNION.match(name)
    return f"q{match['axis']}" if match else ""


def _order(header: tuple[str, ...]) -> QuaternionOrder | None:
    """The order of the quaternion's columns where they are one of the two that are in use."""
    axes = "".join(_role(column)[1] for column in header if _role(column).startswith("q"))[:4]
    return axes if axes in get_args(QuaternionOrder) else None  # type: ignore[return-value]


def _stated(path: Path, header: tuple[str, ...]) -> PoseConventions:
    """What the names of the columns say. ASL's own names (p_RS_R_x) say that the poses are those of the sensor in
    the reference frame, and ASL's stamps are nanoseconds."""
    if not header:
        return PoseConventions()
    asl = any(_split_unit(column)[0].startswith("p_rs_r_") for column in header)
    return PoseConventions(
        quaternion=_order(header),
        length_unit=_stated_unit(path, header, ("x", "y", "z"), get_args(LengthUnit)),
        time_unit=_stated_unit(path, header, ("stamp",), get_args(TimeUnit)) or ("ns" if asl else None),
        pose="world_T_body" if asl else None,
    )


def _stated_unit(path: Path, header: tuple[str, ...], roles: tuple[str, ...], choices: tuple[str, ...]) -> Any:
    """The unit that the columns of these roles have in common, or None."""
    units = {role: _split_unit(column)[1] for column in reversed(header) if (role := _role(column)) in roles}
    stated = set(units.values())
    if len(stated) > 1 or not stated <= {"", *choices}:
        listed = ", ".join(f"{role} in {unit or 'nothing'}" for role, unit in sorted(units.items()))
        raise GtcalError(f"{path}: the header has {listed}; expected one unit of {', '.join(choices)}")
    return stated.pop() or None
