"""The figure of a difference: how far the pixels of points in ref moved over each image, and what is expected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure

from gtcal.camera import Camera
from gtcal.differences.difference import Difference, PixelChange
from gtcal.report.pictures import styled_figure, write_figure
from gtcal.report.plots import draw_map, image_axes

_WIDTH_IN, _ROW_IN = 8.6, 2.9
_EVERY = 5
"""Arrows stand on each of so many cells across."""


def draw_difference(path: Path, found: Difference, cameras: dict[str, Camera]) -> None:
    """Draw it as PNG or SVG, by the file's suffix; whole or not at all. cameras: those of the first calibration.

    Raises GtcalError for another suffix, or where it can't be written."""
    with styled_figure(_WIDTH_IN, _ROW_IN * len(found.pixels)) as figure:
        figure.set_layout_engine("constrained")
        rows = figure.subfigures(len(found.pixels), 1, squeeze=False)[:, 0]
        for row, change in zip(rows, found.pixels, strict=True):
            _row(row, change, cameras[change.camera], found.options.distance_m)
        write_figure(path, figure)


def _row(part: SubFigure, change: PixelChange, camera: Camera, distance_m: float) -> None:
    left, right = part.subfigures(1, 2, squeeze=False)[0]
    highest = float(max(np.nanmax(change.length_px, initial=0.0), np.nanmax(change.expected_px, initial=0.0)))
    part.suptitle(
        f"{change.camera}: pixels of points at {distance_m:g} m moved by {change.rms_px:.3g} px RMS, "
        f"{change.rms_expected_px:.3g} px expected",
        fontsize="medium",
    )
    parts = (left, change.length_px, "moved, px"), (right, change.expected_px, "expected by both covariances, px")
    for figure, values, label in parts:
        axes = image_axes(figure, camera)
        draw_map(figure, axes, change.x_px, change.y_px, values, label, highest=highest)
        if figure is left:
            _arrows(axes, change)


def _arrows(axes: Axes, change: PixelChange) -> None:
    """Which way, the longest as long as the cells between two arrows."""
    every = np.s_[_EVERY // 2 :: _EVERY]
    x_px, y_px = np.meshgrid(change.x_px[every], change.y_px[every])
    dx, dy = np.moveaxis(change.change_px[every, every], 2, 0)
    longest = float(np.nanmax(np.hypot(dx, dy), initial=0.0)) or 1.0
    spacing_px = _EVERY * (change.x_px[1] - change.x_px[0])
    scale = longest / spacing_px
    axes.quiver(x_px, y_px, dx, dy, angles="xy", scale_units="xy", scale=scale, width=0.004, color="white")
