"""Detected corners on disk: gtcal's own CSV or Parquet, the same by tag and corner, and folders of one CSV per view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from gtcal.board import TagGrid
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.recordings.detections import CameraDetections, Cornered, IntArray
from gtcal.recordings.numbering import LARGEST_NUMBER, numbers_of, stamps_of
from gtcal.recordings.parquet_table import SUFFIX as PARQUET
from gtcal.recordings.parquet_table import ParquetTable, open_parquet, write_parquet
from gtcal.recordings.text_table import Kind, TextTable, open_table

DetectionFormat = Literal["csv", "parquet"]
"""How corners are kept, and the end of such a file's name. Parquet is smaller and read faster:
for recordings of millions of corners. It needs pyarrow."""

_HEADER, _NUMBERED_HEADER = "timestamp_ns,corner_id,x_px,y_px", "number,corner_id,x_px,y_px"
_ROWS_PER_WRITE = 100_000
# A corner printed at the same place differs by the rounding of its file; a wrong size or order by millimetres.
_SAME_CORNER_M = 1e-4


def read_detections(path: Path, board: Cornered, camera: Camera, *, numbered: bool = False) -> CameraDetections:
    """Read the detections of one camera from a CSV or Parquet file, or from all those of a folder. The header of each,
    or the names of its columns, tell its kind:

    - ``timestamp_ns,corner_id,x_px,y_px``: corner ids of the board;
    - ``timestamp_ns,tag_id,corner_index,x_px,y_px``: tag ids as printed, corners 0..3 of a tag as its board has;
    - ``#ts,tag_rows,tag_cols,tag_size,tag_spacing,kp_x,kp_y,p_x,p_y,p_z,tag_id,corner_idx``: yac's; the
      corner positions must be the board's.

    Where the recording is ``numbered``, the first column of the first two kinds is ``number``, that of the image.

    Rows come in any order. Raises GtcalError with file and line where a row can't be read, an id is not on the
    board, a corner appears twice in a view, or a pixel lies outside the image."""
    files = _files(path)
    if not files:
        raise GtcalError(f"{path}: there is no .csv or {PARQUET} file in this folder of detections")
    parts = [_read_file(file, board, camera, numbered) for file in files]
    return _joined(parts, board, numbered)


def write_detections(path: Path, detections: CameraDetections, *, numbered: bool = False) -> None:
    """Write detections as gtcal's own Parquet where the path ends so, else as its CSV; every digit. Views without
    corners leave no row.

    Raises GtcalError where that can't be written."""
    of_views = numbers_of(detections.stamps_ns) if numbered else detections.stamps_ns
    stamps_ns = np.repeat(of_views, np.diff(detections.view_start))
    if path.suffix == PARQUET:
        columns = stamps_ns, detections.corner_ids, *detections.corners_px.T
        write_parquet(path, dict(zip((_NUMBERED_HEADER if numbered else _HEADER).split(","), columns, strict=True)))
        return
    with write_aside(path) as file:
        file.write((_NUMBERED_HEADER if numbered else _HEADER) + "\n")
        for start in range(0, detections.n_corners, _ROWS_PER_WRITE):
            rows = slice(start, start + _ROWS_PER_WRITE)
            x_px, y_px = detections.corners_px[rows].T.tolist()
            lines = zip(stamps_ns[rows].tolist(), detections.corner_ids[rows].tolist(), x_px, y_px, strict=True)
            file.writelines(f"{stamp},{corner},{x!r},{y!r}\n" for stamp, corner, x, y in lines)


Table = TextTable | ParquetTable


def _files(path: Path) -> list[Path]:
    """The file, or those of a folder."""
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix in (".csv", PARQUET))


def _opened(path: Path) -> Table:
    return open_parquet(path) if path.suffix == PARQUET else open_table(path, ",")


@dataclass(frozen=True)
class StatedTags:
    """What files of detections say of their board. tag_ids: (T,) the tags seen, increasing. grid: columns, rows, side
    in m and spacing, None where the files have no such columns."""

    tag_ids: IntArray
    grid: tuple[int, int, float, float] | None


def stated_tags(path: Path) -> StatedTags | None:
    """What the detections of one camera say of their board, None where they name no tags. Raises GtcalError where they
    can't be read."""
    known = _LAYOUTS + _NUMBERED_LAYOUTS
    tables = [(table, _layout(table, known)) for table in map(_opened, _files(path))]
    rows = [table.read(layout.columns) for table, layout in tables if ("tag_id", "integer") in layout.columns]
    if not rows:
        return None
    tag_ids = np.unique(np.concatenate([of_file["tag_id"] for of_file in rows]))
    if "tag_size" not in (rows[0].dtype.names or ()):
        return StatedTags(tag_ids, None)
    first = rows[0][0]
    return StatedTags(
        tag_ids,
        (int(first["tag_cols"]), int(first["tag_rows"]), float(first["tag_size"]), float(first["tag_spacing"])),
    )


@dataclass(frozen=True)
class _Part:
    """The rows of one file: time stamps, corner ids (N,) and pixels (N, 2)."""

    table: Table
    stamps_ns: IntArray
    corner_ids: IntArray
    corners_px: FloatArray


@dataclass(frozen=True)
class _Layout:
    """A kind of detection file: its columns, those of the pixel, and how its rows name a corner of the board."""

    columns: tuple[tuple[str, Kind], ...]
    pixel: tuple[str, str]
    corner_ids: Callable[[Table, npt.NDArray, Cornered], IntArray]


def _corner_ids_as_given(table: Table, rows: npt.NDArray, board: Cornered) -> IntArray:
    ids = rows["corner_id"]
    bad = np.flatnonzero((ids < 0) | (ids >= board.n_corners))
    if len(bad):
        raise table.error(
            int(bad[0]),
            f"corner_id {ids[bad[0]]} is not on the board; expected 0 to {board.n_corners - 1} ({board.describe()})",
        )
    return ids


def _corner_ids_by_tag(table: Table, rows: npt.NDArray, board: Cornered) -> IntArray:
    if not isinstance(board, TagGrid):
        raise GtcalError(
            f"{table.path}: the file names corners by tag, but the board is no grid of tags ({board.describe()}); "
            f"expected the header {_HEADER}"
        )
    corner_name = table.header()[-1] if "corner_idx" in table.header() else "corner_index"
    index, corner = rows["tag_id"] - board.first_tag_id, rows[corner_name]
    bad = np.flatnonzero((index < 0) | (index >= board.n_tags))
    if len(bad):
        last = board.first_tag_id + board.n_tags - 1
        raise table.error(
            int(bad[0]),
            f"tag_id {rows['tag_id'][bad[0]]} is not on the board; expected {board.first_tag_id} to {last} "
            f"({board.describe()})",
        )
    bad = np.flatnonzero((corner < 0) | (corner > 3))
    if len(bad):
        raise table.error(int(bad[0]), f"{corner_name} is {corner[bad[0]]}; a tag has the corners 0 to 3")
    return 4 * index + corner


def _corner_ids_of_aprilgrid(table: Table, rows: npt.NDArray, board: Cornered) -> IntArray:
    ids = _corner_ids_by_tag(table, rows, board)
    in_file_m = np.stack([rows[f"p_{axis}"] for axis in "xyz"], axis=1)
    apart_m = np.abs(in_file_m - board.corners_m[ids]).max(axis=1)
    bad = np.flatnonzero(apart_m > _SAME_CORNER_M)
    if len(bad):
        row = rows[bad[0]]
        raise table.error(
            int(bad[0]),
            f"{board.corner_name(int(ids[bad[0]]))} lies at ({row['p_x']:g}, {row['p_y']:g}, {row['p_z']:g}) m on "
            f"this file's board of {row['tag_cols']} x {row['tag_rows']} tags of {1000 * row['tag_size']:g} mm, "
            f"spacing {row['tag_spacing']:g}, not where the manifest's board has it: {board.describe()}",
        )
    return ids


_STAMP: tuple[str, Kind] = ("timestamp_ns", "stamp")
_NUMBER: tuple[str, Kind] = ("number", "integer")
_PIXEL: tuple[tuple[str, Kind], ...] = (("x_px", "number"), ("y_px", "number"))
_LAYOUTS = (
    _Layout((_STAMP, ("corner_id", "integer"), *_PIXEL), ("x_px", "y_px"), _corner_ids_as_given),
    _Layout(
        (_STAMP, ("tag_id", "integer"), ("corner_index", "integer"), *_PIXEL), ("x_px", "y_px"), _corner_ids_by_tag
    ),
    _Layout(
        (
            ("ts", "stamp"),
            ("tag_rows", "integer"),
            ("tag_cols", "integer"),
            *((name, "number") for name in ("tag_size", "tag_spacing", "kp_x", "kp_y", "p_x", "p_y", "p_z")),
            ("tag_id", "integer"),
            ("corner_idx", "integer"),
        ),
        ("kp_x", "kp_y"),
        _corner_ids_of_aprilgrid,
    ),
)
_NUMBERED_LAYOUTS = tuple(replace(layout, columns=(_NUMBER, *layout.columns[1:])) for layout in _LAYOUTS[:2])


def _read_file(path: Path, board: Cornered, camera: Camera, numbered: bool) -> _Part:
    table = _opened(path)
    layout = _layout(table, _NUMBERED_LAYOUTS if numbered else _LAYOUTS)
    rows = table.read(layout.columns)
    corners_px = np.stack([rows[name] for name in layout.pixel], axis=1)
    of_views = rows[layout.columns[0][0]]
    stamps_ns = _stamps_of_numbers(table, of_views) if numbered else table.stamps_ns(of_views, "ns")
    _check_in_image(table, corners_px, camera)
    return _Part(table, stamps_ns, layout.corner_ids(table, rows, board), corners_px)


def _stamps_of_numbers(table: Table, numbers: IntArray) -> IntArray:
    bad = np.flatnonzero((numbers < 0) | (numbers > LARGEST_NUMBER))
    if len(bad):
        raise table.error(
            int(bad[0]),
            f"number is {numbers[bad[0]]}; expected an image's, 0 to {LARGEST_NUMBER} (is it a time?)",
        )
    return stamps_of(numbers)


def _layout(table: Table, layouts: tuple[_Layout, ...]) -> _Layout:
    for layout in layouts:
        if table.holds(_names(layout)):
            return layout
    hint = ""
    if any(map(table.holds, map(_names, _LAYOUTS))):
        hint = "; numbered: true, but these corners have time stamps"
    elif any(map(table.holds, map(_names, _NUMBERED_LAYOUTS))):
        hint = "; these corners go by number: set numbered: true"
    raise GtcalError(
        f"{table.path}:1: the header is {','.join(table.header())!r}, not that of a file of detections; "
        f"expected {' or '.join(','.join(_names(layout)) for layout in layouts[:2])}{hint}"
    )


def _names(layout: _Layout) -> tuple[str, ...]:
    return tuple(name for name, _ in layout.columns)


def _check_in_image(table: Table, corners_px: FloatArray, camera: Camera) -> None:
    bad = np.flatnonzero(~camera.in_image(corners_px))
    if len(bad):
        x, y = corners_px[bad[0]]
        raise table.error(
            int(bad[0]),
            f"the pixel ({x:g}, {y:g}) lies outside the {camera.image_width_px} x {camera.image_height_px} "
            f"image of camera {camera.name!r}; were the corners found in images of another size?",
        )


def _joined(parts: list[_Part], board: Cornered, numbered: bool) -> CameraDetections:
    """The parts as one, in order of time; within a view in the order of the files."""
    stamps_ns, corner_ids, corners_px = (
        _concatenated([getattr(part, column) for part in parts]) for column in ("stamps_ns", "corner_ids", "corners_px")
    )
    if not _increasing(stamps_ns, corner_ids):
        _check_unique(parts, stamps_ns, corner_ids, board, numbered)
        order = np.argsort(stamps_ns, kind="stable")
        stamps_ns, corner_ids, corners_px = stamps_ns[order], corner_ids[order], corners_px[order]
    first = np.flatnonzero(np.diff(stamps_ns, prepend=stamps_ns[:1] - 1))
    view_start = np.append(first, len(stamps_ns)).astype(np.int64)
    return CameraDetections(stamps_ns[first], view_start, corner_ids, corners_px)


def _concatenated(parts: list[npt.NDArray]) -> npt.NDArray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _increasing(stamps_ns: IntArray, corner_ids: IntArray) -> bool:
    """Whether the rows come in order of time, and those of a view in order of their ids, as gtcal writes them."""
    later = np.diff(stamps_ns)
    return bool(((later > 0) | ((later == 0) & (np.diff(corner_ids) > 0))).all())


def _check_unique(
    parts: list[_Part], stamps_ns: IntArray, corner_ids: IntArray, board: Cornered, numbered: bool
) -> None:
    order = np.lexsort((corner_ids, stamps_ns))
    same = (np.diff(stamps_ns[order]) == 0) & (np.diff(corner_ids[order]) == 0)
    if not same.any():
        return
    row = int(order[1:][same].min())
    name = board.corner_name(int(corner_ids[row]))
    view = f"of image {numbers_of(stamps_ns)[row]}" if numbered else f"at {stamps_ns[row]} ns"
    for part in parts:
        if row < len(part.stamps_ns):
            raise part.table.error(row, f"{name} appears twice in the view {view}")
        row -= len(part.stamps_ns)
