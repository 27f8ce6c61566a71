"""Sturm et al. (2012), as the paper describes it: X is measured by hand and held fixed; every camera_T_ref by least
squares on the pixels, then with a Huber kernel."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam

from factors import GAUSSIAN, RobustKernel
from gtcal.baselines.hand_eye import cameras_given_board
from gtcal.baselines.pose_pairs import PosePairs
from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import BODY_T_BOARD, minimise, reprojection_graph, to_values, updated
from gtcal.estimation.observations import Views

HUBER = RobustKernel.named("Huber")
_EPS, _MAX_ITERATIONS = 1e-6, 100


def sturm(
    views: Mapping[str, Views], pairs: Mapping[str, PosePairs], body_T_board: FloatArray, *, huber: bool
) -> Estimate:
    """The estimate with this X (4, 4)."""
    theta = {name: of_camera.camera.theta for name, of_camera in views.items()}
    estimate = _fitted(views, Estimate(body_T_board, cameras_given_board(body_T_board, pairs), theta), GAUSSIAN)
    return _fitted(views, estimate, HUBER) if huber else estimate


def _fitted(views: Mapping[str, Views], estimate: Estimate, kernel: RobustKernel) -> Estimate:
    graph = reprojection_graph(views, estimate, sigma_px=1.0, robust=kernel, intrinsics_priors=None)
    graph.add(gtsam.NonlinearEqualityPose3(BODY_T_BOARD, gtsam.Pose3(estimate.body_T_board)))
    found = minimise(graph, to_values(estimate, with_theta=False), eps=_EPS, max_iterations=_MAX_ITERATIONS)
    return updated(estimate, found.values)
