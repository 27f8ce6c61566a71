"""What stands, what moves and what is tracked; from that ref_T_body over time, the mocap's part of the chain."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from factors.rigid import inverse
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Gap, PosesAt, Trajectory


class Capture(StrEnum):
    """The kinds of capture. ``ref`` is the frame that the cameras are fixed in, ``body`` the one that the board is
    fixed in.

    FIXED_CAMERAS: ref is the mocap world, body the board's tracked body.
    TRACKED_PLATFORM: ref is the platform's tracked body, body the board's.
    STANDING_BOARD: ref is the platform's tracked body, body the mocap world, in which the untracked board stands.
    """

    FIXED_CAMERAS = "fixed_cameras"
    TRACKED_PLATFORM = "tracked_platform"
    STANDING_BOARD = "standing_board"

    @property
    def bodies(self) -> tuple[str, ...]:
        """The tracked bodies, by their names in a manifest: 'platform', 'board_body'."""
        return {
            Capture.FIXED_CAMERAS: ("board_body",),
            Capture.TRACKED_PLATFORM: ("platform", "board_body"),
            Capture.STANDING_BOARD: ("platform",),
        }[self]


@dataclass(frozen=True)
class RefPosesAt:
    """ref_T_body at N query times.

    ref_T_body: (N, 4, 4), NaN where a trajectory has no pose.
    twist_per_s: (N, 6) its time derivative, rotation first:
        ref_T_body(t + dt) = ref_T_body(t) * Exp(twist_per_s dt).
    gaps: by the name of each tracked body, (N,) the values of ``Gap``.
    """

    ref_T_body: FloatArray
    twist_per_s: FloatArray
    gaps: dict[str, IntArray]

    @property
    def ok(self) -> BoolArray:
        """(N,) whether every tracked body has a pose."""
        return np.all([gaps == Gap.NONE for gaps in self.gaps.values()], axis=0)


@dataclass(frozen=True)
class RefMotion:
    """ref_T_body as a function of time, from the trajectories of the tracked bodies.

    max_gap_s: the longest gap to interpolate across; None for each trajectory's own default.
    Raises GtcalError where a body that the capture needs is missing, or one is given that it has no use for.
    """

    capture: Capture
    platform: Trajectory | None
    board_body: Trajectory | None
    max_gap_s: float | None = None

    def __post_init__(self) -> None:
        given = {"platform": self.platform, "board_body": self.board_body}
        check_bodies(self.capture, {name for name, trajectory in given.items() if trajectory is not None})

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """The tracked bodies' trajectories by name: 'platform', 'board_body'."""
        given = {"platform": self.platform, "board_body": self.board_body}
        return {name: trajectory for name, trajectory in given.items() if trajectory is not None}

    def gap_limit_s(self, trajectory: Trajectory) -> float:
        """The longest gap to interpolate across in this trajectory."""
        return trajectory.default_max_gap_s if self.max_gap_s is None else self.max_gap_s

    def at(self, stamps_ns: IntArray) -> RefPosesAt:
        """ref_T_body and its twist at ``stamps_ns`` (N,), mocap clock."""
        ref_T_body, gaps = self.poses_at(stamps_ns)
        return RefPosesAt(ref_T_body, self._twist_per_s(stamps_ns, ref_T_body), gaps)

    def poses_at(self, stamps_ns: IntArray) -> tuple[FloatArray, dict[str, IntArray]]:
        """ref_T_body and the gaps as ``at`` gives them, for those that need no twist."""
        poses = {
            name: trajectory.interpolate(stamps_ns, self.gap_limit_s(trajectory))
            for name, trajectory in self.trajectories.items()
        }
        return self._ref_T_body(poses), {name: at.gaps.astype(np.int64) for name, at in poses.items()}

    def _ref_T_body(self, poses: dict[str, PosesAt]) -> FloatArray:
        if self.capture is Capture.FIXED_CAMERAS:
            return poses["board_body"].world_T_body
        platform_T_world = inverse(poses["platform"].world_T_body)
        if self.capture is Capture.STANDING_BOARD:
            return platform_T_world
        return platform_T_world @ poses["board_body"].world_T_body

    def _twist_per_s(self, stamps_ns: IntArray, ref_T_body: FloatArray) -> FloatArray:
        """From ref_T_body = world_T_platform^-1 * world_T_board_body: the board body's twist less the platform's,
        which the adjoint takes to the board body's frame."""
        twist = np.zeros((len(stamps_ns), 6))
        if self.board_body is not None:
            twist += self.board_body.twist_per_s(stamps_ns)
        if self.platform is not None:
            twist -= _adjoint_apply(inverse(ref_T_body), self.platform.twist_per_s(stamps_ns))
        return twist


def check_bodies(capture: Capture, given: set[str]) -> None:
    """Raises GtcalError where the tracked bodies given are not those of the capture."""
    for name in capture.bodies:
        if name not in given:
            raise GtcalError(f"{name}: is missing; capture {capture.value} needs {' and '.join(capture.bodies)}")
    for name in sorted(given - set(capture.bodies)):
        fitting = [other.value for other in Capture if set(other.bodies) == given]
        raise GtcalError(
            f"{name}: capture {capture.value} has no use for it, only for {' and '.join(capture.bodies)}; "
            + (f"leave it out, or set capture: {fitting[0]}" if fitting else "leave it out")
        )


def _adjoint_apply(a_T_b: FloatArray, twists_b: FloatArray) -> FloatArray:
    """Ad(a_T_b) xi for N transforms and twists (N, 6), rotation first."""
    angular = np.einsum("nij,nj->ni", a_T_b[:, :3, :3], twists_b[:, :3])
    linear = np.einsum("nij,nj->ni", a_T_b[:, :3, :3], twists_b[:, 3:])
    return np.concatenate([angular, linear + np.cross(a_T_b[:, :3, 3], angular)], axis=1)
