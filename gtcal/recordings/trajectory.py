"""A tracked body over time, and its pose and velocity between the samples."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from gtcal.bounds import LARGEST_LENGTH_M
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

QuaternionOrder = Literal["xyzw", "wxyz"]
# One lost sample is bridged, two are not, whatever the rate: 2.5 intervals leave room for the jitter of stamps.
_GAP_INTERVALS = 2.5
# A straight line between poses 0.2 s apart is off by a T^2 / 8 = 1 cm at 2 m/s^2, a calm hand: past use.
_LONGEST_DEFAULT_GAP_S = 0.2


class Gap(IntEnum):
    """Why a trajectory has, or has not, a pose at a time."""

    NONE = 0
    OUTSIDE = 1
    TOO_LONG = 2


@dataclass(frozen=True)
class PosesAt:
    """A trajectory at N query times.

    world_T_body: (N, 4, 4), NaN where there is no pose.
    gaps: (N,) uint8, why there is no pose, in the values of ``Gap``.
    """

    world_T_body: FloatArray
    gaps: npt.NDArray[np.uint8]

    @property
    def ok(self) -> BoolArray:
        """(N,) whether there is a pose."""
        return self.gaps == Gap.NONE


@dataclass(frozen=True)
class Trajectory:
    """The pose of a tracked body in the mocap world at M times.

    body: what it is called in messages and files, as 'platform'.
    stamps_ns: (M,) int64, strictly increasing, mocap clock.
    world_T_body: (M, 4, 4) rigid transforms, metres.
    notes: what was done to get it from its file, one sentence each, for the user to see.
    Raises GtcalError where shapes differ, there is no sample, a value is not finite, or stamps do not increase.
    """

    body: str
    stamps_ns: IntArray
    world_T_body: FloatArray
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.stamps_ns)
        if self.world_T_body.shape != (n, 4, 4):
            raise GtcalError(
                f"trajectory {self.body!r}: {self.world_T_body.shape=} for {n} stamps, expected ({n}, 4, 4)"
            )
        if n == 0:
            raise GtcalError(f"trajectory {self.body!r} has no poses")
        if not np.isfinite(self.world_T_body).all():
            raise GtcalError(f"trajectory {self.body!r} has NaN or infinite values")
        if (farthest_m := float(np.abs(self.world_T_body[:, :3, 3]).max())) > LARGEST_LENGTH_M:
            raise GtcalError(f"trajectory {self.body!r}: a position is {farthest_m:.3g} m from zero; check the unit")
        if (np.diff(self.stamps_ns) <= 0).any():
            raise GtcalError(f"trajectory {self.body!r}: time stamps must increase from sample to sample")

    @property
    def n_samples(self) -> int:
        return len(self.stamps_ns)

    @cached_property
    def median_interval_s(self) -> float:
        """Median time between two samples; infinite for a single one."""
        return float(np.median(np.diff(self.stamps_ns))) * 1e-9 if self.n_samples > 1 else np.inf

    @property
    def default_max_gap_s(self) -> float:
        """The longest gap to interpolate across where the recording does not say: 2.5 median intervals, which
        bridges one lost sample but not two, and never more than 0.2 s."""
        return min(_GAP_INTERVALS * self.median_interval_s, _LONGEST_DEFAULT_GAP_S)

    def interpolate(self, stamps_ns: IntArray, max_gap_s: float) -> PosesAt:
        """The pose at ``stamps_ns`` (N,), in any order: position linear, orientation by SLERP between the two
        samples around it. At a sample's own stamp it is that sample; elsewhere there is none before the first
        sample, after the last, and between samples more than ``max_gap_s`` apart."""
        segment, fraction = self._locate(stamps_ns)
        poses = self.world_T_body[segment]
        inside = (fraction > 0) & (fraction < 1)
        here = segment[inside]
        poses[inside, :3, :3] = self._slerp(here, fraction[inside])
        step = self.world_T_body[here + 1, :3, 3] - self.world_T_body[here, :3, 3]
        poses[inside, :3, 3] += fraction[inside, None] * step
        gaps = self._gaps(segment, fraction, max_gap_s)
        poses[gaps != Gap.NONE] = np.nan
        return PosesAt(poses, gaps)

    def interpolated_variance(self, stamps_ns: IntArray, correlation_s: float = 0.0) -> FloatArray:
        """Noise variance (N,) of an interpolated pose as a share of one sample's: for independent samples 1 at a
        sample and 1/2 midway; less is averaged out of noise that is correlated over ``correlation_s`` (to 1/e)."""
        segment, fraction = self._locate(stamps_ns)
        apart = 2.0 * fraction * (1.0 - fraction)
        if correlation_s == 0.0 or self.n_samples < 2:
            return 1.0 - apart
        segment = np.minimum(segment, self.n_samples - 2)
        interval_s = 1e-9 * (self.stamps_ns[segment + 1] - self.stamps_ns[segment])
        return 1.0 - apart * (1.0 - np.exp(-interval_s / correlation_s))

    def twist_per_s(self, stamps_ns: IntArray) -> FloatArray:
        """The body's velocity (N, 6) at ``stamps_ns`` (N,), the time derivative of ``interpolate``:
        world_T_body(t + dt) = world_T_body(t) * Exp(twist_per_s dt). Rotation first (rad/s, then m/s), in the body
        frame. At a sample it is that of the segment after it. NaN before the first sample and after the last."""
        if self.n_samples < 2:
            return np.full((len(stamps_ns), 6), np.nan)
        segment, fraction = self._locate(stamps_ns)
        outside = self._gaps(segment, fraction, np.inf) == Gap.OUTSIDE
        at_end = segment == self.n_samples - 1
        segment = np.minimum(segment, self.n_samples - 2)
        interval_s = (self.stamps_ns[segment + 1] - self.stamps_ns[segment])[:, None] * 1e-9
        world_R_body = self._slerp(segment, np.where(at_end, 1.0, fraction))
        step_m = self.world_T_body[segment + 1, :3, 3] - self.world_T_body[segment, :3, 3]
        angular = self._turns(segment).as_rotvec() / interval_s
        linear = np.einsum("nij,ni->nj", world_R_body, step_m / interval_s)
        twist = np.concatenate([angular, linear], axis=1)
        twist[outside] = np.nan
        return twist

    def _locate(self, stamps_ns: IntArray) -> tuple[IntArray, FloatArray]:
        """For each query the last sample at or before it (the first for those before all), and how far it is on
        the way to the next: 0 at the sample, below 0 before the first, above 0 after the last."""
        stamps_ns = np.asarray(stamps_ns, dtype=np.int64)
        segment = np.maximum(np.searchsorted(self.stamps_ns, stamps_ns, side="right") - 1, 0)
        following = np.minimum(segment + 1, self.n_samples - 1)
        interval_ns = np.maximum(self.stamps_ns[following] - self.stamps_ns[segment], 1)
        return segment, (stamps_ns - self.stamps_ns[segment]) / interval_ns

    def _gaps(self, segment: IntArray, fraction: FloatArray, max_gap_s: float) -> npt.NDArray[np.uint8]:
        last = self.n_samples - 1
        outside = (fraction < 0) | ((segment == last) & (fraction > 0))
        interval_ns = self.stamps_ns[np.minimum(segment + 1, last)] - self.stamps_ns[segment]
        too_long = (fraction > 0) & (interval_ns > max_gap_s * 1e9)
        return np.select([outside, too_long], [Gap.OUTSIDE, Gap.TOO_LONG], Gap.NONE).astype(np.uint8)

    def _turns(self, segment: IntArray) -> Rotation:
        """The rotation from each of these samples to the next, in the body frame of the first."""
        here, following = self.world_T_body[segment, :3, :3], self.world_T_body[segment + 1, :3, :3]
        return Rotation.from_matrix(np.swapaxes(here, 1, 2) @ following)

    def _slerp(self, segment: IntArray, fraction: FloatArray) -> FloatArray:
        """(N, 3, 3) world_R_body at a fraction of the way from each of these samples to the next."""
        part = Rotation.from_rotvec(self._turns(segment).as_rotvec() * fraction[:, None])
        return self.world_T_body[segment, :3, :3] @ part.as_matrix()


def poses_from_quaternions(quats: FloatArray, order: QuaternionOrder, positions_m: FloatArray) -> FloatArray:
    """(N, 4, 4) rigid transforms a_T_b from unit quaternions (N, 4) of a_R_b and positions (N, 3) of b in a."""
    quats_xyzw = np.roll(quats, -1, axis=1) if order == "wxyz" else quats
    poses = np.zeros((len(quats), 4, 4))
    poses[:, :3, :3] = Rotation.from_quat(quats_xyzw).as_matrix()
    poses[:, :3, 3] = positions_m
    poses[:, 3, 3] = 1.0
    return poses


def quaternions_from_poses(a_T_b: FloatArray, order: QuaternionOrder) -> FloatArray:
    """(N, 4) unit quaternions of the rotations of rigid transforms (N, 4, 4), with w >= 0."""
    quats_xyzw = Rotation.from_matrix(a_T_b[:, :3, :3]).as_quat(canonical=True)
    return np.roll(quats_xyzw, 1, axis=1) if order == "wxyz" else quats_xyzw
