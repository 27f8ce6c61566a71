"""Levenberg-Marquardt for graphs with a variable per frame.

GTSAM linearises, eliminates and solves; only the loop is ours. The loop of GTSAM's own optimizer keeps the variables to
itself, and each of a thousand frames' factors in Python is then handed a copy of all of them, twice an iteration. Here
they are the Python object that the factors share. Only what all frames share is damped, by the diagonal of its
information with the frames eliminated: a frame's own pose has the mocap's prior.
"""

from __future__ import annotations

import gtsam
import numpy as np

from gtcal.errors import GtcalError
from gtcal.estimation.graph import Minimisation
from gtcal.estimation.marginals import shared_information

_FIRST_DAMPING, _LARGEST_DAMPING = 1e-5, 1e9
_FACTOR = 10.0
_SMALLEST_DIAGONAL, _LARGEST_DIAGONAL = 1e-6, 1e32  # as in GTSAM


def minimise_many_frames(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    shared: dict[int, int],
    *,
    eps: float,
    max_iterations: int,
    least_gain: float,
) -> Minimisation:
    """Until an iteration improves the error E by less than eps (1 + E), and by less than ``least_gain``: of a whitened
    error, a gain of 1/2 can be a step of a whole sigma. shared: keys of what is not
    a single frame's, and the size of each."""
    errors, damping, converged = [graph.error(values)], 0.0, False
    while len(errors) <= max_iterations and not converged:
        values, error, damping = _iteration(graph, values, errors[-1], shared, damping)
        errors.append(error)
        converged = not errors[-2] - errors[-1] >= min(eps * (1.0 + errors[-1]), least_gain)
    return Minimisation(values, tuple(errors), converged and bool(np.isfinite(errors[-1])))


def _iteration(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, error: float, shared: dict[int, int], damping: float
) -> tuple[gtsam.Values, float, float]:
    """The values after a step that lowers the error (the same values where none does), their error, and the damping to
    go on with."""
    linear = graph.linearize(values)
    while damping <= _LARGEST_DAMPING:
        step = _step(linear, shared, damping)
        if step is not None:
            moved = values.retract(step)
            moved_error = graph.error(moved)
            if moved_error <= error:
                return moved, moved_error, damping / _FACTOR if damping > _FIRST_DAMPING else 0.0
        damping = max(damping * _FACTOR, _FIRST_DAMPING)
    return values, error, damping


def _step(linear: gtsam.GaussianFactorGraph, shared: dict[int, int], damping: float) -> gtsam.VectorValues | None:
    """None where the system is singular."""
    try:
        return (_damped(linear, shared, damping) if damping > 0.0 else linear).optimize()
    except (RuntimeError, GtcalError):
        return None


def _damped(linear: gtsam.GaussianFactorGraph, shared: dict[int, int], damping: float) -> gtsam.GaussianFactorGraph:
    """With ``damping`` times the diagonal of the shared variables' information added."""
    diagonal = np.clip(np.diag(shared_information(linear, list(shared))), _SMALLEST_DIAGONAL, _LARGEST_DIAGONAL)
    damped = gtsam.GaussianFactorGraph()
    damped.push_back(linear)
    start = 0
    for key, size in shared.items():
        scale = np.sqrt(damping * diagonal[start : start + size])
        damped.add(key, np.diag(scale), np.zeros(size), gtsam.noiseModel.Unit.Create(size))
        start += size
    return damped
