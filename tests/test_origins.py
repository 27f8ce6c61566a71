"""The law of origins: where world, bodies and board have their origins and axes changes nothing but the numbers."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.estimation.observations import Observations, synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.results.calibration import Calibration
from gtcal.simulation.transforms import random_transform

FIXED, STANDING = "pinholes and fisheyes fixed", "headset, AprilGrid stands"
LARGEST_M = 20.0


class Moved:
    """New frames, seen from the old ones."""

    def __init__(self, seed: int, *, ref: bool = True, body: bool = True, board: bool = True) -> None:
        rng = np.random.default_rng(seed)
        self.ref, self.body, self.board = (
            random_transform(rng, rng.uniform(0.1, LARGEST_M)) if moves else np.eye(4) for moves in (ref, body, board)
        )

    def observations(self, of: Observations) -> Observations:
        views = {
            name: replace(
                v,
                ref_T_body=inverse(self.ref) @ v.ref_T_body @ self.body,
                corners_m=(v.corners_m - self.board[:3, 3]) @ self.board[:3, :3],
            )
            for name, v in of.views.items()
        }
        return replace(of, views=views)

    def pairs(self, before: Calibration, after: Calibration) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """For every Y_c and X: by how many of its sigmas it moved, and its covariance before and after, carried
        back."""
        found = [(before.body_T_board, after.body_T_board, self.body, self.board)]
        for name, camera in before.cameras.items():
            found.append((camera.camera_T_ref, after.cameras[name].camera_T_ref, np.eye(4), self.ref))
        pairs = []
        for old, new, left, right in found:
            carried = left @ new.a_T_b @ inverse(right)
            xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(old.a_T_b) @ carried))
            adjoint = gtsam.Pose3(right).AdjointMap()
            pairs.append((xi, old.covariance, adjoint @ new.covariance @ adjoint.T))
        return pairs


def check(before: Calibration, after: Calibration, moved: Moved, tolerance: float) -> None:
    for xi, covariance, carried in moved.pairs(before, after):
        assert np.sqrt(xi @ np.linalg.solve(covariance, xi)) < tolerance
        sigmas = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(
            carried / np.outer(sigmas, sigmas), covariance / np.outer(sigmas, sigmas), atol=tolerance
        )
    assert after.covariance_kind == before.covariance_kind
    assert after.dropped == before.dropped
    for stage_before, stage_after in zip(before.stages, after.stages, strict=True):
        assert stage_after.median_px == pytest.approx(stage_before.median_px, rel=tolerance)


@pytest.mark.parametrize("kind", [HEADSET, STANDING, FIXED])
def test_the_papers_stages_do_not_depend_on_origins_and_axes(kind: str) -> None:
    observations = synchronise(simulated(kind, frames=20).recording)
    options = CalibrationOptions(intrinsics="exact", mocap="exact")
    before = calibrate_observations(observations, options)
    for seed in range(2):
        moved = Moved(seed)
        after = calibrate_observations(moved.observations(observations), options)
        check(before, after, moved, 1e-5)
        assert after.warnings == before.warnings


@pytest.mark.parametrize("stages", [(1,), (1, 2), (2, 3)])
def test_each_stage_keeps_the_law(stages: tuple[int, ...]) -> None:
    observations = synchronise(simulated(FIXED, frames=20).recording)
    before, after = (
        calibrate_observations(o, CalibrationOptions(intrinsics="exact", mocap="exact", stages=stages))
        for o in (observations, Moved(1, body=stages[0] == 1).observations(observations))
    )
    moved = Moved(1, body=stages[0] == 1)
    for name, camera in before.cameras.items():
        carried = after.cameras[name].camera_T_ref.a_T_b @ inverse(moved.ref)
        np.testing.assert_allclose(carried, camera.camera_T_ref.a_T_b, atol=1e-9)


@pytest.mark.parametrize("options", [CalibrationOptions(board="exact"), CalibrationOptions(intrinsics="refine")])
def test_with_the_mocaps_noise_modelled_world_and_board_may_be_anywhere(options: CalibrationOptions) -> None:
    """A body's origin is where its noise sits, and so part of what is stated. The noise's own sigmas are found by a
    search that stops within a thousandth of a unit of likelihood, so that this is no exact law. A board's shape is one
    along its own axes, and moves with them."""
    observations = synchronise(simulated(FIXED, frames=20).recording)
    before = calibrate_observations(observations, options)
    for seed in range(1):
        moved = Moved(seed, body=False)
        check(before, calibrate_observations(moved.observations(observations), options), moved, 0.02)
