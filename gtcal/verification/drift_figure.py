"""The figure of a drift: RMSE with its bounds, recording by recording and camera by camera."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.plain import xml_text
from gtcal.verification.drift import Drift

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette, told apart by the colour-blind; the markers and dashes also without any colour.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
FIGURE_SUFFIXES = (".png", ".svg", ".pdf")


def draw_drift(path: Path, drift: Drift) -> None:
    """Draw the drift as PNG, SVG or PDF, by the file's suffix; whole or not at all.

    Raises GtcalError for another suffix, or where it can't be written."""
    if path.suffix.lower() not in FIGURE_SUFFIXES:
        raise GtcalError(f"{path}: a figure is {', '.join(FIGURE_SUFFIXES)}, not {path.suffix or 'without a suffix'}")
    from matplotlib import rc_context

    with rc_context({"text.parse_math": False}):  # a camera may have $ in its name
        content = _drawn(drift, path.suffix.lower()[1:])
    with write_aside(path, binary=True) as file:
        file.write(content)


def _drawn(drift: Drift, kind: str) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(6.0, 1.0 + 0.9 * len(drift.names)), 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True)
    _panel(upper, drift, "px", drift.options.max_rmse_px)
    _panel(lower, drift, "mm", drift.options.max_rmse_mm)
    lower.set_xticks(range(len(drift.names)), drift.names, rotation=30, ha="right")
    upper.legend(ncols=2, fontsize="small")
    file = io.BytesIO()
    figure.savefig(file, format=kind, dpi=150)
    return xml_text(file.getvalue()) if kind == "svg" else file.getvalue()


def _panel(axes: Axes, drift: Drift, unit: Literal["px", "mm"], limit: float) -> None:
    for index, camera in enumerate(drift.cameras):
        known = [(i, s) for i, s in enumerate(drift.series(camera, unit)) if s is not None]
        x = np.array([i for i, _ in known], dtype=np.float64)
        rmse, low, high = (np.array([getattr(s, name) for _, s in known]) for name in ("rmse", "rmse_low", "rmse_high"))
        colour, marker = _COLOURS[index % len(_COLOURS)], _MARKERS[index % len(_MARKERS)]
        axes.plot(x, rmse, color=colour, marker=marker, label=camera)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.axhline(limit, color="black", linestyle="--", linewidth=1, label="tolerance")
    if drift.first_failing is not None:
        axes.axvline(drift.first_failing, color="black", linestyle=":", linewidth=1, label="first to fail")
    axes.set_ylabel(f"RMSE, {unit}")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
