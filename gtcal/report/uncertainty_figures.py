"""Figures of what a calibration leaves open: over each image, and over the capture volume."""

from __future__ import annotations

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.report.pictures import SEQUENTIAL, Picture, picture, styled_figure
from gtcal.report.plots import draw_map, image_axes
from gtcal.results.calibration import Calibration
from gtcal.uncertainty.projected import image_uncertainty, volume_uncertainty

_VOLUME_CELLS = 48
_REACH_M = 2.0


def image_picture(calibration: Calibration, camera: str, distance_m: float) -> Picture:
    """1-sigma in px of the pixels of points at this distance, with lines of equal sigma in mm."""
    found = image_uncertainty(calibration, camera, distance_m)
    with styled_figure() as figure:
        axes = image_axes(figure, calibration.cameras[camera].camera)
        draw_map(figure, axes, found.x_px, found.y_px, found.sigma_px, "1-sigma, px")
        sigma_mm = np.ma.masked_invalid(found.sigma_mm)
        if sigma_mm.count() and np.ptp(sigma_mm) > 0.05 * sigma_mm.max():
            lines = axes.contour(found.x_px, found.y_px, sigma_mm, levels=4, colors="white", linewidths=0.8)
            axes.clabel(lines, fmt="%.2g mm", fontsize=7)
        middle, worst = _middle(found.sigma_px), float(np.nanmax(found.sigma_px))
        return picture(
            figure,
            f"{camera}: at {distance_m:g} m",
            f"Of the pixel of a point known in ref: {middle:.2g} px 1-sigma in the middle, {worst:.2g} px at worst. "
            f"Lines: of a point that the camera sees at this distance, {_middle(found.sigma_mm):.2g} mm in the middle.",
        )


def volume_picture(calibration: Calibration) -> Picture:
    """1-sigma in mm of points round the cameras, on the plane through them that holds most of their lines of sight."""
    poses = [inverse(camera.camera_T_ref.a_T_b) for camera in calibration.cameras.values()]
    middle_m = np.mean([pose[:3, 3] for pose in poses], axis=0)
    across, up = _axes_of_the_plane(poses)
    reach_m = _REACH_M + max(float(np.linalg.norm(pose[:3, 3] - middle_m)) for pose in poses)
    ticks_m = np.linspace(-reach_m, reach_m, _VOLUME_CELLS)
    x_m, y_m = np.meshgrid(ticks_m, ticks_m)
    points_m = middle_m + x_m.reshape(-1, 1) * across + y_m.reshape(-1, 1) * up
    found = volume_uncertainty(calibration, points_m)
    worst_mm = found.worst_mm.reshape(x_m.shape)
    with styled_figure() as figure:
        axes = figure.add_subplot(aspect="equal")
        extent = (-reach_m, reach_m, -reach_m, reach_m)
        shown = axes.imshow(worst_mm, extent=extent, origin="lower", cmap=SEQUENTIAL, vmin=0.0, interpolation="none")
        figure.colorbar(shown, ax=axes, label="1-sigma, mm", shrink=0.8, aspect=24)
        for pose in poses:
            x, y = (float((pose[:3, 3] - middle_m) @ axis) for axis in (across, up))
            dx, dy = (float(pose[:3, 2] @ axis) for axis in (across, up))
            axes.annotate("", (x + 0.3 * dx, y + 0.3 * dy), (x, y), arrowprops={"arrowstyle": "->", "linewidth": 1.2})
        axes.grid(False)
        axes.set(xlabel=f"m along {_words(across)} of ref", ylabel=f"m along {_words(up)} of ref")
        seen = np.isfinite(worst_mm)
        median = float(np.median(worst_mm[seen])) if seen.any() else float("nan")
        return picture(
            figure,
            "Over the capture volume",
            f"Of a point as a camera places it whose image and distance are exact, by the least sure camera that sees "
            f"it: {median:.2g} mm 1-sigma typically. White: no camera sees it. Arrows: the cameras.",
        )


def _axes_of_the_plane(poses: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Two axes of ref that span the plane in which the cameras look most."""
    looking = np.abs([pose[:3, 2] for pose in poses]).sum(axis=0)
    first, second = sorted(np.argsort(-looking)[:2].tolist())
    return np.eye(3)[first], np.eye(3)[second]


def _words(axis: FloatArray) -> str:
    return "xyz"[int(np.argmax(axis))]


def _middle(grid: FloatArray) -> float:
    """The value nearest to the middle that is one."""
    rows, columns = np.nonzero(np.isfinite(grid))
    if not rows.size:
        return float("nan")
    distance = (rows - 0.5 * grid.shape[0]) ** 2 + (columns - 0.5 * grid.shape[1]) ** 2
    nearest = int(np.argmin(distance))
    return float(grid[rows[nearest], columns[nearest]])
