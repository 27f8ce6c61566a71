"""A drift or a bump in words: since when, how fast, and how many days until a tolerance is left, with how sure that
is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import stdtr

from gtcal.camera import FloatArray

INTERVAL = 0.9
"""Of the days that are left: one in twenty is earlier, one in twenty later."""

_DRAWS = 4000
_CHANCE = 0.01
_LEAST_AFTER = 3


@dataclass(frozen=True)
class Change:
    """How a vector (K,) of a rig changed with time.

    kind: drift: on a straight line from ``since_day`` on. step: at once, between the value before ``since_day`` and it.
    direction: (K,) a unit vector. line: (2,) along it, the value before, and its growth per day or the step; with its
    covariance (2, 2). last_day: of the last value. chance: of a change as large where there is none."""

    kind: Literal["drift", "step"]
    since_day: float
    last_day: float
    direction: FloatArray
    line: FloatArray
    line_covariance: FloatArray
    chance: float

    @property
    def significant(self) -> bool:
        """At 1 %, all days on which it may have begun allowed for."""
        return self.chance < _CHANCE

    @property
    def rate(self) -> float:
        """Growth per day of a drift, or the step."""
        return float(self.line[1])

    @property
    def rate_sigma(self) -> float:
        return math.sqrt(float(self.line_covariance[1, 1]))


@dataclass(frozen=True)
class DaysLeft:
    """Until a tolerance is left: the middle, and an interval; infinite where it may never be."""

    middle: float
    low: float
    high: float


def change_of(days: FloatArray, values: FloatArray, sigmas: FloatArray) -> Change | None:
    """The straight line or step from some day on that explains values (N, K) with sigmas (N, K) best. What they scatter
    about it beyond their sigmas widens its own. None of fewer than five values, or where nothing changes."""
    n, n_axes = values.shape
    if n < 2 + _LEAST_AFTER or not np.ptp(days) > 0.0:
        return None
    weights = 1.0 / np.maximum(sigmas, 1e-12) ** 2
    fits: list[tuple[float, FloatArray, FloatArray, Literal["drift", "step"], float]] = [
        (*_fit(values, weights, shape), kind, float(days[place]))
        for place in range(n - _LEAST_AFTER + 1)
        for kind, shape in _shapes(days, place)
        if np.ptp(shape) > 0.0
    ]
    cost, coefficients, covariance, kind, since = min(fits, key=lambda fit: fit[0])
    dof = max(n_axes * (n - 2) - 1, 1)  # a line on each axis, and the day
    scatter = max(cost / dof, 1.0)
    slope = coefficients[:, 1]
    size = float(np.linalg.norm(slope))
    if not size > 0.0:
        return None
    direction = slope / size
    along = (direction[:, None, None] ** 2 * covariance).sum(axis=0) * scatter
    alone = 2.0 * stdtr(dof, -size / math.sqrt(along[1, 1]))
    return Change(
        kind=kind,
        since_day=float(since),
        last_day=float(days[-1]),
        direction=direction,
        line=coefficients.T @ direction,
        line_covariance=along,
        chance=min(float(alone) * len(fits), 1.0),
    )


def _shapes(days: FloatArray, place: int) -> tuple[tuple[Literal["drift", "step"], FloatArray], ...]:
    """What grows from a day on, and what is another from it on."""
    after = days - days[place]
    return ("drift", np.maximum(after, 0.0)), ("step", (after >= 0.0).astype(np.float64))


def _fit(values: FloatArray, weights: FloatArray, shape: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Of each axis a mean and a multiple of a shape (N,): the cost, both (K, 2), and their covariances (K, 2, 2)."""
    A = np.stack([np.ones_like(shape), shape], axis=1)
    H = np.einsum("ni,nk,nj->kij", A, weights, A)
    covariance = np.linalg.inv(H)
    coefficients = np.einsum("kij,nj,nk->ki", covariance, A, weights * values)
    cost = float((weights * (values - A @ coefficients.T) ** 2).sum())
    return cost, coefficients, covariance


def days_left(change: Change, tolerance: float) -> DaysLeft | None:
    """Until the value along the drift is ``tolerance`` away from zero, counted from the last day. None for a step."""
    if change.kind != "drift":
        return None
    before, rate = np.random.default_rng(0).multivariate_normal(change.line, change.line_covariance, _DRAWS).T
    now = before + rate * (change.last_day - change.since_day)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(rate > 0.0, np.maximum(tolerance - now, 0.0) / rate, np.inf)
    low, middle, high = np.quantile(left, [(1 - INTERVAL) / 2, 0.5, (1 + INTERVAL) / 2], method="nearest")
    return DaysLeft(float(middle), float(low), float(high))


def drift_tolerance(rmse: FloatArray, drifting: FloatArray, largest_rmse: float) -> float:
    """At which value of what drifts (N,) the RMSE (N,) reaches ``largest_rmse``: its square is that of the noise and a
    multiple, one or more, of the drifting value's, both found from the values."""
    squares, drift2 = rmse**2, drifting**2
    about = drift2 - drift2.mean()
    spread = float(about @ about)
    multiple = max(float(about @ (squares - squares.mean())) / spread, 1.0) if spread > 0.0 else 1.0
    noise2 = max(float((squares - multiple * drift2).mean()), 0.0)
    return math.sqrt(max(largest_rmse**2 - noise2, 0.0) / multiple)
