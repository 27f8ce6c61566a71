"""Vicon Nexus' CSV: sections, of which "Segments" (poses) and "Trajectories" (markers) are read.

A section has its title, its rate, the names above the columns, the axes with "Frame, Sub Frame" before them, the units,
and a row per frame; a blank line ends it. A segment's rotations RX, RY, RZ are helical or Euler angles as set in Nexus'
export; the file doesn't say which, so the manifest must. Frame 1 is the start of the take.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtcal.camera import FloatArray
from gtcal.readers.body_trajectory import trajectory_of
from gtcal.readers.mocap_take import (
    BodyColumns,
    MocapTake,
    frame_stamps_ns,
    metres_per_unit,
    stated_rate_hz,
    triple,
    whole_frames,
)
from gtcal.readers.poses import PoseConventions
from gtcal.readers.selection import WHOLE_FILE, BodySelection
from gtcal.readers.text_export import Line, Rows, TextExport, open_export, row_notes, separator_after
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory

FORMAT = "vicon_csv"
_MARKER_AXES, _SEGMENT_AXES = ("X", "Y", "Z"), ("RX", "RY", "RZ", "TX", "TY", "TZ")
_READ = {"Trajectories": _MARKER_AXES, "Segments": _SEGMENT_AXES}
_OTHERS = ("Devices", "Joints", "Model Outputs", "Events", "Global Angles")
_ANGLES = {"deg": True, "rad": False}


@dataclass(frozen=True)
class _Section:
    """A section that was read: frames (N,), their rate, and by name the columns (N, 3) or (N, 6)."""

    frames: IntArray
    rate_hz: float | None
    metres_per_unit: float | None
    degrees: bool | None
    columns: dict[str, FloatArray]
    notes: tuple[str, ...]


def read_vicon_csv(
    path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE
) -> Trajectory:
    """Read a segment of a Vicon Nexus CSV, or a body that is given by its markers.

    Raises GtcalError naming file and line, or the field to state, for anything that can't be read for sure."""
    used = {"name", "markers", "rotation", "rate_hz"}
    return trajectory_of(read_vicon_take(path), body, declared, selection, used)


def is_vicon_csv(head: str) -> bool:
    """Whether a file that starts so is a Vicon Nexus CSV."""
    lines = head.splitlines()
    title = lines[0].strip(' \t,;"') if lines else ""
    return title in (*_READ, *_OTHERS) and any(separator_after(line, "Frame") for line in lines[1:6])


def read_vicon_take(path: Path) -> MocapTake:
    """The segments and markers of a Vicon Nexus CSV. Raises GtcalError naming file and line for anything that is wrong
    with it."""
    export = open_export(path)
    sections: dict[str, _Section] = {}
    line = next((line for line in export.lines() if not line.blank), None)
    while line is not None:
        title = line.text.strip(' \t,;"')
        if title in sections:
            raise export.error(line.number, f"there is a second section {title}; expected one")
        if title in _READ:
            sections[title], rows = _section(export, line, _READ[title])
            start, number = rows.end, rows.first_line + len(rows.values) + rows.cut
        elif title in _OTHERS:
            start, number = _past(export, line)
        else:
            expected = ", ".join((*_READ, *_OTHERS))
            raise export.error(line.number, f"{title[:24]!r} is no title of a section; expected one of {expected}")
        line = next((line for line in export.lines(start=start, number=number) if not line.blank), None)
    if not sections:
        raise export.error(1, "there is no section Segments or Trajectories; export these from Nexus")
    return _take(export, sections)


def _section(export: TextExport, title: Line, axes: tuple[str, ...]) -> tuple[_Section, Rows]:
    lines = export.header(5, title)
    if len(lines) < 3:
        raise export.error(title.number, "the section is cut off; expected its rate, names and axes")
    rate_line, names_line, axes_line = lines[:3]
    separator = separator_after(axes_line.text, "Frame")
    if separator is None:
        raise export.error(axes_line.number, "expected the columns to start with Frame and Sub Frame")
    cells = axes_line.fields(separator)
    if cells[1:2] != ("Sub Frame",):
        raise export.error(axes_line.number, "expected the columns to start with Frame and Sub Frame")
    n_columns = max(i for i, cell in enumerate(cells) if cell) + 1
    groups = _groups(export, names_line, axes_line, separator, axes)
    units_line = lines[3] if len(lines) > 3 and not lines[3].fields(separator)[0] and not lines[3].blank else None
    rows_line = export.header(1, units_line or axes_line)
    if rows_line:
        rows = export.rows(rows_line[0].start, rows_line[0].number, separator, n_columns)
    else:
        rows = Rows(np.empty((0, n_columns)), axes_line.number + 2, len(export.data), False)
    sub_frames = np.flatnonzero(rows.values[:, 1] != 0)
    if len(sub_frames):
        raise export.error(rows.first_line + int(sub_frames[0]), "Sub Frame is not 0; expected one row per frame")
    units = units_line.fields(separator) if units_line is not None else ()
    section = _Section(
        frames=whole_frames(export.path, rows.first_line, rows.values[:, 0]),
        rate_hz=_rate_hz(export, rate_line, separator),
        metres_per_unit=_length(export, units_line, units, groups, axes),
        degrees=_degrees(export, units_line, units, groups, axes),
        columns={name: triple(rows.values, columns) for name, columns in groups.items()},
        notes=row_notes(export.path, None, rows),
    )
    return section, rows


def _rate_hz(export: TextExport, line: Line, separator: str) -> float | None:
    cells = line.fields(separator) or ("",)
    return stated_rate_hz(f"{export.path}:{line.number}: the rate", cells[0])


def _groups(
    export: TextExport, names_line: Line, axes_line: Line, separator: str, axes: tuple[str, ...]
) -> dict[str, list[int]]:
    """The columns of each name, one for each axis. Columns of velocities and the like (X', X'') are passed over.

    Raises GtcalError where a name stands twice, or lacks an axis, or an axis lacks its name."""
    names, given = names_line.fields(separator), axes_line.fields(separator)
    groups: dict[str, list[int]] = {}
    index = 2
    while index < len(given):
        name = names[index] if index < len(names) else ""
        if not given[index] and not name:
            index += 1
        elif "'" in given[index]:
            index += len(axes)
        elif given[index : index + len(axes)] != axes:
            found = ", ".join(given[index : index + len(axes)])
            raise export.error(
                axes_line.number, f"columns {index + 1} on are {found}; expected {', '.join(axes)} under each name"
            )
        elif not name or any(names[index + 1 : index + len(axes)]):
            raise export.error(names_line.number, f"expected one name above the columns {index + 1} on")
        elif name in groups:
            raise export.error(names_line.number, f"the name {name!r} stands twice")
        else:
            groups[name] = list(range(index, index + len(axes)))
            index += len(axes)
    beyond = [name for name in names[len(given) :] if name]
    if beyond:
        raise export.error(names_line.number, f"the name {beyond[0]!r} has no columns; is the header cut off?")
    return groups


def _unit(export: TextExport, line: Line | None, units: tuple[str, ...], columns: list[int], what: str) -> str | None:
    """The one unit of these columns. Raises GtcalError where they have more than one."""
    if line is None or not columns:
        return None
    found = {units[i] if i < len(units) else "" for i in columns}
    if len(found) > 1:
        listed = ", ".join(repr(unit) for unit in sorted(found))
        raise export.error(line.number, f"{what} are in {listed}; expected one unit")
    return found.pop() or None


def _length(
    export: TextExport, line: Line | None, units: tuple[str, ...], groups: dict[str, list[int]], axes: tuple[str, ...]
) -> float | None:
    columns = [column for group in groups.values() for column in group[-3:]]
    unit = _unit(export, line, units, columns, "positions")
    return metres_per_unit(f"{export.path}:{line.number if line else 0}: the unit of positions", unit)


def _degrees(
    export: TextExport, line: Line | None, units: tuple[str, ...], groups: dict[str, list[int]], axes: tuple[str, ...]
) -> bool | None:
    if axes != _SEGMENT_AXES:
        return None
    unit = _unit(export, line, units, [column for group in groups.values() for column in group[:3]], "angles")
    if unit is None or unit not in _ANGLES:
        at = line.number if line is not None else 1
        raise export.error(at, f"the unit of the segments' angles is {unit or 'not stated'}; expected deg or rad")
    return _ANGLES[unit]


def _past(export: TextExport, title: Line) -> tuple[int, int]:
    """Byte and line number after the section that starts with this title: its next blank line."""
    for line in export.lines(title):
        if line.blank:
            return line.end, line.number + 1
    return len(export.data), title.number


def _take(export: TextExport, sections: dict[str, _Section]) -> MocapTake:
    given = list(sections.values())
    if len(given) == 2 and not (
        np.array_equal(given[0].frames, given[1].frames)
        and given[0].rate_hz == given[1].rate_hz
        and given[0].metres_per_unit == given[1].metres_per_unit
    ):
        raise export.error(
            1,
            "the sections Segments and Trajectories have other frames, rates or units than each other; export them "
            "for the same frames, or one by one",
        )
    first = given[0]
    markers = sections["Trajectories"].columns if "Trajectories" in sections else {}
    frames = first.frames - 1
    return MocapTake(
        path=export.path,
        format=FORMAT,
        frames=frames,
        stamps_ns=None if first.rate_hz is None else frame_stamps_ns(frames, first.rate_hz),
        rate_hz=first.rate_hz,
        metres_per_unit=first.metres_per_unit,
        bodies=_segments(sections["Segments"], tuple(markers)) if "Segments" in sections else {},
        markers=markers,
        notes=tuple(dict.fromkeys(note for section in given for note in section.notes)),
    )


def _segments(section: _Section, labels: tuple[str, ...]) -> dict[str, BodyColumns]:
    names = list(section.columns)
    return {
        name: BodyColumns(columns[:, 3:], columns[:, :3], None, section.degrees, _markers_of(name, names, labels))
        for name, columns in section.columns.items()
    }


def _markers_of(segment: str, segments: list[str], labels: tuple[str, ...]) -> tuple[str, ...]:
    """The markers of a segment 'subject:segment': the subject's, where it has no other segment."""
    subject = segment.split(":")[0]
    if sum(other.split(":")[0] == subject for other in segments) > 1:
        return ()
    return tuple(label for label in labels if label.startswith(f"{subject}:"))
