"""How the mocap's body moves around an instant: a parabola through the poses about it.

A velocity from the two neighbouring poses would carry ten times their noise, and that very noise is in the pose between
them: an offset fitted along such velocities is drawn to the middle of the mocap's interval, where interpolation leaves
the least of it. The velocity of a parabola through poses evenly about the instant is not correlated with that noise.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

_FEWEST_INTERVALS = 6  # of the mocap, that a parabola is fitted to
_POSE_SIGMA = 2e-4  # rad and m: how far the mocap's poses scatter; it only sets the prior's weight
_WEAK_PRIOR = (1.0**-2, 10.0**-2, 50.0**-2)  # 1 m, 10 m/s, 50 m/s^2 or rad: felt only where a gap leaves too few poses


def parabolas(motion: RefMotion, stamps_ns: IntArray, *, first_s: float = 0.0, last_s: float = 0.0) -> FloatArray:
    """(V, 2, 6) velocity and half the acceleration of ref_T_body at each stamp (V,), as rotation vector and shift in
    the body's frame, in rad and m per s and per s^2.

    first_s, last_s: what the parabolas are to hold for, after the stamp; they are fitted to a little more on both
    sides. Stamps without a pose, or without any about them, get zeros."""
    span_s = last_s - first_s
    interval_s = max(trajectory.median_interval_s for trajectory in motion.trajectories.values())
    margin_s = max(interval_s, 0.5 * (_FEWEST_INTERVALS * interval_s - span_s))
    n = 1 + round((span_s + 2.0 * margin_s) / interval_s)
    times_s = np.linspace(first_s - margin_s, last_s + margin_s, n)
    moved = _motion_since(motion, stamps_ns, times_s)
    known = np.isfinite(moved[..., 0])
    powers = times_s[:, None] ** np.arange(3)
    H = np.einsum("vk,ki,kj->vij", known.astype(float), powers, powers) / _POSE_SIGMA**2 + np.diag(_WEAK_PRIOR)
    b = np.einsum("ki,vkc->vic", powers, np.nan_to_num(moved)) / _POSE_SIGMA**2
    return np.asarray(np.linalg.solve(H, b)[:, 1:])


def _motion_since(motion: RefMotion, stamps_ns: IntArray, times_s: FloatArray) -> FloatArray:
    """(V, K, 6) rotation vector and shift from each stamp's pose to those at K times after it; NaN in gaps."""
    all_ns = stamps_ns[:, None] + np.rint(1e9 * times_s).astype(np.int64)
    poses = motion.at(all_ns.ravel()).ref_T_body.reshape(*all_ns.shape, 4, 4)
    since = inverse(motion.at(stamps_ns).ref_T_body)[:, None] @ poses
    moved = np.full((*all_ns.shape, 6), np.nan)
    known = np.isfinite(since).all(axis=(2, 3))
    moved[known, :3] = Rotation.from_matrix(since[known][:, :3, :3]).as_rotvec()
    moved[known, 3:] = since[known][:, :3, 3]
    return moved
