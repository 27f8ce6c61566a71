"""Other readings of the trajectories: quaternion order, inverse poses, units, a mirrored axis, swapped bodies, time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.recordings.trajectory import Trajectory, poses_from_quaternions, quaternions_from_poses

_STILL_M, _STILL_RAD, _NEARLY_ALL = 0.02, np.deg2rad(2.0), 0.95

INVERSE = "body_T_world"
"""... or world_T_body, where the manifest says body_T_world."""

_UNITS = {1e-3: "mm", 1e3: "m"}
_OTHER_UNITS = {1e-2: "cm", 1e1: "cm", 0.0254: "inches", 25.4: "inches"}
"""What a length is multiplied by, and the unit that the file then has, where m was said, or mm."""


@dataclass(frozen=True)
class MocapReading:
    """Another reading of what the mocap recorded. bodies: those that are read otherwise. lines: what to write in the
    manifest where it is the true one, or advice: what to do where that says nothing. scale: what positions are
    multiplied by."""

    fault: str
    says: str
    bodies: tuple[str, ...]
    lines: tuple[str, ...]
    advice: tuple[str, ...]
    reread: Callable[[RefMotion], RefMotion]
    scale: float = 1.0


@dataclass(frozen=True)
class Suspicion:
    """Another reading of one trajectory. says, line, advice: with {body} for its name."""

    fault: str
    says: str
    line: str
    advice: str
    reread: Callable[[FloatArray], FloatArray]
    scale: float = 1.0


def _as_wxyz(world_T_body: FloatArray) -> FloatArray:
    columns = quaternions_from_poses(world_T_body, "xyzw")
    return poses_from_quaternions(columns, "wxyz", world_T_body[:, :3, 3])


def _as_xyzw(world_T_body: FloatArray) -> FloatArray:
    columns = quaternions_from_poses(world_T_body, "wxyz")
    return poses_from_quaternions(columns, "xyzw", world_T_body[:, :3, 3])


def _conjugate(world_T_body: FloatArray) -> FloatArray:
    poses = world_T_body.copy()
    poses[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    return poses


def _scaled(factor: float) -> Callable[[FloatArray], FloatArray]:
    return lambda world_T_body: world_T_body * np.array([[1.0, 1.0, 1.0, factor]] * 3 + [[1.0] * 4])


_MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])


def _mirrored(world_T_body: FloatArray) -> FloatArray:
    """In a world and a body whose z axes point the other way. Which axis it is makes no difference: a turn of the
    world, and one of the body, lead from one to the other."""
    return np.asarray(_MIRROR @ world_T_body @ _MIRROR)


def _mirrored_positions(world_T_body: FloatArray) -> FloatArray:
    poses = world_T_body.copy()
    poses[:, 2, 3] *= -1.0
    return poses


_RIGHT_HANDED = "export {body} in right-handed coordinates: a manifest can't say left-handed"

SUSPICIONS = (
    Suspicion(
        "quaternion order", "the quaternions of {body} are in the order wxyz", "{body}.quaternion: wxyz", "", _as_wxyz
    ),
    Suspicion(
        "quaternion order", "the quaternions of {body} are in the order xyzw", "{body}.quaternion: xyzw", "", _as_xyzw
    ),
    Suspicion(
        "inverse poses",
        "the poses of {body} are the inverse of what was said",
        f"{{body}}.pose: {INVERSE}",
        "",
        inverse,
    ),
    *(
        Suspicion(
            "units", f"the positions of {{body}} are in {unit}", f"{{body}}.length_unit: {unit}", "", _scaled(k), k
        )
        for k, unit in _UNITS.items()
    ),
    *(
        Suspicion(
            "units",
            f"the positions of {{body}} are in {unit}",
            "",
            f"write the positions of {{body}} in m or mm: they are in {unit}, which a manifest can't say",
            _scaled(k),
            k,
        )
        for k, unit in _OTHER_UNITS.items()
    ),
    Suspicion(
        "handedness",
        "the poses of {body} come from a left-handed export, or one of its axes is mirrored",
        "",
        _RIGHT_HANDED,
        _mirrored,
    ),
    Suspicion(
        "conjugate rotations",
        "the rotations of {body} are those of the world in the body, while its positions are in the world",
        "",
        "export {body} with the body's rotation in the world: a manifest can't say otherwise",
        _conjugate,
    ),
    Suspicion(
        "handedness",
        "one axis of the positions of {body} is mirrored, but not of its rotations",
        "",
        _RIGHT_HANDED,
        _mirrored_positions,
    ),
)


def mocap_readings(motion: RefMotion) -> Iterator[MocapReading]:
    """Other readings of one trajectory or of all, those first that ask for the fewest changes."""
    names = tuple(motion.trajectories)
    swap = MocapReading(
        "swapped bodies",
        "the trajectories of platform and board_body are interchanged",
        names,
        (),
        ("swap the entries platform and board_body",),
        swapped_bodies,
    )
    # where one body stands still, swapped bodies and inverse poses look alike; mostly that is the board
    swap_first = motion.platform is not None and stands_still(motion.platform)
    if len(names) == 2 and swap_first:
        yield swap
    for size in range(1, len(names) + 1):
        for suspicion in SUSPICIONS:
            for bodies in combinations(names, size):
                yield _reading(suspicion, bodies)
    if len(names) == 2 and not swap_first:
        yield swap
    if motion.capture in _OF_ONE_BODY:
        yield _other_capture(motion.capture)


_OF_ONE_BODY = {
    Capture.STANDING_BOARD: (Capture.FIXED_CAMERAS, "platform", "board_body", "the cameras stood and the board moved"),
    Capture.FIXED_CAMERAS: (Capture.STANDING_BOARD, "board_body", "platform", "the board stood and the cameras moved"),
}
"""By what was said: what else the one trajectory can be of, whose it is then called, and what happened."""


def _other_capture(said: Capture) -> MocapReading:
    other, name, new_name, happened = _OF_ONE_BODY[said]

    def reread(motion: RefMotion) -> RefMotion:
        moved = replace(motion.trajectories[name], body=new_name)
        bodies = {new_name: moved}
        return replace(motion, capture=other, platform=bodies.get("platform"), board_body=bodies.get("board_body"))

    return MocapReading(
        "wrong capture",
        f"{happened}: the trajectory of {name} is that of the {'board' if new_name == 'board_body' else 'cameras'}",
        (name,),
        (),
        (f"write capture: {other.value}, and {new_name} in place of {name}",),
        reread,
    )


def stands_still(trajectory: Trajectory) -> bool:
    """Whether the body hardly moves and turns, nearly all the time."""
    poses = trajectory.world_T_body
    turns_rad = Rotation.from_matrix(poses[0, :3, :3].T @ poses[:, :3, :3]).magnitude()
    moves_m = np.linalg.norm(poses[:, :3, 3] - np.median(poses[:, :3, 3], axis=0), axis=1)
    return bool(np.quantile(turns_rad, _NEARLY_ALL) < _STILL_RAD and np.quantile(moves_m, _NEARLY_ALL) < _STILL_M)


def _reading(suspicion: Suspicion, bodies: tuple[str, ...]) -> MocapReading:
    def each(text: str) -> tuple[str, ...]:
        return tuple(text.format(body=body) for body in bodies) if text else ()

    return MocapReading(
        suspicion.fault,
        suspicion.says.format(body=" and ".join(bodies)),
        bodies,
        each(suspicion.line),
        each(suspicion.advice),
        lambda motion: reread_bodies(motion, bodies, suspicion.reread),
        suspicion.scale,
    )


def swapped_bodies(motion: RefMotion) -> RefMotion:
    """With the trajectories of platform and board exchanged."""
    platform, board_body = motion.board_body, motion.platform
    assert platform is not None
    assert board_body is not None
    return replace(
        motion, platform=replace(platform, body="platform"), board_body=replace(board_body, body="board_body")
    )


def reread_bodies(motion: RefMotion, bodies: tuple[str, ...], reread: Callable[[FloatArray], FloatArray]) -> RefMotion:
    """With the poses (N, 4, 4) of these bodies read otherwise."""

    def other(name: str, trajectory: Trajectory | None) -> Trajectory | None:
        if trajectory is None or name not in bodies:
            return trajectory
        return replace(trajectory, world_T_body=reread(trajectory.world_T_body))

    return replace(
        motion, platform=other("platform", motion.platform), board_body=other("board_body", motion.board_body)
    )
