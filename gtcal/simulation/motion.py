"""Smooth motion of a rigid body: a cubic B-spline through control poses.

The speed of a B-spline never exceeds the distance of its control poses over their interval, so control poses
laid along a path within a person's speed give a motion within it, smooth and of limited bandwidth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import FloatArray
from gtcal.simulation.transforms import transform

CONTROL_INTERVAL_S = 0.25


@dataclass(frozen=True)
class Motion:
    """parent_T_body over time. Control pose k acts around the time start_s + k CONTROL_INTERVAL_S.

    parent_R_body: (K, 3, 3) and parent_t_body_m: (K, 3) the control poses.
    """

    start_s: float
    parent_R_body: FloatArray
    parent_t_body_m: FloatArray

    @property
    def end_s(self) -> float:
        """The last time the motion is defined at; the first is ``start_s + CONTROL_INTERVAL_S``."""
        return self.start_s + (len(self.parent_t_body_m) - 2) * CONTROL_INTERVAL_S

    def at(self, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) parent_T_body at the times (N,). Raises ValueError outside the motion."""
        first, u = self._segment(np.asarray(times_s, dtype=np.float64))
        cumulative = np.stack([(5 + u * (3 + u * (u - 3))) / 6, (1 + u * (3 + u * (3 - 2 * u))) / 6, u**3 / 6])
        controls = Rotation.from_matrix(self.parent_R_body)
        rotation, translation = controls[first], self.parent_t_body_m[first]
        for k, share in enumerate(cumulative):
            before, after = first + k, first + k + 1
            turn = (controls[before].inv() * controls[after]).as_rotvec()
            rotation = rotation * Rotation.from_rotvec(share[:, None] * turn)
            step = self.parent_t_body_m[after] - self.parent_t_body_m[before]
            translation = translation + share[:, None] * step
        return transform(rotation, translation)

    def _segment(self, times_s: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """First of the four control poses that act at each time, and the time within the segment, 0 to 1."""
        steps = (times_s - self.start_s) / CONTROL_INTERVAL_S - 1.0
        n_segments = len(self.parent_t_body_m) - 3
        if len(steps) and not (steps.min() >= 0.0 and steps.max() <= n_segments):
            raise ValueError(f"time outside the motion: {times_s.min()=}, {times_s.max()=}, {self.end_s=}")
        first = np.minimum(np.floor(steps).astype(np.int64), n_segments - 1)
        return first, steps - first


def still(parent_T_body: FloatArray, start_s: float, end_s: float) -> Motion:
    """A body (4, 4) that does not move."""
    n = int(np.ceil((end_s - start_s) / CONTROL_INTERVAL_S)) + 4
    return Motion(
        start_s - CONTROL_INTERVAL_S,
        np.broadcast_to(parent_T_body[:3, :3], (n, 3, 3)),
        np.broadcast_to(parent_T_body[:3, 3], (n, 3)),
    )


def motion_through(
    waypoints: Iterable[FloatArray], start_s: float, end_s: float, *, speed_m_s: float, turn_rate_rad_s: float
) -> Motion:
    """The motion that passes close by each of the waypoints (4, 4), parent_T_body, and lingers there for a
    moment, no faster than the given speeds. ``waypoints`` has to go on for as long as the motion needs.

    Between waypoints the body goes around the parent's origin, not through it: somebody wears the headset."""
    n_controls = int(np.ceil((end_s - start_s) / CONTROL_INTERVAL_S)) + 4
    steps_m, step_rad = speed_m_s * CONTROL_INTERVAL_S, turn_rate_rad_s * CONTROL_INTERVAL_S
    remaining = iter(waypoints)
    here = next(remaining)
    rotations, translations = [here[None, :3, :3]], [here[None, :3, 3]]
    n = 1
    while n < n_controls:
        there = next(remaining)
        leg_rotations, leg_translations = _leg(here, there, steps_m, step_rad)
        rotations.append(leg_rotations)
        translations.append(leg_translations)
        n += len(leg_translations)
        here = there
    return Motion(
        start_s - CONTROL_INTERVAL_S,
        np.concatenate(rotations)[:n_controls],
        np.concatenate(translations)[:n_controls],
    )


def _leg(start: FloatArray, end: FloatArray, step_m: float, step_rad: float) -> tuple[FloatArray, FloatArray]:
    """Control poses after ``start`` up to ``end``, and ``end`` once more for the moment of rest."""
    turn = (Rotation.from_matrix(start[:3, :3]).inv() * Rotation.from_matrix(end[:3, :3])).as_rotvec()
    path = _arc(start[:3, 3], end[:3, 3], np.linspace(0.0, 1.0, 65))
    travelled_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    n = max(1, int(np.ceil(max(travelled_m[-1] / step_m, np.linalg.norm(turn) / step_rad))))
    shares = np.minimum(np.arange(1, n + 2) / n, 1.0)
    along = np.interp(shares * travelled_m[-1], travelled_m, np.linspace(0.0, 1.0, 65))
    rotations = Rotation.from_matrix(start[:3, :3]) * Rotation.from_rotvec(shares[:, None] * turn)
    return rotations.as_matrix(), _arc(start[:3, 3], end[:3, 3], along)


def _arc(start_m: FloatArray, end_m: FloatArray, shares: FloatArray) -> FloatArray:
    """(N, 3) points around the origin from one point to another: the direction turns and the distance changes
    evenly. A half turn goes by way of a direction that the start's own coordinates choose."""
    near, far = np.linalg.norm(start_m), np.linalg.norm(end_m)
    start, end = start_m / near, end_m / far
    axis = np.cross(start, end)
    if np.linalg.norm(axis) < 1e-9:
        axis = np.cross(start, np.roll(start, 1) + 0.1)
    angle = np.arctan2(np.linalg.norm(np.cross(start, end)), start @ end)
    turns = Rotation.from_rotvec(shares[:, None] * angle * axis / np.linalg.norm(axis))
    return turns.apply(start) * (near + shares * (far - near))[:, None]
