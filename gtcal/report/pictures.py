"""Figures as self-contained pictures, and the style that they share."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.plain import xml_text

INK, MUTED, FAINT, PAPER = "#1c2733", "#5c6875", "#d5dae0", "#ffffff"
BLUE, VERMILION, GREEN, ORANGE = "#0072b2", "#d55e00", "#009e73", "#e69f00"
SKY, PURPLE, YELLOW = "#56b4e9", "#cc79a7", "#f0e442"
"""Okabe and Ito's colours, which people with any colour vision tell apart."""

CAMERA_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)

SEQUENTIAL = "cividis"
"""Even in lightness, the same for red-green-blind eyes, and readable in grey."""

_SVG_LIMIT_BYTES = 45_000
_PNG_DPI = 180
_PNG_COLOURS, _FILE_COLOURS = 64, 256
_STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 8.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.labelsize": 8.5,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.4,
    "svg.fonttype": "none",
    "svg.hashsalt": "gtcal",
    "text.parse_math": False,  # a camera may have $ in its name
}


@dataclass(frozen=True)
class Picture:
    """A picture for the page. ``uri`` is a data URI; ``caption`` says how to read it; sizes in CSS px. figure: what it
    is of, None of an image."""

    title: str
    caption: str
    uri: str
    width_px: int
    height_px: int
    figure: Figure | None = field(default=None, compare=False, repr=False)

    @property
    def alt(self) -> str:
        return f"{self.title}. {self.caption}"


@contextmanager
def styled_figure(width_in: float = 3.9, height_in: float = 3.0, *, laid_out: bool = True) -> Iterator[Figure]:
    """A new figure; everything drawn inside has the common style. ``laid_out``: its axes get the room that their
    labels leave; else they stand where they are put."""
    with matplotlib.rc_context(_STYLE):
        yield Figure(figsize=(width_in, height_in), layout="compressed" if laid_out else None)


def picture(figure: Figure, title: str, caption: str) -> Picture:
    """The figure as SVG, which prints sharp at any size, or as PNG where SVG would be large. To be called inside
    ``styled_figure``."""
    width_in, height_in = figure.get_size_inches()
    svg = _svg(figure)
    uri = data_uri("image/svg+xml", svg) if len(svg) <= _SVG_LIMIT_BYTES else data_uri("image/png", _png(figure))
    return Picture(title, caption, uri, round(96 * width_in), round(96 * height_in), figure)


def write_figure(path: Path, figure: Figure) -> None:
    """Write the figure as SVG or PNG, by the file's suffix; whole or not at all. To be called inside
    ``styled_figure``.

    Raises GtcalError for another suffix, or where it can't be written."""
    kinds: dict[str, Callable[[Figure], bytes]] = {".svg": _svg, ".png": partial(_png, colours=_FILE_COLOURS)}
    if path.suffix not in kinds:
        raise GtcalError(f"{path}: a figure is .svg or .png, not {path.suffix or 'without a suffix'}")
    with write_aside(path, binary=True) as file:
        file.write(kinds[path.suffix](figure))


def data_uri(kind: str, content: bytes) -> str:
    """A file inside a page."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _svg(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    return xml_text(file.getvalue())


def _png(figure: Figure, colours: int = _PNG_COLOURS) -> bytes:
    """With a palette: a third of the size, and no eye sees it."""
    full, file = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="png", dpi=_PNG_DPI)
    image = Image.open(full).convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    image.save(file, format="png", optimize=True)
    return file.getvalue()
