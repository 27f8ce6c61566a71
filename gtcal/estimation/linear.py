"""Linear algebra that unknowns of different units need."""

from __future__ import annotations

import numpy as np

from gtcal.camera import FloatArray
from gtcal.recordings.detections import IntArray


def scaled_root(H: FloatArray) -> FloatArray:
    """R with R H R^T = I, of a positive definite matrix whose columns have different units.

    Raises numpy.linalg.LinAlgError where a direction is open."""
    scale = 1.0 / np.sqrt(np.diag(H))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(H * np.outer(scale, scale))) * scale)


def squared_distance(xi: FloatArray, covariance: FloatArray) -> float:
    """xi^T covariance^-1 xi, whatever the units of the components (K,)."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return float((xi * scale) @ np.linalg.solve(covariance * np.outer(scale, scale), xi * scale))


def scaled_inverse(H: FloatArray) -> FloatArray:
    """H^-1, as ``scaled_root``."""
    root = scaled_root(H)
    return np.asarray(root.T @ root)


def summed_by_run(values: FloatArray, key: IntArray) -> FloatArray:
    """(G, ...) sums of the rows of values (N, ...) in each run of rows whose ``key`` (N,) is the same."""
    starts = np.flatnonzero(np.concatenate([[True], np.diff(key) != 0]))
    return np.asarray(np.add.reduceat(values, starts, axis=0))
