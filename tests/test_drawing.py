"""Drawings: rasters that are exact, prints to scale in every format, and the command that makes them."""

from __future__ import annotations

import base64
import re
import struct
import zlib
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml

from gtcal.board import PAPER_A2, AprilGrid, ArucoGrid, Board, CharucoBoard, board_from_manifest
from gtcal.cli import main
from gtcal.detection.detect import detect_view
from gtcal.drawing import ISO_PAGES_MM, board_texture, draw_board, sheet_of
from gtcal.errors import GtcalError

APRIL = AprilGrid(4, 3, 0.05, 0.3)
CHARUCO = CharucoBoard("DICT_5X5_100", 8, 6, 0.03, 0.0225)
SKEW = ArucoGrid("DICT_4X4_50", 3, 2, 0.05, 0.0171)
BOARDS = (PAPER_A2, APRIL, CHARUCO, SKEW)
POINT_MM = 25.4 / 72

each_board = pytest.mark.parametrize("board", BOARDS, ids=["paper_a2", "april", "charuco", "skew"])


@each_board
def test_a_textures_black_area_is_the_prints(board: Board) -> None:
    texture = board_texture(board, texels_per_module=5)
    r = board.black_rectangles_m
    area_m2 = ((r[:, 2] - r[:, 0]) * (r[:, 3] - r[:, 1])).sum()
    black_m2 = (1 - texture.image / 255).sum() * texture.texel_m**2
    assert black_m2 == pytest.approx(area_m2, rel=1e-3)


@pytest.mark.parametrize("board", [PAPER_A2, APRIL, CHARUCO], ids=["paper_a2", "april", "charuco"])
def test_a_textures_edges_are_the_prints_where_they_are_commensurable(board: Board) -> None:
    texture = board_texture(board, texels_per_module=5)
    assert set(np.unique(texture.image)) == {0, 255}
    beside = texture.texels_of(board.corners_m) + 0.5
    np.testing.assert_allclose(beside, np.rint(beside), atol=1e-6)


def test_texels_that_an_edge_cuts_are_grey_where_it_is_not() -> None:
    texture = board_texture(SKEW, texels_per_module=5)
    assert len(np.unique(texture.image)) > 2
    assert (texture.image[0] == 255).all()


def test_the_texture_is_seen_by_the_detector_where_the_board_says() -> None:
    texture = board_texture(APRIL, texels_per_module=4, margin_m=0.02)
    ids, corners_px = detect_view(cv2.GaussianBlur(texture.image, (0, 0), 0.7), APRIL)
    np.testing.assert_array_equal(ids, np.arange(APRIL.n_corners))
    assert np.abs(corners_px - texture.texels_of(APRIL.corners_m)).max() < 0.03


# Prints


def test_pages_are_chosen_and_turned_to_hold_the_board() -> None:
    assert mm(sheet_of(PAPER_A2)) == (594, 420)
    assert mm(sheet_of(AprilGrid(3, 6, 0.03, 0.3))) == (210, 297)
    assert mm(sheet_of(AprilGrid(6, 3, 0.03, 0.3))) == (297, 210)
    assert mm(sheet_of(APRIL, "a1")) == (841, 594)
    assert mm(sheet_of(AprilGrid(3, 6, 0.03, 0.3), "400x250")) == (250, 400)


def mm(sheet: object) -> tuple[float, float]:
    return round(1000 * sheet.width_m, 6), round(1000 * sheet.height_m, 6)  # type: ignore[attr-defined]


@each_board
def test_the_pattern_lies_in_the_middle_clear_of_the_ruler(board: Board) -> None:
    sheet = sheet_of(board)
    pattern, ruler = sheet.rectangles_m[: len(board.black_rectangles_m)], ruler_of(sheet, board)
    low, high = pattern[:, :2].min(axis=0), pattern[:, 2:].max(axis=0)
    np.testing.assert_allclose(low + high, (sheet.width_m, sheet.height_m), atol=1e-9)
    assert low.min() >= 0.0079
    assert low[1] - ruler[:, 3].max() > 0.002
    assert low[1] - max(text.y_m + text.size_m for text in sheet.texts) > 0.002
    np.testing.assert_allclose(pattern, board.black_rectangles_m + np.tile(sheet.board_origin_m, 2))


def ruler_of(sheet: object, board: Board) -> np.ndarray:
    return np.asarray(sheet.rectangles_m[len(board.black_rectangles_m) :])  # type: ignore[attr-defined]


def test_the_ruler_is_100_mm_from_outer_edge_to_outer_edge() -> None:
    ruler = ruler_of(sheet_of(APRIL), APRIL)
    assert ruler[:, 2].max() - ruler[:, 0].min() == pytest.approx(0.1, abs=1e-12)
    middles = np.sort((ruler[1:, 0] + ruler[1:, 2]) / 2)
    assert len(middles) == 11
    np.testing.assert_allclose(np.diff(middles), 0.01, atol=3e-5)


def test_the_caption_describes_the_board_and_fits_the_page() -> None:
    board = AprilGrid(2, 2, 0.05, 0.3)
    sheet = sheet_of(board)
    caption = sheet.texts[0]
    assert board.describe() in caption.words
    assert caption.x_m + 0.5 * caption.size_m * len(caption.words) < sheet.width_m


@each_board
def test_a_pdf_has_every_rectangle_to_scale(board: Board, tmp_path: Path) -> None:
    sheet = draw_board(board, tmp_path / "board.pdf")
    data = (tmp_path / "board.pdf").read_bytes()
    box = [float(n) for n in re.search(rb"/MediaBox \[([^\]]*)\]", data)[1].split()]  # type: ignore[index]
    np.testing.assert_allclose(np.array(box[2:]) * POINT_MM, mm(sheet), atol=1e-3)
    stream = re.search(rb"stream\r?\n(.*?)endstream", data, re.DOTALL)[1].strip()  # type: ignore[index]
    content = zlib.decompress(base64.a85decode(stream.removesuffix(b"~>"))).decode("latin-1")
    drawn = np.array([[float(n) for n in m] for m in re.findall(r"(\S+) (\S+) (\S+) (\S+) re", content)])
    drawn_mm = POINT_MM * np.column_stack([drawn[:, :2], drawn[:, :2] + drawn[:, 2:]])
    np.testing.assert_allclose(drawn_mm, 1000 * sheet.rectangles_m, atol=1e-3)


@each_board
def test_an_svg_has_every_rectangle_to_scale(board: Board, tmp_path: Path) -> None:
    sheet = draw_board(board, tmp_path / "board.svg")
    root = ElementTree.parse(tmp_path / "board.svg").getroot()
    width, height = mm(sheet)
    assert (root.get("width"), root.get("height")) == (f"{width:g}mm", f"{height:g}mm")
    assert root.get("viewBox") == f"0 0 {width:g} {height:g}"
    path = root.find("{http://www.w3.org/2000/svg}path").get("d")  # type: ignore[union-attr]
    numbers = re.findall(r"M(\S+) (\S+)H(\S+)V(\S+)H(\S+)Z", path or "")
    drawn = np.array([[float(n) for n in row] for row in numbers])
    assert (drawn[:, 0] == drawn[:, 4]).all()
    expected = 1000 * sheet.rectangles_m
    np.testing.assert_allclose(drawn[:, [0, 2]], expected[:, [0, 2]], atol=1e-2)
    np.testing.assert_allclose(height - drawn[:, [1, 3]], expected[:, [1, 3]], atol=1e-2)


@each_board
def test_a_png_states_its_resolution_and_shows_the_board_to_scale(board: Board, tmp_path: Path) -> None:
    path = tmp_path / "board.png"
    sheet = draw_board(board, path, dpi=100)
    data = path.read_bytes()
    at = data.index(b"pHYs")
    px_per_m, px_per_m_down, unit = struct.unpack(">IIB", data[at + 4 : at + 13])
    assert (px_per_m, px_per_m_down, unit) == (3937, 3937, 1)
    assert zlib.crc32(data[at : at + 13]) == struct.unpack(">I", data[at + 13 : at + 17])[0]
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (round(sheet.height_m * px_per_m), round(sheet.width_m * px_per_m))
    place_m = board.corners_m[:, :2] + np.array(sheet.board_origin_m)
    expected_px = np.column_stack([place_m[:, 0], image.shape[0] / px_per_m - place_m[:, 1]]) * px_per_m - 0.5
    ids, corners_px = detect_view(image, board)
    np.testing.assert_array_equal(ids, np.arange(board.n_corners))
    assert np.abs(corners_px - expected_px).max() < 0.2


def test_the_printed_ruler_measures_100_mm_in_a_png(tmp_path: Path) -> None:
    sheet = draw_board(APRIL, tmp_path / "board.png", dpi=254)
    image = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    ruler = ruler_of(sheet, APRIL)
    row = image.shape[0] - round((ruler[0, 1] + 5e-5) * 10_000)
    black = np.flatnonzero(image[row, : round((ruler[:, 2].max() + 5e-4) * 10_000)] < 128)
    assert black[-1] - black[0] + 1 == pytest.approx(0.1 * 10_000, abs=1.5)


def test_drawings_are_reproducible(tmp_path: Path) -> None:
    for suffix in ("pdf", "svg", "png"):
        for name in ("a", "b"):
            draw_board(APRIL, tmp_path / f"{name}.{suffix}", dpi=72)
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


@pytest.mark.parametrize(
    ("board", "name", "options", "message"),
    [
        (APRIL, "board.gif", {}, "can't draw a .gif; expected .pdf, .svg or .png"),
        (APRIL, "board", {}, "can't draw a file without suffix"),
        (APRIL, "board.pdf", {"page": "B4"}, "page 'B4' is not known; expected A4, A3, A2, A1, A0 or millimetres"),
        (APRIL, "board.pdf", {"page": "90x400"}, r"expected sides of 136 \(for the ruler\) to 10000"),
        (PAPER_A2, "board.pdf", {"page": "A3"}, "the board needs 576 x 411 mm with its margins, which page 'A3'"),
        (AprilGrid(9, 9, 0.2, 0.3), "board.pdf", {}, "more than A0; state the page"),
        (APRIL, "board.png", {"dpi": 5}, "dpi is 5; expected 30 to 2400"),
    ],
)
def test_what_can_not_be_drawn_is_refused(
    board: Board, name: str, options: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(GtcalError, match=message):
        draw_board(board, tmp_path / name, **options)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_a_place_that_can_not_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GtcalError, match="can't be written"):
        draw_board(APRIL, tmp_path / "file" / "board.pdf")


def test_iso_pages_halve() -> None:
    pages = list(ISO_PAGES_MM.values())
    for (width, height), (next_width, next_height) in pairwise(pages):
        assert next_height == width
        assert next_width // 2 == height


# gtcal board


@pytest.mark.parametrize(
    ("options", "board"),
    [
        ([], PAPER_A2),
        (["--preset", "paper_a2"], PAPER_A2),
        (["--type=aprilgrid", "--tag-columns=4", "--tag-rows=3", "--tag-side-mm=50", "--tag-spacing=0.3"], APRIL),
        (
            [
                *("--type=aruco_grid", "--dictionary=DICT_4X4_50", "--tag-columns=3", "--tag-rows=2"),
                *("--tag-side-mm=50", "--tag-gap-mm=17.1"),
            ],
            SKEW,
        ),
        (
            [
                *("--type=charuco", "--dictionary=DICT_5X5_100", "--square-columns=8", "--square-rows=6"),
                *("--square-side-mm=30", "--marker-side-mm=22.5"),
            ],
            CHARUCO,
        ),
    ],
)
def test_the_command_draws_the_board_and_prints_its_manifest_block(
    options: list[str], board: Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "board.svg"
    assert main(["board", "-o", str(path), *options]) == 0
    draw_board(board, tmp_path / "expected.svg")
    assert path.read_bytes() == (tmp_path / "expected.svg").read_bytes()
    printed = capsys.readouterr().out
    block = yaml.safe_load(printed[printed.index("board:\n") :])["board"]
    assert board_from_manifest(block) == board


def test_the_command_takes_a_board_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "board.yaml").write_text(yaml.safe_dump({"board": APRIL.to_manifest()}))
    command = ["board", "-o", str(tmp_path / "board.pdf"), "--file", str(tmp_path / "board.yaml"), "--quiet"]
    assert main(command) == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    assert not capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--tag-side-mm", "50"], "--tag-side-mm needs --type"),
        (["--preset", "paper_a2", "--type", "aprilgrid"], "--preset and --type both describe a board; give one"),
        (["--type", "aprilgrid"], "board of type aprilgrid lacks tag_columns, tag_rows, tag_side_m, tag_spacing"),
        (["--file", "nowhere.yaml"], "'nowhere.yaml' is no preset"),
        (["--page", "A4"], "which page 'A4' doesn't hold"),
    ],
)
def test_the_command_fails_in_one_line(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["board", "-o", str(tmp_path / "board.pdf"), *options]) == 1
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())
