"""One's own factor added to a calibration's graph."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from example_own_factor import distance_factor
from factors_support import derivative_to, poses
from guide_support import block
from scipy.spatial.transform import Rotation

from gtcal import (
    CalibrationOptions,
    GtcalError,
    calibrate_observations,
    read_calibration,
    synchronise,
    write_calibration,
    write_recording,
)
from gtcal.estimation.solve_again import board_key, camera_key, intrinsics_key, solve_again
from gtcal.results.covariance import ERRORS_IN_VARIABLES, NAIVE
from gtcal.simulation import MocapNoise


@pytest.fixture(scope="module", name="found")
def _found():
    simulation = simulated(HEADSET, frames=30, mocap=MocapNoise(0.3, 0.03))
    return calibrate_observations(synchronise(simulation.recording), CalibrationOptions(intrinsics="exact"))


def test_the_examples_jacobians_equal_numeric_differentiation():
    values = gtsam.Values()
    for key, pose in enumerate(poses(np.random.default_rng(0), 2, 2.0, 0.5)):
        values.insert(key, gtsam.Pose3(pose))
    factor = distance_factor(0, 1, 0.1, 1.0)
    jacobian, _ = factor.linearize(values).jacobian()
    numeric = [derivative_to(factor.unwhitenedError, values, key) for key in range(2)]
    np.testing.assert_allclose(jacobian, np.hstack(numeric), atol=1e-6)


def test_nothing_added_changes_nothing(found):
    again = solve_again(found, [])
    assert again.covariance_kind == ERRORS_IN_VARIABLES
    for name, camera in found.cameras.items():
        moved = np.abs(again.cameras[name].camera_T_ref.a_T_b - camera.camera_T_ref.a_T_b).max()
        assert moved < 0.1 * np.sqrt(np.diag(camera.camera_T_ref.covariance).min())
        np.testing.assert_allclose(again.covariance.matrix, found.covariance.matrix, rtol=0.01, atol=1e-12)


def test_a_distance_between_cameras_is_kept_and_makes_it_surer(found):
    keys = [camera_key(found, name) for name in ("front_left", "side_right")]
    again = solve_again(found, [distance_factor(*keys, 0.2, sigma_m=1e-7)])
    positions_m = [again.cameras[name].camera_T_ref.position_of_a_in_b_m for name in ("front_left", "side_right")]
    assert np.linalg.norm(positions_m[0] - positions_m[1]) == pytest.approx(0.2, abs=1e-5)
    assert (np.diag(again.covariance.matrix) <= np.diag(found.covariance.matrix) * 1.2).all()
    assert again.rmse_px > found.rmse_px
    assert set(again.covariances) == {again.covariance_kind}


def test_it_goes_on_from_stage_3_too():
    simulation = simulated(HEADSET, frames=30)
    options = CalibrationOptions(mocap="exact", intrinsics="refine")
    plain = calibrate_observations(synchronise(simulation.recording), options)
    prior = gtsam.PriorFactorPose3(
        board_key(), gtsam.Pose3(plain.body_T_board.a_T_b), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
    )
    again = solve_again(plain, [prior])
    assert again.covariance_kind == NAIVE
    assert np.sqrt(np.diag(again.body_T_board.covariance)).max() < 1.1e-6
    assert again.solution.values.exists(intrinsics_key(again, "side_left"))
    assert again.cameras["side_left"].theta_covariance.shape == (12, 12)


def test_what_cannot_be_gone_on_from_is_told(found, tmp_path):
    with pytest.raises(GtcalError, match="there is no camera 'left'; cameras: front_left"):
        camera_key(found, "left")
    write_calibration(tmp_path / "c.json", found)
    with pytest.raises(GtcalError, match="read from a file has no graph"):
        solve_again(read_calibration(tmp_path / "c.json"), [])


def test_the_guides_own_kernel_prior_and_factor(tmp_path, monkeypatch):
    simulation = simulated(HEADSET, frames=20, mocap=MocapNoise(0.3, 0.03))
    monkeypatch.chdir(tmp_path)
    write_recording(simulation.recording, "my_recording")
    true = simulation.truth.body_T_board
    off_along_z_m = 0.02 * true[:3, 2]  # of which nothing is known
    place = tuple((true[:3, 3] + off_along_z_m).tolist())
    of_this_one = {
        "cam0": "front_left",
        "(0.012, 0.0, 0.040)": str(place),
        "(1.0, 0.0, 0.0, 0.0)": str(tuple(np.roll(Rotation.from_matrix(true[:3, :3]).as_quat(), 1).tolist())),
        "(0.002, 0.002, None)": "(1e-5, 1e-5, None)",
    }
    blocks = [block(what, "python") for what in ("own kernel", "own prior", "own factor", "solve again")]
    for stated, ours in of_this_one.items():
        assert any(stated in each for each in blocks)
        blocks = [each.replace(stated, ours) for each in blocks]
    space: dict = {}
    for each in blocks:
        assert len([line for line in each.splitlines() if line]) <= 10
        exec(each, space)
    assert space["calibration"].provenance.options["robust"] == {"name": "Custom", "called_back": True}
    off_m = space["with_prior"].body_T_board.a_T_b[:3, 3] - true[:3, 3]
    assert (np.abs(true[:3, :3].T @ off_m) < (3e-5, 3e-5, 5e-3)).all()
    surer, before = (space[name].body_T_board.position_of_b_in_a_sigma_mm for name in ("with_prior", "calibration"))
    assert surer.min() < 0.5 * before.min()
    values = space["calibration"].solution.values
    jacobian = space["laser"].linearize(values).jacobian()[0]
    numeric = derivative_to(space["laser"].whitenedError, values, space["laser"].keys()[0])
    np.testing.assert_allclose(jacobian, numeric, atol=1e-4)
    height_m = space["again"].cameras["front_left"].camera_T_ref.position_of_a_in_b_m[2]
    assert height_m == pytest.approx(0.1, abs=3e-4)
    assert set(read_calibration(tmp_path / "with_laser.json").cameras) == set(space["again"].cameras)
