"""PnP by virtual camera: exact where the pixels are, both planar poses, views that it cannot solve left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_support import HEADSET, KINDS, pose_errors, simulated, true_camera_T_board
from scipy.spatial.transform import Rotation

from factors.board_shape import outline_of
from gtcal.board import AprilGrid
from gtcal.board_tolerance import BoardTolerance
from gtcal.camera import Camera
from gtcal.estimation.observations import Views, synchronise
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import select_corners, select_views
from gtcal.simulation import CornerNoise, quest3_like_rig
from gtcal.simulation.transforms import apply, transform

NO_NOISE = CornerNoise(pixel_px=0.0)
ALL = 10_000


def views_of(kind: str, name: str, **changes: object) -> Views:
    return synchronise(simulated(kind, **changes).recording).views[name]


def off_axis_deg(camera: Camera, pixels_px: np.ndarray) -> np.ndarray:
    bearings, valid = camera.unproject(pixels_px)
    assert valid.all()
    return np.rad2deg(np.arccos(bearings[:, 2]))


@pytest.mark.parametrize("kind", list(KINDS))
def test_without_noise_the_better_pose_is_the_truth(kind: str) -> None:
    simulation = simulated(kind, corners=NO_NOISE)
    for views in synchronise(simulation.recording).views.values():
        found = solve_pnp(views, max_views=ALL)
        true = true_camera_T_board(simulation, select_views(views, found.view_index))
        mm, deg = pose_errors(found.camera_T_board[:, 0], true)
        assert len(mm) > 20
        assert mm.max() < 1e-3
        assert deg.max() < 1e-4
        assert found.median_px[:, 0].max() < 1e-4


def test_solves_views_beyond_80_degrees_off_the_axis() -> None:
    """Boards whose middle lies at 70 to 84 degrees, their corners up to the edge of the valid field."""
    camera = quest3_like_rig().cameras[0]
    board = AprilGrid(3, 3, 0.03, 0.3)
    middle_m = board.corners_m.mean(axis=0)
    rng = np.random.default_rng(5)
    poses, views = [], []
    for off_axis in np.deg2rad(np.linspace(70.0, 84.0, 15)):
        direction = np.array([np.sin(off_axis), 0.0, np.cos(off_axis)])
        facing = Rotation.align_vectors(-direction[None], [[0.0, 0.0, 1.0]])[0]
        turned = facing * Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3))
        camera_T_board = transform(turned, 0.5 * direction - turned.apply(middle_m))
        pixels_px, valid = camera.project(apply(camera_T_board, board.corners_m))
        poses.append(camera_T_board)
        views.append((np.flatnonzero(valid), pixels_px[valid]))
    found = solve_pnp(_views(camera, board, views), max_views=ALL)
    mm, deg = pose_errors(found.camera_T_board[:, 0], np.stack(poses))
    seen_px = np.concatenate([pixels for _, pixels in views])
    assert off_axis_deg(camera, seen_px).max() > 87.0
    assert found.view_index.tolist() == list(range(15))
    assert mm.max() < 1e-3
    assert deg.max() < 1e-4


def _views(camera: Camera, board: AprilGrid, seen: list[tuple[np.ndarray, np.ndarray]]) -> Views:
    n, ids = len(seen), np.concatenate([ids for ids, _ in seen])
    return Views(
        camera=camera,
        stamps_ns=np.arange(n),
        frame_index=np.arange(n),
        ref_T_body=np.tile(np.eye(4), (n, 1, 1)),
        view_start=np.concatenate([[0], np.cumsum([len(ids) for ids, _ in seen])]),
        corner_ids=ids,
        corners_m=board.corners_m[ids],
        corners_px=np.concatenate([pixels for _, pixels in seen]),
        outline_m=outline_of(board.corners_m),
        shape_sigmas=BoardTolerance().shape_sigmas(outline_of(board.corners_m)),
    )


def test_both_poses_of_a_planar_board_are_kept_and_the_better_comes_first() -> None:
    simulation = simulated(HEADSET)
    n_ambiguous = 0
    for views in synchronise(simulation.recording).views.values():
        found = solve_pnp(views, max_views=ALL)
        assert (found.median_px[:, 0] <= found.median_px[:, 1] + 0.05).all()  # ordered by loss, not by median
        _, between_deg = pose_errors(found.camera_T_board[:, 0], found.camera_T_board[:, 1])
        n_ambiguous += (between_deg > 5.0).sum()
    assert n_ambiguous > 20


def test_wrong_tags_do_not_turn_a_view() -> None:
    """With up to a tenth of its corners on wrong tags a view's pose is nearly always as good as without."""
    spoilt = simulated(HEADSET, frames=100, corners=CornerNoise(wrong_tag_share=0.04))
    deg = {"clean": [], "spoilt": []}
    for name, views in synchronise(spoilt.recording).views.items():
        wrong = spoilt.truth.cameras[name].wrong_corners
        share = np.add.reduceat(wrong, views.view_start[:-1]) / np.diff(views.view_start)
        found = solve_pnp(views, max_views=ALL)
        true = true_camera_T_board(spoilt, select_views(views, found.view_index))
        off = pose_errors(found.camera_T_board[:, 0], true)[1]
        share = share[found.view_index]
        deg["clean"].append(off[share == 0.0])
        deg["spoilt"].append(off[(share > 0.0) & (share <= 0.1)])
    clean, spoilt_deg = np.concatenate(deg["clean"]), np.concatenate(deg["spoilt"])
    assert len(spoilt_deg) > 50
    assert np.median(spoilt_deg) < 1.5 * np.median(clean)
    assert (spoilt_deg < 0.5).mean() >= 0.97


def test_no_more_views_than_asked_for_and_spread_over_the_recording() -> None:
    views = views_of(HEADSET, "front_left", frames=100)
    found = solve_pnp(views, max_views=20)
    assert len(found.view_index) == 20
    assert (np.diff(found.view_index) > 0).all()
    assert found.view_index[0] <= 3
    assert found.view_index[-1] >= views.n_views - 4
    assert np.diff(found.view_index).max() <= 2 * views.n_views / 20


def test_views_with_a_single_tag_are_taken_only_where_there_is_nothing_better() -> None:
    views = views_of(HEADSET, "front_left")
    first_four = np.arange(views.n_corners) - views.view_start[views.view_of_corner] < 4
    poor = views.view_of_corner % 3 == 0
    mixed = select_corners(views, ~poor | first_four)
    assert (solve_pnp(mixed, max_views=ALL).view_index % 3 != 0).all()
    only_poor = select_corners(views, first_four)
    assert len(solve_pnp(only_poor, max_views=ALL).view_index) == views.n_views


@pytest.mark.parametrize("shape", ["a line", "a point", "three corners"])
def test_corners_that_fix_no_pose_leave_their_view_out(shape: str) -> None:
    views = views_of(HEADSET, "front_left")
    in_view_2 = views.view_of_corner == 2
    if shape == "three corners":
        views = select_corners(views, ~in_view_2 | (np.cumsum(in_view_2) <= 3))
    else:
        corners_m, corners_px = views.corners_m.copy(), views.corners_px.copy()
        along = 0.0 if shape == "a point" else np.linspace(0.0, 1.0, in_view_2.sum())[:, None]
        corners_m[in_view_2] = along * np.array([[0.1, 0.05, 0.0]])
        corners_px[in_view_2] = np.array([600.0, 500.0]) + along * np.array([[40.0, 30.0]])
        views = replace(views, corners_m=corners_m, corners_px=corners_px)
    found = solve_pnp(views, max_views=ALL)
    assert 2 not in found.view_index
    assert {1, 3} <= set(found.view_index.tolist())
    assert np.isfinite(found.camera_T_board).all()


def test_a_camera_without_a_solvable_view_gives_none() -> None:
    views = select_views(views_of(HEADSET, "front_left"), np.array([0, 1]))
    nowhere = replace(views, corners_m=np.zeros_like(views.corners_m))
    found = solve_pnp(nowhere, max_views=ALL)
    assert found.camera_T_board.shape == (0, 2, 4, 4)
    assert found.median_px.shape == (0, 2)


def test_many_views_are_solved_as_few_are() -> None:
    """How far a pose is refined may depend on the others, but hardly."""
    views = views_of(HEADSET, "front_left", frames=120)
    assert views.n_views > 70
    together = solve_pnp(views, max_views=ALL)
    apart = [solve_pnp(select_views(views, part), max_views=ALL) for part in np.array_split(together.view_index, 3)]
    expected = np.concatenate([part.camera_T_board for part in apart])
    np.testing.assert_allclose(together.camera_T_board, expected, atol=1e-5)
