"""Errors that no noise model foresees, put into simulated recordings by size: what the studies of effects and of
coverage share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from factors.reprojection import residuals_px
from gtcal.camera import FloatArray
from gtcal.estimation.observations import Views, synchronise
from gtcal.estimation.residuals import corner_views
from gtcal.recordings.recording import Recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation import Simulation

AXIS = np.array([1.0, 0.5, -0.3]) / np.linalg.norm([1.0, 0.5, -0.3])
CHANGED_AT, CAMERA = 0.4, "front_left"

Spoil = Callable[[Simulation, float], Recording]
"""A simulation and the size of what is put into it, to the recording."""


def slip(body: str, *, turns: bool = False, at: float = CHANGED_AT) -> Spoil:
    """The body's markers move by mm, or turn by deg, at this share of the time."""

    def spoilt(simulation: Simulation, size: float) -> Recording:
        after = getattr(simulation.recording, body).stamps_ns > _changed_ns(simulation.recording, at)
        return _with_errors(simulation.recording, body, np.where(after[:, None], _twist(size, turns=turns), 0.0))

    return spoilt


def slow_drift(body: str) -> Spoil:
    """The body's markers creep by mm from the first frame to the last, and are half way where they were found."""

    def spoilt(simulation: Simulation, size: float) -> Recording:
        stamps_ns = getattr(simulation.recording, body).stamps_ns
        share = (stamps_ns - stamps_ns[0]) / (stamps_ns[-1] - stamps_ns[0]) - 0.5
        return _with_errors(simulation.recording, body, share[:, None] * _twist(size, turns=False))

    return spoilt


def joint_errors(simulation: Simulation, size: float) -> Recording:
    """The platform's poses err by mm (RMS by component, with 0.1 deg a mm) as an arm's do: by smooth functions of where
    it stands and how it is turned, three waves over the range of motion."""
    trajectory = simulation.recording.platform
    assert trajectory is not None
    random = np.random.default_rng([simulation.seed, 1])
    poses = trajectory.world_T_body
    turned = Rotation.from_matrix(poses[0, :3, :3].T @ poses[:, :3, :3]).as_rotvec()
    joints = np.concatenate([turned, poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)], axis=1)
    joints = joints / joints.std(axis=0)
    waves = np.sqrt(2.0 / 3.0) * np.sin(joints @ random.normal(size=(3, 6, 6)) / 2.0 + random.uniform(0, 7, (3, 1, 6)))
    errors = waves.sum(axis=0) * np.repeat([np.deg2rad(0.1 * size), 1e-3 * size], 3)
    return _with_errors(simulation.recording, "platform", errors)


def turned_camera(simulation: Simulation, size: float) -> Recording:
    """A camera turns about its centre by deg."""
    views = synchronise(simulation.recording).views[CAMERA]
    camera_T_board = _camera_T_board(simulation, views)
    turned = camera_T_board.copy()
    after = views.stamps_ns > _changed_ns(simulation.recording, CHANGED_AT)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(np.deg2rad(size) * AXIS).as_matrix()
    turned[after] = turn @ turned[after]
    return _with_corners_moved(simulation, {CAMERA: (views, camera_T_board, turned, views)})


def bow(simulation: Simulation, size: float) -> Recording:
    """The board's middle stands out of the plane of its short edges by mm."""
    recording = simulation.recording
    corners_m = recording.board.corners_m
    middle, half = 0.5 * np.ptp(corners_m[:, 0]) + corners_m[:, 0].min(), 0.5 * np.ptp(corners_m[:, 0])
    moved = {}
    for name, views in synchronise(recording).views.items():
        camera_T_board = _camera_T_board(simulation, views)
        bent = views.corners_m.copy()
        bent[:, 2] += 1e-3 * size * (1.0 - ((bent[:, 0] - middle) / half) ** 2)
        moved[name] = views, camera_T_board, camera_T_board, replace(views, corners_m=bent)
    return _with_corners_moved(simulation, moved)


def clock(*, drifts: bool) -> Spoil:
    """The cameras' stamps are ahead by ms, or gain us/s."""

    def spoilt(simulation: Simulation, size: float) -> Recording:
        recording = simulation.recording
        middle_ns = _stamps(recording).mean()
        detections = {}
        for name, found in recording.detections.items():
            ahead_ns = 1e-6 * size * (found.stamps_ns - middle_ns) if drifts else np.full(found.n_views, 1e6 * size)
            detections[name] = replace(found, stamps_ns=found.stamps_ns - np.rint(ahead_ns).astype(np.int64))
        return replace(recording, detections=detections)

    return spoilt


def focal_length(simulation: Simulation, size: float) -> Recording:
    """A camera's focal length is larger than stated by %."""
    recording = simulation.recording
    theta = recording.cameras[CAMERA].theta.copy()
    theta[:2] /= 1.0 + 0.01 * size
    stated = replace(recording.cameras[CAMERA], parameters=theta)
    return replace(recording, cameras=recording.cameras | {CAMERA: stated})


def scale(simulation: Simulation, size: float) -> Recording:
    """The board is larger than stated by %."""
    board, stated = simulation.recording.board, 1.0 / (1.0 + 0.01 * size)
    smaller = replace(board, tag_side_m=stated * board.tag_side_m, tag_gap_m=stated * board.tag_gap_m)
    return replace(simulation.recording, board=smaller)


def _twist(size: float, *, turns: bool) -> FloatArray:
    """(6,) rotation in rad, translation in m, along ``AXIS``: of mm, or of deg."""
    zero = np.zeros(3)
    return np.concatenate([np.deg2rad(size) * AXIS, zero] if turns else [zero, 1e-3 * size * AXIS])


def _with_errors(recording: Recording, body: str, errors: FloatArray) -> Recording:
    """The body's poses moved in its own frame by errors (M, 6): rotation vector in rad, translation in m."""
    trajectory: Trajectory = getattr(recording, body)
    moved = np.tile(np.eye(4), (len(errors), 1, 1))
    moved[:, :3, :3] = Rotation.from_rotvec(errors[:, :3]).as_matrix()
    moved[:, :3, 3] = errors[:, 3:]
    return replace(recording, **{body: replace(trajectory, world_T_body=trajectory.world_T_body @ moved)})


def _camera_T_board(simulation: Simulation, views: Views) -> FloatArray:
    """(V, 4, 4) the true poses of the views."""
    of_camera = simulation.truth.cameras[views.camera.name]
    ref_T_body = of_camera.ref_T_body[of_camera.frames_of(views.stamps_ns)]
    return np.ascontiguousarray(of_camera.camera_T_ref @ ref_T_body @ simulation.truth.body_T_board)


def _with_corners_moved(
    simulation: Simulation, moved: dict[str, tuple[Views, FloatArray, FloatArray, Views]]
) -> Recording:
    """The recording with corners moved as projections differ: by camera its views, their poses, and poses and views
    after."""
    recording = simulation.recording
    detections = dict(recording.detections)
    for name, (views, before_T, after_T, bent) in moved.items():
        model, theta = views.camera.model, simulation.truth.intrinsics[name]
        before_px = residuals_px(corner_views(views), before_T, model, theta)
        moved_px = residuals_px(corner_views(bent), after_T, model, theta) - before_px
        seen = recording.detections[name]
        seen = seen.select_views(np.isin(seen.stamps_ns, views.stamps_ns))
        detections[name] = replace(seen, corners_px=seen.corners_px + np.nan_to_num(moved_px))
    return replace(recording, detections=detections)


def _stamps(recording: Recording) -> np.ndarray:
    return np.unique(np.concatenate([found.stamps_ns for found in recording.detections.values()]))


def _changed_ns(recording: Recording, at: float) -> int:
    stamps_ns = _stamps(recording)
    return int(stamps_ns[0] + at * (stamps_ns[-1] - stamps_ns[0]))
