"""Time: an offset of the cameras' clock, its drift, and a lag of one tracked body. Each moves ref_T_body along its own
velocity, so all need a body that moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.rigid import adjoint, inverse
from gtcal.camera import FloatArray
from gtcal.clock.local_motion import parabolas
from gtcal.effects.effect import single
from gtcal.effects.frames import Frames
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.results.effect_finding import Moment, Quantity

SLOWEST_M_PER_S, SLOWEST_RAD_PER_S = 0.02, np.deg2rad(2.0)
"""A body slower than this, typically, tells nothing of time: an arm that stops for each image."""


COARSEST_S = 0.2
"""Poses further apart do not say how fast a body was at any of them: it may have stopped for each."""


def moves(frames: Frames) -> bool:
    """Whether the board is known to move, as the cameras see it, while images are taken."""
    if max(trajectory.median_interval_s for trajectory in frames.motion.trajectories.values()) > COARSEST_S:
        return False
    twist = parabolas(frames.motion, frames.stamps_ns)[:, 0]
    turn, shift = (np.median(np.linalg.norm(part, axis=1)) for part in (twist[:, :3], twist[:, 3:]))
    return bool(shift > SLOWEST_M_PER_S or turn > SLOWEST_RAD_PER_S)


@dataclass(frozen=True)
class ClockOffset:
    """Of all cameras together."""

    name: str = "clock offset"
    what: str = "the cameras' clock is offset from the mocap's"
    advice: str = "--clock estimate finds the offset and corrects it"
    moment: Moment | None = None

    def columns(self, frames: Frames) -> FloatArray:
        return _along(frames, parabolas(frames.motion, frames.stamps_ns)[:, 0])

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 1e3, "ms")


@dataclass(frozen=True)
class ClockDrift:
    """An offset that grows in time, nil in the middle."""

    name: str = "clock drift"
    what: str = "the cameras' clock drifts from the mocap's"
    advice: str = "--clock estimate --clock-drift finds the drift and corrects it"
    moment: Moment | None = None

    def columns(self, frames: Frames) -> FloatArray:
        since_s = frames.seconds(frames.stamps_ns)
        twist = parabolas(frames.motion, frames.stamps_ns)[:, 0]
        return _along(frames, (since_s - since_s.mean())[:, None] * twist)

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 1e6, "us/s")


@dataclass(frozen=True)
class BodyLag:
    """The platform's poses are of other times than the board body's, as where the mocap smooths one more."""

    name: str = "platform lag"
    what: str = "the mocap's poses of 'platform' and 'board_body' are of different times"
    advice: str = "turn off the mocap's smoothing, or give both bodies the same"
    moment: Moment | None = None

    @staticmethod
    def possible(frames: Frames) -> bool:
        return frames.motion.capture is Capture.TRACKED_PLATFORM

    def columns(self, frames: Frames) -> FloatArray:
        """platform_T_world alone moves: ref_T_body = platform_T_world * world_T_board_body, by the twist of the first
        carried over to the body."""
        alone = RefMotion(Capture.STANDING_BOARD, frames.motion.platform, None, frames.motion.max_gap_s)
        twist = parabolas(alone, frames.stamps_ns)[:, 0]
        body_T_world = inverse(frames.ref_T_body) @ alone.at(frames.stamps_ns).ref_T_body
        return _along(frames, (adjoint(body_T_world) @ twist[:, :, None])[:, :, 0])

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 1e3, "ms")


def _along(frames: Frames, twist: FloatArray) -> FloatArray:
    """(n, D - 1, 1) that moves A_f by twists (n, 6)."""
    columns = np.zeros((len(twist), frames.n_columns, 1))
    columns[:, :6, 0] = twist
    return columns
