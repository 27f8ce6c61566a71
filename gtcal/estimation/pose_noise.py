"""The noise of poses that a detector or a tracker made: its covariance, its tails, and what they say of each view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from gtcal.camera import FloatArray

TAILS = (2.0, 4.0, 10.0, np.inf)
"""Degrees of freedom of the Student t that are tried; infinite is Gaussian."""

SHRUNK_BY = 6.0
"""The covariance of the views is drawn to one that is alike in all directions as if by so many views more."""

_LEAST_RAD, _LEAST_M = 1e-7, 1e-7


@dataclass(frozen=True)
class PoseNoise:
    """covariance: (6, 6) of a view's rotation, about the board's axes, and shift, along the camera's (rad, m). tail:
    the degrees of freedom of its Student t. drifts: whether it is of steps from view to view."""

    covariance: FloatArray
    tail: float
    drifts: bool

    @property
    def log_determinant(self) -> float:
        return float(np.linalg.slogdet(self.covariance)[1])


def weights_of(r: FloatArray, covariance: FloatArray, tail: float) -> FloatArray:
    """(V,) of a Student t; 1 of a Gaussian."""
    if np.isinf(tail):
        return np.ones(len(r))
    return np.asarray((tail + 6.0) / (tail + squared_distances(r, covariance)))


def minus_log_likelihood(r: FloatArray, covariance: FloatArray, tail: float) -> float:
    """Up to what all tails have in common."""
    distance2, half = squared_distances(r, covariance), 0.5 * np.linalg.slogdet(covariance)[1]
    if np.isinf(tail):
        return float(np.sum(0.5 * distance2 + half))
    constant = gammaln(0.5 * tail) - gammaln(0.5 * (tail + 6.0)) + 3.0 * np.log(0.5 * tail)
    return float(np.sum(half + constant + 0.5 * (tail + 6.0) * np.log1p(distance2 / tail)))


def squared_distances(r: FloatArray, covariance: FloatArray) -> FloatArray:
    white = np.linalg.solve(np.linalg.cholesky(covariance), r.T)
    return np.asarray((white**2).sum(axis=0))


def robust_covariance(r: FloatArray) -> FloatArray:
    """By medians, alike in all directions of the rotation, and of the shift."""
    sigmas = [1.4826 * float(np.median(np.abs(part))) for part in (r[:, :3], r[:, 3:])]
    return np.diag(np.repeat([max(sigmas[0], _LEAST_RAD), max(sigmas[1], _LEAST_M)], 3) ** 2)


def shrunk(covariance: FloatArray, n: int) -> FloatArray:
    """Of few views, drawn to one without correlations that is alike in all directions of the rotation, and of the
    shift: by the logarithms of its sigmas, which may well differ by a factor of thirty."""
    logs = np.log(np.maximum(np.diag(covariance), np.repeat([_LEAST_RAD, _LEAST_M], 3) ** 2))
    correlations = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)).clip(min=1e-300))
    share = SHRUNK_BY / (n + SHRUNK_BY)
    alike = np.repeat([logs[:3].mean(), logs[3:].mean()], 3)
    sigmas = np.exp(0.5 * ((1.0 - share) * logs + share * alike))
    drawn = (1.0 - share) * correlations + share * np.eye(6)
    return np.asarray(drawn * np.outer(sigmas, sigmas))
