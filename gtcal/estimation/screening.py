"""Gross outliers: views and corners that the chain contradicts, told by robust statistics of all the views.

A mocap swap moves all corners of a view together; a wrong tag moves some corners against their view. So a view is
judged by the median residual of its corners, and a corner by its residual less its view's median: mocap noise cancels
in the second, and the first needs no faultless corners.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from factors.cores import in_order
from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Dropped, Views
from gtcal.estimation.residuals import chain_residuals_px, median_by_view, norms, offsets_from_view, select_corners

VIEW_GATE = 5.0
"""A view is out where its median residual is over 5 times the camera's median one. Shifts of views by Gaussian
mocap noise have a Rayleigh length, which exceeds 5 times its median with probability 2^-25."""

CORNER_GATE = 7.0
"""A corner is out where it lies over 7 times the median distance from its view's median residual: 8.2 sigma of a
Gaussian (the median Rayleigh length is 1.18 sigma), to spare room for lens-model error."""

MEDIAN_OVER_QUARTER = 3.0
"""A camera's median residual is not what is usual where it is over 3 times the lowest quarter's (1.55 times, for
lengths of Gaussian vectors): then it is that of gross views, which by chance are over half of this camera's."""

FLOOR_PX = 0.3
"""No gate below this many pixels: in data without noise nothing is an outlier."""

GROSS_VIEW = "gross view (mocap or detection contradicts the chain)"
"""Why a view is left out."""


@dataclass(frozen=True)
class Screened:
    """The views and corners that stay, by camera, and the lengths (n,) of their residuals under the estimate; with
    their masks over the views (V,) and corners (N,) screened."""

    views: dict[str, Views]
    lengths_px: dict[str, FloatArray]
    keep_view: dict[str, BoolArray]
    keep_corner: dict[str, BoolArray]

    def same_as(self, other: Screened) -> bool:
        """Whether the same corners stay."""
        return all(np.array_equal(keep, other.keep_corner[name]) for name, keep in self.keep_corner.items())

    def under(self, estimate: Estimate) -> Screened:
        """The same corners with their residuals under another estimate."""
        lengths_px = {name: norms(chain_residuals_px(views, estimate)) for name, views in self.views.items()}
        return replace(self, lengths_px=lengths_px)

    @property
    def rms_px(self) -> float:
        """Of the residuals' norms, corners without a pixel aside."""
        lengths_px = np.concatenate(list(self.lengths_px.values()))
        return float(np.sqrt(np.mean(lengths_px[np.isfinite(lengths_px)] ** 2)))

    def dropped(self, screened: Mapping[str, Views]) -> tuple[Dropped, ...]:
        """What was left out of the views that were screened."""
        found = []
        for name, views in screened.items():
            keep_view, keep_corner = self.keep_view[name], self.keep_corner[name]
            in_kept_view = keep_view[views.view_of_corner]
            n_views = int((~keep_view).sum())
            n_single = int((in_kept_view & ~keep_corner).sum())
            if n_views:
                found.append(Dropped(name, GROSS_VIEW, n_views, int((~in_kept_view).sum())))
            if n_single:
                found.append(Dropped(name, "gross corner (contradicts its view)", 0, n_single))
        return tuple(found)


def screen(views: Mapping[str, Views], estimate: Estimate) -> Screened:
    """Drop the views, then the corners, whose residuals under the estimate are gross. At least half of a camera's
    views stay, since the gate is relative to their median, or at least a quarter where the others lie far off."""
    return _screened(views, estimate, _masks)


def keep_all(views: Mapping[str, Views], estimate: Estimate) -> Screened:
    """No screening."""
    return _screened(views, estimate, _all)


def _screened(
    views: Mapping[str, Views],
    estimate: Estimate,
    masks: Callable[[Views, FloatArray, FloatArray], tuple[BoolArray, BoolArray]],
) -> Screened:
    def of(of_camera: Views) -> tuple[Views, FloatArray, BoolArray, BoolArray]:
        residuals_px = chain_residuals_px(of_camera, estimate)
        lengths = norms(residuals_px)
        keep_view, keep = masks(of_camera, residuals_px, lengths)
        return of_camera if keep.all() else select_corners(of_camera, keep), lengths[keep], keep_view, keep

    kept, lengths_px, keep_view, keep_corner = zip(*in_order(of, views.values()), strict=True)
    of_each = (dict(zip(views, values, strict=True)) for values in (kept, lengths_px, keep_view, keep_corner))
    return Screened(*of_each)


def _all(views: Views, residuals_px: FloatArray, lengths_px: FloatArray) -> tuple[BoolArray, BoolArray]:
    return np.ones(views.n_views, dtype=bool), np.ones(views.n_corners, dtype=bool)


def _masks(views: Views, residuals_px: FloatArray, lengths_px: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Which views (V,) and corners (N,) stay. A corner without a pixel (NaN) counts as infinitely far off."""
    of_view = median_by_view(views, lengths_px)
    keep_view = of_view <= max(VIEW_GATE * _usual(of_view), FLOOR_PX)
    from_view = offsets_from_view(views, residuals_px)
    in_kept_view = np.repeat(keep_view, np.diff(views.view_start))
    usual = float(np.median(from_view[in_kept_view]))
    return keep_view, in_kept_view & (from_view <= max(CORNER_GATE * usual, FLOOR_PX))


def _usual(lengths_px: FloatArray) -> float:
    """The median, or what the lowest quarter lets one expect of it if that is far less."""
    quarter = float(np.sort(lengths_px)[(len(lengths_px) - 1) // 4])
    median = float(np.median(lengths_px))
    return float(min(median, max(MEDIAN_OVER_QUARTER * quarter, FLOOR_PX)))
