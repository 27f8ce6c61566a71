"""What is covered, and whether what is missing is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_support import simulated, true_camera_T_board
from scipy.spatial.transform import Rotation

from factors import KANNALA_BRANDT4
from gtcal import CalibrationOptions, GtcalError, calibrate_observations, synchronise
from gtcal.camera import Camera
from gtcal.recordings.capture import Capture
from gtcal.simulation.transforms import transform
from gtcal.uncertainty.coverage import coverage, image_coverage, turn_coverage

WIDTH, HEIGHT = 1280, 1024
NARROW = Camera("cam", KANNALA_BRANDT4, np.array([700.0, 700.0, 640.0, 512.0, 0, 0, 0, 0]), WIDTH, HEIGHT)
ROUND = replace(NARROW, parameters=np.array([200.0, 200.0, 640.0, 512.0, 0, 0, 0, 0]))
"""Its field of 180 deg is a circle of 628 px: the image's corners see nothing."""


def corners(*boxes: tuple[float, float, float, float], n: int = 20_000) -> np.ndarray:
    """Spread over boxes (left, top, right, bottom), in shares of the image."""
    rng = np.random.default_rng(0)
    size = np.array([WIDTH, HEIGHT])
    parts = [rng.uniform(np.array(box[:2]) * size, np.array(box[2:]) * size, (n, 2)) for box in boxes]
    return np.concatenate(parts) - 0.5


ALL = (0.0, 0.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("boxes", "missing"),
    [
        ([ALL], []),
        ([(0.0, 0.0, 0.5, 1.0)], ["no detections in the right half of the image"]),
        ([(0.0, 0.0, 1.0, 0.5)], ["no detections in the lower half of the image"]),
        ([(0.0, 0.0, 1.0, 0.5), (0.5, 0.5, 1.0, 1.0)], ["no detections in the lower left quarter of the image"]),
        (
            [(0.0, 0.0, 0.5, 0.5)],
            ["no detections in the lower half of the image", "no detections in the right half of the image"],
        ),
        ([(0.2, 0.0, 1.0, 1.0)], ["no detections in the left border of the image"]),
        (
            [(0.0, 0.2, 0.8, 1.0)],
            ["no detections in the upper border of the image", "no detections in the right border of the image"],
        ),
        ([(0.2, 0.0, 1.0, 1.0), (0.0, 0.2, 0.2, 1.0)], ["no detections in the upper left corner of the image"]),
        (
            [(0.0, 0.0, 1.0, 0.25), (0.0, 0.75, 1.0, 1.0), (0.0, 0.0, 0.25, 1.0), (0.75, 0.0, 1.0, 1.0)],
            ["no detections in the middle of the image"],
        ),
    ],
)
def test_what_is_missing_of_an_image_is_named(boxes: list, missing: list[str]) -> None:
    assert list(image_coverage(NARROW, corners(*boxes)).missing) == missing


def test_a_few_corners_are_hardly_any() -> None:
    few = np.concatenate([corners((0.0, 0.0, 0.5, 1.0)), [[1000.0, 500.0], [800.0, 900.0]]])
    assert image_coverage(NARROW, few).missing == ("hardly any detections in the right half of the image",)
    assert image_coverage(NARROW, np.empty((0, 2))).missing == ("no detections in the image",)


def test_the_share_is_of_what_the_lens_can_see() -> None:
    x, y = np.meshgrid(np.arange(0, WIDTH, 8.0), np.arange(0, HEIGHT, 8.0))
    in_circle = np.hypot(x - 640, y - 512) < 620
    found = image_coverage(ROUND, np.stack([x[in_circle], y[in_circle]], axis=1))
    assert not found.visible.all()
    assert found.share == 1.0
    assert found.missing == ()
    assert image_coverage(NARROW, np.stack([x[in_circle], y[in_circle]], axis=1)).share < 0.99


def test_counts_stand_where_the_corners_were() -> None:
    counts = image_coverage(NARROW, np.array([[-0.5, -0.5], [1279.4, 1023.4], [1279.4, 1023.0]])).counts
    assert counts.shape == (16, 20)
    assert (counts[0, 0], counts[-1, -1], counts.sum()) == (1, 2, 3)
    assert image_coverage(NARROW, corners(ALL), across=8, down=6).counts.shape == (6, 8)


def turned(*sigmas_deg: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    return transform(Rotation.from_rotvec(np.deg2rad(sigmas_deg) * rng.standard_normal((2000, 3))), np.zeros((2000, 3)))


def test_missing_turns_are_named_with_the_axis_to_turn_about() -> None:
    assert turn_coverage([turned(30, 20, 1)], Capture.FIXED_CAMERAS).missing == ()
    (line,) = turn_coverage([turned(1, 30, 4)], Capture.FIXED_CAMERAS).missing
    assert line.startswith("the board turned about the body's y axis (29 deg rms) and hardly about any other (4.0 deg)")
    assert line.endswith("turn it about the body's z axis too, by 20 deg or more")
    (line,) = turn_coverage([turned(1, 3, 1)], Capture.STANDING_BOARD).missing
    assert line.startswith("the rig hardly turned (2.9 deg rms)")


def test_a_simulated_recording_is_covered_as_the_truth_has_it() -> None:
    simulation = simulated("pinholes and fisheyes fixed")
    calibration = calibrate_observations(synchronise(simulation.recording), CalibrationOptions(mocap="exact"))
    found = coverage(calibration)
    assert found.turns.missing == ()
    assert (found.turns.rms_deg[:2] > 8.0).all()
    for name, views in calibration.solution.views.items():
        T = true_camera_T_board(simulation, views)[views.view_of_corner]
        true_m = np.linalg.norm(np.einsum("nij,nj->ni", T[:, :3, :3], views.corners_m) + T[:, :3, 3], axis=1)
        distances = found.distances[name]
        assert distances.median_m == pytest.approx(np.median(true_m), abs=2e-3)
        assert distances.nearest_m == pytest.approx(true_m.min(), abs=2e-3)
        assert distances.near_m < distances.median_m < distances.far_m < distances.farthest_m
        assert found.images[name].counts.sum() == views.n_corners
    with pytest.raises(GtcalError, match="keeps no views"):
        coverage(replace(calibration, solution=None))


def test_one_distance_is_named() -> None:
    simulation = simulated("pinholes and fisheyes fixed")
    found = coverage(calibrate_observations(synchronise(simulation.recording), CalibrationOptions(mocap="exact")))
    one = replace(found.distances["cam0"], near_m=0.95, median_m=1.0, far_m=1.1)
    lines = replace(found, distances={"cam0": one}).missing
    assert "camera 'cam0': the board was always about 1 m away: show it from half and from twice that too" in lines
