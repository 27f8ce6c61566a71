"""Other readings of the board: how its tags and their corners are counted, its first id, its columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtcal.board import AprilGrid, ArucoGrid, Board, CharucoBoard, board_from_manifest
from gtcal.doctor.manifest_lines import line_of
from gtcal.errors import GtcalError
from gtcal.recordings.detections import CameraDetections, IntArray

Grid = ArucoGrid | AprilGrid

_MOST_COLUMNS = 16
_ARUCO_APRILTAG = "DICT_APRILTAG_"


@dataclass(frozen=True)
class BoardReading:
    """Another reading of the board. corner_ids: (C,) what each id of the stated board means on this one, -1 where it
    has no such corner."""

    fault: str
    says: str
    lines: tuple[str, ...]
    advice: tuple[str, ...]
    board: Board
    corner_ids: IntArray

    def reread(self, detections: CameraDetections) -> CameraDetections:
        """The detections with this board's corner ids; those it has not are left out."""
        ids = self.corner_ids[detections.corner_ids]
        keep = ids >= 0
        counts = np.add.reduceat(keep.astype(np.int64), detections.view_start[:-1])
        trimmed = CameraDetections(
            detections.stamps_ns,
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            ids[keep],
            detections.corners_px[keep],
        )
        return trimmed.select_views(counts > 0)


def board_readings(board: Board) -> Iterator[BoardReading]:
    """Other readings of a board, those first that one line of the manifest mends."""
    if isinstance(board, ArucoGrid | AprilGrid):
        yield from _other_types(board)
        yield from _other_columns(board)
        yield from _other_first_ids(board)
        yield from _renumbered(board)
    elif isinstance(board, CharucoBoard):
        yield from _other_squares(board)
        yield from _renumbered_chessboard(board)


def _same_ids(board: Board) -> IntArray:
    return np.arange(board.n_corners)


def _other_types(board: Grid) -> Iterator[BoardReading]:
    other: Grid
    if isinstance(board, AprilGrid):
        words = "from the upper left, as on ArUco boards"
        sizes = (board.tag_columns, board.tag_rows, board.tag_side_m, board.tag_gap_m, board.first_tag_id)
        other = ArucoGrid(board.dictionary, *sizes, corner_squares=True)
    elif board.dictionary.startswith(_ARUCO_APRILTAG):
        words = "from the lower left, as on Kalibr's AprilGrid"
        family = board.dictionary.removeprefix(_ARUCO_APRILTAG).lower()
        spacing = round(board.tag_gap_m / board.tag_side_m, 9)
        other = AprilGrid(board.tag_columns, board.tag_rows, board.tag_side_m, spacing, family, board.first_tag_id)
    else:
        return
    says = f"the tags and their corners are counted {words}"
    yield BoardReading("board type", says, (line_of("board", other.to_manifest()),), (), other, _same_ids(board))


def _other_columns(board: Grid) -> Iterator[BoardReading]:
    """Grids of other columns and rows, with ids in the same order."""
    for columns in range(1, min(_MOST_COLUMNS, board.n_tags) + 1):
        rows = -(-board.n_tags // columns)
        if columns == board.tag_columns:
            continue
        try:
            other = replace(board, tag_columns=columns, tag_rows=rows)
        except GtcalError:
            continue
        swapped = (columns, rows) == (board.tag_rows, board.tag_columns)
        yield BoardReading(
            "board columns and rows",
            "the board's columns and rows are exchanged" if swapped else f"the board has {columns} columns of tags",
            (f"board.tag_columns: {columns}", f"board.tag_rows: {rows}"),
            (),
            other,
            _same_ids(board),
        )


def _other_first_ids(board: Grid) -> Iterator[BoardReading]:
    """The same grid with its ids starting elsewhere."""
    ids = _same_ids(board)
    for shift in [step * sign for step in range(1, board.n_tags // 2 + 1) for sign in (1, -1)]:
        first = board.first_tag_id + shift
        moved = ids - 4 * shift
        moved[(moved < 0) | (moved >= board.n_corners)] = -1
        if first < 0:
            continue
        try:
            other = replace(board, first_tag_id=first)
        except GtcalError:
            continue
        yield BoardReading(
            "first tag id", f"the board's first tag is {first}", (f"board.first_tag_id: {first}",), (), other, moved
        )


def with_gap(board: Grid, spacing: float) -> BoardReading:
    """The grid with this gap between its tags, as a share of a tag's side."""
    if isinstance(board, AprilGrid):
        other, line = replace(board, tag_spacing=spacing), f"board.tag_spacing: {spacing:.4g}"
        says = f"the gaps between the board's tags are {spacing:.4g} of a tag's side, not {board.tag_spacing:.4g}"
        return BoardReading("board gaps", says, (line,), (), other, _same_ids(board))
    gap_m = float(f"{spacing * board.tag_side_m:.4g}")
    says = f"the gaps between the board's tags are {1e3 * gap_m:.4g} mm, not {1e3 * board.tag_gap_m:.4g}"
    line = f"board.tag_gap_m: {gap_m:g}"
    return BoardReading("board gaps", says, (line,), (), replace(board, tag_gap_m=gap_m), _same_ids(board))


def _renumbered(board: Grid) -> Iterator[BoardReading]:
    """Tags counted along columns, from other ends, and their corners from other corners or the other way round."""
    for grid_says, tags, columns, rows in _grids(board.tag_columns, board.tag_rows):
        other = replace(board, tag_columns=columns, tag_rows=rows)
        for corner_says, corners in _CORNERS.items():
            if not (grid_says or corner_says):
                continue
            ids = (4 * tags[:, None] + np.array(corners)).ravel()
            words = " and ".join(part for part in (grid_says, corner_says) if part)
            yield BoardReading(
                "tag order",
                f"in the detections {words}",
                (),
                (f"renumber the corners of the detections: in them {words}, against {board.describe()}",),
                other,
                ids,
            )


_CORNERS = {
    "": (0, 1, 2, 3),
    "the corners of a tag start one corner further": (1, 2, 3, 0),
    "the corners of a tag start two corners further": (2, 3, 0, 1),
    "the corners of a tag start three corners further": (3, 0, 1, 2),
    "the corners of a tag go round the other way": (0, 3, 2, 1),
    "the corners of a tag go round the other way, from the next corner": (1, 0, 3, 2),
    "the corners of a tag go round the other way, from the opposite corner": (2, 1, 0, 3),
    "the corners of a tag go round the other way, from the last corner": (3, 2, 1, 0),
}
"""Which corner of a tag is meant by 0, 1, 2, 3."""


def _grids(columns: int, rows: int) -> Iterator[tuple[str, IntArray, int, int]]:
    """Ways to count the tags of a grid: in words, the place (T,) of each id in the usual count, the grid's columns and
    rows."""
    place = np.arange(columns * rows).reshape(rows, columns)
    across = place.ravel()
    yield "", across, columns, rows
    yield "the rows of tags are counted from the other end", place[::-1].ravel(), columns, rows
    yield "the tags are counted from the right", place[:, ::-1].ravel(), columns, rows
    yield "the tags are counted backwards", place[::-1, ::-1].ravel(), columns, rows
    yield "the tags are counted column by column", place.T.ravel(), columns, rows
    yield "the tags are counted column by column from the other end", place[::-1].T.ravel(), columns, rows
    yield "the tags are counted column by column from the right", place[:, ::-1].T.ravel(), columns, rows
    yield "the tags are counted column by column backwards", place[::-1, ::-1].T.ravel(), columns, rows


def _other_squares(board: CharucoBoard) -> Iterator[BoardReading]:
    """Boards of other columns and rows with the corners counted in the same order."""
    if board.square_columns != board.square_rows:
        other = replace(board, square_columns=board.square_rows, square_rows=board.square_columns)
        yield BoardReading(
            "board columns and rows",
            "the board's columns and rows are exchanged",
            (f"board.square_columns: {board.square_rows}", f"board.square_rows: {board.square_columns}"),
            (),
            other,
            _same_ids(board),
        )


def _renumbered_chessboard(board: CharucoBoard) -> Iterator[BoardReading]:
    for words, ids, _, _ in _grids(board.square_columns - 1, board.square_rows - 1):
        if words:
            words = words.replace("tags", "corners")
            yield BoardReading(
                "tag order",
                f"in the detections {words}",
                (),
                (f"renumber the corners of the detections: in them {words}, against {board.describe()}",),
                board,
                ids,
            )


def scaled_board(board: Board, factor: float) -> tuple[Board, tuple[str, ...]]:
    """The board with its sides made larger, to four digits, and its lines in the manifest. Raises GtcalError where no
    board is of that size."""
    lengths_m = {name: value for name, value in board.to_manifest().items() if name.endswith("_m")}
    sides = {name: float(f"{factor * value:.4g}") for name, value in lengths_m.items() if value}
    larger = board_from_manifest(board.to_manifest() | sides)
    return larger, tuple(f"board.{name}: {side:g}" for name, side in sides.items())
