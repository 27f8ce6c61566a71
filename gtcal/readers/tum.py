"""TUM text: ``timestamp tx ty tz qx qy qz qw`` on each row, separated by white space, '#' before comments.

The format says seconds, metres, xyzw and the pose of the body in the world. A file of that shape with other
conventions can be read by declaring them, unless its own comment names the columns otherwise.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.readers.poses import PoseConventions, settle, trajectory_from_rows
from gtcal.readers.selection import WHOLE_FILE, BodySelection, refuse_unused, shifted
from gtcal.recordings.text_table import Kind, TextTable, open_table
from gtcal.recordings.trajectory import QuaternionOrder, Trajectory, quaternions_from_poses

_FORMAT = PoseConventions(quaternion="xyzw", length_unit="m", time_unit="s", pose="world_T_body")
_COLUMNS: list[tuple[str, Kind]] = [
    ("stamp", "stamp"),
    *((name, "number") for name in ("x", "y", "z", "q0", "q1", "q2", "q3")),
]
_QUATERNIONS: dict[tuple[str, ...], QuaternionOrder] = {
    ("qx", "qy", "qz", "qw"): "xyzw",
    ("qw", "qx", "qy", "qz"): "wxyz",
}


def read_tum(path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE) -> Trajectory:
    """Read a TUM text file as the trajectory of ``body``. ``declared`` is what the manifest states.

    Raises GtcalError naming file and line for anything that can't be read for sure."""
    refuse_unused(path, body, selection, {"stamp_offset_ns"}, "tum")
    table, columns, _ = open_tum(path)
    conventions = settle(path, body, _named_order(table), _with_format(_named_order(table), declared))
    trajectory = trajectory_from_rows(table, body, table.read(columns), conventions)
    return shifted(trajectory, selection.stamp_offset_ns)


def open_tum(path: Path) -> tuple[TextTable, list[tuple[str, Kind]], PoseConventions]:
    """The file's table, its columns, and what the format and the file's comment state.

    Raises GtcalError where the columns are others."""
    table = open_table(path, None)
    if table.n_columns not in (0, len(_COLUMNS)):
        raise GtcalError(
            f"{path}:{table.skip_lines + 1}: fields separated by white space in the row: {table.n_columns}, "
            "expected 8: timestamp tx ty tz qx qy qz qw"
        )
    return table, _COLUMNS, _with_format(_named_order(table), PoseConventions())


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM text: seconds with nine decimals, metres, quaternion xyzw, every digit."""
    quats_xyzw = quaternions_from_poses(trajectory.world_T_body, "xyzw")
    numbers = np.concatenate([trajectory.world_T_body[:, :3, 3], quats_xyzw], axis=1).tolist()
    with write_aside(path) as file:
        file.write("# timestamp tx ty tz qx qy qz qw\n")
        for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), numbers, strict=True):
            sign, (seconds, nanoseconds) = "-" * (stamp_ns < 0), divmod(abs(stamp_ns), 1_000_000_000)
            file.write(f"{sign}{seconds}.{nanoseconds:09d} {' '.join(map(repr, row))}\n")


def _named_order(table: TextTable) -> PoseConventions:
    return PoseConventions(quaternion=_stated_order(table))


def _stated_order(table: TextTable) -> QuaternionOrder | None:
    """The order in the last comment that names the quaternion's columns."""
    named = [_QUATERNIONS.get(tuple(table.split(comment.lower())[-4:])) for comment in table.comments]
    return next((order for order in reversed(named) if order), None)


def _with_format(in_file: PoseConventions, declared: PoseConventions) -> PoseConventions:
    """What is declared, and the format's own where neither the manifest nor the file says otherwise."""
    return PoseConventions(
        **{
            field.name: getattr(declared, field.name) or getattr(in_file, field.name) or getattr(_FORMAT, field.name)
            for field in fields(PoseConventions)
        }
    )
