"""Figures of one camera's residuals."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from scipy.ndimage import median_filter

from gtcal.camera import FloatArray
from gtcal.report.evidence import CameraEvidence
from gtcal.report.pictures import BLUE, INK, SEQUENTIAL, VERMILION, Picture, picture, styled_figure
from gtcal.report.plots import (
    LEAST_SPAN_PX,
    beyond,
    bin_sums,
    binned_quantiles,
    count_scale,
    draw_arrows,
    draw_bins,
    evenly,
    image_axes,
    image_bins,
    in_readable_unit,
    middles,
    vector_scatter,
)
from gtcal.uncertainty.coverage import CELLS_ACROSS, image_coverage

_MOST_ANGLES = 300_000
_BINS_ACROSS = 14
_FEWEST_IN_BIN = 8
_MOST_MARKS_IN_TIME = 400
PALE = LinearSegmentedColormap.from_list("pale", ["#ffffff", "#f4d9a6"])


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
    times, unit = (evidence.times_s, "") if evidence.numbered else in_readable_unit(evidence.times_s)
    over = "number of the image" if evidence.numbered else f"time since the first view, {unit}"
    rmse_px, keep = evidence.rmse_of_views_px, evidence.keep_view
    with styled_figure() as figure:
        axes = figure.add_subplot()
        top_px = max(1.25 * float(np.quantile(rmse_px[keep & np.isfinite(rmse_px)], 0.999)), LEAST_SPAN_PX)
        _kept_over_time(axes, times[keep], rmse_px[keep])
        _left_out_over_time(axes, times[~keep], np.minimum(rmse_px[~keep], 0.97 * top_px))
        axes.set(xlabel=over, ylabel="RMSE of a view, px", ylim=(0, top_px))
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
    middle, low, median, high = binned_quantiles(times, rmse_px, edges)
    axes.fill_between(middle, low, high, color=BLUE, alpha=0.25, linewidth=0, label="5 to 95 %")
    axes.plot(middle, median, color=BLUE, linewidth=1.1)


def _left_out_over_time(axes: Axes, times: FloatArray, heights_px: FloatArray) -> None:
    if len(times):
        pick = evenly(len(times), _MOST_MARKS_IN_TIME)
        axes.plot(times[pick], heights_px[pick], "x", color=VERMILION, markersize=5, label="left out", clip_on=False)


def field(evidence: CameraEvidence) -> Picture:
    """Mean residual over the image: arrows that agree with their neighbours are lens or chain, not noise."""
    camera, corners_px, residuals_px = evidence.camera, evidence.corners_px, evidence.kept_residuals_px
    x_edges, y_edges = image_bins(camera, _BINS_ACROSS)
    count = bin_sums(corners_px, x_edges, y_edges)
    enough = count >= _FEWEST_IN_BIN
    per_bin = np.maximum(count, 1)
    mean = [bin_sums(corners_px, x_edges, y_edges, residuals_px[:, axis]) / per_bin for axis in range(2)]
    rmse = np.sqrt(bin_sums(corners_px, x_edges, y_edges, evidence.lengths_px**2) / per_bin)
    with styled_figure() as figure:
        axes = image_axes(figure, camera)
        draw_bins(axes, np.where(enough, rmse, np.nan), x_edges, y_edges, "RMSE in the bin, px", cmap=PALE, vmin=0.0)
        draw_arrows(axes, x_edges, y_edges, mean, enough)
        return picture(
            figure,
            "Residual field",
            f"Mean of projection less measurement per bin with {_FEWEST_IN_BIN} or more corners, much enlarged (see "
            "the key). Noise points everywhere; neighbours that agree tell of the lens model or the chain.",
        )


def against_field_angle(evidence: CameraEvidence) -> Picture:
    """Radial and azimuthal residual against the angle from the optical axis: a wrong lens polynomial is a wave in
    the radial one, a wrong principal point a slope."""
    camera = evidence.camera
    pick = evenly(len(evidence.corners_px), _MOST_ANGLES)
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
    middle, low, median, high = binned_quantiles(angle_deg, error_px, edges, (0.16, 0.5, 0.84))
    axes.axhline(0.0, color=INK, linewidth=0.7)
    axes.fill_between(middle, low, high, color=colour, alpha=0.22, linewidth=0)
    axes.plot(middle, median, color=colour, marker="o", markersize=2.5)


def scatter(evidence: CameraEvidence) -> Picture:
    """Residual vectors about zero: round and centred where they are noise."""
    return vector_scatter(evidence.kept_residuals_px, "Residual scatter", "Projection less measurement", "corner")


def histogram(evidence: CameraEvidence) -> Picture:
    """Lengths of the residuals, beside those of Gaussian noise with the same median."""
    lengths_px = evidence.lengths_px
    top_px = max(float(np.quantile(lengths_px, 0.998)) * 1.05, LEAST_SPAN_PX)
    median_px, p95_px = np.quantile(lengths_px, [0.5, 0.95])
    edges = np.linspace(0.0, top_px, 41)
    counts, _ = np.histogram(lengths_px, edges)
    sigma_px = median_px / np.sqrt(2.0 * np.log(2.0))
    cumulative = 1.0 - np.exp(-0.5 * (edges / max(sigma_px, 1e-12)) ** 2)
    with styled_figure() as figure:
        axes = figure.add_subplot()
        axes.stairs(100 * counts / len(lengths_px), edges, fill=True, color=BLUE, alpha=0.55)
        axes.plot(middles(edges), 100 * np.diff(cumulative), color=INK, linewidth=1.2)
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
            "Line: Gaussian noise with the same median. A longer tail is blur, wrong corners or a wrong model."
            + beyond(lengths_px, 0.0, top_px, "px"),
        )


def coverage(evidence: CameraEvidence) -> Picture:
    """Corners over the image: where nothing was seen, nothing is known of the lens."""
    camera, corners_px = evidence.camera, evidence.corners_px
    x_edges, y_edges = image_bins(camera, CELLS_ACROSS)
    counts = bin_sums(corners_px, x_edges, y_edges)
    with styled_figure() as figure:
        axes = image_axes(figure, camera)
        draw_bins(axes, counts, x_edges, y_edges, "corners in the bin", cmap=SEQUENTIAL, norm=count_scale(counts))
        axes.plot(*camera.theta[2:4], "+", color=VERMILION, markersize=9, markeredgewidth=1.6)
        return picture(
            figure,
            "Coverage of the image",
            f"{covered_share(evidence):.0%} of the cells that the lens can see hold corners; white has none. Cross: "
            "principal point.",
        )


def covered_share(evidence: CameraEvidence) -> float:
    """Share of the image's cells that the lens can see that hold a corner that was used: those of ``coverage``."""
    return image_coverage(evidence.camera, evidence.corners_px, across=CELLS_ACROSS).share
