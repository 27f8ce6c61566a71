"""A board as a picture: an exact raster for the simulator, and prints to scale as PDF, SVG and PNG."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.sax.saxutils import escape

import cv2
import numpy as np

from gtcal.board import Board
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.plain import xml_text
from gtcal.recordings.images import GreyImage

# A texel grid is aligned with an edge when the edge is off by less than this fraction of a texel.
_ALIGNED_TEXELS = 1e-6
_MM = 1e-3
_POINT_M = 0.0254 / 72

ISO_PAGES_MM = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
"""Width and height of each page, landscape."""

# Clear of the page's edge: what printers can't reach at the sides, and the strip of the ruler at top and bottom (both,
# so that the pattern is in the middle).
_SIDE_MARGIN_M, _STRIP_M = 8 * _MM, 14 * _MM
_RULER_M, _RULER_STEP_M, _LINE_M = 100 * _MM, 10 * _MM, 0.25 * _MM
_RULER_Y_M, _CAPTION_Y_M, _TEXT_M = 8.5 * _MM, 4.5 * _MM, 2.8 * _MM
# The mean width of a letter over its size, in Helvetica.
_LETTER_WIDTH = 0.52


@dataclass(frozen=True)
class BoardTexture:
    """The printed board as a raster, white margin included.

    image: uint8 (H, W), 0 black, 255 white; row 0 is the top of the print.
    texel_m: side of a texel.
    origin_m: (x, y) in the board frame of the centre of texel (column 0, row 0).
    """

    image: GreyImage
    texel_m: float
    origin_m: tuple[float, float]

    def texels_of(self, points_m: FloatArray) -> FloatArray:
        """(N, 2) column and row, texel centres at integers, of points (N, 2 or 3) in the board frame."""
        offset = points_m[:, :2] - np.array(self.origin_m)
        return offset * np.array([1.0, -1.0]) / self.texel_m


def board_texture(board: Board, *, texels_per_module: int = 8, margin_m: float | None = None) -> BoardTexture:
    """The print as an exact raster.

    A texel is a module over ``texels_per_module``, or over up to four times as many where that puts every edge of the
    pattern on the border between two texels. Where no such number is found, the texels that an edge cuts are grey by
    the area that is black. The white margin is ``margin_m`` (default: four modules), rounded up to whole texels.
    """
    texel_m = board.module_m / _aligned_texels_per_module(board, texels_per_module)
    x_min, y_min, x_max, y_max = board.bounds_m
    margin = _whole((4 * board.module_m if margin_m is None else margin_m) / texel_m)
    width, height = _whole((x_max - x_min) / texel_m), _whole((y_max - y_min) / texel_m)
    left_m, top_m = x_min - margin * texel_m, y_max + margin * texel_m
    image = _raster(
        board.black_rectangles_m - np.array([left_m, top_m, left_m, top_m]),
        1 / texel_m,
        (height + 2 * margin, width + 2 * margin),
    )
    return BoardTexture(image, texel_m, (left_m + texel_m / 2, top_m - texel_m / 2))


@dataclass(frozen=True)
class Text:
    """A line of text on a sheet. x_m, y_m: where its baseline begins. size_m: of the letters."""

    x_m: float
    y_m: float
    size_m: float
    words: str


@dataclass(frozen=True)
class Sheet:
    """A page to print: black rectangles (R, 4) x_min, y_min, x_max, y_max, black discs (D, 3) x, y, radius, and texts,
    in metres from the page's lower-left corner, x right, y up.

    board_origin_m: where on the page the origin of the board frame is.
    """

    width_m: float
    height_m: float
    rectangles_m: FloatArray
    texts: tuple[Text, ...]
    board_origin_m: tuple[float, float]
    discs_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))


def draw_board(board: Board, path: Path, *, page: str | None = None, dpi: int = 300) -> Sheet:
    """Draw a board to scale into a .pdf, .svg or .png file, with a ruler of 100 mm and a caption below the pattern.

    page: 'A4' to 'A0' or millimetres as '500x400', turned as the pattern fits; None for the smallest of A4 to A0.
    dpi: resolution of a PNG, stored in it.

    Returns what was drawn. Raises GtcalError where the suffix is another, the page is unknown or too small, or the file
    can't be written."""
    check_figure(path, dpi)
    sheet = sheet_of(board, page)
    write_sheet(sheet, path, dpi=dpi)
    return sheet


def check_figure(path: Path, dpi: int) -> None:
    """Raises GtcalError where ``write_sheet`` knows no such suffix or resolution."""
    if path.suffix.lower() not in (".pdf", ".svg", ".png"):
        raise GtcalError(f"{path}: can't draw a {path.suffix or 'file without suffix'}; expected .pdf, .svg or .png")
    if not 30 <= dpi <= 2400:
        raise GtcalError(f"dpi is {dpi}; expected 30 to 2400")


def write_sheet(sheet: Sheet, path: Path, *, dpi: int) -> None:
    """Write a page as .pdf, .svg or .png, whole or not at all.

    Raises GtcalError where the suffix is another, or the file can't be written."""
    check_figure(path, dpi)
    writers: dict[str, Callable[[Sheet], bytes]] = {
        ".pdf": _pdf,
        ".svg": _svg,
        ".png": lambda page: _png(page, dpi),
    }
    drawn = writers[path.suffix.lower()](sheet)
    with write_aside(path, binary=True) as file:
        file.write(drawn)


def sheet_of(board: Board, page: str | None = None) -> Sheet:
    """Lay a board out on a page (see ``draw_board``), the pattern in the middle.

    Raises GtcalError where the page is unknown or too small."""
    rectangles_m = np.empty((0, 4)) if len(board.discs_m) else board.black_rectangles_m
    sheet = lay_out(rectangles_m, (), board.bounds_m, board.describe(), page)
    return replace(sheet, discs_m=board.discs_m + np.array([*sheet.board_origin_m, 0.0]))


def lay_out(
    rectangles_m: FloatArray,
    texts: Sequence[Text],
    bounds_m: tuple[float, float, float, float],
    what: str,
    page: str | None = None,
) -> Sheet:
    """A drawing (rectangles (R, 4), texts and bounds in a frame of its own) in the middle of a page, with the ruler and
    a caption that says ``what`` it is.

    Raises GtcalError where the page is unknown or too small."""
    x_min, y_min, x_max, y_max = bounds_m
    width_m, height_m = _page_m(x_max - x_min, y_max - y_min, page)
    origin = ((width_m - x_min - x_max) / 2, (height_m - y_min - y_max) / 2)
    caption = f"gtcal: {what}. Print at 100 %: the ruler must measure {_RULER_M / _MM:g} mm."
    size_m = min(_TEXT_M, (width_m - 2 * _SIDE_MARGIN_M) / (_LETTER_WIDTH * len(caption)))
    end_m = _SIDE_MARGIN_M + _RULER_M + 1.5 * _MM
    return Sheet(
        width_m,
        height_m,
        np.concatenate([rectangles_m + np.tile(origin, 2), _ruler()]),
        (
            *(replace(text, x_m=text.x_m + origin[0], y_m=text.y_m + origin[1]) for text in texts),
            Text(_SIDE_MARGIN_M, _CAPTION_Y_M, size_m, caption),
            Text(end_m, _RULER_Y_M, _TEXT_M, f"{_RULER_M / _MM:g} mm"),
        ),
        origin,
    )


def _page_m(board_width_m: float, board_height_m: float, page: str | None) -> tuple[float, float]:
    """Width and height of the page, turned as the pattern fits."""
    needed_m = (board_width_m + 2 * _SIDE_MARGIN_M, board_height_m + 2 * _STRIP_M)
    for width_mm, height_mm in ISO_PAGES_MM.values() if page is None else [_page_mm(page)]:
        for width, height in ((width_mm, height_mm), (height_mm, width_mm)):
            if needed_m[0] <= width * _MM and needed_m[1] <= height * _MM:
                return width * _MM, height * _MM
    need = f"{needed_m[0] / _MM:.0f} x {needed_m[1] / _MM:.0f} mm with its margins"
    if page is None:
        raise GtcalError(f"the board needs {need}, more than A0; state the page, as 1500x1000 (millimetres)")
    raise GtcalError(f"the board needs {need}, which page {page!r} doesn't hold; leave the page out to have it chosen")


def _page_mm(page: str) -> tuple[float, float]:
    if page.upper() in ISO_PAGES_MM:
        return ISO_PAGES_MM[page.upper()]
    try:
        width, height = (float(side) for side in page.lower().split("x"))
    except ValueError:
        raise GtcalError(
            f"page {page!r} is not known; expected {', '.join(ISO_PAGES_MM)} or millimetres as 500x400"
        ) from None
    least = (_RULER_M + 2 * _SIDE_MARGIN_M) / _MM + 20
    if not (least <= min(width, height) and max(width, height) <= 10_000):
        raise GtcalError(f"page {page!r} in millimetres; expected sides of {least:g} (for the ruler) to 10000")
    return width, height


def _ruler() -> FloatArray:
    """(R, 4) a line with a mark every 10 mm, longer at the ends and in the middle; the ends' outer edges are 100 mm
    apart."""
    x0, y0 = _SIDE_MARGIN_M, _RULER_Y_M
    marks = []
    for i in range(round(_RULER_M / _RULER_STEP_M) + 1):
        # The first mark begins at 0, the last one ends at 100 mm, the others lie about their place.
        left = x0 + i * _RULER_STEP_M - _LINE_M * i * _RULER_STEP_M / _RULER_M
        marks.append((left, y0 + _LINE_M, left + _LINE_M, y0 + (3.0 if i % 5 == 0 else 1.8) * _MM))
    return np.array([(x0, y0, x0 + _RULER_M, y0 + _LINE_M), *marks])


def _pdf(sheet: Sheet) -> bytes:
    from reportlab.pdfgen.canvas import Canvas

    canvas = Canvas("", pagesize=(sheet.width_m / _POINT_M, sheet.height_m / _POINT_M), invariant=True)
    canvas.setTitle("gtcal board")
    canvas.setViewerPreference("PrintScaling", "None")
    # One path: viewers would show hairlines between rectangles that are drawn one by one.
    path = canvas.beginPath()
    for x0, y0, x1, y1 in (sheet.rectangles_m / _POINT_M).tolist():
        path.rect(x0, y0, x1 - x0, y1 - y0)
    for x, y, r in (sheet.discs_m / _POINT_M).tolist():
        path.circle(x, y, r)
    canvas.drawPath(path, stroke=0, fill=1)
    for text in sheet.texts:
        canvas.setFont("Helvetica", text.size_m / _POINT_M)
        canvas.drawString(text.x_m / _POINT_M, text.y_m / _POINT_M, text.words)
    return bytes(canvas.getpdfdata())


def _svg(sheet: Sheet) -> bytes:
    width_mm, height_mm = sheet.width_m / _MM, sheet.height_m / _MM
    path = "".join(
        f"M{x0:.6g} {height_mm - y0:.6g}H{x1:.6g}V{height_mm - y1:.6g}H{x0:.6g}Z"
        for x0, y0, x1, y1 in (sheet.rectangles_m / _MM).tolist()
    )
    discs = "".join(
        f'<circle cx="{x:.6g}" cy="{height_mm - y:.6g}" r="{r:.6g}"/>\n' for x, y, r in (sheet.discs_m / _MM).tolist()
    )
    texts = "".join(
        f'<text x="{text.x_m / _MM:g}" y="{height_mm - text.y_m / _MM:g}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{text.size_m / _MM:g}">{escape(text.words)}</text>\n'
        for text in sheet.texts
    )
    return xml_text(
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_mm:g}mm" height="{height_mm:g}mm" '
            f'viewBox="0 0 {width_mm:g} {height_mm:g}">\n'
            f'<rect width="100%" height="100%" fill="white"/>\n<path d="{path}"/>\n{discs}{texts}</svg>\n'
        ).encode()
    )


def _png(sheet: Sheet, dpi: int) -> bytes:
    # PNG stores whole pixels per metre, so the drawing takes that as its scale, not the rounded inches.
    px_per_m = round(dpi / 0.0254)
    shape = (round(sheet.height_m * px_per_m), round(sheet.width_m * px_per_m))
    top_m = shape[0] / px_per_m
    image = _raster(sheet.rectangles_m - np.array([0, top_m, 0, top_m]), px_per_m, shape)
    for x, y, r in (sheet.discs_m * px_per_m).tolist():
        _draw_disc(image, x - 0.5, shape[0] - y - 0.5, r)
    for text in sheet.texts:
        _write_text(image, text, px_per_m)
    encoded = cv2.imencode(".png", image)[1].tobytes()
    return _with_resolution(encoded, px_per_m)


def _draw_disc(image: GreyImage, x: float, y: float, r: float) -> None:
    """Black, about a point in pixels (centres at integers); the pixels of its rim are grey by how far it reaches into
    them."""
    columns = np.arange(int(x - r) - 1, int(x + r) + 3)
    rows = np.arange(int(y - r) - 1, int(y + r) + 3)
    black = np.clip(r + 0.5 - np.hypot(columns - x, rows[:, None] - y), 0.0, 1.0)
    piece = image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    np.minimum(piece, np.rint(255.0 * (1.0 - black)).astype(np.uint8), out=piece)


def _write_text(image: GreyImage, text: Text, px_per_m: float) -> None:
    font = cv2.FONT_HERSHEY_SIMPLEX
    thickness = max(1, round(text.size_m * px_per_m / 12))
    size_px = text.size_m * px_per_m * _LETTER_WIDTH * len(text.words)
    scale = size_px / max(cv2.getTextSize(text.words, font, 1.0, 1)[0][0], 1)
    place = (round(text.x_m * px_per_m), round(image.shape[0] - text.y_m * px_per_m))
    cv2.putText(image, text.words, place, font, scale, (0,), thickness, cv2.LINE_AA)


def _with_resolution(png: bytes, px_per_m: int) -> bytes:
    """A PNG with the chunk that states its pixels per metre, which belongs right behind the header."""
    header_end = 8 + 4 + 4 + 13 + 4
    body = b"pHYs" + struct.pack(">IIB", px_per_m, px_per_m, 1)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:header_end] + chunk + png[header_end:]


def _raster(rectangles_m: FloatArray, px_per_m: float, shape: tuple[int, int]) -> GreyImage:
    """Black rectangles in metres from the image's upper-left corner, x right, y up (so negative), as an image. The
    pixels that an edge cuts are grey by the area that is black."""
    image = np.full(shape, 255, dtype=np.uint8)
    for x0, y0, x1, y1 in (rectangles_m * px_per_m).tolist():
        columns, across = _coverage(x0, x1)
        rows, down = _coverage(-y1, -y0)
        grey = image[rows, columns] - 255 * down[:, None] * across
        image[rows, columns] = np.rint(np.maximum(grey, 0))
    return image


def _coverage(start: float, end: float) -> tuple[slice, FloatArray]:
    """Which cells [i, i + 1] the interval touches, and how much of each it covers."""
    start, end = _snapped(start), _snapped(end)
    first, last = int(np.floor(start)), int(np.ceil(end))
    cells = np.arange(first, last)
    return slice(first, last), np.minimum(cells + 1, end) - np.maximum(cells, start)


def _snapped(value: float) -> float:
    nearest = round(value)
    return float(nearest) if abs(value - nearest) < 1e-4 else value


def _whole(texels: float) -> int:
    return int(np.ceil(texels - _ALIGNED_TEXELS))


def _aligned_texels_per_module(board: Board, least: int) -> int:
    x_min, _, _, y_max = board.bounds_m
    rectangles = board.black_rectangles_m
    edges_m = np.concatenate([rectangles[:, [0, 2]].ravel() - x_min, y_max - rectangles[:, [1, 3]].ravel()])
    for per_module in range(least, 4 * least + 1):
        texels = edges_m * per_module / board.module_m
        if np.abs(texels - np.rint(texels)).max() < _ALIGNED_TEXELS * per_module:
            return per_module
    return least
