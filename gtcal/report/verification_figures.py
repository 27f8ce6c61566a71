"""Figures of one camera's verification with the Lollypop."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch, Rectangle

from gtcal.camera import Camera, FloatArray
from gtcal.report.pictures import BLUE, INK, MUTED, VERMILION, Picture, picture, styled_figure
from gtcal.report.plots import (
    LEAST_SPAN_PX,
    beyond,
    count_scale,
    draw_arrows,
    draw_bins,
    evenly,
    image_axes,
    in_readable_unit,
    vector_scatter,
)
from gtcal.report.residual_figures import PALE
from gtcal.verification.verification import (
    ERROR_CLASS_LIMITS_PX,
    CameraVerification,
    ErrorClass,
    ErrorCurve,
    HeatMap,
    Sightings,
    TriangulationCheck,
    VerificationOptions,
)

# The paper's colours, of different lightness, and all but green hatched: nobody has to tell green from red.
CLASS_COLOURS = {
    ErrorClass.GREEN: "#7ccf8a",
    ErrorClass.YELLOW: "#fff3a1",
    ErrorClass.RED: "#d7402b",
    ErrorClass.MAGENTA: "#8b1c8a",
}
_CLASS_HATCHES = {ErrorClass.YELLOW: "...", ErrorClass.RED: "///", ErrorClass.MAGENTA: "xxx"}
_CELL_EDGE, _ON_YELLOW, _SHOWN = "#5c687588", "#c9b458", "#e3e7eb"
_FEWEST_FOR_ARROW = 3
_MOST_DOTS = 600
_CURVE_LABELS = {
    "distance_m": "distance, m",
    "viewing_angle_deg": "viewing angle, deg",
    "field_angle_deg": "field angle, deg",
}


def verification_pictures(
    found: CameraVerification, camera: Camera, sightings: Sightings | None, options: VerificationOptions
) -> tuple[Picture, ...]:
    """All figures of one camera; those of single sightings where there are any in memory."""
    shown = [heat_map(found, camera, options), mean_errors(found.heat_map, camera), curves(found.curves, options)]
    if sightings is not None and len(sightings) > 0:
        shown.append(over_time(sightings, options))
        shown.append(vector_scatter(sightings.errors_px, "Error scatter", "Image centre less mocap centre", "sighting"))
    return tuple(shown)


def heat_map(found: CameraVerification, camera: Camera, options: VerificationOptions) -> Picture:
    """e_2D over the image in the paper's colours, on the cells that its coverage counts."""
    shape = (2 * options.coverage_rows, 2 * options.coverage_columns)
    caption = "RMSE of e_2D per bin of the image; white: the device was not shown there."
    with styled_figure() as figure:
        axes = image_axes(figure, camera)
        if found.heat_map.count.shape == shape:
            _draw_shown(axes, found.heat_map)
            caption += (
                f" Grey: the cells, of two by two bins, in which it was shown: {found.coverage:.0%} of those that the "
                "lens can see."
            )
        draw_heat_map(axes, found.heat_map)
        class_legend(figure)
        return picture(figure, "Lollypop heat map", caption)


def _draw_shown(axes: Axes, found: HeatMap) -> None:
    """Shade the cells of two by two bins that hold a sighting."""
    counts, _ = _coarser(found)
    x_edges, y_edges = _every_second(found.x_edges_px), _every_second(found.y_edges_px)
    for column, row in np.argwhere(counts > 0):
        width, height = x_edges[column + 1] - x_edges[column], y_edges[row + 1] - y_edges[row]
        axes.add_patch(Rectangle((x_edges[column], y_edges[row]), width, height, facecolor=_SHOWN, linewidth=0))


def draw_heat_map(axes: Axes, found: HeatMap, *, counts: bool = False) -> None:
    """Colour the bins by their class; ``counts``: write into each how many sightings it holds."""
    classes = found.classes
    for row, column in np.argwhere(classes != ErrorClass.NONE):
        cell = _cell(found, row, column, ErrorClass(classes[row, column]))
        axes.add_patch(cell)
        if counts:
            _write_count(axes, cell, int(found.count[row, column]))


def _write_count(axes: Axes, cell: Rectangle, count: int) -> None:
    """On a plate of the cell's colour, clear of the hatch; white on the dark colours."""
    red, green, blue = to_rgb(cell.get_facecolor())
    ink = "white" if 0.3 * red + 0.6 * green + 0.1 * blue < 0.5 else INK
    plate = {"boxstyle": "square,pad=0.12", "facecolor": cell.get_facecolor(), "edgecolor": "none"}
    x, y = cell.get_center()
    axes.text(x, y, str(count), ha="center", va="center", size=6, color=ink, bbox=plate)


def _cell(found: HeatMap, row: int, column: int, kind: ErrorClass) -> Rectangle:
    left, right = found.x_edges_px[column : column + 2]
    top, bottom = found.y_edges_px[row : row + 2]
    return Rectangle((left, top), right - left, bottom - top, **_class_style(kind))


def _class_style(kind: ErrorClass) -> dict[str, Any]:
    hatch = _CLASS_HATCHES.get(kind, "")
    edge = {ErrorClass.GREEN: _CELL_EDGE, ErrorClass.YELLOW: _ON_YELLOW}.get(kind, "white")
    return {"facecolor": CLASS_COLOURS[kind], "edgecolor": edge, "hatch": hatch, "linewidth": 0.3}


def class_legend(figure: FigureBase) -> None:
    """What the colours mean, above the axes."""
    low, middle, high = ERROR_CLASS_LIMITS_PX
    names = (f"< {low:g} px", f"< {middle:g}", f"< {high:g}", "more")
    handles = [Patch(label=name, **_class_style(kind)) for kind, name in zip(CLASS_COLOURS, names, strict=True)]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, columnspacing=1.0, handlelength=1.4)


def mean_errors(found: HeatMap, camera: Camera) -> Picture:
    """Mean error vectors on the count of the sightings: arrows that agree are no noise."""
    counts, mean = _coarser(found)
    x_edges, y_edges = _every_second(found.x_edges_px), _every_second(found.y_edges_px)
    with styled_figure() as figure:
        axes = image_axes(figure, camera)
        draw_bins(axes, counts, x_edges, y_edges, "sightings in the bin", cmap=PALE, norm=count_scale(counts))
        draw_arrows(axes, x_edges, y_edges, mean, counts >= _FEWEST_FOR_ARROW)
        return picture(
            figure,
            "Mean error and count",
            f"Image centre less mocap centre per bin with {_FEWEST_FOR_ARROW} or more sightings, enlarged (see the "
            "key). All one way: the camera or its markers moved; in a whirl or a star: the lens.",
        )


def _coarser(found: HeatMap) -> tuple[FloatArray, list[FloatArray]]:
    """Counts and mean vectors (columns, rows) of two by two bins each: single ones hold too few for a mean."""
    counts = found.count.astype(np.float64)
    sums = np.where(counts[..., None] > 0, found.mean_error_px * counts[..., None], 0.0)
    n = _two_by_two(counts)
    mean = [_two_by_two(sums[..., axis]) / np.maximum(n, 1.0) for axis in range(2)]
    return n.T, [part.T for part in mean]


def _two_by_two(values: FloatArray) -> FloatArray:
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], 2), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], 2), axis=1)


def _every_second(edges: FloatArray) -> FloatArray:
    return np.append(edges[:-1:2], edges[-1])


def curves(found: tuple[ErrorCurve, ...], options: VerificationOptions) -> Picture:
    """RMSE in px and mm against distance, viewing angle and field angle."""
    with styled_figure() as figure:
        grid = figure.subplots(2, len(found), sharex="col", sharey="row", squeeze=False)
        for column, curve in enumerate(found):
            middle = 0.5 * (curve.edges[1:] + curve.edges[:-1])
            _curve(grid[0, column], middle, curve.rmse_px, BLUE, options.max_rmse_px)
            _curve(grid[1, column], middle, curve.rmse_mm, VERMILION, options.max_rmse_mm)
            grid[1, column].set_xlabel(_CURVE_LABELS[curve.quantity])
        grid[0, 0].set_ylabel("e_2D RMSE, px")
        grid[1, 0].set_ylabel("e_3D RMSE, mm")
        for row in range(2):
            grid[row, 0].set_ylim(bottom=0.0)
        figure.align_ylabels()
        return picture(
            figure,
            "Error against distance and angles",
            "Dashed: tolerance. Viewing angle: from the face's normal; field angle: from the optical axis.",
        )


def _curve(axes: Axes, middle: FloatArray, rmse: FloatArray, colour: str, limit: float) -> None:
    seen = ~np.isnan(rmse)
    axes.plot(middle[seen], rmse[seen], "o-", color=colour, markersize=2.5)
    axes.axhline(limit, color=INK, linestyle="--", linewidth=0.9)


def over_time(sightings: Sightings, options: VerificationOptions) -> Picture:
    """e_2D of each sighting: a jump is a bump, a slope is warming or sliding."""
    pick = evenly(len(sightings), _MOST_DOTS)
    times, unit = in_readable_unit((sightings.stamps_ns - sightings.stamps_ns[0]) * 1e-9)
    e_2d_px = sightings.e_2d_px
    with styled_figure() as figure:
        axes = figure.add_subplot()
        axes.plot(times[pick], e_2d_px[pick], ".", color=BLUE, markersize=5, alpha=0.7, markeredgewidth=0)
        axes.axhline(options.max_rmse_px, color=INK, linestyle="--", linewidth=0.9)
        axes.set(xlabel=f"time since the first sighting, {unit}", ylabel="e_2D, px")
        axes.set_ylim(0.0, 1.1 * max(float(e_2d_px.max()), options.max_rmse_px))
        axes.margins(x=0.01)
        every = (
            "Each dot is a sighting" if len(pick) == len(sightings) else f"{len(pick)} of {len(sightings)} sightings"
        )
        return picture(figure, "Error over time", f"{every}; dashed: tolerance of the RMSE.")


def triangulation(check: TriangulationCheck) -> Picture:
    """Triangulated less mocap centre: along the line of sight, where e_3D is blind, and across it."""
    limit_mm = max(float(np.quantile(np.abs([check.depth_mm, check.across_mm]), 0.98)) * 1.1, LEAST_SPAN_PX)
    edges = np.linspace(-limit_mm, limit_mm, 41)
    with styled_figure() as figure:
        upper, lower = figure.subplots(2, 1)
        upper.hist(check.depth_mm, edges, color=BLUE, alpha=0.7)
        upper.axvline(0.0, color=INK, linewidth=0.7)
        upper.set(xlabel="depth error, mm (positive: farther)", ylabel="count")
        lower.hist(check.across_mm, edges[20:], color=MUTED, alpha=0.8)
        lower.set(xlabel="error across the line of sight, mm", ylabel="count")
        return picture(
            figure,
            "Triangulated centre",
            f"Where two or more cameras see a face at once ({len(check.stamps_ns)} times)."
            + beyond(check.depth_mm, -limit_mm, limit_mm, "mm")
            + beyond(check.across_mm, 0.0, limit_mm, "mm"),
        )
