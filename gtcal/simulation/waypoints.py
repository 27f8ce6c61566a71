"""Where the board is carried: poses in front of each camera in turn, near and far, at every angle."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.simulation.rig import Rig
from gtcal.simulation.transforms import apply, transform
from gtcal.simulation.visibility import Features, ViewLimits, features_of, visible_features

MotionKind = Literal["free", "single_axis", "translation"]
"""How the board moves with respect to the rig: in any way; turning about one axis only, the rig's upright; or
never turning. The last two leave directions that no calibration can find."""

_CANDIDATES = 48
_SCATTER = 0.08  # of the image and of the range of distances, among the candidates
_R3 = 1.22074408460575947536 ** -np.arange(1.0, 4.0)
_READABLE_SHARE = 0.35  # of the features, for a pose to count as in front of the camera
_LARGEST_TILT_RAD = np.deg2rad(55.0)
_LARGEST_YAW_RAD = np.deg2rad(45.0)


def board_waypoints(
    rig: Rig, board: Board, motion: MotionKind, limits: ViewLimits, rng: np.random.Generator
) -> Iterator[FloatArray]:
    """Endless rig_T_board (4, 4), poses in which the camera whose turn it is can read the board. The board's
    middle falls everywhere in its image."""
    features = features_of(board)
    middle_m = board.corners_m.mean(axis=0)
    resting = _resting_rotation(rig, rng)
    placers = [_Placer(rig, index, rng) for index in range(len(rig.cameras))]
    while True:
        for index in rng.permutation(len(rig.cameras)):
            positions_m = placers[index].candidates()
            rotations = _rotations(rig, index, positions_m, motion, resting, rng)
            rig_T_board = transform(rotations, positions_m - rotations.apply(middle_m))
            camera_T_board = inverse(rig.rig_T_camera[index]) @ rig_T_board
            yield rig_T_board[_first_readable(rig.cameras[index], camera_T_board, features, limits)]


def _first_readable(camera: Camera, camera_T_board: FloatArray, features: Features, limits: ViewLimits) -> int:
    """The first candidate that shows enough of the board, else the one that shows most."""
    share = visible_features(camera, camera_T_board, features, limits).mean(axis=1)
    return int(np.argmax(np.minimum(share, _READABLE_SHARE)))


class _Placer:
    """Places for the board's middle in front of one camera, by a low-discrepancy sequence (Roberts' R3): a few
    already cover the image and the distances evenly, the latter by their logarithm."""

    def __init__(self, rig: Rig, index: int, rng: np.random.Generator) -> None:
        self._rig, self._index, self._rng = rig, index, rng
        self._point = rng.uniform(size=3)

    def candidates(self) -> FloatArray:
        """(N, 3) places in the rig frame, around the sequence's next place that the lens can see."""
        camera = self._rig.cameras[self._index]
        size_px = np.array([camera.image_width_px, camera.image_height_px])
        bearings = np.empty((0, 3))
        while not len(bearings):
            self._point = (self._point + _R3) % 1.0
            pixels_px = self._scattered(self._point[:2]) * size_px - 0.5
            bearings, valid = camera.unproject(pixels_px)
            bearings = bearings[valid]
        nearest, farthest = np.log(self._rig.nearest_m), np.log(self._rig.farthest_m)
        shares = self._scattered(self._point[2:])[: len(bearings)]
        distances_m = np.exp(nearest + shares * (farthest - nearest))
        return apply(self._rig.rig_T_camera[self._index], bearings * distances_m)

    def _scattered(self, middle: FloatArray) -> FloatArray:
        """(N, D) points of the unit cube around one (D,)."""
        return np.clip(middle + self._rng.uniform(-_SCATTER, _SCATTER, (_CANDIDATES, len(middle))), 0.0, 1.0)


def _rotations(
    rig: Rig,
    index: int,
    positions_m: FloatArray,
    motion: MotionKind,
    resting: Rotation,
    rng: np.random.Generator,
) -> Rotation:
    """Candidates for rig_R_board at these positions (N, 3)."""
    if motion == "translation":
        return Rotation.concatenate([resting] * len(positions_m))
    to_camera = rig.rig_T_camera[index][:3, 3] - positions_m
    if motion == "single_axis":
        yaw = rng.uniform(-_LARGEST_YAW_RAD, _LARGEST_YAW_RAD, len(positions_m))
        return Rotation.from_rotvec(yaw[:, None] * rig.up_in_rig) * _upright(rig, to_camera)
    return _facing(to_camera, rng)


def _facing(directions: FloatArray, rng: np.random.Generator) -> Rotation:
    """Boards whose printed side looks along the directions (N, 3), give or take a tilt, turned any way about
    their normal."""
    n = len(directions)
    normals = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    aside = np.cross(normals, np.roll(normals, 1, axis=1) + np.array([0.1, 0.0, 0.0]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    facing = Rotation.from_matrix(np.stack([aside, np.cross(normals, aside), normals], axis=2))
    roll = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, n)[:, None] * np.array([0.0, 0.0, 1.0]))
    tilt_rad, azimuth = _LARGEST_TILT_RAD * np.sqrt(rng.uniform(size=n)), rng.uniform(-np.pi, np.pi, n)
    tilt_axes = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(n)], axis=1)
    return facing * Rotation.from_rotvec(tilt_rad[:, None] * tilt_axes) * roll


def _upright(rig: Rig, directions: FloatArray) -> Rotation:
    """Boards that stand upright in the rig frame and look along the directions (N, 3) as well as they can."""
    level = directions - np.outer(directions @ rig.up_in_rig, rig.up_in_rig)
    normals = level / np.linalg.norm(level, axis=1, keepdims=True)
    up = np.broadcast_to(rig.up_in_rig, normals.shape)
    return Rotation.from_matrix(np.stack([np.cross(up, normals), up, normals], axis=2))


def _resting_rotation(rig: Rig, rng: np.random.Generator) -> Rotation:
    """One rotation that all cameras see as well as they can: against their common line of sight."""
    sight = rig.rig_T_camera[:, :3, 2].sum(axis=0)
    return _facing(-sight[None], rng)[0] if np.linalg.norm(sight) > 0.1 else Rotation.random(rng=rng)


def head_waypoints(world_T_home: FloatArray, up_in_rig: FloatArray, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Endless world_T_rig (4, 4) of a rig carried about its home (4, 4): it looks around, nods and leans."""
    while True:
        yaw = rng.uniform(-1.0, 1.0) * up_in_rig
        nod = rng.uniform(-0.45, 0.45, 3)
        home_T_rig = transform(Rotation.from_rotvec(yaw) * Rotation.from_rotvec(nod), rng.uniform(-0.35, 0.35, 3))
        yield world_T_home @ home_T_rig
