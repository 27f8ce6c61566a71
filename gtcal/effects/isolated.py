"""Gross views that stand alone. After a slip or a bump all views are off, and that is what is looked for; where a view
is off and those about it are not, the mocap swapped markers or the detector erred."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import chain_residuals_px, median_by_view, norms, offsets_from_view, select_corners
from gtcal.estimation.screening import CORNER_GATE, FLOOR_PX, VIEW_GATE

NEIGHBOURS = 15
"""Views of a camera, in order of time, about one that is judged by them: a change must last for half of them."""


def without_isolated(views: Mapping[str, Views], estimate: Estimate) -> dict[str, Views]:
    """The views less those that are gross beside their neighbours, and less corners that contradict their view."""
    return {name: _kept(of_camera, estimate) for name, of_camera in views.items()}


def _kept(views: Views, estimate: Estimate) -> Views:
    residuals_px = chain_residuals_px(views, estimate)
    of_view = median_by_view(views, norms(residuals_px))
    good = ~isolated(of_view)
    from_view = offsets_from_view(views, residuals_px)
    in_good = np.repeat(good, np.diff(views.view_start))
    usual = float(np.median(from_view[in_good]))
    keep = in_good & (from_view <= max(CORNER_GATE * usual, FLOOR_PX))
    return views if keep.all() else select_corners(views, keep)


def isolated(lengths: FloatArray, floor: float = FLOOR_PX) -> BoolArray:
    """(V,) which views' residuals, in order of time, are gross beside those of the views about them. floor: a length
    that no view is gross under."""
    window = min(NEIGHBOURS, len(lengths))
    medians = np.median(sliding_window_view(lengths, window), axis=1)
    first = np.clip(np.arange(len(lengths)) - window // 2, 0, len(medians) - 1)
    return np.asarray((lengths > np.maximum(VIEW_GATE * medians[first], floor)) | ~np.isfinite(lengths))
