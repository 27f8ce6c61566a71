"""Qualisys QTM's 6D TSV: settings by name, names of the columns, then a row per frame with a body after the other.

QTM writes millimetres and degrees. Of each body there are X, Y, Z, three angles, the residual, and the nine numbers of
the rotation matrix, which are taken: how the angles are defined is a setting of QTM that the file doesn't state. A body
that was not tracked has blank cells, or zeros and a negative residual.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.readers.body_trajectory import trajectory_of
from gtcal.readers.mocap_take import (
    METRES_PER_UNIT,
    BodyColumns,
    MocapTake,
    RotationKind,
    frame_stamps_ns,
    rotations,
    settled_stamps,
    stated_rate_hz,
    triple,
    whole_frames,
)
from gtcal.readers.poses import PoseConventions
from gtcal.readers.selection import WHOLE_FILE, BodySelection
from gtcal.readers.text_export import Line, TextExport, open_export, row_notes
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory

FORMAT = "qualisys_tsv"
_TAB = "\t"
_FIRST_KEYS = ("FILE_VERSION", "NO_OF_FRAMES")
_MOST_HEADER_LINES = 40
_MATRIX = tuple(f"ROT[{i}]" for i in range(9))
_POSITION = ("X", "Y", "Z")
_AGREE_RAD = 0.01


def read_qualisys_tsv(
    path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE
) -> Trajectory:
    """Read a body of a Qualisys 6D TSV.

    Raises GtcalError naming file and line, or the field to state, for anything that can't be read for sure."""
    return trajectory_of(read_qualisys_take(path), body, declared, selection, {"name", "rotation", "rate_hz"})


def is_qualisys_tsv(head: str) -> bool:
    """Whether a file that starts so is a TSV of QTM."""
    return head.split(_TAB)[0].strip() in _FIRST_KEYS


def read_qualisys_take(path: Path) -> MocapTake:
    """All that a Qualisys 6D TSV holds. Raises GtcalError naming file and line for anything that is wrong with it."""
    export = open_export(path)
    lines = export.header(_MOST_HEADER_LINES)
    if not is_qualisys_tsv(lines[0].text):
        raise export.error(1, "is no TSV of Qualisys QTM; expected its header, starting with NO_OF_FRAMES")
    settings, columns_line = _settings(export, lines)
    names = tuple(name for name in settings.get("BODY_NAMES", ()) if name)
    _check_bodies(export, settings, names)
    lead, groups, n_columns = _groups(export, columns_line, names)
    rows = export.rows(columns_line.end, columns_line.number + 1, _TAB, n_columns)
    export.check_end(rows)
    said = " ".join(settings.get("NO_OF_FRAMES", ()))
    if not lead and said != str(len(rows.values)):
        raise GtcalError(
            f"{path}: NO_OF_FRAMES is {said or 'not stated'}, but there are {len(rows.values)} rows, and nothing tells "
            "which frames these are; export with frame numbers or times"
        )
    rate_hz = stated_rate_hz(f"{path}: FREQUENCY", " ".join(settings.get("FREQUENCY", ())).strip())
    values = rows.values
    frames = (
        whole_frames(path, rows.first_line, values[:, lead["FRAME"]]) - 1 if "FRAME" in lead else np.arange(len(values))
    )
    stamps_ns: IntArray | None
    if "TIME" in lead:
        decimals = export.decimals(columns_line.end, _TAB, lead["TIME"])
        stamps_ns = settled_stamps(path, rows.first_line, frames, values[:, lead["TIME"]], decimals, rate_hz)
    else:
        stamps_ns = None if rate_hz is None else frame_stamps_ns(frames, rate_hz)
    return MocapTake(
        path=path,
        format=FORMAT,
        frames=frames,
        stamps_ns=stamps_ns,
        rate_hz=rate_hz,
        metres_per_unit=METRES_PER_UNIT["mm"],
        bodies={name: _body(values, group) for name, group in groups.items()},
        markers={},
        stated={key: " ".join(cells) for key, cells in settings.items() if key != "BODY_NAMES"},
        notes=row_notes(path, said, rows),
    )


def _settings(export: TextExport, lines: list[Line]) -> tuple[dict[str, tuple[str, ...]], Line]:
    """The settings by name, and the line of the columns' names, which has an X, Y and Z."""
    settings: dict[str, tuple[str, ...]] = {}
    for line in lines:
        cells = line.fields(_TAB)
        plain = tuple(cell.upper().split(" ")[-1] for cell in cells)
        if all(axis in plain for axis in _POSITION):
            return settings, line
        if cells and cells[0]:
            settings[cells[0]] = cells[1:]
    included = " ".join(settings.get("DATA_INCLUDED", ()))
    if included and included.upper() != "6D":
        raise export.error(1, f"DATA_INCLUDED is {included}; export 6D data from QTM")
    raise export.error(len(lines), "there is no line of column names (X, Y, Z, ...); export with column names")


def _check_bodies(export: TextExport, settings: dict[str, tuple[str, ...]], names: tuple[str, ...]) -> None:
    included = " ".join(settings.get("DATA_INCLUDED", ())).strip().upper()
    if included and included != "6D":
        raise export.error(1, f"DATA_INCLUDED is {included}; export 6D data from QTM")
    if not names:
        raise export.error(1, "there is no line BODY_NAMES; is this an export of 6D data?")
    said = " ".join(settings.get("NO_OF_BODIES", ())).strip()
    if said and said != str(len(names)):
        raise export.error(1, f"NO_OF_BODIES is {said}, but BODY_NAMES has {len(names)}")
    if len(set(names)) < len(names):
        raise export.error(1, "a name stands twice in BODY_NAMES")


def _groups(
    export: TextExport, line: Line, names: tuple[str, ...]
) -> tuple[dict[str, int], dict[str, dict[str, int]], int]:
    """Leading columns (FRAME, TIME) by name; of each body the columns by name; how many columns there are. A column
    may have the body's name before its own."""
    cells = line.fields(_TAB)
    last = max(i for i, cell in enumerate(cells) if cell)
    plain = [cell.upper().split(" ")[-1] for cell in cells[: last + 1]]
    starts = [i for i, name in enumerate(plain) if name == "X"]
    if len(starts) != len(names):
        raise export.error(line.number, f"{len(starts)} columns X for the {len(names)} bodies of BODY_NAMES")
    groups = {}
    for name, start, end in zip(names, starts, [*starts[1:], len(plain)], strict=True):
        own = plain[start:end]
        if len(set(own) - {""}) < sum(bool(column) for column in own):
            raise export.error(line.number, f"a column of body {name!r} stands twice")
        group = {column: start + i for i, column in enumerate(own) if column}
        missing = [column for column in _POSITION if column not in group]
        some = [column for column in _MATRIX if column in group]
        if missing or 0 < len(some) < len(_MATRIX):
            lost = missing or [column for column in _MATRIX if column not in group]
            raise export.error(line.number, f"body {name!r} has no column {lost[0]}")
        groups[name] = group
    lead = {name: i for i, name in enumerate(plain[: starts[0]]) if name in ("FRAME", "TIME")}
    return lead, groups, last + 1


def _body(values: FloatArray, group: dict[str, int]) -> BodyColumns:
    positions = triple(values, [group[axis] for axis in _POSITION])
    angles = [column for column in group if column not in (*_POSITION, *_MATRIX, "RESIDUAL")][:3]
    has_matrix = _MATRIX[0] in group
    numbers = triple(values, [group[column] for column in (_MATRIX if has_matrix else angles)])
    lost = (positions == 0).all(axis=1) & (numbers == 0).all(axis=1)
    if "RESIDUAL" in group:
        lost |= values[:, group["RESIDUAL"]] < 0
    gone = lost[:, None]
    positions, numbers = np.where(gone, np.nan, positions), np.where(gone, np.nan, numbers)
    kind = _matrix_order(numbers, triple(values, [group[a] for a in angles])) if has_matrix else None
    return BodyColumns(positions, numbers, kind, degrees=None if has_matrix else True)


def _matrix_order(numbers: FloatArray, angles: FloatArray) -> RotationKind | None:
    """Whether the nine numbers are columns or rows: as the angles confirm, where they are QTM's standard ones (about
    x, the new y, the new z). None where they don't."""
    known = np.flatnonzero(np.isfinite(numbers).all(axis=1) & np.isfinite(angles).all(axis=1))[:200]
    if angles.shape[1] != 3 or not len(known):
        return None
    expected = rotations("euler_xyz_intrinsic", angles[known], True, "")
    off = {
        kind: float(np.median(np.abs(given - expected).max(axis=(1, 2))))
        for kind, given in (
            ("matrix_by_rows", numbers[known].reshape(-1, 3, 3)),
            ("matrix_by_columns", np.swapaxes(numbers[known].reshape(-1, 3, 3), 1, 2)),
        )
    }
    fitting = [kind for kind in off if off[kind] < _AGREE_RAD]
    return fitting[0] if len(fitting) == 1 else None  # type: ignore[return-value]
