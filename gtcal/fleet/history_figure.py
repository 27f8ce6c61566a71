"""The figures of a rig's history: errors, charts, and how its cameras moved, over time. Loads matplotlib; import it
late."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from gtcal.camera import FloatArray
from gtcal.fleet.history import Event, History
from gtcal.fleet.jobs import utc
from gtcal.report.pictures import CAMERA_COLOURS, INK, MUTED, VERMILION, Picture, picture, styled_figure, write_figure

_MARKERS = ("o", "s", "^", "D", "v", "P")
Draw = Callable[[Axes, History], None]


def write_history_figure(path: Path, history: History) -> None:
    """Write all figures of a rig in one, as PNG or SVG. Raises GtcalError for another suffix, or where it can't be
    written."""
    with styled_figure(9.0, 6.4) as figure:
        for axes, (title, _, draw) in zip(figure.subplots(2, 2).ravel(), FIGURES, strict=True):
            draw(axes, history)
            axes.set_title(title, loc="left")
        _legend(figure, history)
        write_figure(path, figure)


def history_pictures(history: History) -> list[Picture]:
    """Each figure by itself, for a page."""
    pictures = []
    for title, caption, draw in FIGURES:
        with styled_figure(5.6, 3.0) as figure:
            draw(figure.add_subplot(), history)
            _legend(figure, history)
            pictures.append(picture(figure, title, caption))
    return pictures


def _legend(figure: Figure, history: History) -> None:
    handles = [
        figure.axes[0].plot([], [], marker=_marker(place), color=_colour(place), label=name)[0]
        for place, name in enumerate(history.cameras)
    ]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 6))


def _colour(place: int) -> str:
    return CAMERA_COLOURS[place % len(CAMERA_COLOURS)]


def _marker(place: int) -> str:
    return _MARKERS[place % len(_MARKERS)]


def _errors(axes: Axes, history: History) -> None:
    for place, camera in enumerate(history.cameras):
        _line(axes, history.verifications, camera, ("rmse_px",), place)
    last = history.verifications[-1].record.options if history.verifications else {}
    limit = last.get("max_rmse_px")
    if isinstance(limit, float):
        axes.axhline(limit, color=INK, linestyle="--", linewidth=0.9)
    axes.set_ylim(bottom=0.0)
    _dress(axes, history, "RMSE, px")


def _bias(axes: Axes, history: History) -> None:
    for place, camera in enumerate(history.cameras):
        _line(axes, history.verifications, camera, ("bias_x_px", "bias_y_px"), place)
    axes.set_ylim(bottom=0.0)
    _dress(axes, history, "mean error, px")


def _moves(axes: Axes, history: History) -> None:
    for place, camera in enumerate(history.cameras):
        _line(axes, history.calibrations, camera, ("moved_x_mm", "moved_y_mm", "moved_z_mm"), place)
    axes.set_ylim(bottom=0.0)
    _dress(axes, history, "moved, mm")


def _charts(axes: Axes, history: History) -> None:
    """Of each camera the chart that is nearest to its limit, as a share of it."""
    for place, camera in enumerate(history.cameras):
        found = [
            (one.days, chart.ewma / chart.limit)
            for one in history.series
            if one.camera == camera
            for chart in history.charts.get((camera, one.what), ())
        ]
        if found:
            days, share = max(found, key=lambda pair: float(np.abs(pair[1]).max()))
            axes.plot(_moments(days), share, color=_colour(place), marker=_marker(place), markersize=3)
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color=INK, linestyle="--", linewidth=0.9)
    _dress(axes, history, "EWMA, share of its limit")


def _line(axes: Axes, events: Sequence[Event], camera: str, quantities: tuple[str, ...], place: int) -> None:
    """The length of a vector of quantities, with bars of 1-sigma."""
    having = [event for event in events if all((camera, name) in event.measures for name in quantities)]
    if not having:
        return
    numbers = np.array([[event.measures[camera, name] for name in quantities] for event in having])
    values, sigmas = np.linalg.norm(numbers[..., 0], axis=1), np.nan_to_num(numbers[..., 1].max(axis=1))
    moments = [utc(event.taken_ns) for event in having]
    axes.errorbar(
        moments,  # type: ignore[arg-type]
        values,
        yerr=sigmas,
        color=_colour(place),
        marker=_marker(place),
        markersize=3,
        linewidth=1.0,
        elinewidth=0.7,
    )


def _moments(days: FloatArray) -> Any:
    return [datetime.datetime.fromtimestamp(86400.0 * day, datetime.UTC) for day in days]


def _dress(axes: Axes, history: History, label: str) -> None:
    """Dates, the accepted calibration, and when a chart spoke up."""
    axes.set_ylabel(label)
    if not history.events:
        return
    if history.accepted is not None:
        axes.axvline(utc(history.accepted.taken_ns), color=MUTED, linestyle=":", linewidth=1.0)  # type: ignore[arg-type]
    for finding in history.findings:
        axes.axvline(utc(finding.alarm_ns), color=VERMILION, linestyle="-.", linewidth=1.0)  # type: ignore[arg-type]
    locator = AutoDateLocator()
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))


_LINES = "Dotted: the accepted calibration; dash-dotted: where a chart spoke up."

FIGURES: tuple[tuple[str, str, Draw], ...] = (
    ("Lollypop: RMSE", f"e_2D of each verification with 1-sigma; dashed: the tolerance. {_LINES}", _errors),
    ("Lollypop: bias", f"Length of the mean error of each verification with 1-sigma. {_LINES}", _bias),
    (
        "Control charts",
        "Of each camera the chart that came nearest to its limit, since the accepted calibration. A chart beyond its "
        f"limit says that the camera is no longer what it was. {_LINES}",
        _charts,
    ),
    (
        "Calibrations: place of the cameras",
        f"How far each calibration finds the cameras from where the accepted one has them, with 1-sigma. {_LINES}",
        _moves,
    ),
)
"""Title, how to read it, and what draws it."""
