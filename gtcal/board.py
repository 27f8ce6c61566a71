"""Calibration boards: where every corner lies, what is printed, and how a manifest names it.

Board frame, for every board: origin at the lower-left corner of the lower-left tag (tag grids) or of the
lower-left square (ChArUco, chessboard), or at the lower-left dot's centre, of the upright print, x right along the
print, y up, z out of the printed face towards the viewer. Right-handed, metres, all corners at z = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, Protocol, get_type_hints, runtime_checkable

from gtcal.board_tolerance import tolerance_of
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.plain_boards import Chessboard, DotGrid
from gtcal.recordings.detections import IntArray
from gtcal.tag_boards import AprilGrid as AprilGrid
from gtcal.tag_boards import ArucoGrid as ArucoGrid
from gtcal.tag_boards import CharucoBoard as CharucoBoard
from gtcal.tag_boards import TagGrid as TagGrid
from gtcal.tag_boards import aruco_dictionary as aruco_dictionary
from gtcal.tag_boards import tag_codes as tag_codes


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
