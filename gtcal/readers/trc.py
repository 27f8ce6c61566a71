"""TRC: markers by frame, as OpenSim, Cortex and others write them. Five or six lines of header, tabs or commas."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gtcal.camera import FloatArray
from gtcal.readers.body_trajectory import trajectory_of
from gtcal.readers.mocap_take import MocapTake, metres_per_unit, settled_stamps, stated_rate_hz, triple, whole_frames
from gtcal.readers.poses import PoseConventions
from gtcal.readers.selection import WHOLE_FILE, BodySelection
from gtcal.readers.text_export import Line, Rows, TextExport, open_export, row_notes, separator_after
from gtcal.recordings.trajectory import Trajectory

FORMAT = "trc"
_FIRST_WORD = "PathFileType"
_MOST_HEADER_LINES = 8


def read_trc(path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE) -> Trajectory:
    """Read a body that is given by markers of a TRC file.

    Raises GtcalError naming file and line, or the field to state, for anything that can't be read for sure."""
    return trajectory_of(read_trc_take(path), body, declared, selection, {"name", "markers", "rate_hz"})


def is_trc(head: str) -> bool:
    """Whether a file that starts so is a TRC."""
    return separator_after(head, _FIRST_WORD) is not None


def read_trc_take(path: Path) -> MocapTake:
    """All that a TRC file holds. Raises GtcalError naming file and line for anything that is wrong with it."""
    export = open_export(path)
    lines = export.header(_MOST_HEADER_LINES)
    separator = separator_after(lines[0].text, _FIRST_WORD)
    if separator is None:
        raise export.error(1, "is no TRC file; expected the first line to start with 'PathFileType'")
    if len(lines) < 5:
        raise export.error(len(lines), "the header is cut off; expected names of settings, their values and markers")
    stated = {
        key: value
        for key, value in zip(lines[1].fields(separator), lines[2].fields(separator), strict=False)
        if key and value
    }
    names = _names(export, lines[3], lines[4], separator)
    _check_counts(export, stated, names)
    start = next((line for line in lines[5:] if not line.blank), None)
    n_columns = 2 + 3 * len(names)
    if start is None:
        rows = Rows(np.empty((0, n_columns)), lines[-1].number + 1, len(export.data), False)
    else:
        rows = export.rows(start.start, start.number, separator, n_columns)
        export.check_end(rows)
    frames = whole_frames(path, rows.first_line, rows.values[:, 0])
    rate_hz = stated_rate_hz(f"{path}:3: DataRate", stated.get("DataRate"))
    decimals = export.decimals(start.start, separator, 1) if start is not None else 0
    return MocapTake(
        path=path,
        format=FORMAT,
        frames=frames,
        stamps_ns=settled_stamps(path, rows.first_line, frames, rows.values[:, 1], decimals, rate_hz),
        rate_hz=rate_hz,
        metres_per_unit=metres_per_unit(f"{path}:3: Units", stated.get("Units")),
        bodies={},
        markers={name: _occluded(triple(rows.values, range(2 + 3 * i, 5 + 3 * i))) for i, name in enumerate(names)},
        stated=stated,
        notes=row_notes(path, stated.get("NumFrames"), rows),
    )


def _names(export: TextExport, names_line: Line, axes_line: Line, separator: str) -> tuple[str, ...]:
    """The markers' labels: one above each three axes."""
    cells, axes = names_line.fields(separator), axes_line.fields(separator)
    if len(cells) < 2 or not cells[0].lower().startswith("frame") or not cells[1].lower().startswith("time"):
        raise export.error(names_line.number, "expected the columns to start with Frame# and Time")
    last = max((i for i, cell in enumerate(cells) if cell), default=1)
    names = tuple(cells[i] for i in range(2, last + 1, 3))
    between = [cells[i] for i in range(2, last + 1) if (i - 2) % 3 and cells[i]]
    if between or not all(names):
        raise export.error(names_line.number, "expected the label of a marker above every third column")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise export.error(names_line.number, f"the label {twice!r} stands twice")
    expected = [f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ"]
    given = [axis for axis in axes if axis]
    if [axis.upper() for axis in given] != expected:
        raise export.error(axes_line.number, f"expected the axes X1, Y1, Z1 to Z{len(names)}, for {len(names)} markers")
    return names


def _check_counts(export: TextExport, stated: dict[str, str], names: tuple[str, ...]) -> None:
    said = stated.get("NumMarkers")
    if said is not None and said != str(len(names)):
        raise export.error(3, f"NumMarkers is {said}, but line 4 names {len(names)} markers")


def _occluded(positions: FloatArray) -> FloatArray:
    """Zeros stand for a marker that was not seen: no marker is at the origin to the last digit."""
    return np.where((positions == 0).all(axis=1)[:, None], np.nan, positions)
