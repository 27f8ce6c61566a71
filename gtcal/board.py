"""Calibration boards: where every corner lies, what is printed, and how a manifest names it.

Board frame, for every board: origin at the lower-left corner of the lower-left tag (tag grids) or of the
lower-left square (ChArUco, chessboard), or at the lower-left dot's centre, of the upright print, x right along the
print, y up, z out of the printed face towards the viewer. Right-handed, metres, all corners at z = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, get_type_hints, runtime_checkable

import cv2
import numpy as np
import numpy.typing as npt

from gtcal.board_base import BoardBase, check_count, check_side, mm
from gtcal.board_tolerance import tolerance_of
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.plain_boards import Chessboard, DotGrid
from gtcal.recordings.detections import IntArray

CodeArray = npt.NDArray[np.uint8]

# Kalibr's AprilGrid prints its tags with a black border of two modules (the plain AprilTag and ArUco: one).
_APRILGRID_BORDER_MODULES, _ARUCO_BORDER_MODULES = 2, 1
# OpenCV holds the AprilTag codes turned by half a turn against the families' own and so the upright AprilGrid: its
# upper-left corner of a tag is the print's lower-right. Reference corners of a real AprilGrid recording agree.
_APRILGRID_OPENCV_CORNERS = (1, 0, 3, 2)
_ARUCO_OPENCV_CORNERS = (0, 1, 2, 3)


@runtime_checkable
class Board(Protocol):
    """What a board knows about itself. C corners, lengths in metres.

    A *corner* is a point that is measured in images. Its id is its row in ``corners_m``."""

    @property
    def corners_m(self) -> FloatArray:
        """(C, 3) the corners in the board frame; corner ids are the row numbers."""

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the pattern in the board frame, without the white margin."""

    @property
    def module_m(self) -> float:
        """Side of one module (the smallest square of a tag's code)."""

    @property
    def black_rectangles_m(self) -> FloatArray:
        """(R, 4) the whole print as non-overlapping black rectangles x_min, y_min, x_max, y_max."""

    @property
    def discs_m(self) -> FloatArray:
        """(D, 3) x, y and radius of the discs that make the print, where it is of discs: the rectangles are strips of
        them then."""

    @property
    def turns(self) -> IntArray:
        """(G, C) the turns after which the print looks the same, the identity first: the corner that each corner comes
        to lie on. Of a board whose corners have codes, the identity alone."""

    @property
    def corner_quadrants(self) -> BoolArray:
        """(C, 4) whether the print is black next to a corner, towards (+x +y), (-x +y), (-x -y), (+x -y)."""

    @property
    def clear_band_m(self) -> float:
        """Around a corner the four quadrants are uniform up to this distance from either of its two edges."""

    @property
    def clear_reach_m(self) -> float:
        """... as far as this along the edges."""

    def corner_name(self, corner_id: int) -> str:
        """What a person calls this corner, as 'tag 7 corner 2'."""

    def describe(self) -> str:
        """The board in one line."""

    def to_manifest(self) -> dict[str, Any]:
        """The board as a manifest's ``board`` block; ``board_from_manifest`` reads it back."""

    @property
    def pitch_m(self) -> float:
        """From one tag of a grid, one square or one dot to the next."""

    def __hash__(self) -> int: ...
    @property
    def n_corners(self) -> int: ...
    @property
    def width_m(self) -> float: ...
    @property
    def height_m(self) -> float: ...


@runtime_checkable
class TaggedBoard(Board, Protocol):
    """A board of T tags, the printed codes. A *tag* is what tells corners apart; on a tag grid its four corners are
    measured, on a ChArUco board they only guide."""

    @property
    def dictionary(self) -> str:
        """OpenCV's name of the dictionary of codes, as DICT_4X4_50."""

    @property
    def border_modules(self) -> int:
        """Width of the black border around each code, in modules."""

    @property
    def tag_ids(self) -> IntArray:
        """(T,) the id of each tag in the dictionary."""

    @property
    def tag_corners_m(self) -> FloatArray:
        """(T, 4, 3) each tag's outer corners in the order in which OpenCV reports them: clockwise in the
        image, from the corner that is the upper-left one of OpenCV's own drawing of the code."""

    @property
    def corner_tags(self) -> IntArray:
        """(C, K) the tags next to each corner, -1 where there are fewer than K."""


class TagGrid(BoardBase):
    """A grid of square tags: tag t = 0 .. T-1 has the dictionary id ``first_tag_id + t`` and the corner ids
    4 t + c. ``ArucoGrid`` and ``AprilGrid`` differ in how t and c are counted and in what fills the gaps."""

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
        return _manifest_block(self)

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
        return _manifest_block(self)


def board_from_manifest(block: object) -> Board:
    """The board that a manifest's ``board`` block describes: ``{preset: paper_a2}``, or ``{type: ...}`` with
    the fields of that type. What the block states of its tolerance is no part of it.

    Raises GtcalError naming the field that is unknown, missing, of the wrong type or implausible."""
    if not isinstance(block, Mapping):
        raise GtcalError(f"'board' is {block!r}; expected fields, as 'preset: paper_a2' or 'type: aprilgrid' ...")
    given, _ = tolerance_of(block)
    if "preset" in given:
        return _preset(given)
    if "type" not in given:
        raise GtcalError(f"'board' has neither 'preset' ({_listed(PRESETS)}) nor 'type' ({_listed(BOARD_TYPES)})")
    type_name = given.pop("type")
    if type_name not in list(BOARD_TYPES):
        raise GtcalError(f"board type {type_name!r} is not known; types: {_listed(BOARD_TYPES)}")
    board_type = BOARD_TYPES[type_name]
    return board_type(**_checked_fields(type_name, board_type, given))


def load_board(name: str) -> Board:
    """The board of a preset's name, or of a YAML file: a board block by itself, or in a manifest.

    Raises GtcalError where ``name`` is neither, or the block is wrong."""
    from gtcal.documents import load_plain_yaml, read_text
    from gtcal.files import is_there

    if name in PRESETS:
        return PRESETS[name]
    if not is_there(Path(name)):
        raise GtcalError(f"board {name!r} is no preset ({_listed(PRESETS)}) and no file: No such file or directory")
    block = load_plain_yaml(Path(name), read_text(Path(name)))
    try:
        return board_from_manifest(block["board"] if isinstance(block, dict) and "board" in block else block)
    except GtcalError as error:
        raise GtcalError(f"{name}: {error}") from error


def board_manifest_schema() -> dict[str, Any]:
    """The JSON schema of a manifest's ``board`` block."""
    preset = _object_schema({"preset": {"enum": list(PRESETS)}}, ["preset"])
    types = [
        _object_schema(
            {"type": {"const": name}, **{f.name: _field_schema(t, f) for f in fields(t)}},
            ["type", *(f.name for f in fields(t) if f.default is MISSING)],
        )
        for name, t in BOARD_TYPES.items()
    ]
    return {"oneOf": [preset, *types]}


def _object_schema(properties: dict[str, Any], required: list[str]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def _field_schema(board_type: type, field: Field[Any]) -> dict[str, Any]:
    names = {int: "integer", float: "number", bool: "boolean", str: "string"}
    schema: dict[str, Any] = {"type": names[get_type_hints(board_type)[field.name]]}
    return schema if field.default is MISSING else {**schema, "default": field.default}


def _preset(given: dict[str, Any]) -> Board:
    name = given.pop("preset")
    if given:
        raise GtcalError(f"'board' has a preset and also {_listed(given)}; a preset stands alone")
    if name not in list(PRESETS):  # it may be a list, which has no hash
        raise GtcalError(f"board preset {name!r} is not known; presets: {_listed(PRESETS)}")
    return PRESETS[name]


def _checked_fields(type_name: str, board_type: type, given: dict[str, Any]) -> dict[str, Any]:
    known = {field.name: field for field in fields(board_type)}
    unknown = [name for name in given if name not in known]
    if unknown:
        raise GtcalError(f"board of type {type_name} has no field {unknown[0]!r}; fields: {_listed(known)}")
    missing = [name for name, field in known.items() if field.default is MISSING and name not in given]
    if missing:
        raise GtcalError(f"board of type {type_name} lacks {_listed(missing)}")
    hints = get_type_hints(board_type)
    return {name: _typed(type_name, name, value, hints[name]) for name, value in given.items()}


def _typed(type_name: str, name: str, value: Any, expected: type) -> Any:
    """The value as the field's type. YAML writes 1 for 1.0; it must not write true for 1 or 1 for true."""
    if expected is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not expected:
        words = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}
        raise GtcalError(f"board of type {type_name}: {name!r} is {value!r}; expected {words[expected]}")
    return value


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
        raise GtcalError(f"dictionary {name!r} is not known; dictionaries: {_listed(known)}")
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


def _manifest_block(board: Any) -> dict[str, Any]:
    type_name = next(name for name, known in BOARD_TYPES.items() if known is type(board))
    return {"type": type_name, **asdict(board)}


def _listed(names: Any) -> str:
    return ", ".join(str(name) for name in names)


# DICT_4X4_50, the smallest codes: the widest modules for a given tag, so read at the greatest distance and
# under the strongest distortion. Their short codes are no risk here, because a tag must also agree with its
# neighbours on the board. And the gap is three modules exactly.
PAPER_A2 = ArucoGrid(
    dictionary="DICT_4X4_50",
    tag_columns=6,
    tag_rows=4,
    tag_side_m=0.059,
    tag_gap_m=0.0295,
    first_tag_id=0,
    corner_squares=True,
)
# Both fit an A2 sheet, and have one way up.
CHESSBOARD_A2 = Chessboard(square_columns=11, square_rows=8, square_side_m=0.045)
DOTS_A2 = DotGrid(dot_columns=7, dot_rows=9, dot_pitch_m=0.07, asymmetric=True, dot_diameter_m=0.025)
PRESETS: dict[str, Board] = {"paper_a2": PAPER_A2, "chessboard": CHESSBOARD_A2, "dots": DOTS_A2}
BOARD_TYPES: dict[str, type[ArucoGrid] | type[AprilGrid] | type[CharucoBoard] | type[Chessboard] | type[DotGrid]] = {
    "aruco_grid": ArucoGrid,
    "aprilgrid": AprilGrid,
    "charuco": CharucoBoard,
    "chessboard": Chessboard,
    "dot_grid": DotGrid,
}
