"""The edge of the lens's field: what tells nothing there is left out, and the rest is no wall to an optimiser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import study_optimum
from rich.console import Console

from gtcal.estimation.field_edge import AT_EDGE, LEAST_SLOPE, without_edge
from gtcal.estimation.observations import Observations


@pytest.fixture(scope="module", name="recorded")
def _recorded() -> tuple[study_optimum.Simulation, Observations]:
    return study_optimum.recorded()


def rim_px(observations: Observations, name: str, share: float, n: int = 12) -> np.ndarray:
    """Pixels all round the axis at that share of the radius at which the lens's field ends."""
    camera = observations.views[name].camera
    limit = camera.model.max_angle_rad(camera.theta)
    azimuth = np.linspace(0.0, 2 * np.pi, n, endpoint=False)
    angle = np.full(n, 0.999999 * limit)
    bearings = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
    pixels, valid = camera.model.project(bearings, camera.theta)
    assert valid.all()
    return camera.theta[2:4] + share * (pixels - camera.theta[2:4])


@pytest.mark.parametrize(("share", "n_left_out"), [(0.97, 0), (0.9999, 12), (1.01, 12)])
def test_what_lies_where_the_lens_tells_nothing_is_left_out(recorded, share: float, n_left_out: int) -> None:
    _, observations = recorded
    name, views = next(iter(observations.views.items()))
    corners_px = views.corners_px.copy()
    corners_px[:12] = rim_px(observations, name, share)
    moved = replace(observations, views=observations.views | {name: replace(views, corners_px=corners_px)})
    left = without_edge(moved)
    assert views.n_corners - left.views[name].n_corners == n_left_out
    counted = {d.camera: d.n_corners for d in left.dropped if d.reason == AT_EDGE}
    before = {d.camera: d.n_corners for d in observations.dropped if d.reason == AT_EDGE}
    assert counted.get(name, 0) - before.get(name, 0) == n_left_out
    for of_camera in left.views.values():
        bearings, found = of_camera.camera.unproject(of_camera.corners_px)
        assert found.all()
        assert (of_camera.camera.model.radial_slopes(bearings, of_camera.camera.theta) > LEAST_SLOPE).all()


def test_a_lens_that_ends_where_the_corners_are_is_wrong_and_they_stay(recorded) -> None:
    _, observations = recorded
    name, views = next(iter(observations.views.items()))
    narrow = views.camera.theta.copy()
    narrow[4:10] = [-0.6, 0.0, 0.0, 0.0, 0.0, 0.0]  # ends at 43 deg
    with_narrow = replace(views, camera=replace(views.camera, parameters=narrow))
    left = without_edge(replace(observations, views=observations.views | {name: with_narrow}))
    assert left.views[name] is with_narrow


@pytest.mark.long
@pytest.mark.parametrize("intrinsics", ["exact", "refine"])
def test_from_many_starts_one_optimum(recorded, intrinsics: str) -> None:
    simulation, observations = recorded
    truth = study_optimum.truth_of(simulation, observations)
    for stage, runs in ((study_optimum.stage_3, 20), (study_optimum.stage_4, 4)):
        run = stage(observations, truth, intrinsics)
        excess, iterations, outside = study_optimum.study(run, truth, observations, runs, Console(quiet=True))
        assert (excess < study_optimum.SAME).all()
        assert iterations.max() <= 10
        assert outside.max() > 1e-3
