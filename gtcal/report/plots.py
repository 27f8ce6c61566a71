"""What the figures of residuals and of verification errors share. Everything is binned, so that an hour of recording
takes no more room than a minute."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import FigureBase
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.report.pictures import BLUE, INK, MUTED, SEQUENTIAL, Picture, picture, styled_figure

LEAST_SPAN_PX = 1e-6
"""Of an axis: data without any error are points on zero."""

_MOST_POINTS = 1500
_DENSITY_BINS = 48
_FEW_COUNTS = 30


def image_axes(figure: FigureBase, camera: Camera) -> Axes:
    """Axes over the camera's image, y down."""
    width_px, height_px = camera.image_width_px, camera.image_height_px
    axes = figure.add_subplot(aspect="equal")
    axes.set(xlabel="x, px", ylabel="y, px", xlim=(-0.5, width_px - 0.5), ylim=(height_px - 0.5, -0.5))
    axes.grid(False)
    frame = Rectangle((-0.5, -0.5), width_px, height_px, fill=False, edgecolor=MUTED, linewidth=0.8, clip_on=False)
    axes.add_patch(frame)
    return axes


def draw_map(
    figure: FigureBase,
    axes: Axes,
    x_px: FloatArray,
    y_px: FloatArray,
    values: FloatArray,
    label: str,
    *,
    highest: float | None = None,
) -> None:
    """Colour the cells of an image whose middles are x_px (W,) and y_px (H,) by values (H, W), from zero on, and say
    what the colours mean."""
    half = 0.5 * (x_px[1] - x_px[0])
    extent = (x_px[0] - half, x_px[-1] + half, y_px[-1] + half, y_px[0] - half)
    shown = axes.imshow(values, extent=extent, cmap=SEQUENTIAL, vmin=0.0, vmax=highest, interpolation="none")
    figure.colorbar(shown, ax=axes, label=label, shrink=0.8, aspect=24)


def image_bins(camera: Camera, across: int) -> tuple[FloatArray, FloatArray]:
    """Edges of nearly square bins over the image, in x and y."""
    down = max(round(across * camera.image_height_px / camera.image_width_px), 1)
    return (
        np.linspace(-0.5, camera.image_width_px - 0.5, across + 1),
        np.linspace(-0.5, camera.image_height_px - 0.5, down + 1),
    )


def bin_sums(
    points: FloatArray, x_edges: FloatArray, y_edges: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """Per bin (columns, rows) how many of the points (N, 2) it holds, or the sum of their weights (N,)."""
    weights = np.ones(len(points)) if weights is None else weights
    return np.histogram2d(points[:, 0], points[:, 1], bins=[x_edges, y_edges], weights=weights)[0]


def draw_bins(
    axes: Axes, values: FloatArray, x_edges: FloatArray, y_edges: FloatArray, label: str, **scale: Any
) -> None:
    """Colour the bins (columns, rows) that hold something, and say what the colours mean."""
    extent = (x_edges[0], x_edges[-1], y_edges[-1], y_edges[0])
    seen = np.ma.masked_invalid(np.where(values > 0, values, np.nan)).T
    shown = axes.imshow(seen, extent=extent, interpolation="none", **scale)
    figure = axes.get_figure()
    assert figure is not None
    bar = figure.colorbar(shown, ax=axes, label=label, shrink=0.8, aspect=24, format="%g")
    bar.ax.yaxis.set_minor_formatter(NullFormatter())


def beyond(values: FloatArray, low: float, high: float, unit: str) -> str:
    """What to say under a histogram of the values (N,) that its axis, from low to high, does not show."""
    outside = values[(values < low) | (values > high)]
    if not len(outside):
        return ""
    farthest = outside[np.argmax(np.abs(outside))]
    return f" Beyond the axis: {len(outside)} of {len(values):,}, up to {farthest:.3g} {unit}."


def count_scale(counts: FloatArray) -> Normalize:
    """Colours for counts: even ones for few, else by their logarithm."""
    most = float(counts.max())
    return Normalize(0.0, max(most, 1.0)) if most <= _FEW_COUNTS else LogNorm(1.0, most)


def draw_arrows(
    axes: Axes, x_edges: FloatArray, y_edges: FloatArray, mean: list[FloatArray], enough: BoolArray
) -> None:
    """The mean vectors (two arrays, columns by rows) of the bins with ``enough`` in them, enlarged, with a key."""
    if not enough.any():
        return
    X, Y = np.meshgrid(middles(x_edges), middles(y_edges), indexing="ij")
    longest_px = float(np.quantile(np.hypot(*mean)[enough], 0.9)) or 1.0
    key_px = _round_down(longest_px)
    scale = longest_px / (0.95 * (x_edges[1] - x_edges[0]))
    arrows = axes.quiver(
        X[enough],
        Y[enough],
        mean[0][enough],
        mean[1][enough],
        angles="xy",
        scale_units="xy",
        scale=scale,
        color=INK,
        width=0.005,
        headwidth=4,
        headlength=4,
        headaxislength=3.6,
    )
    axes.quiverkey(arrows, 0.82, 1.05, key_px, f"{key_px:g} px", labelpos="E", coordinates="axes", labelsep=0.06)


def _round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value) * power)


def vector_scatter(vectors_px: FloatArray, title: str, what: str, of: str) -> Picture:
    """Vectors (N, 2) about zero, with circles that hold half and 95 % of them."""
    lengths_px = np.linalg.norm(vectors_px, axis=1)
    limit_px = max(1.1 * float(np.quantile(lengths_px, 0.998)), LEAST_SPAN_PX)
    few = len(vectors_px) <= _MOST_POINTS
    with styled_figure() as figure:
        axes = figure.add_subplot(aspect="equal")
        if few:
            axes.plot(*vectors_px.T, ".", color=BLUE, markersize=4.5, alpha=0.6, markeredgewidth=0)
        else:
            _density(axes, vectors_px, limit_px, of)
        for share, style in ((0.5, "-"), (0.95, "--")):
            radius_px = float(np.quantile(lengths_px, share))
            axes.add_patch(Circle((0, 0), radius_px, fill=False, color=INK, linestyle=style, linewidth=1.0))
            axes.annotate(
                f"{share:.0%}",
                (0, -radius_px),
                (0, 3),
                textcoords="offset points",
                ha="center",
                size=7,
                bbox={"facecolor": "white", "alpha": 0.7, "pad": 0.8, "linewidth": 0},
            )
        axes.set(xlabel="x, px", ylabel="y, px", xlim=(-limit_px, limit_px), ylim=(limit_px, -limit_px))
        mean_x, mean_y = vectors_px.mean(axis=0)
        return picture(
            figure,
            title,
            f"{what}, {'a dot' if few else 'counts'} per {of}; circles hold half and 95 % of them. "
            f"Mean ({mean_x:+.3f}, {mean_y:+.3f}) px.",
        )


def _density(axes: Axes, vectors_px: FloatArray, limit_px: float, of: str) -> None:
    edges = np.linspace(-limit_px, limit_px, _DENSITY_BINS + 1)
    counts = bin_sums(vectors_px, edges, edges)
    axes.grid(False)
    draw_bins(axes, counts, edges, edges, f"{of}s in the bin", cmap="Blues", norm=count_scale(counts))


def binned_quantiles(
    x: FloatArray, y: FloatArray, edges: FloatArray, quantiles: tuple[float, float, float] = (0.05, 0.5, 0.95)
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Middles of the bins of x that hold values, and three quantiles of y in each."""
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    order = np.argsort(bins, kind="stable")
    parts = np.split(y[order], np.searchsorted(bins[order], np.arange(1, len(edges) - 1)))
    rows = [
        (middle, *np.quantile(part, quantiles)) for middle, part in zip(middles(edges), parts, strict=True) if len(part)
    ]
    middle, low, median, high = np.array(rows).T
    return middle, low, median, high


def middles(edges: FloatArray) -> FloatArray:
    """Of the bins between edges."""
    return 0.5 * (edges[1:] + edges[:-1])


def evenly(n: int, most: int) -> NDArray[np.int64]:
    """Indices of at most ``most`` of n rows, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).astype(np.int64)


def in_readable_unit(times_s: FloatArray) -> tuple[FloatArray, str]:
    """Times in s, or where that were long numbers in min, and the unit."""
    return (times_s / 60.0, "min") if times_s[-1] > 300.0 else (times_s, "s")
