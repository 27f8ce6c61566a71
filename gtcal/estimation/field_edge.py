"""Corners at the very edge of a lens's field, left out once, before anything is solved: by where they are, not by how
they fit.

Where the radial function turns, its slope is zero: all angles near it have one pixel, which tells none of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors.cores import in_order
from gtcal.camera import BoolArray
from gtcal.estimation.observations import Dropped, Observations, Views, pooled
from gtcal.estimation.residuals import select_corners

LEAST_SLOPE = 0.1
"""Of the radial function, 1 on the axis: below it a pixel is ten times as many mrad as in the middle of the image."""

MOST = 0.05
"""The share of a camera's corners from which it is not they that are at the edge: the stated lens is wrong."""

AT_EDGE = "corner at the edge of the lens's field (its pixel does not tell its direction)"


def without_edge(observations: Observations) -> Observations:
    """The observations less those corners, which are counted among the dropped."""
    views, dropped = dict(observations.views), []
    found = in_order(_inside, observations.views.values())
    for (name, of_camera), inside in zip(observations.views.items(), found, strict=True):
        if inside.all() or np.mean(~inside) > MOST:
            continue
        views[name] = select_corners(of_camera, inside)
        n_views = of_camera.n_views - views[name].n_views
        dropped.append(Dropped(name, AT_EDGE, n_views, int((~inside).sum())))
    return replace(observations, views=views, dropped=pooled((*observations.dropped, *dropped)))


def _inside(views: Views) -> BoolArray:
    """(N,) the corners whose measured pixel tells their direction, by the stated lens."""
    model, theta = views.camera.model, views.camera.theta
    bearings, found = views.camera.unproject(views.corners_px)
    return np.asarray(found & (model.radial_slopes(bearings, theta) > LEAST_SLOPE))
