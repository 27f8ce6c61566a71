"""Boards of tags, whose printed codes tell their corners apart: ArUco grids, AprilGrids, ChArUco boards.

The frame of all boards is said in ``gtcal.board``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from gtcal.board_base import BoardBase, check_count, check_side, mm
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

# Kalibr's AprilGrid prints its tags with a black border of two modules (the plain AprilTag and ArUco: one).
_APRILGRID_BORDER_MODULES, _ARUCO_BORDER_MODULES = 2, 1
# OpenCV holds the AprilTag codes turned by half a turn against the families' own and so the upright AprilGrid: its
# upper-left corner of a tag is the print's lower-right. Reference corners of a real AprilGrid recording agree.
_APRILGRID_OPENCV_CORNERS = (1, 0, 3, 2)
_ARUCO_OPENCV_CORNERS = (0, 1, 2, 3)


class TagGrid(BoardBase):
    """A grid of square tags: tag t = 0 .. T-1 has the dictionary id ``first_tag_id + t`` and the corner ids
    4 t + c. ``ArucoGrid`` and ``AprilGrid`` differ in how t and c are counted and in what fills the gaps."""

    type_name: ClassVar[str]  # in a manifest
    tag_columns: int
    tag_rows: int
    tag_side_m: float
    first_tag_id: int
    rows_from_the_top: ClassVar[bool]
    # The corners c = 0..3 within a tag, as (right, up), and the corner c that OpenCV reports 1st .. 4th.
    corner_order: ClassVar[tuple[tuple[int, int], ...]]
    opencv_corners: ClassVar[tuple[int, ...]]
    border_modules: int

    @property
    def has_corner_squares(self) -> bool:
        """Whether black squares fill the grid's intersections, so that every tag corner is a saddle."""
        raise NotImplementedError

    if TYPE_CHECKING:  # fields of ArucoGrid, derived in AprilGrid

        @property
        def dictionary(self) -> str: ...
        @property
        def tag_gap_m(self) -> float: ...

    @property
    def n_tags(self) -> int:
        return self.tag_columns * self.tag_rows

    @property
    def tag_ids(self) -> IntArray:
        return self.first_tag_id + np.arange(self.n_tags)

    @property
    def pitch_m(self) -> float:
        return self.tag_side_m + self.tag_gap_m

    @cached_property
    def tag_origins_m(self) -> FloatArray:
        """(T, 2) the lower-left corner of each tag."""
        row, column = np.divmod(np.arange(self.n_tags), self.tag_columns)
        row_up = self.tag_rows - 1 - row if self.rows_from_the_top else row
        return np.stack([column, row_up], axis=1) * self.pitch_m

    @cached_property
    def corners_m(self) -> FloatArray:
        offsets = np.array(self.corner_order) * self.tag_side_m
        flat = (self.tag_origins_m[:, None] + offsets).reshape(-1, 2)
        return np.column_stack([flat, np.zeros(len(flat))])

    @property
    def tag_corners_m(self) -> FloatArray:
        return self.corners_m.reshape(-1, 4, 3)[:, list(self.opencv_corners)]

    @property
    def corner_tags(self) -> IntArray:
        return np.repeat(np.arange(self.n_tags), 4)[:, None]

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        width = self.tag_columns * self.pitch_m - self.tag_gap_m
        height = self.tag_rows * self.pitch_m - self.tag_gap_m
        rim = self.tag_gap_m if self.has_corner_squares else 0.0
        return -rim, -rim, width + rim, height + rim

    @property
    def module_m(self) -> float:
        return self.tag_side_m / (_code_bits(self.dictionary) + 2 * self.border_modules)

    @property
    def clear_band_m(self) -> float:
        return min(self.border_modules * self.module_m, self.tag_gap_m)

    @property
    def clear_reach_m(self) -> float:
        return min(self.tag_gap_m, self.tag_side_m / 2)

    @cached_property
    def black_rectangles_m(self) -> FloatArray:
        tags = [
            _tag_rectangles(_tag_modules(self, int(tag_id)), origin, self.module_m)
            for tag_id, origin in zip(self.tag_ids, self.tag_origins_m, strict=True)
        ]
        return np.concatenate([*tags, self._corner_squares()])

    def _corner_squares(self) -> FloatArray:
        if not self.has_corner_squares:
            return np.empty((0, 4))
        column, row = np.meshgrid(np.arange(self.tag_columns + 1), np.arange(self.tag_rows + 1))
        upper_right = np.stack([column.ravel(), row.ravel()], axis=1) * self.pitch_m
        return np.column_stack([upper_right - self.tag_gap_m, upper_right])

    def corner_name(self, corner_id: int) -> str:
        return f"tag {self.first_tag_id + corner_id // 4} corner {corner_id % 4}"

    def to_manifest(self) -> dict[str, Any]:
        return {"type": self.type_name, **asdict(self)}  # type: ignore[call-overload]

    def _check(self) -> None:
        check_count(self, "tag_columns", 1)
        check_count(self, "tag_rows", 1)
        check_count(self, "first_tag_id", 0)
        check_side(self, "tag_side_m")
        _check_ids(self, self.dictionary, self.first_tag_id, self.n_tags)


@dataclass(frozen=True)
class ArucoGrid(TagGrid):
    """Tags of an OpenCV ArUco dictionary, numbered row by row from the UPPER-left; corners of a tag as OpenCV
    has them: 0 upper-left, 1 upper-right, 2 lower-right, 3 lower-left.

    dictionary: OpenCV's name, as DICT_4X4_50.
    tag_side_m, tag_gap_m: side of a tag's black square, and the white between two tags.
    corner_squares: black squares at every intersection of the gaps, also around the border, so that every
        tag corner is a checkerboard corner.
    Raises GtcalError where a field is out of range."""

    dictionary: str
    tag_columns: int
    tag_rows: int
    tag_side_m: float
    tag_gap_m: float
    first_tag_id: int = 0
    corner_squares: bool = False

    type_name = "aruco_grid"
    rows_from_the_top = True
    corner_order = ((0, 1), (1, 1), (1, 0), (0, 0))
    opencv_corners = _ARUCO_OPENCV_CORNERS
    border_modules = _ARUCO_BORDER_MODULES

    def __post_init__(self) -> None:
        self._check()
        check_side(self, "tag_gap_m")

    @property
    def has_corner_squares(self) -> bool:
        return self.corner_squares

    def describe(self) -> str:
        squares = "with" if self.corner_squares else "without"
        return (
            f"ArUco grid {self.tag_columns} x {self.tag_rows} of {self.dictionary}, "
            f"first id {self.first_tag_id}, tags {mm(self.tag_side_m)}, gaps {mm(self.tag_gap_m)}, "
            f"{squares} corner squares"
        )


@dataclass(frozen=True)
class AprilGrid(TagGrid):
    """Kalibr's AprilGrid: AprilTags with a border of two modules, numbered row by row from the LOWER-left,
    black squares at every intersection; corners of a tag 0 lower-left, 1 lower-right, 2 upper-right,
    3 upper-left.

    family: AprilTag family, as 36h11.
    tag_spacing: gap between tags over the side of a tag (Kalibr's tagSpacing, yac's tag_spacing).
    Raises GtcalError where a field is out of range."""

    tag_columns: int
    tag_rows: int
    tag_side_m: float
    tag_spacing: float
    family: str = "36h11"
    first_tag_id: int = 0

    type_name = "aprilgrid"
    rows_from_the_top = False
    corner_order = ((0, 0), (1, 0), (1, 1), (0, 1))
    opencv_corners = _APRILGRID_OPENCV_CORNERS
    border_modules = _APRILGRID_BORDER_MODULES

    def __post_init__(self) -> None:
        self._check()
        if not 0.05 <= self.tag_spacing <= 2.0:
            raise GtcalError(
                f"board field 'tag_spacing' is {self.tag_spacing:g}; expected 0.05 to 2, "
                "the gap between tags over the side of a tag (0.3 on Kalibr's boards)"
            )

    @property
    def tag_gap_m(self) -> float:
        return self.tag_spacing * self.tag_side_m

    @property
    def has_corner_squares(self) -> bool:
        return True

    @property
    def dictionary(self) -> str:
        return f"DICT_APRILTAG_{self.family}"

    def describe(self) -> str:
        return (
            f"AprilGrid {self.tag_columns} x {self.tag_rows} of tag{self.family}, "
            f"first id {self.first_tag_id}, tags {mm(self.tag_side_m)}, "
            f"spacing {self.tag_spacing:g} ({mm(self.tag_gap_m)})"
        )


@dataclass(frozen=True)
class CharucoBoard(BoardBase):
    """OpenCV's ChArUco board (the pattern of OpenCV 4.6 and later): a chessboard with a marker in every white
    square. The corners are the inner chessboard corners, numbered row by row from the upper-left, as OpenCV
    does.

    square_columns, square_rows: chessboard squares across and down.
    square_side_m, marker_side_m: side of a square, and of the black marker inside the white ones.
    Raises GtcalError where a field is out of range."""

    dictionary: str
    square_columns: int
    square_rows: int
    square_side_m: float
    marker_side_m: float

    type_name = "charuco"
    border_modules = _ARUCO_BORDER_MODULES

    def __post_init__(self) -> None:
        check_count(self, "square_columns", 2)
        check_count(self, "square_rows", 2)
        check_side(self, "square_side_m")
        check_side(self, "marker_side_m")
        if self.marker_side_m >= self.square_side_m:
            raise GtcalError(
                f"board field 'marker_side_m' is {self.marker_side_m:g}; expected less than "
                f"square_side_m = {self.square_side_m:g}"
            )
        _check_ids(self, self.dictionary, 0, self.square_columns * self.square_rows // 2)

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        return 0.0, 0.0, self.square_columns * self.square_side_m, self.square_rows * self.square_side_m

    @property
    def pitch_m(self) -> float:
        return self.square_side_m

    @property
    def module_m(self) -> float:
        return self.marker_side_m / (_code_bits(self.dictionary) + 2 * self.border_modules)

    @property
    def clear_band_m(self) -> float:
        return (self.square_side_m - self.marker_side_m) / 2

    @property
    def clear_reach_m(self) -> float:
        return self.square_side_m

    @cached_property
    def corners_m(self) -> FloatArray:
        row, column = np.divmod(np.arange((self.square_columns - 1) * (self.square_rows - 1)), self.square_columns - 1)
        grid = np.stack([column + 1, self.square_rows - 1 - row, np.zeros(len(row))], axis=1)
        return grid * self.square_side_m

    @cached_property
    def _white_squares(self) -> IntArray:
        """(T, 2) column and row (counted from the top) of the squares that hold a marker, in order of id."""
        row, column = np.divmod(np.arange(self.square_columns * self.square_rows), self.square_columns)
        white = (row + column) % 2 == 1
        return np.stack([column[white], row[white]], axis=1)

    def _lower_left_m(self, squares: IntArray) -> FloatArray:
        up = self.square_rows - 1 - squares[:, 1]
        return np.stack([squares[:, 0], up], axis=1) * self.square_side_m

    @property
    def tag_ids(self) -> IntArray:
        return np.arange(len(self._white_squares))

    @cached_property
    def tag_corners_m(self) -> FloatArray:
        lower_left = self._lower_left_m(self._white_squares) + self.clear_band_m
        corners = lower_left[:, None] + np.array(ArucoGrid.corner_order) * self.marker_side_m
        return np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2)

    @cached_property
    def corner_tags(self) -> IntArray:
        centres = self.tag_corners_m.mean(axis=1)
        apart = np.abs(self.corners_m[:, None, :2] - centres[None, :, :2]).max(axis=2)
        return np.stack([np.flatnonzero(row < 0.75 * self.square_side_m) for row in apart])

    @cached_property
    def black_rectangles_m(self) -> FloatArray:
        row, column = np.divmod(np.arange(self.square_columns * self.square_rows), self.square_columns)
        black = (row + column) % 2 == 0
        lower_left = self._lower_left_m(np.stack([column[black], row[black]], axis=1))
        squares = np.column_stack([lower_left, lower_left + self.square_side_m])
        tags = [
            _tag_rectangles(_tag_modules(self, int(tag_id)), corners[3, :2], self.module_m)
            for tag_id, corners in zip(self.tag_ids, self.tag_corners_m, strict=True)
        ]
        return np.concatenate([squares, *tags])

    def corner_name(self, corner_id: int) -> str:
        return f"chessboard corner {corner_id}"

    def describe(self) -> str:
        return (
            f"ChArUco board {self.square_columns} x {self.square_rows} of {self.dictionary}, "
            f"squares {mm(self.square_side_m)}, markers {mm(self.marker_side_m)}"
        )

    def to_manifest(self) -> dict[str, Any]:
        return {"type": self.type_name, **asdict(self)}


def _check_ids(board: Any, dictionary: str, first_id: int, n_tags: int) -> None:
    size = len(aruco_dictionary(dictionary).bytesList)
    if first_id + n_tags > size:
        raise GtcalError(
            f"the board needs the tag ids {first_id} to {first_id + n_tags - 1}, "
            f"but {dictionary} ends at {size - 1}: take a larger dictionary or a smaller board"
        )


def aruco_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's predefined dictionary of this name. Raises GtcalError where OpenCV has none."""
    known = sorted(key for key in dir(cv2.aruco) if key.startswith("DICT_"))
    if name not in known:
        raise GtcalError(f"dictionary {name!r} is not known; dictionaries: {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@lru_cache
def _code_bits(dictionary: str) -> int:
    """Modules along the side of a code of this dictionary, without its border."""
    return int(aruco_dictionary(dictionary).markerSize)


@lru_cache
def tag_codes(dictionary: str, tag_ids: tuple[int, ...], border_modules: int) -> BoolArray:
    """(T, M, M) whether each module of these tags is white, border included, rows from the top, in OpenCV's
    own drawing of the code."""
    codes = aruco_dictionary(dictionary)
    side = codes.markerSize + 2 * border_modules
    drawn = [cv2.aruco.generateImageMarker(codes, i, side, borderBits=border_modules) for i in tag_ids]
    return np.stack(drawn) > 127


def _tag_modules(board: Any, tag_id: int) -> BoolArray:
    """(M, M) whether each module of the upright print of a tag is black, rows from the top."""
    drawn = ~tag_codes(board.dictionary, (tag_id,), board.border_modules)[0]
    return np.rot90(drawn, 2) if isinstance(board, AprilGrid) else drawn


def _tag_rectangles(modules: BoolArray, lower_left_m: FloatArray, module_m: float) -> FloatArray:
    """(R, 4) the black modules of a tag as rectangles, runs of a row joined."""
    rectangles = []
    for up, row in enumerate(modules[::-1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        rectangles += [(start, up, end, up + 1) for start, end in edges.reshape(-1, 2)]
    return np.array(rectangles) * module_m + np.tile(lower_left_m, 2)
