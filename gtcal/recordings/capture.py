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
    gaps: by the name of each tracked body, (N,) the values of ``Gap``.
    """

    ref_T_body: FloatArray
    gaps: dict[str, IntArray]

    @property
    def ok(self) -> BoolArray:
        """(N,) whether every tracked body has a pose."""
        return np.all([gaps == Gap.NONE for gaps in self.gaps.values()], axis=0)


@dataclass(frozen=True)
class RefMotion:
    """ref_T_body as a function of time, from the trajectories of the tracked bodies.

    max_gap_s: the longest gap to interpolate across; None for each trajectory's own default.
    numbered: poses go with images by number (``gtcal.recordings.numbering``): there is no time, and none between them.
    Raises GtcalError where a body that the capture needs is missing, or one is given that it has no use for.
    """

    capture: Capture
    platform: Trajectory | None
    board_body: Trajectory | None
    max_gap_s: float | None = None
    numbered: bool = False

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
        if self.numbered:
            return 0.0
        return trajectory.default_max_gap_s if self.max_gap_s is None else self.max_gap_s

    def at(self, stamps_ns: IntArray) -> RefPosesAt:
        """ref_T_body at ``stamps_ns`` (N,), mocap clock."""
        poses = {
            name: trajectory.interpolate(stamps_ns, self.gap_limit_s(trajectory))
            for name, trajectory in self.trajectories.items()
        }
        return RefPosesAt(self._ref_T_body(poses), {name: at.gaps.astype(np.int64) for name, at in poses.items()})

    def _ref_T_body(self, poses: dict[str, PosesAt]) -> FloatArray:
        if self.capture is Capture.FIXED_CAMERAS:
            return poses["board_body"].world_T_body
        platform_T_world = inverse(poses["platform"].world_T_body)
        if self.capture is Capture.STANDING_BOARD:
            return platform_T_world
        return platform_T_world @ poses["board_body"].world_T_body


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
