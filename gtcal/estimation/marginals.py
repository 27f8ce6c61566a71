"""Marginal information and covariance of the unknowns that all frames share, from a graph at its solution.

GTSAM linearises the graph and eliminates the other variables; what is left is small and dense. It is inverted in units
of its own diagonal: focal lengths in px beside distortion coefficients make it too ill-conditioned for GTSAM's own
``Marginals`` long before any unknown is open.
"""

from __future__ import annotations

import gtsam
import numpy as np

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError


def joint_information(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: list[int]) -> FloatArray:
    """(P, P) of the variables ``keys``, in their order, all others eliminated. May be singular.

    Raises GtcalError where the others are open by themselves."""
    return shared_information(graph.linearize(values), keys)


def shared_information(linear: gtsam.GaussianFactorGraph, keys: list[int]) -> FloatArray:
    """``joint_information`` of a linear graph."""
    return shared_normal_equations(linear, keys)[0]


def shared_normal_equations(linear: gtsam.GaussianFactorGraph, keys: list[int]) -> tuple[FloatArray, FloatArray]:
    """``shared_information``, and (P,) minus the gradient."""
    others = _ordering(sorted(set(linear.keyVector()) - set(keys)))
    if others.size():
        try:
            _, linear = linear.eliminatePartialMultifrontal(others)
        except RuntimeError as error:
            raise GtcalError(
                "the poses of single frames are open, so nothing can be said of the rest: is the mocap's prior missing?"
            ) from error
    information, descent = linear.hessian(_ordering(keys))
    return np.asarray(information), np.asarray(descent)


def covariance_of(information: FloatArray) -> FloatArray | None:
    """The inverse (P, P); None where a direction is open."""
    diagonal = np.diag(information)
    if not (np.isfinite(information).all() and (diagonal > 0.0).all()):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    scaled = information * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    if not values[0] > _OPEN * values[-1]:
        return None
    half = vectors / np.sqrt(values)
    return np.asarray((half @ half.T) * np.outer(scale, scale))


_OPEN = 1e-13
"""An eigenvalue, as a share of the largest, that rounding makes of none."""


def _ordering(keys: list[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering
