"""Statistics of sightings: norms with bounds, bias, curves and the heat map."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import special

from gtcal.camera import Camera, FloatArray
from gtcal.recordings.detections import IntArray
from gtcal.uncertainty.coverage import image_coverage
from gtcal.verification.blocks import sum_covariance
from gtcal.verification.verification import Bias, ErrorCurve, ErrorStatistics, HeatMap, Sightings, VerificationOptions

_CURVE_BINS = 12


def error_statistics(
    norms: FloatArray, frame_index: IntArray, unit: Literal["px", "mm"], confidence: float
) -> ErrorStatistics:
    """Of error norms (S,), in order of time."""
    if len(norms) == 0:
        nan = float("nan")
        return ErrorStatistics(unit, 0, nan, nan, nan, nan, nan, nan, nan)
    low, high = rmse_bounds(norms, frame_index, confidence)
    return ErrorStatistics(
        unit=unit,
        count=len(norms),
        rmse=float(np.sqrt(np.mean(norms**2))),
        mean=float(norms.mean()),
        median=float(np.median(norms)),
        p95=float(np.quantile(norms, 0.95)),
        worst=float(norms.max()),
        rmse_low=low,
        rmse_high=high,
    )


def rmse_bounds(norms: FloatArray, frame_index: IntArray, confidence: float) -> tuple[float, float]:
    """One-sided bounds on the RMSE, each at ``confidence``; NaN where there are too few frames."""
    squares = norms**2
    of_sum = sum_covariance(squares[:, None], frame_index)
    if of_sum is None:
        return float("nan"), float("nan")
    sigma = float(np.sqrt(of_sum.covariance[0, 0])) / len(norms)
    reach = float(special.stdtrit(of_sum.degrees_of_freedom, confidence)) * sigma
    mean = float(squares.mean())
    return float(np.sqrt(max(mean - reach, 0.0))), float(np.sqrt(mean + reach))


def bias(sightings: Sightings, confidence: float) -> Bias:
    """The mean error of one camera with its confidence interval."""
    xy, half_xy = _mean_with_interval(sightings.errors_px, sightings.frame_index, confidence)
    rt, half_rt = _mean_with_interval(sightings.radial_tangential_px, sightings.frame_index, confidence)
    return Bias(xy, half_xy, float(rt[0]), float(half_rt[0]), float(rt[1]), float(half_rt[1]))


def _mean_with_interval(values: FloatArray, frame_index: IntArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    if len(values) == 0:
        return np.full(2, np.nan), np.full(2, np.nan)
    mean = values.mean(axis=0)
    half = np.full(2, np.nan)
    for i in range(2):
        of_sum = sum_covariance(values[:, i : i + 1], frame_index)
        if of_sum is not None:
            quantile = special.stdtrit(of_sum.degrees_of_freedom, 0.5 + 0.5 * confidence)
            half[i] = quantile * np.sqrt(of_sum.covariance[0, 0]) / len(values)
    return mean, half


def curves(sightings: Sightings) -> tuple[ErrorCurve, ...]:
    """Error against distance, viewing angle and field angle."""
    return (
        _curve("distance_m", sightings.distance_m, sightings),
        _curve("viewing_angle_deg", np.rad2deg(sightings.viewing_angle_rad), sightings),
        _curve("field_angle_deg", np.rad2deg(sightings.field_angle_rad), sightings),
    )


def _curve(
    quantity: Literal["distance_m", "viewing_angle_deg", "field_angle_deg"], values: FloatArray, sightings: Sightings
) -> ErrorCurve:
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    edges = np.linspace(low, high if high > low else low + 1.0, _CURVE_BINS + 1)
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _CURVE_BINS - 1)
    count = np.bincount(which, minlength=_CURVE_BINS)
    norms_px = sightings.e_2d_px
    median = np.full(_CURVE_BINS, np.nan)
    for b in np.flatnonzero(count):
        median[b] = np.median(norms_px[which == b])
    rmse_px, rmse_mm = (_binned_rmse(norms, which, count) for norms in (norms_px, sightings.e_3d_mm))
    return ErrorCurve(quantity, edges, count, rmse_px, median, rmse_mm)


def _binned_rmse(norms: FloatArray, which: IntArray, count: IntArray) -> FloatArray:
    squares = np.bincount(which, norms**2, minlength=len(count))
    return np.sqrt(np.where(count > 0, squares / np.maximum(count, 1), np.nan))


def heat_map(sightings: Sightings, columns: int, rows: int) -> HeatMap:
    """e_2D over the image in columns x rows bins."""
    camera = sightings.camera
    cells = _cells(camera, sightings.image_centre_px, columns, rows)
    count = np.bincount(cells, minlength=rows * columns)
    rmse = _binned_rmse(sightings.e_2d_px, cells, count)
    errors = sightings.errors_px
    sums = np.stack([np.bincount(cells, errors[:, i], minlength=rows * columns) for i in range(2)], axis=1)
    mean = np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], np.nan)
    return HeatMap(
        x_edges_px=np.linspace(-0.5, camera.image_width_px - 0.5, columns + 1),
        y_edges_px=np.linspace(-0.5, camera.image_height_px - 0.5, rows + 1),
        count=count.reshape(rows, columns),
        rmse_px=rmse.reshape(rows, columns),
        mean_error_px=mean.reshape(rows, columns, 2),
    )


def coverage(sightings: Sightings, options: VerificationOptions) -> float:
    """Share of the image's cells that the lens can see that hold a sighting."""
    found = image_coverage(
        sightings.camera, sightings.image_centre_px, across=options.coverage_columns, down=options.coverage_rows
    )
    return found.share


def _cells(camera: Camera, pixels_px: FloatArray, columns: int, rows: int) -> IntArray:
    """(S,) the cell of each pixel, row by row."""
    size = np.array([camera.image_width_px, camera.image_height_px])
    share = (pixels_px + 0.5) / size
    column, row = np.clip((share * [columns, rows]).astype(np.int64), 0, [columns - 1, rows - 1]).T
    return np.asarray(row * columns + column)
