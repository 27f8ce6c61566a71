"""Hand-eye calibration from poses alone: true sigmas, gross views, drifting poses, and directions that stay open."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from factors_support import numeric_derivative

from factors.rigid import inverse
from gtcal import GtcalError, calibrate_poses
from gtcal.estimation.pose_level import AbsolutePoses, PoseLevel, PoseSteps, _settled


def random_pose(random: np.random.Generator, turn: float, shift_m: float) -> np.ndarray:
    xi = random.normal(size=6) * np.repeat([turn, shift_m], 3)
    return np.asarray(gtsam.Pose3.Expmap(xi).matrix())


def moved(pose: np.ndarray, xi: np.ndarray) -> np.ndarray:
    return np.asarray(pose @ gtsam.Pose3.Expmap(xi).matrix())


class Arm:
    """An eye in hand before a board: the truth, and poses with noise."""

    def __init__(self, seed: int, n: int, *, turn: float = 0.5) -> None:
        self.random = random = np.random.default_rng(seed)
        self.Y, self.X = random_pose(random, 1.0, 0.1), random_pose(random, 1.0, 1.0)
        away = np.eye(4)
        away[2, 3] = 0.6
        self.camera_T_board = np.stack([random_pose(random, turn, 0.15) @ away for _ in range(n)])
        self.ref_T_body = inverse(self.Y) @ self.camera_T_board @ inverse(self.X)

    def measured(self, rotation_rad: float, shift_m: tuple[float, float, float]) -> np.ndarray:
        """As the noise is modelled: about the board's axes, and along the camera's."""
        seen = self.camera_T_board.copy()
        for pose in seen:
            pose[:3, :3] = moved(pose, np.r_[self.random.normal(size=3) * rotation_rad, np.zeros(3)])[:3, :3]
            pose[:3, 3] += self.random.normal(size=3) * shift_m
        return seen

    def nees(self, found: PoseLevel) -> float:
        """Per degree of freedom, of both poses together."""
        xi = np.concatenate(
            [
                gtsam.Pose3.Logmap(gtsam.Pose3(inverse(of) @ to))
                for of, to in ((found.camera_T_ref, self.Y), (found.body_T_board, self.X))
            ]
        )
        return float(xi @ np.linalg.solve(found.covariance, xi)) / 12.0

    def error_in_camera_mm(self, found: PoseLevel) -> np.ndarray:
        """Of the camera's place, along its axes."""
        return 1e3 * np.asarray(self.Y[:3, :3] @ (inverse(found.camera_T_ref)[:3, 3] - inverse(self.Y)[:3, 3]))

    def error_mm(self, found: PoseLevel) -> float:
        return float(np.linalg.norm(self.error_in_camera_mm(found)))


NOISE = (0.004, (0.001, 0.001, 0.004))


@pytest.mark.parametrize("model", [AbsolutePoses, PoseSteps])
def test_the_jacobians_are_numeric_ones(model: type[AbsolutePoses] | type[PoseSteps]) -> None:
    arm = Arm(0, 6)
    found = model(arm.ref_T_body, arm.measured(0.1, (0.1, 0.1, 0.1)))
    Y, X = random_pose(arm.random, 1.0, 1.0), random_pose(arm.random, 1.0, 1.0)
    _, J = found.residuals(Y, X)

    def residuals(xi: np.ndarray) -> np.ndarray:
        return found.residuals(moved(Y, xi[:6]), moved(X, xi[6:]))[0].ravel()

    np.testing.assert_allclose(J.reshape(-1, 12), numeric_derivative(residuals, np.zeros(12), 1e-6), atol=1e-7)


@pytest.mark.long
def test_the_covariance_is_true() -> None:
    arms = [Arm(seed, 40) for seed in range(16)]
    nees = [arm.nees(calibrate_poses(arm.ref_T_body, arm.measured(*NOISE))) for arm in arms]
    assert 0.7 < np.mean(nees) < 1.5


@pytest.mark.long
def test_noise_that_differs_by_direction_is_weighed_so() -> None:
    """Against equal weights: as all of it were noise alike in all directions."""
    arms = [Arm(seed, 60) for seed in range(8)]
    found = [calibrate_poses(arm.ref_T_body, arm.measured(0.001, (0.0003, 0.0003, 0.01))) for arm in arms]
    sigmas = np.mean([np.sqrt(np.diag(one.noise.covariance)) for one in found], axis=0)
    assert sigmas == pytest.approx([0.001] * 3 + [0.0003, 0.0003, 0.01], rel=0.25)
    lateral_mm = [np.linalg.norm(arm.error_in_camera_mm(one)[:2]) for arm, one in zip(arms, found, strict=True)]
    assert np.mean(lateral_mm) < 0.5  # along the camera's axis it is 10 mm / sqrt(60)


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_gross_views_do_not_decide(share: float) -> None:
    arm = Arm(3, 60)
    seen = arm.measured(*NOISE)
    gross = arm.random.permutation(60)[: round(60 * share)]
    seen[gross] = np.stack([random_pose(arm.random, 0.5, 0.4) @ pose for pose in seen[gross]])
    found = calibrate_poses(arm.ref_T_body, seen)
    assert arm.error_mm(found) < 3.0
    assert found.weights[gross].max() < 0.2 * np.median(np.delete(found.weights, gross))


@pytest.mark.long
def test_poses_that_drift_are_taken_by_their_steps() -> None:
    """As of a visual odometry: each step is measured, and their errors add up."""
    arm = Arm(4, 200)
    true_steps = arm.camera_T_board[:-1] @ inverse(arm.camera_T_board[1:])
    seen = [arm.camera_T_board[0]]
    for step in true_steps:
        seen.append(inverse(moved(step, arm.random.normal(size=6) * 0.001)) @ seen[-1])
    drifted = np.stack(seen)
    found = calibrate_poses(arm.ref_T_body, drifted)
    assert found.noise.drifts
    as_absolute = _settled(AbsolutePoses(arm.ref_T_body, drifted), (arm.Y, arm.X))
    assert arm.error_mm(found) < 0.5 * arm.error_mm(as_absolute)
    assert not calibrate_poses(arm.ref_T_body, arm.measured(*NOISE)).noise.drifts


@pytest.mark.parametrize("spoil", [np.nan, 1e3, -1.0])
def test_what_is_no_pose_is_named(spoil: float) -> None:
    arm = Arm(5, 20)
    wrong = arm.camera_T_board.copy()
    wrong[7, :3, :3] *= spoil
    with pytest.raises(GtcalError, match="camera_T_board: pose 7 is no rotation and translation"):
        calibrate_poses(arm.ref_T_body, wrong)


def test_what_stays_open_is_refused_in_a_line() -> None:
    arm = Arm(5, 20)
    with pytest.raises(GtcalError, match="3 or more of each"):
        calibrate_poses(arm.ref_T_body[:2], arm.camera_T_board[:2])
    with pytest.raises(GtcalError, match="in pairs"):
        calibrate_poses(arm.ref_T_body, arm.camera_T_board[:9])
