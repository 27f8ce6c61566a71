"""Boards: every corner where the print has it, codes as OpenCV reads them, manifests checked field by field."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gtcal.board import (
    BOARD_TYPES,
    CHESSBOARD_A2,
    DOTS_A2,
    PAPER_A2,
    AprilGrid,
    ArucoGrid,
    Board,
    CharucoBoard,
    aruco_dictionary,
    board_from_manifest,
    board_manifest_schema,
    load_board,
)
from gtcal.drawing import board_texture
from gtcal.errors import GtcalError

APRIL = AprilGrid(6, 5, 0.088, 0.3, first_tag_id=3)
PLAIN = ArucoGrid("DICT_5X5_100", 3, 4, 0.04, 0.013, first_tag_id=7)
CHARUCO = CharucoBoard("DICT_5X5_100", 8, 5, 0.04, 0.03)
BOARDS = (PAPER_A2, PLAIN, APRIL, CHARUCO)
APRIL_BLOCK = {"type": "aprilgrid", "tag_columns": 6, "tag_rows": 6, "tag_side_m": 0.088, "tag_spacing": 0.3}
CHARUCO_BLOCK = {
    "type": "charuco",
    "dictionary": "DICT_5X5_100",
    "square_columns": 8,
    "square_rows": 6,
    "square_side_m": 0.04,
    "marker_side_m": 0.03,
}

each_board = pytest.mark.parametrize("board", BOARDS, ids=lambda board: type(board).__name__)


@each_board
def test_corners_are_distinct_points_of_the_plane_inside_the_pattern(board: Board) -> None:
    assert board.corners_m.shape == (board.n_corners, 3)
    assert len(np.unique(board.corners_m.round(9), axis=0)) == board.n_corners
    assert not board.corners_m[:, 2].any()
    x_min, y_min, x_max, y_max = board.bounds_m
    assert (board.corners_m[:, :2] >= (x_min, y_min)).all()
    assert (board.corners_m[:, :2] <= (x_max + 1e-12, y_max + 1e-12)).all()
    assert board.width_m == pytest.approx(x_max - x_min)
    assert board.height_m == pytest.approx(y_max - y_min)
    assert isinstance(board, Board)


@each_board
def test_opencv_reads_every_tag_of_the_print_where_the_board_has_it(board: Board) -> None:
    texture = board_texture(board, texels_per_module=8)
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = board.border_modules
    detector = cv2.aruco.ArucoDetector(aruco_dictionary(board.dictionary), parameters)
    quads, ids, _ = detector.detectMarkers(cv2.blur(texture.image, (3, 3)))
    order = np.argsort(ids.ravel())
    np.testing.assert_array_equal(ids.ravel()[order], board.tag_ids)
    expected = texture.texels_of(board.tag_corners_m.reshape(-1, 3)).reshape(-1, 4, 2)
    assert np.abs(np.concatenate(quads)[order] - expected).max() < 2.0


@each_board
def test_a_corner_is_where_black_meets_white_as_its_quadrants_say(board: Board) -> None:
    texture = board_texture(board, texels_per_module=8)
    step_m = 0.9 * board.clear_band_m / 2 * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    places = (board.corners_m[:, None, :2] + step_m).reshape(-1, 2)
    columns, rows = np.rint(texture.texels_of(places)).astype(int).T
    np.testing.assert_array_equal((texture.image[rows, columns] == 0).reshape(-1, 4), board.corner_quadrants)
    assert board.corner_quadrants.any(axis=1).all()
    assert not board.corner_quadrants.all(axis=1).any()


def test_aprilgrid_counts_as_kalibr_does() -> None:
    """Tags row by row from the lower-left; corners lower-left, lower-right, upper-right, upper-left."""
    pitch = 1.3 * 0.088
    np.testing.assert_allclose(APRIL.corners_m[:4, :2], [(0, 0), (0.088, 0), (0.088, 0.088), (0, 0.088)])
    np.testing.assert_allclose(APRIL.corners_m[4 * 1, :2], (pitch, 0), atol=1e-12)
    np.testing.assert_allclose(APRIL.corners_m[4 * 6, :2], (0, pitch), atol=1e-12)
    assert APRIL.corner_name(4 * 6 + 2) == "tag 9 corner 2"


def test_aruco_grid_counts_as_opencv_does() -> None:
    """Tags row by row from the upper-left; corners upper-left, upper-right, lower-right, lower-left."""
    grid = cv2.aruco.GridBoard(
        (PLAIN.tag_columns, PLAIN.tag_rows), PLAIN.tag_side_m, PLAIN.tag_gap_m, aruco_dictionary(PLAIN.dictionary)
    )
    theirs = np.concatenate(grid.getObjPoints())
    height = PLAIN.height_m
    np.testing.assert_allclose(PLAIN.corners_m[:, 0], theirs[:, 0], atol=1e-6)
    np.testing.assert_allclose(PLAIN.corners_m[:, 1], height - theirs[:, 1], atol=1e-6)


@pytest.mark.parametrize("size", [(8, 6), (7, 5), (5, 8), (6, 7)])
def test_charuco_is_opencvs_board(size: tuple[int, int]) -> None:
    board = CharucoBoard("DICT_5X5_100", *size, 0.04, 0.03)
    theirs = cv2.aruco.CharucoBoard(size, 0.04, 0.03, aruco_dictionary("DICT_5X5_100"))
    texture = board_texture(board, texels_per_module=6, margin_m=0.0)
    height, width = texture.image.shape
    np.testing.assert_array_equal(texture.image, theirs.generateImage((width, height), marginSize=0))
    corners = theirs.getChessboardCorners()
    np.testing.assert_allclose(board.corners_m[:, 0], corners[:, 0], atol=1e-6)
    np.testing.assert_allclose(board.corners_m[:, 1], board.height_m - corners[:, 1], atol=1e-6)


def test_a_charuco_corner_lies_between_its_two_markers() -> None:
    centres = CHARUCO.tag_corners_m.mean(axis=1)[CHARUCO.corner_tags]
    assert centres.shape == (CHARUCO.n_corners, 2, 3)
    np.testing.assert_allclose(centres.mean(axis=1), CHARUCO.corners_m, atol=1e-12)


def test_an_upright_april_tag_shows_the_familys_code() -> None:
    """The first code of family 36h11 is 0xd5d628584, rows from the top, white 1 (OpenCV holds it upside down)."""
    texture = board_texture(AprilGrid(1, 1, 0.1, 0.3), texels_per_module=1, margin_m=0.0)
    code = texture.image[5:11, 5:11] == 255
    assert int("".join(str(int(white)) for white in code.ravel()), base=2) == 0xD5D628584


def test_the_papers_board() -> None:
    assert PAPER_A2.n_tags == 24
    assert PAPER_A2.tag_side_m == 0.059
    assert PAPER_A2.tag_gap_m == 0.0295
    assert PAPER_A2.width_m < 0.594
    assert PAPER_A2.height_m < 0.420
    white_across = PAPER_A2.corner_quadrants[:, [0, 1]] != PAPER_A2.corner_quadrants[:, [1, 2]]
    assert white_across.all(), "every tag corner is a checkerboard corner"
    squares = PAPER_A2.black_rectangles_m[-7 * 5 :]
    np.testing.assert_allclose(squares[:, 2:] - squares[:, :2], 0.0295)


def test_black_rectangles_do_not_overlap() -> None:
    for board in BOARDS:
        r = board.black_rectangles_m
        across = np.minimum(r[:, None, 2], r[None, :, 2]) - np.maximum(r[:, None, 0], r[None, :, 0])
        up = np.minimum(r[:, None, 3], r[None, :, 3]) - np.maximum(r[:, None, 1], r[None, :, 1])
        common = np.maximum(across, 0) * np.maximum(up, 0)
        np.fill_diagonal(common, 0)
        assert common.max() < 1e-12, board.describe()


@each_board
def test_a_board_comes_back_from_its_manifest(board: Board) -> None:
    assert board_from_manifest(board.to_manifest()) == board


def test_the_preset_is_the_papers_board() -> None:
    assert board_from_manifest({"preset": "paper_a2"}) == PAPER_A2


def test_whole_numbers_serve_as_lengths() -> None:
    board = board_from_manifest({**APRIL_BLOCK, "tag_side_m": 1, "tag_spacing": 1})
    assert board == AprilGrid(6, 6, 1.0, 1.0)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("aprilgrid", "'board' is 'aprilgrid'; expected fields"),
        ({}, "neither 'preset' .* nor 'type'"),
        ({"preset": "paper_a1"}, "preset 'paper_a1' is not known; presets: paper_a2"),
        ({"preset": "paper_a2", "tag_rows": 3}, "a preset and also tag_rows"),
        ({"type": "april"}, "type 'april' is not known; types: aruco_grid, aprilgrid, charuco"),
        ({**APRIL_BLOCK, "rows": 3}, "aprilgrid has no field 'rows'; fields: tag_columns, tag_rows"),
        ({"type": "aprilgrid", "tag_columns": 6}, "aprilgrid lacks tag_rows, tag_side_m, tag_spacing"),
        ({**APRIL_BLOCK, "tag_rows": 6.0}, "'tag_rows' is 6.0; expected a whole number"),
        ({**APRIL_BLOCK, "tag_rows": True}, "'tag_rows' is True; expected a whole number"),
        ({**APRIL_BLOCK, "tag_rows": 0}, "'tag_rows' is 0; expected 1 or more"),
        ({**APRIL_BLOCK, "tag_side_m": "0.088"}, "'tag_side_m' is '0.088'; expected a number"),
        ({**APRIL_BLOCK, "tag_side_m": 88.0}, "88 mm is 0.088 m"),
        ({**APRIL_BLOCK, "tag_side_m": float("nan")}, "'tag_side_m' is nan"),
        ({**APRIL_BLOCK, "tag_spacing": 26.4}, "'tag_spacing' is 26.4; expected 0.05 to 2"),
        ({**APRIL_BLOCK, "family": "36h12"}, "dictionary 'DICT_APRILTAG_36h12' is not known"),
        ({**APRIL_BLOCK, "tag_rows": 100}, "needs the tag ids 0 to 599, but DICT_APRILTAG_36h11 ends at 586"),
        ({**CHARUCO_BLOCK, "marker_side_m": 0.04}, "'marker_side_m' is 0.04; expected less than square_side_m = 0.04"),
        ({**CHARUCO_BLOCK, "square_rows": 1}, "'square_rows' is 1; expected 2 or more"),
        ({**CHARUCO_BLOCK, "dictionary": 5}, "'dictionary' is 5; expected a text"),
    ],
)
def test_a_wrong_block_is_refused_with_its_field(block: Any, message: str) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        board_from_manifest(block)
    assert "\n" not in str(caught.value)


def test_the_schema_knows_every_type_and_field() -> None:
    preset, *types = board_manifest_schema()["oneOf"]
    assert preset["properties"]["preset"]["enum"] == ["paper_a2", "chessboard", "dots"]
    assert [t["properties"]["type"]["const"] for t in types] == list(BOARD_TYPES)
    for schema, board in zip(types, (PLAIN, APRIL, CHARUCO, CHESSBOARD_A2, DOTS_A2), strict=True):
        assert set(board.to_manifest()) == set(schema["properties"])
        least = {name: value for name, value in board.to_manifest().items() if name in schema["required"]}
        assert type(board_from_manifest(least)) is type(board)
        for name in schema["required"]:
            with pytest.raises(GtcalError):
                board_from_manifest({key: value for key, value in least.items() if key != name})


def test_boards_are_loaded_by_name_from_a_block_and_from_a_manifest(tmp_path: Path) -> None:
    block, manifest = tmp_path / "board.yaml", tmp_path / "recording.yaml"
    block.write_text("{type: aprilgrid, tag_columns: 2, tag_rows: 3, tag_side_m: 0.05, tag_spacing: 0.25}")
    manifest.write_text(f"capture: fixed_cameras\nboard: {block.read_text()}\n")
    assert load_board("paper_a2") == PAPER_A2
    assert load_board(str(block)) == load_board(str(manifest)) == AprilGrid(2, 3, 0.05, 0.25)


@pytest.mark.parametrize(
    ("text", "message"),
    [("{type: april}", "board.yaml: board type 'april' is not known"), ("{type: [", "board.yaml: is not valid YAML")],
)
def test_a_wrong_board_file_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "board.yaml"
    path.write_text(text)
    with pytest.raises(GtcalError, match=message):
        load_board(str(path))


def test_neither_preset_nor_file() -> None:
    with pytest.raises(GtcalError, match=r"'nowhere.yaml' is no preset \(paper_a2, chessboard, dots\) and no file"):
        load_board("nowhere.yaml")


def test_ids_from_the_first_one_on() -> None:
    shifted = replace(PLAIN, first_tag_id=40)
    np.testing.assert_array_equal(shifted.tag_ids, np.arange(40, 52))
    assert shifted.corner_name(5) == "tag 41 corner 1"
    np.testing.assert_array_equal(shifted.corners_m, PLAIN.corners_m)
