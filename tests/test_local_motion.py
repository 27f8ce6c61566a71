"""The mocap's velocity about an instant: exact where the motion is smooth, and free of the noise of the pose itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gtcal.clock.local_motion import parabolas
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.recordings.trajectory import Trajectory

INTERVAL_NS = 8_333_333
TWISTS = {
    "platform": np.array([0.3, -0.2, 0.1, 0.2, 0.1, -0.1]),
    "board_body": np.array([-0.5, 0.8, 0.3, 0.4, -0.3, 0.2]),
}


def trajectory(body: str, pose_at: Callable[[float], np.ndarray], n: int = 100) -> Trajectory:
    stamps_ns = INTERVAL_NS * np.arange(n)
    return Trajectory(body, stamps_ns, np.stack([pose_at(1e-9 * stamp) for stamp in stamps_ns]))


def steady(body: str) -> Callable[[float], np.ndarray]:
    start = gtsam.Pose3.Expmap(np.arange(1.0, 7.0) / 10.0)
    return lambda t_s: (start * gtsam.Pose3.Expmap(TWISTS[body] * t_s)).matrix()


def motion_of(capture: Capture) -> RefMotion:
    bodies = {name: trajectory(name, steady(name)) if name in capture.bodies else None for name in TWISTS}
    return RefMotion(capture, **bodies)


@pytest.mark.parametrize("capture", list(Capture))
def test_the_velocity_is_the_derivative_of_ref_T_body(capture: Capture) -> None:
    motion = motion_of(capture)
    stamps_ns = np.array([200, 333, 415]) * 1_000_000
    found = parabolas(motion, stamps_ns)[:, 0]
    step_ns = 2_000_000
    before, after = (motion.at(stamps_ns + side * step_ns).ref_T_body for side in (-1, 1))
    for i, twist in enumerate(found):
        numeric = gtsam.Pose3(before[i]).between(gtsam.Pose3(after[i]))
        np.testing.assert_allclose(twist, gtsam.Pose3.Logmap(numeric) / (2e-9 * step_ns), atol=2e-3)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5, 0.9])
def test_the_velocity_is_not_correlated_with_the_noise_of_the_pose(fraction: float) -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((40_000, 3)) * 1e-3
    poses = np.tile(np.eye(4), (len(noise), 1, 1))
    poses[:, :3, 3] = noise
    body = Trajectory("board_body", INTERVAL_NS * np.arange(len(noise)), poses)
    motion = RefMotion(Capture.FIXED_CAMERAS, None, body)
    stamps_ns = INTERVAL_NS * np.arange(10, len(noise) - 10, 10) + round(fraction * INTERVAL_NS)
    at = motion.at(stamps_ns).ref_T_body

    def correlation(velocity_m_s: np.ndarray) -> float:
        return float(np.corrcoef(velocity_m_s.ravel(), at[:, :3, 3].ravel())[0, 1])

    assert abs(correlation(parabolas(motion, stamps_ns)[:, 0, 3:])) < 0.03  # three sigmas of chance
    if fraction in (0.1, 0.9):  # the velocity of the interval itself is
        assert abs(correlation(body.twist_per_s(stamps_ns)[:, 3:])) > 0.5


def test_beside_a_gap_the_poses_that_are_there_tell() -> None:
    whole = trajectory("board_body", steady("board_body"))
    kept = np.r_[0:50, 60:100]
    gappy = replace(whole, stamps_ns=whole.stamps_ns[kept], world_T_body=whole.world_T_body[kept])
    stamps_ns = whole.stamps_ns[49:50]
    velocities = [
        parabolas(motion, stamps_ns)[0, 0]
        for motion in (RefMotion(Capture.FIXED_CAMERAS, None, body) for body in (whole, gappy))
    ]
    np.testing.assert_allclose(velocities[1], velocities[0], atol=5e-3)


@pytest.mark.parametrize("span_intervals", [0, 2, 5, 8])  # fitted to odd and even numbers of poses
def test_a_pose_that_stands_alone_tells_no_motion(span_intervals: int) -> None:
    whole = trajectory("board_body", steady("board_body"), n=200)
    kept = np.r_[0:50, 100, 150:200]
    alone = replace(whole, stamps_ns=whole.stamps_ns[kept], world_T_body=whole.world_T_body[kept])
    motion = RefMotion(Capture.FIXED_CAMERAS, None, alone)
    found = parabolas(motion, whole.stamps_ns[[100]], last_s=1e-9 * span_intervals * INTERVAL_NS)
    np.testing.assert_allclose(found, 0.0, atol=1e-6)


def test_a_parabola_holds_over_the_span_that_is_asked_for() -> None:
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4])

    def thrown(t_s: float) -> np.ndarray:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn.as_matrix(), [0.5 * t_s, 0.0, -4.9 * t_s**2]
        return pose

    motion = RefMotion(Capture.FIXED_CAMERAS, None, trajectory("board_body", thrown))
    stamps_ns = INTERVAL_NS * np.array([30])
    velocity, half_acceleration = parabolas(motion, stamps_ns, last_s=0.03)[0]
    t_s = 1e-9 * stamps_ns[0]
    np.testing.assert_allclose(turn.apply(velocity[3:]), [0.5, 0.0, -9.8 * t_s], atol=2e-3)
    np.testing.assert_allclose(turn.apply(half_acceleration[3:]), [0.0, 0.0, -4.9], atol=0.05)
