"""How sure a mean, or a fit, over frames is whose errors are correlated in time.

The errors of neighbouring frames share mocap noise, and everything that depends on where the device is. So the
covariance is taken as that of independent frames times a factor for the correlation, which is measured: sums over
stretches of 1, 2, 4, ... frames scatter more than independent frames would let them, up to the length over which the
errors forget themselves. The largest factor counts, also the one that the two longest stretches point to. Sightings of
one frame are summed first: what they share (the mocap's pose of that moment) needs no model.

A fit bends towards its own data, most where they are few; so for a fit the scatter is that of the estimates without
each of the stretches in turn (the jackknife), which does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.estimation.linear import summed_by_run
from gtcal.recordings.detections import IntArray

_FEWEST_STRETCHES = 6
_FEWEST_FRAMES = 8


@dataclass(frozen=True)
class BlockedCovariance:
    """A covariance (K, K).

    inflation: the factor for the correlation in time, 1 or more. n_frames: that it is from."""

    covariance: FloatArray
    inflation: float
    n_frames: int

    @property
    def n_independent(self) -> float:
        """As many independent frames say as much."""
        return self.n_frames / self.inflation

    @property
    def degrees_of_freedom(self) -> float:
        """Of the estimate of the covariance."""
        return max(self.n_independent - 1.0, 1.0)


def sum_covariance(values: FloatArray, frame_index: IntArray) -> BlockedCovariance | None:
    """The covariance of the sum of values (S, K) about their mean, each with its place in time ``frame_index`` (S,),
    not decreasing. None where there are too few frames to tell."""
    by_frame = summed_by_run(values - values.mean(axis=0), frame_index)

    def of_stretches(edges: IntArray) -> FloatArray:
        sums = np.add.reduceat(by_frame, edges[:-1], axis=0)
        n = len(sums)
        return np.asarray(sums.T @ sums * (n / (n - 1)))

    return _inflated(len(by_frame), of_stretches)


def fit_covariance(
    scores: FloatArray, information: FloatArray, prior: FloatArray, frame_index: IntArray
) -> BlockedCovariance | None:
    """The covariance of a least-squares estimate of K parameters, from each row's gradient at the estimate (S, K), its
    part of the Gauss-Newton Hessian (S, K, K), and what was added to the Hessian (K, K). ``frame_index`` and None as
    in ``sum_covariance``."""
    score_of_frame, information_of_frame = summed_by_run(scores, frame_index), summed_by_run(information, frame_index)
    total = information.sum(axis=0) + prior

    def of_stretches(edges: IntArray) -> FloatArray:
        score = np.add.reduceat(score_of_frame, edges[:-1], axis=0)
        without = total - np.add.reduceat(information_of_frame, edges[:-1], axis=0)
        moved = np.linalg.solve(without, score[:, :, None])[:, :, 0]
        n = len(moved)
        return np.asarray(moved.T @ moved * ((n - 1) / n))

    return _inflated(len(score_of_frame), of_stretches)


def _inflated(n_frames: int, of_stretches: Callable[[IntArray], FloatArray]) -> BlockedCovariance | None:
    """From the covariance by stretches, given where these begin and end: (B + 1,) frames."""
    if n_frames < _FEWEST_FRAMES:
        return None
    white = of_stretches(np.arange(n_frames + 1))
    k = len(white)
    white = white + (1e-9 * np.trace(white) / k + 1e-300) * np.eye(k)
    factors, length = [1.0], 2
    while n_frames // length >= _FEWEST_STRETCHES:
        edges = np.linspace(0, n_frames, n_frames // length + 1).round().astype(np.int64)
        factors.append(float(np.trace(np.linalg.solve(white, of_stretches(edges))) / k))
        length *= 2
    # What stretches of length L miss of the factor falls with 1 / L, so that two lengths tell the limit.
    limit = 2.0 * factors[-1] - factors[-2] if len(factors) > 1 else 1.0
    inflation = max(*factors, limit, 1.0)
    return BlockedCovariance(inflation * white, inflation, n_frames)
