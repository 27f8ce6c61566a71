from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from test_verification import CUBE

from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.verification.lollypop import DEVICE_PRESETS
from gtcal.verification.lollypop_detection import see_lollypop
from gtcal.verification.lollypop_drawing import draw_lollypop, lollypop_sheet

PAPER = DEVICE_PRESETS["paper_lollypop"]
DPI = 300


def test_the_drawing_shows_the_tag_where_the_discs_have_their_centroid(tmp_path: Path) -> None:
    """The detector reads the tag in the drawing; its corners and the discs' crosses are to scale."""
    sheet = draw_lollypop(PAPER, tmp_path / "lollypop.png", dpi=DPI)
    image = cv2.imread(str(tmp_path / "lollypop.png"), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    px_per_m = round(DPI / 0.0254)

    def pixels(points_m: np.ndarray) -> np.ndarray:
        on_page = points_m[:, :2] + np.array(sheet.board_origin_m)
        return np.column_stack([on_page[:, 0], sheet.height_m - on_page[:, 1]]) * px_per_m - 0.5

    seen = see_lollypop(image, PAPER)
    np.testing.assert_array_equal(seen.corner_ids, [0, 1, 2, 3])
    np.testing.assert_allclose(seen.corners_px, pixels(PAPER.corners_m), atol=0.6)
    for x, y in pixels(PAPER.markers_in_body_m).round().astype(int):
        assert image[y, x] < 128  # the cross
        assert image[y + 24, x + 24] == 255  # white between the cross and the circle
        ring = image[y, x + 40 : x + 56].min()  # half of 8 mm is 47 pixels
        assert ring < 128


def test_all_faces_are_drawn_side_by_side() -> None:
    sheet = lollypop_sheet(CUBE)
    alone = [len(face.board.black_rectangles_m) for face in CUBE.faces]
    assert len(sheet.rectangles_m) > sum(alone)
    assert sheet.rectangles_m.min() > 0
    assert sheet.rectangles_m[:, 2].max() < sheet.width_m


def test_board_lollypop_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["board", "-o", str(tmp_path / "l.pdf"), "--lollypop"]) == 0
    assert "preset: paper_lollypop" in capsys.readouterr().out
    assert (tmp_path / "l.pdf").read_bytes().startswith(b"%PDF")
    (tmp_path / "device.yaml").write_text("{dictionary: DICT_5X5_50, tag_id: 3, tag_side_m: 0.08}")
    assert main(["board", "-o", str(tmp_path / "l.svg"), "--lollypop", "--file", str(tmp_path / "device.yaml")]) == 0
    assert "tag 3 of DICT_5X5_50, side 80 mm" in (tmp_path / "l.svg").read_text()
    with pytest.raises(GtcalError, match=r"expected .pdf, .svg or .png"):
        draw_lollypop(PAPER, tmp_path / "l.bmp")
