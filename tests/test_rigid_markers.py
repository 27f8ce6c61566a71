import numpy as np
import pytest
from mocap_files import CUBE_M, markers_of
from scipy.spatial.transform import Rotation
from support import wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers.body_trajectory import from_both, from_markers
from gtcal.readers.rigid_markers import MarkerShape, exchangeable, fit, in_body_frame, mean_shape, register

LABELS = tuple("abcde")
SHAPE = MarkerShape(LABELS, CUBE_M)
POSES = wandering_trajectory("b", n=200).world_T_body
STAMPS_NS = 10_000_000 * np.arange(len(POSES))
SQUARE_M = 0.05 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])


def noisy(sigma_m: float = 1e-4, seed: int = 0) -> np.ndarray:
    return markers_of(POSES) + np.random.default_rng(seed).normal(0, sigma_m, (len(POSES), len(CUBE_M), 3))


def errors_mm_deg(found: np.ndarray, true: np.ndarray = POSES) -> tuple[np.ndarray, np.ndarray]:
    apart = np.linalg.inv(true) @ found
    turned = np.rad2deg(Rotation.from_matrix(apart[:, :3, :3]).magnitude())
    return 1000 * np.linalg.norm(apart[:, :3, 3], axis=1), turned


def test_exact_markers_give_the_exact_pose() -> None:
    poses, rms_m = register(CUBE_M, markers_of(POSES))
    np.testing.assert_allclose(poses, POSES, atol=1e-12)
    assert rms_m.max() < 1e-12


def test_the_pose_is_the_least_squares_one() -> None:
    """No small motion of it lowers the residual."""
    at = noisy(1e-3)[:5]
    poses, rms_m = register(CUBE_M, at)
    random = np.random.default_rng(1)
    for _ in range(50):
        moved = poses.copy()
        moved[:, :3, :3] @= Rotation.from_rotvec(random.normal(0, 1e-3, 3)).as_matrix()
        moved[:, :3, 3] += random.normal(0, 1e-4, 3)
        off = np.linalg.norm(at - markers_of(moved), axis=2)
        assert (np.sqrt((off**2).mean(axis=1)) >= rms_m).all()


def test_mirrored_markers_are_turned_never_mirrored() -> None:
    poses, _ = register(CUBE_M, markers_of(POSES) * np.array([1.0, 1, -1]))
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)


def test_unseen_markers_are_done_without() -> None:
    at = noisy(0.0)
    at[3, 0] = at[4, [0, 1]] = at[5, [0, 1, 2]] = at[6] = np.nan
    found = fit(SHAPE, at)
    assert np.flatnonzero(found.too_few).tolist() == [5, 6]
    assert np.isnan(found.world_T_body[[5, 6]]).all()
    kept = np.delete(np.arange(len(POSES)), [5, 6])
    np.testing.assert_allclose(found.world_T_body[kept], POSES[kept], atol=1e-10)


def test_three_in_a_line_have_no_pose() -> None:
    points_m = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 1e-4, 0], [0, 0.1, 0]])
    at = markers_of(POSES, points_m)
    at[7, 3] = np.nan
    found = fit(MarkerShape(tuple("abcd"), points_m), at)
    assert np.flatnonzero(found.too_few).tolist() == [7]


@pytest.mark.parametrize("pair", [(0, 1), (0, 4), (2, 3)])
def test_two_swapped_labels_are_swapped_back(pair: tuple[int, int]) -> None:
    at = noisy()
    rows = [10, 11, 50]
    at[np.ix_(rows, pair)] = at[np.ix_(rows, pair[::-1])]
    found = fit(SHAPE, at)
    assert np.flatnonzero(found.swapped).tolist() == rows
    assert not found.contradicting.any()
    mm, deg = errors_mm_deg(found.world_T_body)
    assert mm.max() < 0.5
    assert deg.max() < 0.5


def test_a_marker_that_jumped_is_left_out() -> None:
    at = noisy()
    at[20, 2] += 0.03
    at[21, 4] += [0, 0.2, 0]
    found = fit(SHAPE, at)
    assert np.flatnonzero(found.without_one).tolist() == [20, 21]
    mm, _ = errors_mm_deg(found.world_T_body)
    assert mm.max() < 0.5


def test_what_is_not_clear_is_left_out_and_counted() -> None:
    """Three labels in a ring are no swap; and of a triangle with one wrong marker nobody knows which."""
    at = noisy()
    at[30, :3] = at[30, [1, 2, 0]]
    at[31, 3:] = np.nan
    at[31, 0] += 0.02
    found = fit(SHAPE, at)
    assert np.flatnonzero(found.contradicting).tolist() == [30, 31]
    assert np.isnan(found.world_T_body[[30, 31]]).all()
    solved = from_markers(at, STAMPS_NS, LABELS, "file: b", "b")
    assert "2 frames left out, their markers contradict each other" in solved.notes[0]


def test_a_label_on_the_ball_of_an_unseen_one_is_moved_there() -> None:
    at = noisy()
    at[40, 1] = at[40, 0]
    at[40, 0] = np.nan
    found = fit(SHAPE, at)
    assert found.swapped[40] or found.without_one[40] or found.contradicting[40]
    mm, _ = errors_mm_deg(found.world_T_body[found.ok], POSES[found.ok])
    assert mm.max() < 0.5


def test_swapped_labels_of_a_symmetric_shape_are_noticed_by_how_it_turns() -> None:
    """Two opposite corners of a square swapped: it turns over and fits as well as before."""
    labels = tuple("abcd")
    at = markers_of(POSES, SQUARE_M)
    true = from_markers(at, STAMPS_NS, labels, "file: b", "b")
    rows = [20, 21, 22, 90]
    at[np.ix_(rows, (0, 2))] = at[np.ix_(rows, (2, 0))]
    found = fit(MarkerShape(labels, SQUARE_M), at)
    assert found.ok.all()
    assert exchangeable(MarkerShape(labels, SQUARE_M), found.limit_m) == ("a", "c")
    assert exchangeable(SHAPE, found.limit_m) is None
    solved = from_markers(at, STAMPS_NS, labels, "file: b", "b")
    assert np.flatnonzero(np.isnan(solved.world_T_body[:, 0, 0])).tolist() == rows
    assert "4 frames left out, turned over by swapped labels" in solved.notes[0]
    others = np.delete(np.arange(len(POSES)), rows)
    np.testing.assert_allclose(solved.world_T_body[others], true.world_T_body[others], atol=1e-9)
    at[:80, [0, 2]] = at[:80, [2, 0]]
    with pytest.raises(GtcalError, match=r"the body turns over, as at 0\.\d+ s; .* 'a' and 'c' get swapped"):
        from_markers(at, STAMPS_NS, labels, "file: b", "b")


def test_the_mean_shape_is_the_shape_in_spite_of_gaps_swaps_and_noise() -> None:
    random = np.random.default_rng(3)
    at = noisy(2e-4)
    at[random.random(at.shape[:2]) < 0.3] = np.nan
    at[5:15, [0, 1]] = at[5:15, [1, 0]]
    shape_m = mean_shape(at, LABELS, "b")
    _, rms_m = register(shape_m, CUBE_M[None])
    assert rms_m[0] < 1e-4


def test_markers_that_are_never_all_seen_at_once_still_make_a_shape() -> None:
    at = noisy(1e-5)
    at[:100, 4] = np.nan
    at[100:, 0] = np.nan
    _, rms_m = register(mean_shape(at, LABELS, "b"), CUBE_M[None])
    assert rms_m[0] < 1e-5
    at[:, 4] = np.nan
    with pytest.raises(GtcalError, match="b: marker 'e' is never seen; leave it out"):
        mean_shape(at, LABELS, "b")
    at[:5, 4], at[:5, :3] = 0.0, np.nan
    with pytest.raises(GtcalError, match="b: marker 'e' is never seen together with three of the others"):
        mean_shape(at, LABELS, "b")


def test_what_moves_within_itself_is_no_rigid_body() -> None:
    at = noisy()
    at[:, 0] += np.random.default_rng(0).normal(0, 0.03, (len(at), 3))
    with pytest.raises(GtcalError, match=r"b: the markers a, b, c, d, e move against each other by .* mm rms"):
        mean_shape(at, LABELS, "b")


def test_the_bodys_frame_is_the_markers_own() -> None:
    """The same from any take: whatever the noise, the gaps and the world."""
    frames = []
    for seed in (0, 1):
        at = noisy(1e-4, seed) @ Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        frames.append(in_body_frame(mean_shape(at, LABELS, "b"), LABELS, "b"))
        np.testing.assert_allclose(frames[-1].mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(frames[-1][0, 1:], 0.0, atol=1e-12)
        assert frames[-1][0, 0] > 0
        assert frames[-1][1, 1] > 0
        np.testing.assert_allclose(frames[-1][1, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(frames[0], frames[1], atol=1e-4)


def test_markers_that_give_no_frame_are_refused() -> None:
    line_m = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.25, 0, 0]])
    with pytest.raises(GtcalError, match="b: the markers a, b, c are in a line"):
        in_body_frame(line_m, tuple("abc"), "b")
    central_m = np.concatenate([[[0.0, 0, 0]], SQUARE_M])
    with pytest.raises(GtcalError, match=r"b: marker 'a' is at the centroid.*list another one first"):
        in_body_frame(central_m, LABELS, "b")


def test_a_pose_that_the_markers_confirm_stays_the_files_and_so_does_its_frame() -> None:
    """An origin that is not the centroid, axes that are not the markers'."""
    given = POSES.copy()
    given[[4, 5]] = np.nan
    solved = from_both(given, noisy(5e-5), LABELS, "file: b", "b")
    np.testing.assert_array_equal(np.delete(solved.world_T_body, [4, 5], axis=0), np.delete(POSES, [4, 5], axis=0))
    mm, deg = errors_mm_deg(solved.world_T_body)
    assert mm.max() < 0.3
    assert deg.max() < 0.2


def test_noisy_poses_give_way_to_better_markers() -> None:
    random = np.random.default_rng(0)
    given = POSES.copy()
    given[:, :3, 3] += random.normal(0, 2e-3, (len(POSES), 3))
    solved = from_both(given, noisy(5e-5), LABELS, "file: b", "b")
    mm, _ = errors_mm_deg(solved.world_T_body)
    assert np.median(mm) < 0.5  # the frame is the file's on average: 2 mm over the root of 200 frames
    assert "solved from its 5 measured markers" in solved.notes[0]


def test_noisy_markers_leave_good_poses_alone() -> None:
    solved = from_both(POSES, noisy(1e-3), LABELS, "file: b", "b")
    np.testing.assert_array_equal(solved.world_T_body, POSES)
    assert solved.notes == ()
