"""The true world of a simulated recording: who is where at any time, without noise.

    camera_T_board(t) = camera_T_ref * ref_T_body(t) * body_T_board

Times are seconds since the recording's start, by the mocap's clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import FloatArray
from gtcal.recordings.capture import Capture
from gtcal.simulation.motion import Motion, motion_through, still
from gtcal.simulation.rig import Rig
from gtcal.simulation.transforms import random_transform, transform
from gtcal.simulation.visibility import ViewLimits
from gtcal.simulation.waypoints import MotionKind, board_waypoints, head_waypoints

# A person's pace: the board with respect to the rig, and the rig with respect to the room.
BOARD_SPEED_M_S, BOARD_TURN_RATE_RAD_S = 0.45, float(np.deg2rad(80.0))
RIG_SPEED_M_S, RIG_TURN_RATE_RAD_S = 0.15, float(np.deg2rad(25.0))
LEAD_S = 1.0  # the motion begins before the first frame and ends after the last one

# The mocap's rigid bodies: markers glued on anywhere, with axes that mean nothing.
_PLATFORM_BODY_OFFSET_M, _BOARD_BODY_OFFSET_M = 0.15, 0.35


@dataclass(frozen=True)
class Scene:
    """True geometry over time.

    world_T_anchor: the rig's motion in the mocap world; with a standing board, the board's, which is constant.
    rig_T_board: the motion of one with respect to the other.
    rig_T_platform: (4, 4) the rigid body that the mocap tracks on the rig.
    boardbody_T_board: (4, 4) the board in the rigid body that the mocap tracks on it.
    """

    capture: Capture
    rig: Rig
    board: Board
    world_T_anchor: Motion
    rig_T_board: Motion
    rig_T_platform: FloatArray
    boardbody_T_board: FloatArray

    def world_T_rig(self, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) at the times (N,)."""
        anchor = self.world_T_anchor.at(times_s)
        return anchor @ inverse(self.rig_T_board.at(times_s)) if self._board_stands else anchor

    def world_T_board(self, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) at the times (N,)."""
        anchor = self.world_T_anchor.at(times_s)
        return anchor if self._board_stands else anchor @ self.rig_T_board.at(times_s)

    def world_T_platform(self, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) the rig's tracked body at the times (N,)."""
        return self.world_T_rig(times_s) @ self.rig_T_platform

    def world_T_boardbody(self, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) the board's tracked body at the times (N,)."""
        return self.world_T_board(times_s) @ inverse(self.boardbody_T_board)

    def camera_T_board(self, camera_index: int, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) at the times (N,)."""
        return inverse(self.rig.rig_T_camera[camera_index]) @ self.rig_T_board.at(times_s)

    def world_T_camera(self, camera_index: int, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) at the times (N,)."""
        return self.world_T_rig(times_s) @ self.rig.rig_T_camera[camera_index]

    def ref_T_body(self, times_s: FloatArray) -> FloatArray:
        """(N, 4, 4) what the mocap would say at the times (N,) if it made no error."""
        if self.capture == Capture.FIXED_CAMERAS:
            return self.world_T_boardbody(times_s)
        platform_T_world = inverse(self.world_T_platform(times_s))
        return platform_T_world if self._board_stands else platform_T_world @ self.world_T_boardbody(times_s)

    def camera_T_ref(self, camera_index: int) -> FloatArray:
        """(4, 4) the extrinsic that a calibration is to find."""
        if self.capture == Capture.FIXED_CAMERAS:
            return inverse(self.world_T_camera(camera_index, np.zeros(1))[0])
        return inverse(self.rig.rig_T_camera[camera_index]) @ self.rig_T_platform

    @property
    def body_T_board(self) -> FloatArray:
        """(4, 4) the board-to-body transform that a calibration is to find."""
        return self.world_T_board(np.zeros(1))[0] if self._board_stands else self.boardbody_T_board

    @property
    def _board_stands(self) -> bool:
        return self.capture == Capture.STANDING_BOARD


def random_scene(
    capture: Capture,
    rig: Rig,
    board: Board,
    motion: MotionKind,
    limits: ViewLimits,
    duration_s: float,
    rng: np.random.Generator,
) -> Scene:
    """A scene in which the board is shown to every camera of the rig, for ``duration_s``."""
    start_s, end_s = -LEAD_S, duration_s + LEAD_S
    bodies = (random_transform(rng, _PLATFORM_BODY_OFFSET_M), random_transform(rng, _BOARD_BODY_OFFSET_M))
    home = _home(rig, rng)
    rig_T_board = motion_through(
        board_waypoints(rig, board, motion, limits, rng),
        start_s,
        end_s,
        speed_m_s=BOARD_SPEED_M_S,
        turn_rate_rad_s=BOARD_TURN_RATE_RAD_S,
    )
    if capture == Capture.TRACKED_PLATFORM:
        anchor = motion_through(
            head_waypoints(home, rig.up_in_rig, rng),
            start_s,
            end_s,
            speed_m_s=RIG_SPEED_M_S,
            turn_rate_rad_s=RIG_TURN_RATE_RAD_S,
        )
    else:
        anchor = still(home, start_s, end_s)
    return Scene(capture, rig, board, anchor, rig_T_board, *bodies)


def _home(rig: Rig, rng: np.random.Generator) -> FloatArray:
    """(4, 4) where the rig (or the board) is in the room: upright, turned any way, at a person's height. The
    mocap's z points up."""
    turn = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [rig.up_in_rig])
    place_m = np.array([rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5), rng.uniform(1.2, 1.7)])
    return transform(turn * upright, place_m)
