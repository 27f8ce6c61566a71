"""Gross views and corners are told from noise, and told from each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_support import HEADSET, NO_MOCAP_NOISE, simulated, true_ref_T_body
from scipy.spatial.transform import Rotation

from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views, synchronise
from gtcal.estimation.residuals import chain_residuals_px, median_by_view, select_corners, select_views
from gtcal.estimation.screening import FLOOR_PX, Screened, keep_all, screen
from gtcal.simulation import CornerNoise, Simulation
from gtcal.simulation.transforms import transform


def at_the_truth(simulation: Simulation) -> Estimate:
    truth = simulation.truth
    return Estimate(truth.body_T_board, truth.camera_T_ref, truth.intrinsics)


def front(simulation: Simulation) -> dict[str, Views]:
    return {"front_left": synchronise(simulation.recording).views["front_left"]}


def moved(views: Views, index: list[int], turn_deg: float) -> Views:
    """The views with wrong mocap poses at ``index``."""
    ref_T_body = views.ref_T_body.copy()
    wrong = transform(Rotation.from_rotvec([0.0, turn_deg, 0.0], degrees=True), np.array([0.02, 0.0, 0.0]))
    ref_T_body[index] = ref_T_body[index] @ wrong
    return replace(views, ref_T_body=ref_T_body)


def names_kept(screened: Screened) -> tuple[np.ndarray, np.ndarray]:
    return screened.keep_view["front_left"], screened.keep_corner["front_left"]


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_no_outlier(seed: int) -> None:
    """Five recordings with usual noise: of all their corners not one in ten thousand is left out."""
    simulation = simulated(HEADSET, seed=seed)
    views = synchronise(simulation.recording).views
    screened = screen(views, at_the_truth(simulation))
    dropped = sum((~keep).sum() for keep in screened.keep_corner.values())
    assert all(keep.all() for keep in screened.keep_view.values())
    assert dropped <= 1e-4 * sum(of_camera.n_corners for of_camera in views.values())


def test_views_that_the_mocap_puts_elsewhere_are_left_out_whole() -> None:
    simulation = simulated(HEADSET)
    gross = [3, 7, 20]
    views = {"front_left": moved(front(simulation)["front_left"], gross, 20.0)}
    screened = screen(views, at_the_truth(simulation))
    keep_view, keep_corner = names_kept(screened)
    assert np.flatnonzero(~keep_view).tolist() == gross
    np.testing.assert_array_equal(keep_corner, keep_view[views["front_left"].view_of_corner])
    (dropped,) = screened.dropped(views)
    assert dropped.n_views == 3
    assert dropped.n_corners == np.diff(views["front_left"].view_start)[gross].sum()
    assert "gross view" in dropped.reason


def test_a_view_is_gross_where_it_is_off_several_times_more_than_usual() -> None:
    simulation = simulated(HEADSET)
    views = front(simulation)
    of_camera = views["front_left"]
    residuals = np.hypot(*chain_residuals_px(of_camera, at_the_truth(simulation)).T)
    usual_px = float(np.median(median_by_view(of_camera, residuals)))
    pixels = of_camera.corners_px.copy()
    for view, times in ((4, 3.0), (8, 12.0)):
        pixels[of_camera.view_of_corner == view] += [times * usual_px, 0.0]
    views["front_left"] = replace(of_camera, corners_px=pixels)
    keep_view, _ = names_kept(screen(views, at_the_truth(simulation)))
    assert np.flatnonzero(~keep_view).tolist() == [8]


def test_single_wrong_corners_are_left_out_and_their_view_stays() -> None:
    simulation = simulated(HEADSET)
    views = front(simulation)
    rows = np.array([5, 130, 131, 900])
    pixels = views["front_left"].corners_px.copy()
    pixels[rows] += [12.0, -9.0]
    views["front_left"] = replace(views["front_left"], corners_px=pixels)
    keep_view, keep_corner = names_kept(screen(views, at_the_truth(simulation)))
    assert keep_view.all()
    assert np.flatnonzero(~keep_corner).tolist() == rows.tolist()


def test_a_wrong_corner_is_seen_also_in_a_view_that_mocap_noise_shifts() -> None:
    """Views off by 1 to 2 px each are noise, corners 4 px off their view are not."""
    simulation = simulated(HEADSET)
    views = front(simulation)
    of_camera = views["front_left"]
    rng = np.random.default_rng(0)
    pixels = of_camera.corners_px + rng.normal(0.0, 1.5, (of_camera.n_views, 2))[of_camera.view_of_corner]
    pixels[::50] += [0.0, 4.0]
    views["front_left"] = replace(of_camera, corners_px=pixels)
    keep_view, keep_corner = names_kept(screen(views, at_the_truth(simulation)))
    in_kept_view = keep_view[of_camera.view_of_corner]
    wrong = np.arange(of_camera.n_corners) % 50 == 0
    assert keep_view.mean() > 0.95
    assert not keep_corner[wrong].any()
    assert keep_corner[~wrong & in_kept_view].mean() > 0.999


def test_at_least_half_of_the_views_stay() -> None:
    """A wrong estimate condemns no camera: its gate is relative to its own views."""
    simulation = simulated(HEADSET)
    views = front(simulation)
    n = views["front_left"].n_views
    for n_gross in (n // 2, n):
        wrong = {"front_left": moved(views["front_left"], list(range(n_gross)), 15.0)}
        keep_view, _ = names_kept(screen(wrong, at_the_truth(simulation)))
        assert keep_view.sum() >= n / 2


def test_in_data_without_noise_nothing_is_an_outlier() -> None:
    """Residuals of a ten-thousandth of a pixel are not screened against their own median."""
    simulation = simulated(HEADSET, corners=CornerNoise(pixel_px=0.0), mocap=NO_MOCAP_NOISE)
    views = front(simulation)
    exact = replace(views["front_left"], ref_T_body=true_ref_T_body(simulation, views["front_left"]))
    pixels = exact.corners_px.copy()
    pixels[::7] += 0.5 * FLOOR_PX
    views = {"front_left": replace(exact, corners_px=pixels)}
    keep_view, keep_corner = names_kept(screen(views, at_the_truth(simulation)))
    assert keep_view.all()
    assert keep_corner.all()


def test_a_corner_without_a_pixel_goes_alone() -> None:
    """It says nothing about the other corners of its view."""
    simulation = simulated(HEADSET)
    views = front(simulation)
    of_camera = views["front_left"]
    corners_m = of_camera.corners_m.copy()
    rows = np.concatenate([of_camera.view_start[v] + np.array([1, 4, 6]) for v in (2, 5, 9)])
    corners_m[rows] += [0.0, 0.0, 50.0]  # behind the camera
    views["front_left"] = replace(of_camera, corners_m=corners_m)
    assert np.isnan(chain_residuals_px(views["front_left"], at_the_truth(simulation))[rows]).all()
    keep_view, keep_corner = names_kept(screen(views, at_the_truth(simulation)))
    assert keep_view.all()
    assert np.flatnonzero(~keep_corner).tolist() == rows.tolist()


def test_lengths_are_those_of_the_corners_that_stay() -> None:
    simulation = simulated(HEADSET, corners=CornerNoise(wrong_corner_share=0.05))
    views = synchronise(simulation.recording).views
    screened = screen(views, at_the_truth(simulation))
    for name, of_camera in screened.views.items():
        residuals = chain_residuals_px(of_camera, at_the_truth(simulation))
        np.testing.assert_allclose(screened.lengths_px[name], np.hypot(*residuals.T))
        assert screened.keep_corner[name].sum() == of_camera.n_corners


def test_without_screening_all_stays() -> None:
    simulation = simulated(HEADSET, corners=CornerNoise(wrong_corner_share=0.05))
    views = synchronise(simulation.recording).views
    kept = keep_all(views, at_the_truth(simulation))
    assert kept.dropped(views) == ()
    assert all(kept.views[name].n_corners == of_camera.n_corners for name, of_camera in views.items())


# Views picked apart


def test_median_by_view_is_the_median_of_each_view() -> None:
    views = front(simulated(HEADSET))["front_left"]
    values = np.random.default_rng(0).normal(size=views.n_corners)
    expected = [np.median(part) for part in np.split(values, views.view_start[1:-1])]
    np.testing.assert_allclose(median_by_view(views, values), expected, rtol=1e-15)


def test_in_a_median_by_view_nan_ranks_above_all_numbers() -> None:
    views = front(simulated(HEADSET))["front_left"]
    rng = np.random.default_rng(0)
    values = rng.normal(size=views.n_corners)
    values[rng.random(views.n_corners) < 0.2] = np.nan
    ranked = np.where(np.isnan(values), np.inf, values)
    expected = [np.median(part) for part in np.split(ranked, views.view_start[1:-1])]
    np.testing.assert_allclose(median_by_view(views, values), expected, rtol=1e-15)


def test_selected_views_hold_their_own_corners() -> None:
    views = front(simulated(HEADSET))["front_left"]
    chosen = select_views(views, np.array([9, 2, 4]))
    for place, index in enumerate([9, 2, 4]):
        here = slice(chosen.view_start[place], chosen.view_start[place + 1])
        there = slice(views.view_start[index], views.view_start[index + 1])
        for field in ("corner_ids", "corners_m", "corners_px"):
            np.testing.assert_array_equal(getattr(chosen, field)[here], getattr(views, field)[there])
        assert chosen.stamps_ns[place] == views.stamps_ns[index]
        np.testing.assert_array_equal(chosen.ref_T_body[place], views.ref_T_body[index])


def test_selecting_corners_drops_the_views_that_lose_all() -> None:
    views = front(simulated(HEADSET))["front_left"]
    of_view_3 = views.view_of_corner == 3
    without = select_corners(views, ~of_view_3)
    assert without.n_views == views.n_views - 1
    np.testing.assert_array_equal(without.corners_px, views.corners_px[~of_view_3])
    assert views.stamps_ns[3] not in without.stamps_ns
    trimmed = select_corners(views, np.arange(views.n_corners) != views.view_start[3])
    assert trimmed.n_views == views.n_views
    assert np.diff(trimmed.view_start)[3] == np.diff(views.view_start)[3] - 1
