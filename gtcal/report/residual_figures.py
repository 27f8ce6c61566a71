"""Figures of one camera's residuals. Everything is binned, so that an hour of recording takes no more room than a
minute."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from gtcal.camera import Camera, FloatArray
from gtcal.report.evidence import CameraEvidence
from gtcal.report.pictures import (
    BLUE,
    INK,
    MUTED,
    SEQUENTIAL,
    VERMILION,
    Picture,
    picture,
    styled_figure,
)

_MOST_POINTS = 1500
_MOST_ANGLES = 300_000
_BINS_ACROSS = 14
_FEWEST_IN_BIN = 8
_MOST_MARKS_IN_TIME = 400
_PALE = LinearSegmentedColormap.from_list("pale", ["#ffffff", "#f4d9a6"])


def residual_pictures(evidence: CameraEvidence) -> tuple[Picture, ...]:
    """All figures of one camera, in the order in which one reads them."""
    return (
        over_time(evidence),
        field(evidence),
        against_field_angle(evidence),
        scatter(evidence),
        histogram(evidence),
        coverage(evidence),
    )


def over_time(evidence: CameraEvidence) -> Picture:
    """RMSE of each view against time, with those left out; drift, a bumped camera and gross mocap poses show."""
    times, unit = _in_readable_unit(evidence.times_s)
    rmse_px, keep = evidence.rmse_of_views_px, evidence.keep_view
    with styled_figure() as figure:
        axes = figure.add_subplot()
        top_px = 1.25 * float(np.quantile(rmse_px[keep & np.isfinite(rmse_px)], 0.999))
        _kept_over_time(axes, times[keep], rmse_px[keep])
        _left_out_over_time(axes, times[~keep], np.minimum(rmse_px[~keep], 0.97 * top_px))
        axes.set(xlabel=f"time since the first view, {unit}", ylabel="RMSE of a view, px", ylim=(0, top_px))
        axes.margins(x=0.01)
        if not keep.all():
            axes.legend(loc="upper left", bbox_to_anchor=(0, 1.13), ncols=2, handletextpad=0.2, borderaxespad=0)
        caption = (
            "Each dot is a view; line: running median of 15."
            if keep.sum() <= _MOST_MARKS_IN_TIME
            else "Line: median of the views near that time; band: 5 to 95 % of them."
        )
        if not keep.all():
            caption += " Crosses: gross views that were left out; those off the scale stand at the top."
        return picture(figure, "Residual over time", caption)


def _kept_over_time(axes: Axes, times: FloatArray, rmse_px: FloatArray) -> None:
    if len(times) <= _MOST_MARKS_IN_TIME:
        axes.plot(times, rmse_px, ".", color=BLUE, markersize=5, alpha=0.7, markeredgewidth=0, label="view")
        axes.plot(times, median_filter(rmse_px, size=min(15, len(times)), mode="nearest"), color=INK, linewidth=1.1)
        return
    edges = np.linspace(times[0], times[-1], 121)
    middle, low, median, high = _binned_quantiles(times, rmse_px, edges)
    axes.fill_between(middle, low, high, color=BLUE, alpha=0.25, linewidth=0, label="5 to 95 %")
    axes.plot(middle, median, color=BLUE, linewidth=1.1)


def _left_out_over_time(axes: Axes, times: FloatArray, heights_px: FloatArray) -> None:
    if len(times):
        pick = _evenly(len(times), _MOST_MARKS_IN_TIME)
        axes.plot(times[pick], heights_px[pick], "x", color=VERMILION, markersize=5, label="left out", clip_on=False)


def field(evidence: CameraEvidence) -> Picture:
    """Mean residual over the image: arrows that agree with their neighbours are lens or chain, not noise."""
    camera, corners_px, residuals_px = evidence.camera, evidence.corners_px, evidence.kept_residuals_px
    x_edges, y_edges = _image_bins(camera)
    count = _sums(corners_px, x_edges, y_edges)
    enough = count >= _FEWEST_IN_BIN
    per_bin = np.maximum(count, 1)
    mean = [_sums(corners_px, x_edges, y_edges, residuals_px[:, axis]) / per_bin for axis in range(2)]
    rmse = np.sqrt(_sums(corners_px, x_edges, y_edges, evidence.lengths_px**2) / per_bin)
    with styled_figure() as figure:
        axes = _image_axes(figure, camera)
        _bins(axes, np.where(enough, rmse, np.nan), x_edges, y_edges, "RMSE in the bin, px", cmap=_PALE, vmin=0.0)
        _arrows(axes, x_edges, y_edges, mean, enough)
        return picture(
            figure,
            "Residual field",
            f"Mean of projection less measurement per bin with {_FEWEST_IN_BIN} or more corners, much enlarged (see "
            "the key). Noise points everywhere; neighbours that agree tell of the lens model or the chain.",
        )


def _arrows(
    axes: Axes, x_edges: FloatArray, y_edges: FloatArray, mean: list[FloatArray], enough: NDArray[np.bool_]
) -> None:
    if not enough.any():
        return
    X, Y = np.meshgrid(_middles(x_edges), _middles(y_edges), indexing="ij")
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


def against_field_angle(evidence: CameraEvidence) -> Picture:
    """Radial and azimuthal residual against the angle from the optical axis: a wrong lens polynomial is a wave in
    the radial one, a wrong principal point a slope."""
    camera = evidence.camera
    pick = _evenly(len(evidence.corners_px), _MOST_ANGLES)
    corners_px, residuals_px = evidence.corners_px[pick], evidence.kept_residuals_px[pick]
    bearings, valid = camera.unproject(corners_px)
    angle_deg = np.rad2deg(np.arctan2(np.hypot(bearings[:, 0], bearings[:, 1]), bearings[:, 2]))
    outward = corners_px - camera.theta[2:4]
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    radial_px = (residuals_px * outward).sum(axis=1)
    azimuthal_px = residuals_px[:, 1] * outward[:, 0] - residuals_px[:, 0] * outward[:, 1]
    edges = np.linspace(0.0, float(angle_deg[valid].max()) + 1e-6, 21)
    with styled_figure() as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
        _band(upper, angle_deg[valid], radial_px[valid], edges, BLUE)
        _band(lower, angle_deg[valid], azimuthal_px[valid], edges, VERMILION)
        upper.set_ylabel("radial, px")
        lower.set_ylabel("azimuthal, px")
        lower.set_xlabel("field angle, deg")
        figure.align_ylabels()
        return picture(
            figure,
            "Error against field angle",
            "Line: median; band: 16 to 84 %. A wave in the radial error is a wrong lens polynomial; both should lie on "
            "zero. Radial: outward from the principal point; azimuthal: x towards y.",
        )


def _band(axes: Axes, angle_deg: FloatArray, error_px: FloatArray, edges: FloatArray, colour: str) -> None:
    middle, low, median, high = _binned_quantiles(angle_deg, error_px, edges, (0.16, 0.5, 0.84))
    axes.axhline(0.0, color=INK, linewidth=0.7)
    axes.fill_between(middle, low, high, color=colour, alpha=0.22, linewidth=0)
    axes.plot(middle, median, color=colour, marker="o", markersize=2.5)


def scatter(evidence: CameraEvidence) -> Picture:
    """Residual vectors about zero: round and centred where they are noise."""
    residuals_px, lengths_px = evidence.kept_residuals_px, evidence.lengths_px
    limit_px = 1.1 * float(np.quantile(lengths_px, 0.998))
    few = len(residuals_px) <= _MOST_POINTS
    with styled_figure() as figure:
        axes = figure.add_subplot(aspect="equal")
        if few:
            axes.plot(*residuals_px.T, ".", color=BLUE, markersize=3, alpha=0.5, markeredgewidth=0)
        else:
            _density(axes, residuals_px, limit_px)
        for radius_px, style, name in (
            (float(np.median(lengths_px)), "-", "50 %"),
            (float(np.quantile(lengths_px, 0.95)), "--", "95 %"),
        ):
            axes.add_patch(Circle((0, 0), radius_px, fill=False, color=INK, linestyle=style, linewidth=1.0))
            axes.annotate(name, (0, -radius_px), (0, -2), textcoords="offset points", ha="center", va="bottom", size=7)
        axes.set(
            xlabel="x residual, px", ylabel="y residual, px", xlim=(-limit_px, limit_px), ylim=(limit_px, -limit_px)
        )
        mean_x, mean_y = residuals_px.mean(axis=0)
        return picture(
            figure,
            "Residual scatter",
            f"Projection less measurement, {'a dot' if few else 'counts'} per corner; circles hold half and 95 % of "
            f"them. Mean ({mean_x:+.3f}, {mean_y:+.3f}) px.",
        )


def _density(axes: Axes, residuals_px: FloatArray, limit_px: float) -> None:
    edges = np.linspace(-limit_px, limit_px, 49)
    counts = _sums(residuals_px, edges, edges)
    _bins(axes, counts, edges, edges, "corners in the bin", cmap="Blues", norm=_count_scale(counts))


def histogram(evidence: CameraEvidence) -> Picture:
    """Lengths of the residuals, beside those of Gaussian noise with the same median."""
    lengths_px = evidence.lengths_px
    top_px = float(np.quantile(lengths_px, 0.998)) * 1.05
    median_px, p95_px = np.quantile(lengths_px, [0.5, 0.95])
    edges = np.linspace(0.0, top_px, 41)
    counts, _ = np.histogram(lengths_px, edges)
    sigma_px = median_px / np.sqrt(2.0 * np.log(2.0))
    cumulative = 1.0 - np.exp(-0.5 * (edges / max(sigma_px, 1e-12)) ** 2)
    with styled_figure() as figure:
        axes = figure.add_subplot()
        axes.stairs(100 * counts / len(lengths_px), edges, fill=True, color=BLUE, alpha=0.55)
        axes.plot(_middles(edges), 100 * np.diff(cumulative), color=INK, linewidth=1.2)
        for value, style, name in ((median_px, "-", "median"), (p95_px, "--", "95 %")):
            axes.axvline(value, color=VERMILION, linestyle=style, linewidth=1.1)
            axes.annotate(
                f"{name} {value:.3g}",
                (value, 1.0),
                (3, -1),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                va="bottom",
                size=7.5,
                color=VERMILION,
            )
        axes.set(
            xlabel="length of the residual, px", ylabel="share of the corners, %", xlim=(0, top_px), ylim=(0, None)
        )
        return picture(
            figure,
            "Histogram",
            "Line: Gaussian noise with the same median. A longer tail is blur, wrong corners or a wrong model.",
        )


def coverage(evidence: CameraEvidence) -> Picture:
    """Corners over the image: where nothing was seen, nothing is known of the lens."""
    camera, corners_px = evidence.camera, evidence.corners_px
    x_edges, y_edges = _image_bins(camera, across=20)
    counts = _sums(corners_px, x_edges, y_edges)
    with styled_figure() as figure:
        axes = _image_axes(figure, camera)
        _bins(axes, counts, x_edges, y_edges, "corners in the bin", cmap=SEQUENTIAL, norm=_count_scale(counts))
        axes.plot(*camera.theta[2:4], "+", color=VERMILION, markersize=9, markeredgewidth=1.6)
        return picture(
            figure,
            "Coverage of the image",
            f"{covered_share(evidence):.0%} of the image's bins hold corners; white has none. Cross: principal point.",
        )


def covered_share(evidence: CameraEvidence) -> float:
    """Share of the image's bins, 20 across, that hold a corner that was used."""
    counts = _sums(evidence.corners_px, *_image_bins(evidence.camera, across=20))
    return float(np.mean(counts > 0))


def _bins(axes: Axes, values: FloatArray, x_edges: FloatArray, y_edges: FloatArray, label: str, **scale: Any) -> None:
    """Colour the bins (columns, rows) that hold something, and say what the colours mean."""
    extent = (x_edges[0], x_edges[-1], y_edges[-1], y_edges[0])
    seen = np.ma.masked_invalid(np.where(values > 0, values, np.nan)).T
    shown = axes.imshow(seen, extent=extent, interpolation="none", **scale)
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(shown, ax=axes, label=label, shrink=0.8, aspect=24, format="%g")


def _count_scale(counts: FloatArray) -> LogNorm:
    return LogNorm(1, max(float(counts.max()), 2.0))


def _image_axes(figure: Figure, camera: Camera) -> Axes:
    width_px, height_px = camera.image_width_px, camera.image_height_px
    axes = figure.add_subplot(aspect="equal")
    axes.set(xlabel="x, px", ylabel="y, px", xlim=(-0.5, width_px - 0.5), ylim=(height_px - 0.5, -0.5))
    axes.grid(False)
    frame = Rectangle((-0.5, -0.5), width_px, height_px, fill=False, edgecolor=MUTED, linewidth=0.8, clip_on=False)
    axes.add_patch(frame)
    return axes


def _image_bins(camera: Camera, across: int = _BINS_ACROSS) -> tuple[FloatArray, FloatArray]:
    """Edges of nearly square bins over the image, in x and y."""
    down = max(round(across * camera.image_height_px / camera.image_width_px), 1)
    return (
        np.linspace(-0.5, camera.image_width_px - 0.5, across + 1),
        np.linspace(-0.5, camera.image_height_px - 0.5, down + 1),
    )


def _sums(
    points: FloatArray, x_edges: FloatArray, y_edges: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """Per bin (columns, rows) how many of the points (N, 2) it holds, or the sum of their weights (N,)."""
    weights = np.ones(len(points)) if weights is None else weights
    return np.histogram2d(points[:, 0], points[:, 1], bins=[x_edges, y_edges], weights=weights)[0]


def _binned_quantiles(
    x: FloatArray, y: FloatArray, edges: FloatArray, quantiles: tuple[float, float, float] = (0.05, 0.5, 0.95)
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Middles of the bins of x that hold values, and three quantiles of y in each."""
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    order = np.argsort(bins, kind="stable")
    parts = np.split(y[order], np.searchsorted(bins[order], np.arange(1, len(edges) - 1)))
    rows = [
        (middle, *np.quantile(part, quantiles))
        for middle, part in zip(_middles(edges), parts, strict=True)
        if len(part)
    ]
    middle, low, median, high = np.array(rows).T
    return middle, low, median, high


def _middles(edges: FloatArray) -> FloatArray:
    return 0.5 * (edges[1:] + edges[:-1])


def _evenly(n: int, most: int) -> NDArray[np.int64]:
    """Indices of at most ``most`` of n rows, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).astype(np.int64)


def _in_readable_unit(times_s: FloatArray) -> tuple[FloatArray, str]:
    return (times_s / 60.0, "min") if times_s[-1] > 300.0 else (times_s, "s")


def _round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value) * power)
