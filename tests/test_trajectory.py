from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import EPOCH_NS, wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.recordings.trajectory import Gap, Trajectory, poses_from_quaternions, quaternions_from_poses

MS = 1_000_000


def at_times_ms(*times_ms: float) -> Trajectory:
    """A body that moves 1 mm and turns 1 mrad about a skew axis per millisecond, sampled at these times."""
    times = np.array(times_ms)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    axis = np.array([2.0, -1.0, 2.0]) / 3
    start = Rotation.from_rotvec([0.3, -0.8, 2.0])
    poses[:, :3, :3] = (start * Rotation.from_rotvec(times[:, None] * 1e-3 * axis)).as_matrix()
    poses[:, :3, 3] = [0.5, 1.0, -2.0] + times[:, None] * 1e-3 * np.array([1.0, 0, 0])
    return Trajectory("board", EPOCH_NS + np.round(times * MS).astype(np.int64), poses)


def queries_ms(*times_ms: float) -> np.ndarray:
    return EPOCH_NS + np.round(np.array(times_ms) * MS).astype(np.int64)


def test_at_its_samples_the_trajectory_is_its_samples() -> None:
    trajectory = wandering_trajectory("board")
    at = trajectory.interpolate(trajectory.stamps_ns, max_gap_s=1e-9)
    assert at.ok.all()
    np.testing.assert_array_equal(at.world_T_body, trajectory.world_T_body)


def test_a_steady_motion_is_followed_exactly_between_uneven_samples() -> None:
    trajectory = at_times_ms(0, 10, 11, 35, 50)
    times_ms = np.sort(np.random.default_rng(3).uniform(0, 50, 200).round(6))
    at = trajectory.interpolate(queries_ms(*times_ms), max_gap_s=1)
    truth = at_times_ms(*times_ms).world_T_body
    np.testing.assert_allclose(at.world_T_body, truth, atol=1e-9)


def test_queries_a_nanosecond_apart_are_told_apart_at_epoch_stamps() -> None:
    trajectory = at_times_ms(0, 10)
    at = trajectory.interpolate(EPOCH_NS + np.array([1, 2, 3]), max_gap_s=1)
    np.testing.assert_allclose(np.diff(at.world_T_body[:, 0, 3]), 1e-9, rtol=1e-4)


def test_interpolation_takes_the_short_way_whatever_the_signs_of_the_quaternions() -> None:
    trajectory = wandering_trajectory("board")
    quats = quaternions_from_poses(trajectory.world_T_body, "xyzw")
    quats[::2] *= -1
    flipped = replace(
        trajectory,
        world_T_body=poses_from_quaternions(quats, "xyzw", trajectory.world_T_body[:, :3, 3]),
    )
    between = trajectory.stamps_ns[:-1] + 4 * MS
    np.testing.assert_allclose(
        flipped.interpolate(between, 1).world_T_body, trajectory.interpolate(between, 1).world_T_body, atol=1e-12
    )


def test_no_pose_across_a_long_gap_or_outside_but_at_the_samples_beside_it() -> None:
    trajectory = at_times_ms(0, 10, 60, 70)
    at = trajectory.interpolate(queries_ms(-0.001, 0, 5, 10, 10.001, 59.999, 60, 65, 70, 70.001), max_gap_s=0.03)
    outside, none, too_long = Gap.OUTSIDE, Gap.NONE, Gap.TOO_LONG
    assert at.gaps.tolist() == [outside, none, none, none, too_long, too_long, none, none, none, outside]
    assert np.isnan(at.world_T_body[~at.ok]).all()
    assert np.isfinite(at.world_T_body[at.ok]).all()


def test_a_gap_of_exactly_the_limit_is_bridged() -> None:
    trajectory = at_times_ms(0, 50)
    assert trajectory.interpolate(queries_ms(25), max_gap_s=0.050).ok.all()
    assert not trajectory.interpolate(queries_ms(25), max_gap_s=0.049).ok.any()


def test_queries_come_in_any_order_and_number() -> None:
    trajectory = wandering_trajectory("board")
    stamps_ns = trajectory.stamps_ns[0] + np.array([90, 3, 90, 41]) * MS
    together = trajectory.interpolate(stamps_ns, 1).world_T_body
    for stamp_ns, pose in zip(stamps_ns, together, strict=True):
        np.testing.assert_array_equal(trajectory.interpolate(np.array([stamp_ns]), 1).world_T_body[0], pose)
    assert trajectory.interpolate(np.empty(0, dtype=np.int64), 1).world_T_body.shape == (0, 4, 4)
    assert trajectory.twist_per_s(np.empty(0, dtype=np.int64)).shape == (0, 6)


def test_the_twist_is_the_derivative_of_the_pose() -> None:
    trajectory = wandering_trajectory("board")
    h_ns = MS // 10
    inside = trajectory.stamps_ns[:-1, None] + np.array([1, 4, 8]) * MS
    stamps_ns = inside.ravel()
    before = trajectory.interpolate(stamps_ns - h_ns, 1).world_T_body
    after = trajectory.interpolate(stamps_ns + h_ns, 1).world_T_body
    numeric = [
        gtsam.Pose3.Logmap(gtsam.Pose3(b).between(gtsam.Pose3(a))) / (2e-9 * h_ns)
        for b, a in zip(before, after, strict=True)
    ]
    np.testing.assert_allclose(trajectory.twist_per_s(stamps_ns), numeric, atol=1e-6)


def test_the_twist_at_a_sample_is_that_of_the_segment_after_it_and_at_the_end_of_the_last() -> None:
    trajectory = at_times_ms(0, 10, 20)
    twist = trajectory.twist_per_s(queries_ms(0, 10, 20, 5))
    assert np.isfinite(twist).all()
    np.testing.assert_allclose(twist[:, :3], twist[[3, 3, 3, 3], :3], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(twist[:, 3:], axis=1), 1.0, atol=1e-9)
    end = at_times_ms(20).world_T_body[0, :3, :3]
    np.testing.assert_allclose(twist[2, 3:], end.T @ [1.0, 0, 0], atol=1e-9)
    assert np.isnan(trajectory.twist_per_s(queries_ms(-1, 21))).all()


def test_a_single_sample_is_a_pose_at_its_own_time_only() -> None:
    trajectory = at_times_ms(5)
    at = trajectory.interpolate(queries_ms(4, 5, 6), max_gap_s=1)
    assert at.gaps.tolist() == [Gap.OUTSIDE, Gap.NONE, Gap.OUTSIDE]
    assert np.isnan(trajectory.twist_per_s(queries_ms(5))).all()


@pytest.mark.parametrize("interval_ms", [2.8, 8.0, 50.0])
def test_by_default_one_lost_sample_is_bridged_and_two_are_not(interval_ms: float) -> None:
    one_lost = at_times_ms(*(interval_ms * np.array([0, 1, 2, 4, 5, 6])))
    two_lost = at_times_ms(*(interval_ms * np.array([0, 1, 2, 5, 6, 7])))
    query = queries_ms(2.5 * interval_ms)
    assert one_lost.interpolate(query, one_lost.default_max_gap_s).ok.all()
    assert not two_lost.interpolate(query, two_lost.default_max_gap_s).ok.any()


def test_by_default_no_gap_beyond_200_ms_is_bridged_however_slow_the_sampling() -> None:
    assert at_times_ms(0, 10_000, 20_000).default_max_gap_s == pytest.approx(0.2)


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_quaternions_and_poses_turn_into_each_other(order: str) -> None:
    random = np.random.default_rng(0)
    quats = random.normal(size=(100, 4))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    poses = poses_from_quaternions(quats, order, random.normal(size=(100, 3)))
    x, y, z, w = (quats[0] if order == "xyzw" else np.roll(quats[0], -1)).tolist()
    np.testing.assert_allclose(poses[0, :3, :3], gtsam.Rot3.Quaternion(w, x, y, z).matrix(), atol=1e-14)
    back = quaternions_from_poses(poses, order)
    np.testing.assert_allclose(np.abs(np.sum(back * quats, axis=1)), 1.0, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world_T_body": np.tile(np.eye(4), (2, 1, 1))}, r"\(2, 4, 4\) for 3 stamps, expected \(3, 4, 4\)"),
        ({"world_T_body": np.full((3, 4, 4), np.nan)}, "'board' has NaN"),
        ({"stamps_ns": np.array([1, 2, 2])}, "'board': time stamps must increase"),
        ({"stamps_ns": np.empty(0, np.int64), "world_T_body": np.empty((0, 4, 4))}, "'board' has no poses"),
    ],
)
def test_what_is_no_trajectory_is_refused(change: dict, message: str) -> None:
    with pytest.raises(GtcalError, match=message):
        replace(at_times_ms(0, 1, 2), **change)
