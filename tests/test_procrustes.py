"""Stages 1 and 2: the closed-form updates are optimal, the sums are exact, and any X is found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from calibration_support import HEADSET, NO_MOCAP_NOISE, errors_of, guides, simulated, with_exact_mocap, worst
from scipy.spatial.transform import Rotation

from factors.alignment import corner_moments
from gtcal.estimation.alignment import GuideViews, fitting_views, stage_1, stage_2
from gtcal.estimation.observations import synchronise
from gtcal.estimation.procrustes import (
    N_RANDOM_ROTATIONS,
    N_STARTS,
    AlignmentSums,
    alignment_sums,
    energy_m2,
    solve_body_T_board,
    solve_camera_T_ref,
    starting_rotations,
    sweep,
)
from gtcal.simulation import CornerNoise
from gtcal.simulation.transforms import random_transform, transform

FIXED = "pinholes and fisheyes fixed"
STAGE_2 = {"eps": 1e-4, "max_iterations": 100}


class Problem:
    """Two cameras whose PnP poses fit no chain exactly, with their corners."""

    def __init__(self, seed: int, n_views: int = 7) -> None:
        rng = np.random.default_rng(seed)
        self.ref_T_body = [_random_transforms(rng, n_views) for _ in range(2)]
        self.pnp = [_random_transforms(rng, n_views) for _ in range(2)]
        self.corners_m = [rng.normal(0.0, 0.2, (n_views, 5, 3)) for _ in range(2)]
        self.X, self.Y = _random_transforms(rng, 1)[0], _random_transforms(rng, 2)

    def sums(self, camera: int, views: slice = slice(None)) -> AlignmentSums:
        corners_m = self.corners_m[camera][views]
        moments = corner_moments(5 * np.arange(len(corners_m) + 1), corners_m.reshape(-1, 3))
        return alignment_sums(self.ref_T_body[camera][views], self.pnp[camera][views], moments)

    def energy(self, Y: np.ndarray, X: np.ndarray) -> float:
        """E_3D corner by corner."""
        total = 0.0
        for c in range(2):
            corners = np.concatenate([self.corners_m[c], np.ones((*self.corners_m[c].shape[:2], 1))], axis=2)
            for A, That, of_view in zip(self.ref_T_body[c], self.pnp[c], corners, strict=True):
                for p in of_view:
                    total += (((Y[c] @ A @ X - That) @ p) ** 2).sum()
        return total


def _random_transforms(rng: np.random.Generator, n: int) -> np.ndarray:
    return transform(Rotation.random(n, rng=rng), rng.normal(0.0, 0.5, (n, 3)))


def _nudges(rng: np.random.Generator) -> list[np.ndarray]:
    """Small motions in every direction, along and between the axes."""
    directions = np.concatenate([np.eye(6), -np.eye(6), rng.standard_normal((30, 6))])
    return [transform(Rotation.from_rotvec(1e-3 * d[:3]), 1e-3 * d[3:]) for d in directions]


@pytest.mark.parametrize("seed", range(3))
def test_energy_from_the_sums_is_that_of_the_corners(seed: int) -> None:
    problem = Problem(seed)
    found = energy_m2([problem.sums(0), problem.sums(1)], problem.Y[None], problem.X[None])
    assert found[0] == pytest.approx(problem.energy(problem.Y, problem.X), rel=1e-9)


def test_energy_of_a_batch_is_that_of_each() -> None:
    problems = [Problem(seed) for seed in range(4)]
    sums = [problems[0].sums(0), problems[0].sums(1)]
    Y, X = np.stack([p.Y for p in problems]), np.stack([p.X for p in problems])
    apart = [energy_m2(sums, Y[i : i + 1], X[i : i + 1])[0] for i in range(4)]
    np.testing.assert_allclose(energy_m2(sums, Y, X), apart, rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_no_nudge_of_a_closed_form_camera_pose_lowers_the_energy(seed: int) -> None:
    problem = Problem(seed)
    Y = np.stack([solve_camera_T_ref(problem.sums(c), problem.X[None])[0] for c in range(2)])
    best = problem.energy(Y, problem.X)
    assert best < problem.energy(problem.Y, problem.X)
    for nudge in _nudges(np.random.default_rng(seed)):
        assert problem.energy(np.stack([Y[0] @ nudge, Y[1]]), problem.X) > best
        assert problem.energy(np.stack([Y[0], Y[1] @ nudge]), problem.X) > best


@pytest.mark.parametrize("seed", range(3))
def test_no_nudge_of_a_closed_form_board_pose_lowers_the_energy(seed: int) -> None:
    problem = Problem(seed)
    X = solve_body_T_board([problem.sums(0), problem.sums(1)], problem.Y[None])[0]
    best = problem.energy(problem.Y, X)
    assert best < problem.energy(problem.Y, problem.X)
    assert all(problem.energy(problem.Y, X @ nudge) > best for nudge in _nudges(np.random.default_rng(seed)))


def test_closed_forms_are_rigid_even_where_the_best_fit_would_mirror() -> None:
    """Point sets that a reflection fits best still get a rotation."""
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    problem = Problem(0)
    problem.pnp = [mirror @ problem.Y[c] @ problem.ref_T_body[c] @ problem.X for c in range(2)]
    found = solve_camera_T_ref(problem.sums(0), problem.X[None])[0]
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_array_equal(found[3], [0.0, 0.0, 0.0, 1.0])


def test_sums_of_all_views_are_the_sums_of_the_parts() -> None:
    problem = Problem(0)
    whole, parts = problem.sums(0), [problem.sums(0, slice(3)), problem.sums(0, slice(3, None))]
    for field in ("K", "L", "M", "constant", "n_corners"):
        added = getattr(parts[0], field) + getattr(parts[1], field)
        np.testing.assert_allclose(getattr(whole, field), added, rtol=1e-12, atol=1e-12)


def test_what_a_sweep_works_on_has_one_size_for_any_number_of_views() -> None:
    sums = [Problem(0, n_views).sums(0) for n_views in (3, 3000)]
    shapes = [{name: np.shape(value) for name, value in vars(s).items()} for s in sums]
    assert shapes[0] == shapes[1]
    assert shapes[0]["K"] == shapes[0]["L"] == (4, 4, 4, 4)


def test_starting_rotations_are_far_apart() -> None:
    rotations = starting_rotations(np.random.default_rng(0))
    assert rotations.shape == (N_STARTS, 3, 3)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    plain = [Rotation.random(N_STARTS, rng=np.random.default_rng(seed)).as_matrix() for seed in range(20)]
    assert _nearest_deg(rotations) > 45.0
    assert _nearest_deg(rotations) > 1.5 * max(_nearest_deg(other) for other in plain)


def test_starting_rotations_are_picked_from_the_random_ones_greedily() -> None:
    rotations = starting_rotations(np.random.default_rng(3))
    pool = Rotation.random(N_RANDOM_ROTATIONS, rng=np.random.default_rng(3)).as_matrix()
    far = [np.linalg.norm(pool[:, None] - rotations[:k], axis=(2, 3)).min(axis=1) for k in range(1, N_STARTS)]
    for k, distance in enumerate(far, start=1):
        np.testing.assert_array_equal(rotations[k], pool[distance.argmax()])


def _nearest_deg(rotations: np.ndarray) -> float:
    """The smallest angle between two of the rotations."""
    turns = np.einsum("aji,bjk->abik", rotations, rotations)
    angles = Rotation.from_matrix(turns[np.triu_indices(len(rotations), 1)]).magnitude()
    return float(np.rad2deg(angles.min()))


def test_on_exact_poses_the_sweep_ends_at_the_truth() -> None:
    simulation = simulated(HEADSET, corners=CornerNoise(pixel_px=0.0), mocap=NO_MOCAP_NOISE)
    of_camera = guides(with_exact_mocap(simulation))
    aligned = stage_1(of_camera, np.random.default_rng(0))
    estimate, _ = stage_2(aligned.views, aligned.estimate, eps=1e-15, max_iterations=50)
    mm, deg = worst(errors_of(estimate.camera_T_ref, estimate.body_T_board, simulation).values())
    assert mm < 1e-3
    assert deg < 1e-4


def test_the_sweep_reports_the_rmse_of_its_result() -> None:
    of_camera = guides(synchronise(simulated(HEADSET).recording)).values()
    sums = [alignment_sums(g.views.ref_T_body, g.pnp_camera_T_board[:, 0], g.corner_moments) for g in of_camera]
    found = sweep(sums, np.random.default_rng(0))
    energy = energy_m2(sums, found.camera_T_ref[None], found.body_T_board[None])[0]
    assert found.rmse_m == pytest.approx(np.sqrt(energy / sum(s.n_corners for s in sums)))
    assert found.rmse_of_starts_m.shape == (N_STARTS,)
    assert found.rmse_m == found.rmse_of_starts_m.min()


@pytest.mark.long
@pytest.mark.parametrize("kind", [HEADSET, FIXED])
def test_the_right_basin_is_reached_from_any_X(kind: str) -> None:
    """As markers glued on elsewhere would have it: ref_T_body' = ref_T_body * D, body_T_board' = D^-1 * X. The 1,000
    of the issue are those of scripts/study_basins.py."""
    simulation = simulated(kind, frames=30)
    of_camera = guides(synchronise(simulation.recording))
    rng = np.random.default_rng(0)
    for run in range(60):
        D = random_transform(rng, shift_m=rng.uniform(0.0, 0.5))
        aligned = stage_1(_rebased(of_camera, D), np.random.default_rng(run))
        estimate, _ = stage_2(aligned.views, aligned.estimate, **STAGE_2)
        found = errors_of(estimate.camera_T_ref, D @ estimate.body_T_board, simulation)
        mm, deg = worst(found.values())
        assert mm < 2.0, f"{run=}"
        assert deg < 0.2, f"{run=}"


def _rebased(of_camera: dict[str, GuideViews], D: np.ndarray) -> dict[str, GuideViews]:
    return _with_motion(of_camera, lambda ref_T_body: ref_T_body @ D)


def _with_motion(of_camera: dict[str, GuideViews], change: Callable[[np.ndarray], np.ndarray]) -> dict[str, GuideViews]:
    return {
        name: replace(guide, views=replace(guide.views, ref_T_body=change(guide.views.ref_T_body)))
        for name, guide in of_camera.items()
    }


def test_flipped_pnp_poses_do_not_matter() -> None:
    """Of each third view the wrong one of the two planar poses comes first."""
    simulation = simulated(HEADSET)
    of_camera = guides(synchronise(simulation.recording))
    flipped = {name: replace(guide, pnp_camera_T_board=_flip(guide)) for name, guide in of_camera.items()}
    for of_run in (of_camera, flipped):
        aligned = stage_1(of_run, np.random.default_rng(0))
        estimate, _ = stage_2(aligned.views, aligned.estimate, **STAGE_2)
        mm, deg = worst(errors_of(estimate.camera_T_ref, estimate.body_T_board, simulation).values())
        assert mm < 1.0
        assert deg < 0.1
    chosen = fitting_views(flipped, estimate)
    for name, guide in of_camera.items():
        used = chosen[name].pnp_camera_T_board
        distance = np.abs(used[:, None] - guide.pnp_camera_T_board[:, 0]).max(axis=(2, 3)).min(axis=1)
        assert (distance < 1e-3).mean() > 0.9  # nearly always the better pose, though it came second


def _flip(guide: GuideViews) -> np.ndarray:
    poses = guide.pnp_camera_T_board.copy()
    poses[::3] = poses[::3, ::-1]
    return poses


@pytest.mark.long
@pytest.mark.parametrize("kind", [HEADSET, FIXED, "one carried camera"])
def test_a_third_of_swapped_frames_is_seen_through(kind: str) -> None:
    """With the swaps told by their turns alone, before anything is known of X: four recordings of each kind."""
    for seed in range(1, 5):
        simulation = simulated(kind, seed=seed, swap_share=0.33)
        aligned = stage_1(guides(synchronise(simulation.recording)), np.random.default_rng(0))
        estimate, _ = stage_2(aligned.views, aligned.estimate, **STAGE_2)
        mm, deg = worst(errors_of(estimate.camera_T_ref, estimate.body_T_board, simulation).values())
        assert mm < 2.0, f"{seed=}"
        assert deg < 0.2, f"{seed=}"


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_gross_views_do_not_decide_the_alignment(share: float) -> None:
    """Mocap poses of some views turned and moved anywhere."""
    simulation = simulated(HEADSET)
    of_camera = guides(synchronise(simulation.recording))
    rng = np.random.default_rng(1)

    def spoil(ref_T_body: np.ndarray) -> np.ndarray:
        gross = rng.random(len(ref_T_body)) < share
        swaps = np.stack([random_transform(rng, 0.2) if wrong else np.eye(4) for wrong in gross])
        return ref_T_body @ swaps

    spoilt = _with_motion(of_camera, spoil)
    aligned = stage_1(spoilt, np.random.default_rng(0))
    estimate, _ = stage_2(aligned.views, aligned.estimate, **STAGE_2)
    mm, deg = worst(errors_of(estimate.camera_T_ref, estimate.body_T_board, simulation).values())
    n_views = sum(guide.views.n_views for guide in of_camera.values())
    assert aligned.n_outlying > 0.6 * share * n_views
    assert mm < 2.0
    assert deg < 0.2


def test_stage_2_lowers_the_energy_that_the_sweep_left() -> None:
    of_camera = guides(synchronise(simulated(FIXED).recording))
    aligned = stage_1(of_camera, np.random.default_rng(0), method="paper")
    _, minimised = stage_2(aligned.views, aligned.estimate, **STAGE_2)
    sums = [alignment_sums(v.ref_T_body, v.pnp_camera_T_board, v.corner_moments) for v in aligned.views.values()]
    Y = np.stack(list(aligned.estimate.camera_T_ref.values()))[None]
    before = energy_m2(sums, Y, aligned.estimate.body_T_board[None])[0]
    assert minimised.errors[0] == pytest.approx(0.5 * before, rel=1e-6)
    assert minimised.errors[-1] < minimised.errors[0]
    assert minimised.converged


def test_the_seed_decides_the_sweep() -> None:
    of_camera = guides(synchronise(simulated(HEADSET).recording))
    runs = [stage_1(of_camera, np.random.default_rng(seed)).estimate.body_T_board for seed in (4, 4, 5)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0] - runs[2]).max() > 0.0
