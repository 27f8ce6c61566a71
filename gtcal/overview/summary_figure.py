"""A recording as a picture: when cameras and mocap recorded, where the images had corners, how the bodies moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure

from gtcal.camera import FloatArray
from gtcal.overview.summary import BodySummary, CameraSummary, RecordingSummary, Times
from gtcal.recordings.detections import IntArray
from gtcal.report.pictures import BLUE, CAMERA_COLOURS, GREEN, MUTED, VERMILION, styled_figure, write_figure
from gtcal.report.plots import count_scale, evenly, image_axes

_WIDTH_IN = 10.0
_ROW_IN, _COVERAGE_IN, _MOTION_IN = 0.28, 2.3, 1.9
_CAMERAS_ACROSS = 4
# More images than this are drawn as bars without gaps; the eye sees no single marks any more.
_MOST_MARKS = 400
_MOST_POINTS = 4000
_AXES = (("x", BLUE), ("y", VERMILION), ("z", GREEN))
_BODY_COLOUR = MUTED


def draw_recording(path: Path, summary: RecordingSummary) -> None:
    """Draw a recording's summary as PNG or SVG, by the file's suffix; whole or not at all.

    Raises GtcalError for another suffix, or where it can't be written."""
    covered = [camera for camera in summary.cameras.values() if camera.coverage is not None]
    rows_of_images = -(-len(covered) // _CAMERAS_ACROSS)
    timeline_in = 0.9 + _ROW_IN * (len(summary.cameras) + len(summary.bodies))
    heights_in = [timeline_in, *[_COVERAGE_IN] * rows_of_images, *[_MOTION_IN] * len(summary.bodies)]
    with styled_figure(_WIDTH_IN, sum(heights_in)) as figure:
        figure.set_layout_engine("constrained")
        parts = iter(figure.subfigures(len(heights_in), 1, height_ratios=heights_in, squeeze=False)[:, 0])
        _timeline(next(parts), summary)
        for row in range(rows_of_images):
            _coverage(next(parts), covered[row * _CAMERAS_ACROSS : (row + 1) * _CAMERAS_ACROSS])
        for name, body in summary.bodies.items():
            _motion(next(parts), name, body, summary)
        write_figure(path, figure)


def _timeline(part: SubFigure, summary: RecordingSummary) -> None:
    """A row for each camera and each body, the first on top."""
    axes = part.add_subplot()
    names = [*summary.cameras, *summary.bodies]
    for index, camera in enumerate(summary.cameras.values()):
        colour = CAMERA_COLOURS[index % len(CAMERA_COLOURS)]
        _row(axes, index, camera.times, summary.start_ns, colour, marks=len(camera.times.stamps_ns) <= _MOST_MARKS)
    for index, body in enumerate(summary.bodies.values(), start=len(summary.cameras)):
        _row(axes, index, body.times, summary.start_ns, _BODY_COLOUR, marks=False)
    axes.set_yticks(range(len(names)), names)
    over = "number of the image" if summary.numbered else "time since the first stamp, s"
    axes.set(xlabel=over, ylim=(len(names) - 0.4, -0.6))
    axes.set_title(f"{summary.what}: images, and poses without gaps", loc="left", fontsize=9)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.01)


def _row(axes: Axes, row: int, times: Times, start_ns: int, colour: str, *, marks: bool) -> None:
    if marks:
        at_s = _seconds(times.stamps_ns, start_ns)
        axes.vlines(at_s, row - 0.32, row + 0.32, color=colour, linewidth=0.9)
        return
    first_s, last_s = _seconds(times.runs_ns, start_ns).T
    shortest_s = 1.0 / times.rate_hz if np.isfinite(times.rate_hz) else 0.0  # a lone sample is still to be seen
    bars = list(zip(first_s.tolist(), np.maximum(last_s - first_s, shortest_s).tolist(), strict=True))
    axes.broken_barh(bars, (row - 0.3, 0.6), facecolors=colour, linewidth=0)


def _seconds(stamps_ns: IntArray, start_ns: int) -> FloatArray:
    return np.asarray((stamps_ns - start_ns) * 1e-9)


def _coverage(part: SubFigure, cameras: list[CameraSummary]) -> None:
    """Corners over each camera's image."""
    for place, camera in zip(part.subfigures(1, _CAMERAS_ACROSS, squeeze=False)[0], cameras, strict=False):
        assert camera.coverage is not None
        axes = image_axes(place, camera.camera)
        counts = camera.coverage.counts.astype(np.float64)
        width_px, height_px = camera.camera.image_width_px, camera.camera.image_height_px
        axes.imshow(
            np.ma.masked_equal(counts, 0.0),
            extent=(-0.5, width_px - 0.5, height_px - 0.5, -0.5),
            cmap="viridis",
            norm=count_scale(counts),
            interpolation="none",
        )
        axes.set_title(f"{camera.camera.name}: {camera.coverage.share:.0%} covered", fontsize=8.5)


def _motion(part: SubFigure, name: str, body: BodySummary, summary: RecordingSummary) -> None:
    """Position and attitude over time, or the images' numbers, each about its mean."""
    left, right = part.subplots(1, 2)
    rows = evenly(body.trajectory.n_samples, _MOST_POINTS)
    at_s = _seconds(body.trajectory.stamps_ns[rows], summary.start_ns)
    after_gap = np.diff(at_s, prepend=at_s[0]) > max(body.times.gap_s, 2.5 * float(np.median(np.diff(at_s, prepend=0))))
    positions_mm = 1e3 * body.trajectory.world_T_body[:, :3, 3]
    for axes, values, unit, what in (
        (left, (positions_mm - positions_mm.mean(axis=0))[rows], "mm", "position in the mocap world"),
        (right, body.turns_deg[rows], "deg", "rotation vector in the body"),
    ):
        # A rotation vector jumps to its opposite where the turn passes 180 deg.
        jumps = (np.abs(np.diff(values, axis=0, prepend=values[:1])) > 180.0).any(axis=1) & (unit == "deg")
        broken = np.where((after_gap | jumps)[:, None], np.nan, values)
        for column, (axis, colour) in enumerate(_AXES):
            axes.plot(at_s, broken[:, column], color=colour, label=axis, linewidth=0.9)
        axes.set(xlabel="number of the image" if summary.numbered else "time, s", ylabel=unit)
        axes.set_title(f"{name}: {what}, from its mean", loc="left", fontsize=8.5)
        axes.margins(x=0.01)
    left.legend(loc="upper left", ncols=3)
