"""What a mocap system makes of a true motion: noise, jitter, gaps and swaps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from gtcal.camera import BoolArray, FloatArray
from gtcal.simulation.transforms import transform

_SMALLEST_SWAP_TURN_RAD = np.deg2rad(30.0)
_SMALLEST_SWAP_SHIFT_M, _LARGEST_SWAP_SHIFT_M = 0.03, 0.3


@dataclass(frozen=True)
class MocapNoise:
    """How a mocap system measures one rigid body.

    translation_mm, rotation_deg: 1-sigma of each component of world_T_body * Exp(noise), in the body frame.
    correlation_s: time constant over which the noise forgets itself (Gauss-Markov); 0 for white noise.
    jitter_s: 1-sigma of the difference between a sample's stamp and the time it was taken at.
    gap_share, gap_duration_s: share of the samples that is lost, in gaps of this length.
    """

    translation_mm: float = 0.1
    rotation_deg: float = 0.01
    correlation_s: float = 0.0
    jitter_s: float = 0.0
    gap_share: float = 0.0
    gap_duration_s: float = 0.25


@dataclass(frozen=True)
class MocapSamples:
    """A body as the mocap measured it. times_s: (M,) as stamped. world_T_body: (M, 4, 4). swapped: (M,)."""

    times_s: FloatArray
    world_T_body: FloatArray
    swapped: BoolArray

    def swapped_at(self, times_s: FloatArray) -> BoolArray:
        """(N,) whether the pose interpolated at each time (N,) is spoilt by a swap."""
        after = np.minimum(np.searchsorted(self.times_s, times_s), len(self.times_s) - 1)
        return self.swapped[after] | self.swapped[np.maximum(after - 1, 0)]


@dataclass(frozen=True)
class Swaps:
    """Moments at which the mocap takes one marker for another, and so a wrong pose for the body.

    centres_s: (S,) the middle of each, in order of time. duration_s: how long one lasts.
    true_T_wrong: (S, 4, 4) what the pose is wrong by, in the body frame.
    """

    centres_s: FloatArray
    duration_s: float
    true_T_wrong: FloatArray

    def only(self, chosen: BoolArray) -> Swaps:
        """Those that are ``chosen`` (S,)."""
        return Swaps(self.centres_s[chosen], self.duration_s, self.true_T_wrong[chosen])

    def applied(self, samples: MocapSamples) -> MocapSamples:
        """The samples with those of the swaps made wrong."""
        if not len(self.centres_s):
            return samples
        nearest = _nearest(self.centres_s, samples.times_s)
        swapped = np.abs(samples.times_s - self.centres_s[nearest]) <= 0.5 * self.duration_s
        wrong = samples.world_T_body.copy()
        wrong[swapped] = wrong[swapped] @ self.true_T_wrong[nearest[swapped]]
        return MocapSamples(samples.times_s, wrong, swapped)


def measured_body(
    world_T_body: Callable[[FloatArray], FloatArray],
    times_s: FloatArray,
    noise: MocapNoise,
    rng: np.random.Generator,
) -> MocapSamples:
    """Sample a true motion at evenly spaced times (M,), with noise, jitter and gaps."""
    n, interval_s = len(times_s), float(times_s[1] - times_s[0])
    jitter_s = noise.jitter_s * rng.standard_normal(n)
    exact = world_T_body(times_s + jitter_s)
    measured = exact @ pose_noise(n, interval_s, noise, rng)
    kept = ~_gaps(n, noise.gap_share, max(1, round(noise.gap_duration_s / interval_s)), rng)
    return MocapSamples(times_s[kept], measured[kept], np.zeros(kept.sum(), dtype=np.bool_))


def pose_noise(n: int, interval_s: float, noise: MocapNoise, rng: np.random.Generator) -> FloatArray:
    """(N, 4, 4) Exp of the noise of consecutive samples, ``interval_s`` apart."""
    from scipy.signal import lfilter  # slow to import

    unit = rng.standard_normal((n, 6))
    if noise.correlation_s > 0.0:
        kept = np.exp(-interval_s / noise.correlation_s)
        unit[1:] *= np.sqrt(1.0 - kept**2)
        unit = lfilter([1.0], [1.0, -kept], unit, axis=0)
    rotation = Rotation.from_rotvec(np.deg2rad(noise.rotation_deg) * unit[:, :3])
    return transform(rotation, 1e-3 * noise.translation_mm * unit[:, 3:])


def _gaps(n: int, share: float, length: int, rng: np.random.Generator) -> BoolArray:
    """(N,) whether a sample is lost: as many gaps as make up the share."""
    lost = np.zeros(n, dtype=np.bool_)
    while lost.sum() < share * n:
        start = rng.integers(-length + 1, n)
        lost[max(start, 0) : start + length] = True
    return lost


def random_swaps(
    frame_times_s: FloatArray, share: float, duration_s: float, reach_s: float, rng: np.random.Generator
) -> Swaps:
    """Swaps around randomly chosen frames, until ``share`` of the frames at ``frame_times_s`` (V,) lie within
    a swap or within ``reach_s``, an interval of the mocap, of one."""
    touched = np.zeros(len(frame_times_s), dtype=np.bool_)
    centres_s = []
    for frame in rng.permutation(len(frame_times_s)):
        if touched.sum() >= round(share * len(frame_times_s)):
            break
        if not touched[frame]:
            centres_s.append(frame_times_s[frame])
            touched |= np.abs(frame_times_s - frame_times_s[frame]) <= 0.5 * duration_s + reach_s
    return Swaps(np.sort(centres_s), duration_s, _gross_errors(len(centres_s), rng))


def _gross_errors(n: int, rng: np.random.Generator) -> FloatArray:
    """(N, 4, 4) turns of 30 to 180 degrees about any axis, with shifts of 3 to 30 cm."""
    axes, directions = rng.standard_normal((2, n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turns_rad = rng.uniform(_SMALLEST_SWAP_TURN_RAD, np.pi, (n, 1))
    shifts_m = rng.uniform(_SMALLEST_SWAP_SHIFT_M, _LARGEST_SWAP_SHIFT_M, (n, 1))
    return transform(Rotation.from_rotvec(turns_rad * axes), shifts_m * directions)


def _nearest(sorted_values: FloatArray, queries: FloatArray) -> npt.NDArray[np.intp]:
    """(N,) the index of the value nearest to each query."""
    after = np.minimum(np.searchsorted(sorted_values, queries), len(sorted_values) - 1)
    before = np.maximum(after - 1, 0)
    nearer_before = np.abs(queries - sorted_values[before]) <= np.abs(sorted_values[after] - queries)
    return np.where(nearer_before, before, after)
