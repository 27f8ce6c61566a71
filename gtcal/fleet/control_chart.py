"""Control charts: has a series left what it was, or is it chance?

Nobody knows beforehand what a rig's errors are on a good day, nor how they scatter. So a chart starts by itself: each
value is held against those before it (Hawkins 1987; Quesenberry 1991), which for independent normal values gives
independent standard normal scores whatever their mean and scatter are, from the third value on. Values that follow
each other alike are first freed from that: of each the share ``autocorrelation`` of the one before is taken away
(Alwan and Roberts 1988). The scores go through an EWMA; its limit is set so that, where nothing has changed, it is left
once in a stated number of values on average (the run length, by Crowder's integral equation, 1987). Many charts that
are watched at once have as many times the run length each, so that together they have the stated one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtri, stdtr

from gtcal.camera import FloatArray

WEIGHT = 0.2
"""Of a new score in the EWMA: 0.2 is best at shifts of about one sigma."""

FEWEST = 5
"""A chart of fewer values tells nothing."""

_NODES = 64
_MOST_AUTOCORRELATION = 0.9
_LARGEST_SCORE = 8.0
_NORMAL = 3.0


@dataclass(frozen=True)
class Chart:
    """scores, ewma: (N,), 0 where there is no score yet. limit: of the EWMA, either way. alarm: the place of the first
    value beyond it, None where there is none. run_length: this chart's own, in values."""

    scores: FloatArray
    ewma: FloatArray
    limit: float
    alarm: int | None
    run_length: float


def chart(values: FloatArray, *, run_length: float, autocorrelation: float = 0.0) -> Chart:
    """The chart of values (N,) in order of time."""
    scores = self_starting_scores(freed(values, autocorrelation))
    ewma, limit = _ewma(scores), limit_for(run_length)
    beyond = np.flatnonzero(np.abs(ewma) > limit)
    return Chart(scores, ewma, limit, int(beyond[0]) if len(beyond) else None, run_length)


def freed(values: FloatArray, autocorrelation: float) -> FloatArray:
    """(N,) the values less what each takes over from the one before; the first is scaled to scatter as the others."""
    rest = values.copy()
    rest[1:] -= autocorrelation * values[:-1]
    rest[:1] = (1.0 - autocorrelation) * values[:1]
    return rest


def self_starting_scores(values: FloatArray) -> FloatArray:
    """(N,) of values (N,): how far each is from those before it, as a standard normal number; 0 for the first two, and
    where those before are all alike. What was beyond 3 is no longer held up as what is normal: else a bump would hide
    itself."""
    scores, n, mean, squares = np.zeros(len(values)), 0, 0.0, 0.0  # squares: of the distances from the mean, summed
    for place, value in enumerate(values.tolist()):
        if squares > 0.0:  # of two or more
            t = math.sqrt(n / (n + 1)) * (value - mean) / math.sqrt(squares / (n - 1))
            scores[place] = _normal(t, n - 1)
        if abs(scores[place]) <= _NORMAL:
            n, before = n + 1, mean
            mean += (value - mean) / n
            squares += (value - before) * (value - mean)  # Welford's
    return scores


def _normal(t: float, dof: int) -> float:
    """The standard normal number as far out as t of Student's distribution."""
    tail = float(stdtr(dof, -abs(t)))  # the small side, which keeps its digits
    return float(math.copysign(min(-ndtri(tail), _LARGEST_SCORE), t))


def _ewma(scores: FloatArray) -> FloatArray:
    smooth, found = 0.0, np.zeros(len(scores))
    for n, score in enumerate(scores):
        smooth += WEIGHT * (float(score) - smooth)
        found[n] = smooth
    return found


@cache
def limit_for(run_length: float) -> float:
    """The limit at which an EWMA of independent standard normal scores is left once in so many, from 0 on."""
    scale = math.sqrt(WEIGHT / (2.0 - WEIGHT))
    wanted = math.log(run_length)
    return float(brentq(lambda h: math.log(run_length_at(h)) - wanted, 0.5 * scale, 5.5 * scale, xtol=1e-6))


def run_length_at(limit: float) -> float:
    """How many scores an EWMA takes on average to leave +-limit where nothing has changed: Crowder's equation
    L(u) = 1 + int L(y) phi((y - (1 - w) u) / w) / w dy, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    y, w = limit * nodes, limit * weights
    density = _density((y[None, :] - (1.0 - WEIGHT) * y[:, None]) / WEIGHT) / WEIGHT
    lengths = np.linalg.solve(np.eye(_NODES) - density * w[None, :], np.ones(_NODES))
    return float(1.0 + (lengths * w) @ (_density(y / WEIGHT) / WEIGHT))


def _density(x: FloatArray) -> FloatArray:
    return np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi)


def autocorrelation_of(series: Iterable[FloatArray]) -> float:
    """From one value to the next, of many series together: the median of each one's about its own straight line (a
    drift is none), freed from the bias of short series (Kendall 1954). Between 0 and 0.9."""
    found = [_lag_1(values) for values in series if len(values) >= FEWEST]
    return float(np.clip(np.median(found), 0.0, _MOST_AUTOCORRELATION)) if found else 0.0


def _lag_1(values: FloatArray) -> float:
    n = len(values)
    about_line = values - np.polynomial.Polynomial.fit(np.arange(n), values, 1)(np.arange(n))
    total = float(about_line @ about_line)
    lag = float(about_line[1:] @ about_line[:-1]) / total if total > 0.0 else 0.0
    return lag + (2.0 + 4.0 * lag) / n  # of a line that is taken away; 1 + 3 lag of a mean
