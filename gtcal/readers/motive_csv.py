"""OptiTrack Motive's CSV: a line of settings, some lines that name the columns, then a row per frame.

Above each column stand its type (Rigid Body, Rigid Body Marker, Marker, Bone, ...), name, ID, in newer versions its
parent, then Rotation or Position, and the axis. "Rigid Body Marker" is where Motive's pose puts a marker, "Marker" is
where it was measured. Angles are degrees about the body's own axes, in the order that the header states, since Motive
1.6. The world's axes are the file's, y up unless it was exported otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.readers.body_trajectory import trajectory_of
from gtcal.readers.mocap_take import (
    BodyColumns,
    MocapTake,
    RotationKind,
    check_rotation_kind,
    metres_per_unit,
    settled_stamps,
    stated_rate_hz,
    triple,
    whole_frames,
)
from gtcal.readers.poses import PoseConventions
from gtcal.readers.selection import WHOLE_FILE, BodySelection
from gtcal.readers.text_export import Line, TextExport, open_export, row_notes, separator_after
from gtcal.recordings.trajectory import Trajectory

FORMAT = "motive_csv"
_FIRST_WORD = "Format Version"
_BODY_TYPES = ("Rigid Body", "Bone")
_EXPECTED_TYPES = ("Rigid Body Marker", "Bone Marker")
_MEASURED_TYPES = ("Marker",)
_MOST_HEADER_LINES = 12
_KEYS = (
    "Format Version",
    "Take Name",
    "Capture Frame Rate",
    "Export Frame Rate",
    "Capture Start Time",
    "Total Exported Frames",
    "Rotation Type",
    "Length Units",
    "Coordinate Space",
)


@dataclass(frozen=True)
class _Columns:
    """The lines above the rows: type, name, ID and kind of each column, and the axes, with the line of these."""

    types: tuple[str, ...]
    names: tuple[str, ...]
    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    axes: tuple[str, ...]
    axes_line: Line


def read_motive_csv(
    path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE
) -> Trajectory:
    """Read a body of a Motive CSV. Where the file has the body's measured markers too, see ``from_both``.

    Raises GtcalError naming file and line, or the field to state, for anything that can't be read for sure."""
    used = {"name", "markers", "rotation", "rate_hz"}
    return trajectory_of(read_motive_take(path), body, declared, selection, used)


def is_motive_csv(head: str) -> bool:
    """Whether a file that starts so is a Motive CSV."""
    return separator_after(head, _FIRST_WORD) is not None


def read_motive_take(path: Path) -> MocapTake:
    """All that a Motive CSV holds. Raises GtcalError naming file and line for anything that is wrong with it."""
    export = open_export(path)
    lines = export.header(_MOST_HEADER_LINES)
    separator = separator_after(lines[0].text, _FIRST_WORD)
    if separator is None:
        raise export.error(1, "is no Motive CSV; expected the first line to start with 'Format Version'")
    stated = _stated(lines[0].fields(separator))
    columns = _columns(export, lines, separator)
    rows = export.rows(columns.axes_line.end, columns.axes_line.number + 1, separator, len(columns.axes))
    export.check_end(rows)
    frames = whole_frames(path, rows.first_line, rows.values[:, 0])
    rate_hz = stated_rate_hz(f"{path}:1: the frame rate", stated.get("Export Frame Rate"))
    decimals = export.decimals(columns.axes_line.end, separator, 1)
    stamps_ns = settled_stamps(path, rows.first_line, frames, rows.values[:, 1], decimals, rate_hz)
    rotation = _rotation(path, stated)
    expected, measured = _markers(export, columns, rows.values)
    return MocapTake(
        path=path,
        format=FORMAT,
        frames=frames,
        stamps_ns=stamps_ns,
        rate_hz=rate_hz,
        metres_per_unit=metres_per_unit(f"{path}:1: Length Units", stated.get("Length Units")),
        bodies=_bodies(export, columns, rows.values, rotation, expected, measured),
        markers=measured,
        stated=stated,
        notes=row_notes(path, stated.get("Total Exported Frames"), rows),
    )


def _stated(fields: tuple[str, ...]) -> dict[str, str]:
    """The settings of the first line: names and values in turn, found by name because a value may hold separators."""
    found = {}
    for key in _KEYS:
        if key in fields[:-1]:
            found[key] = fields[fields.index(key) + 1]
    return {key: value for key, value in found.items() if value}


def _columns(export: TextExport, lines: list[Line], separator: str) -> _Columns:
    axes_line = next((line for line in lines if line.fields(separator)[:1] == ("Frame",)), None)
    if axes_line is None:
        raise export.error(len(lines), f"no line of the first {len(lines)} starts with 'Frame'; expected the columns")
    axes = axes_line.fields(separator)
    if len(axes) < 2 or not axes[1].lower().startswith("time"):
        raise export.error(axes_line.number, "expected the columns to start with Frame and Time (Seconds)")
    above = {}
    for line in lines[1 : lines.index(axes_line)]:
        fields = line.fields(separator)
        if line.blank:  # Excel fills it with separators
            continue
        if len(fields) != len(axes):
            raise export.error(
                line.number, f"{len(fields)} cells, but line {axes_line.number} names {len(axes)} columns"
            )
        above[fields[1].rstrip(":") or "kind"] = fields
    nothing = ("",) * len(axes)
    if "Type" not in above or "Name" not in above:
        raise export.error(axes_line.number, "expected lines with the Type and the Name of each column above this one")
    if "kind" not in above and len(axes) > 2:
        raise export.error(axes_line.number, "expected a line with Rotation or Position above this one")
    return _Columns(above["Type"], above["Name"], above.get("ID", nothing), above.get("kind", nothing), axes, axes_line)


def _rotation(path: Path, stated: dict[str, str]) -> RotationKind | None:
    space = stated.get("Coordinate Space", "Global")
    if space.lower() != "global":
        raise GtcalError(f"{path}:1: Coordinate Space is {space!r}; export with Coordinate Space: Global")
    said = stated.get("Rotation Type")
    if said is None:
        return None
    if said.lower() == "quaternion":
        return "quaternion_xyzw"
    kind = f"euler_{said.lower()}_intrinsic"
    if not check_rotation_kind(kind):
        raise GtcalError(f"{path}:1: Rotation Type is {said!r}; expected Quaternion or an order of axes like XYZ")
    return cast(RotationKind, kind)


def _groups(columns: _Columns, types: tuple[str, ...]) -> dict[tuple[str, str, str], dict[tuple[str, str], list[int]]]:
    """For each type, name and ID the columns by kind and axis."""
    groups: dict[tuple[str, str, str], dict[tuple[str, str], list[int]]] = {}
    for index in range(2, len(columns.axes)):
        if columns.types[index] in types:
            key = (columns.types[index], columns.names[index], columns.ids[index])
            place = (columns.kinds[index], columns.axes[index].upper())
            groups.setdefault(key, {}).setdefault(place, []).append(index)
    return groups


def _named(
    export: TextExport, columns: _Columns, found: dict[tuple[str, str], list[int]], what: str, kind: str, axes: str
) -> list[int]:
    """The columns of these axes. Raises GtcalError where one is missing or stands twice."""
    indices = []
    for axis in axes:
        at = found.get((kind, axis), [])
        if len(at) != 1:
            problem = "has no" if not at else f"has {len(at)}"
            raise export.error(columns.axes_line.number, f"{what} {problem} column {kind} {axis}; expected one")
        indices.append(at[0])
    return indices


def _bodies(
    export: TextExport,
    columns: _Columns,
    values: FloatArray,
    rotation: RotationKind | None,
    expected: dict[str, FloatArray],
    measured: dict[str, FloatArray],
) -> dict[str, BodyColumns]:
    bodies: dict[str, BodyColumns] = {}
    for (kind, name, identity), found in _groups(columns, _BODY_TYPES).items():
        what = f"{kind} {name!r}"
        positions = _named(export, columns, found, what, "Position", "XYZ")
        has_w = ("Rotation", "W") in found
        if rotation is not None and has_w != (rotation == "quaternion_xyzw"):
            raise export.error(
                columns.axes_line.number,
                f"{what} has rotations in {'X, Y, Z, W' if has_w else 'X, Y, Z'}, but line 1 says Rotation Type "
                f"{'Quaternion' if not has_w else rotation}",
            )
        turned = _named(export, columns, found, what, "Rotation", "XYZW" if has_w else "XYZ")
        own = tuple(label for label in measured if label.startswith(f"{name}:"))
        bodies[name if name not in bodies else f"{name} [{identity}]"] = BodyColumns(
            positions=triple(values, positions),
            rotations=triple(values, turned),
            rotation="quaternion_xyzw" if has_w else rotation,
            degrees=None if has_w else True,
            markers=own,
            expected={label: at for label, at in expected.items() if label.startswith(f"{name}:")},
        )
    return bodies


def _markers(
    export: TextExport, columns: _Columns, values: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Expected and measured markers (N, 3) by label."""
    by_types = []
    for types in (_EXPECTED_TYPES, _MEASURED_TYPES):
        markers: dict[str, FloatArray] = {}
        for (kind, name, identity), found in _groups(columns, types).items():
            at = _named(export, columns, found, f"{kind} {name!r}", "Position", "XYZ")
            markers[name if name not in markers else f"{name} [{identity}]"] = triple(values, at)
        by_types.append(markers)
    return by_types[0], by_types[1]
