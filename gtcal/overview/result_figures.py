"""Results as pictures, from their files alone: where the cameras are, and heat maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from factors.rigid import inverse
from gtcal.report.pictures import CAMERA_COLOURS, MUTED, styled_figure, write_figure
from gtcal.report.scene import REF_NAMES
from gtcal.report.verification_figures import class_legend, draw_heat_map
from gtcal.results.calibration import Calibration
from gtcal.verification.verification import HeatMap, Verification

_PLANES = ((0, 1), (0, 2))
# Of the extent of all cameras, or of a metre where there is one only.
_ARROW_SHARE, _LONE_EXTENT_MM = 0.2, 1000.0
_HEAT_MAPS_ACROSS = 3


def draw_calibration(path: Path, calibration: Calibration) -> None:
    """Draw where the cameras are in ref and look to, from two sides, and how well each fits: PNG or SVG, by the file's
    suffix; whole or not at all.

    Raises GtcalError for another suffix, or where it can't be written."""
    with styled_figure(10.0, 3.6) as figure:
        _on_calibration(figure, calibration)
        write_figure(path, figure)


def calibration_figure(calibration: Calibration) -> Figure:
    """Where the cameras are in ref and look to, from two sides, and how well each fits."""
    with styled_figure(10.0, 3.6) as figure:
        _on_calibration(figure, calibration)
        return figure


def _on_calibration(figure: Figure, calibration: Calibration) -> None:
    figure.set_layout_engine("constrained")
    *views, fit = figure.subplots(1, 3)
    for axes, plane in zip(views, _PLANES, strict=True):
        _cameras(axes, calibration, plane)
    _fits(fit, calibration)
    views[0].set_title(f"cameras in the {REF_NAMES[calibration.capture]}", loc="left", fontsize=9)


def _cameras(axes: Axes, calibration: Calibration, plane: tuple[int, int]) -> None:
    """Positions and viewing directions in one plane of ref. Names that would lie on each other are moved apart."""
    ref_T_camera = {name: inverse(camera.camera_T_ref.a_T_b) for name, camera in calibration.cameras.items()}
    at_mm = 1e3 * np.stack([pose[:3, 3] for pose in ref_T_camera.values()])
    extent_mm = float(np.ptp(at_mm, axis=0).max()) if len(at_mm) > 1 else _LONE_EXTENT_MM
    i, k = plane
    for index, (name, pose) in enumerate(ref_T_camera.items()):
        colour = CAMERA_COLOURS[index % len(CAMERA_COLOURS)]
        x, y = 1e3 * pose[[i, k], 3]
        dx, dy = _ARROW_SHARE * extent_mm * pose[[i, k], 2]
        axes.annotate("", (x + dx, y + dy), (x, y), arrowprops={"arrowstyle": "->", "color": colour})
        axes.plot(x, y, "o", color=colour, markersize=4, label=name)
        axes.plot(x + dx, y + dy, alpha=0.0)  # room for the arrow's head
    axes.plot(0, 0, "+", color=MUTED, markersize=10)
    axes.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[k]}, mm", aspect="equal", adjustable="datalim")
    axes.margins(0.15)
    if plane == _PLANES[-1]:
        axes.legend(loc="best", fontsize=7)


def _fits(axes: Axes, calibration: Calibration) -> None:
    """RMSE of each camera as a bar, the 95 % quantile as a mark."""
    names = list(calibration.cameras)
    fits = [camera.residuals for camera in calibration.cameras.values()]
    colours = [CAMERA_COLOURS[index % len(CAMERA_COLOURS)] for index in range(len(names))]
    axes.barh(names, [fit.rmse_px for fit in fits], color=colours, height=0.6)
    axes.plot([fit.p95_px for fit in fits], names, "|", color=MUTED, markersize=14)
    axes.set(xlabel="residual, px", xlim=(0, None))
    axes.set_title("bar: RMSE; mark: 95 % of the corners", loc="left", fontsize=9)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)


def draw_verification(path: Path, verification: Verification) -> None:
    """Draw the heat map of every camera: PNG or SVG, by the file's suffix; whole or not at all.

    Raises GtcalError for another suffix, or where it can't be written."""
    with styled_figure(*_size_of(verification)) as figure:
        _on_verification(figure, verification)
        write_figure(path, figure)


def verification_figure(verification: Verification) -> Figure:
    """The heat map of every camera."""
    with styled_figure(*_size_of(verification)) as figure:
        _on_verification(figure, verification)
        return figure


def _grid_of(verification: Verification) -> tuple[int, int]:
    """Rows and columns."""
    across = min(len(verification.cameras), _HEAT_MAPS_ACROSS)
    return -(-len(verification.cameras) // across), across


def _size_of(verification: Verification) -> tuple[float, float]:
    rows, across = _grid_of(verification)
    return 3.3 * across, 0.5 + 2.9 * rows


def _on_verification(figure: Figure, verification: Verification) -> None:
    rows, across = _grid_of(verification)
    figure.set_layout_engine("constrained")
    parts = figure.subfigures(rows, across, squeeze=False).ravel()
    for part, camera in zip(parts, verification.cameras.values(), strict=False):
        axes = part.add_subplot(aspect="equal")
        _over_image(axes, camera.heat_map)
        draw_heat_map(axes, camera.heat_map)
        axes.set_title(f"{camera.camera}: {camera.verdict.value}, {camera.px.rmse:.2f} px", fontsize=9)
    class_legend(figure)


def _over_image(axes: Axes, found: HeatMap) -> None:
    """The bins span the image."""
    x_px, y_px = found.x_edges_px, found.y_edges_px
    axes.set(xlabel="x, px", ylabel="y, px", xlim=(x_px[0], x_px[-1]), ylim=(y_px[-1], y_px[0]))
    axes.grid(False)
