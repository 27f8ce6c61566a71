"""Going on from a calibration: one's own factors added to its graph, and all of it solved again."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import gtsam

from gtcal.errors import GtcalError
from gtcal.estimation.graph import BODY_T_BOARD, camera_T_ref_key, minimise, theta_key, updated
from gtcal.estimation.marginals import covariance_of, joint_information
from gtcal.estimation.residuals import chain_residuals_px, norms
from gtcal.results.calibration import Calibration, PoseEstimate, ResidualStatistics
from gtcal.results.covariance import CLUSTERED, NAIVE, JointCovariance


def camera_key(calibration: Calibration, camera: str) -> int:
    """GTSAM's key of a camera's camera_T_ref, a Pose3. Raises GtcalError for a camera that is not there."""
    return camera_T_ref_key(_index(calibration, camera))


def intrinsics_key(calibration: Calibration, camera: str) -> int:
    """GTSAM's key of a camera's intrinsics, a vector; a variable only where they were refined.

    Raises GtcalError for a camera that is not there."""
    return theta_key(_index(calibration, camera))


def board_key() -> int:
    """GTSAM's key of body_T_board, a Pose3."""
    return BODY_T_BOARD


def solve_again(
    calibration: Calibration, factors: Iterable[gtsam.NonlinearFactor], *, eps: float = 1e-6
) -> Calibration:
    """The calibration with these factors added to its graph, from where it ended. Its covariance is that of the graph:
    naive, or errors in variables where stage 4 was taken.

    Raises GtcalError for a calibration that was read from a file, which has no graph, or where a direction is open."""
    solution = calibration.solution
    if solution is None:
        raise GtcalError("a calibration that was read from a file has no graph to add factors to: calibrate again")
    graph = gtsam.NonlinearFactorGraph(solution.graph)
    for factor in factors:
        graph.add(factor)
    names = list(calibration.cameras)
    sizes = {
        name: solution.estimate.theta[name].size if solution.values.exists(theta_key(i)) else 0
        for i, name in enumerate(names)
    }
    unknowns = [BODY_T_BOARD, *map(camera_T_ref_key, range(len(names)))]
    unknowns += [theta_key(i) for i, name in enumerate(names) if sizes[name]]
    found = minimise(graph, solution.values, eps=eps, max_iterations=100)
    estimate = updated(solution.estimate, found.values)
    matrix = covariance_of(joint_information(graph, found.values, unknowns))
    if matrix is None:
        raise GtcalError("the graph leaves a direction open: do the added factors take as much as they give?")
    kind = NAIVE if calibration.covariance_kind == CLUSTERED else calibration.covariance_kind
    joint = JointCovariance(kind, sizes, solution.covariance_factor * matrix)
    cameras = {}
    for name, camera in calibration.cameras.items():
        views = solution.views[name]
        cameras[name] = replace(
            camera,
            camera=replace(camera.camera, parameters=estimate.theta[name]),
            camera_T_ref=PoseEstimate(estimate.camera_T_ref[name], joint.camera_T_ref(name)),
            theta_covariance=joint.theta(name),
            residuals=ResidualStatistics.of(norms(chain_residuals_px(views, estimate)), views.n_views),
        )
    stage = 4 if calibration.mocap_noise is not None and calibration.mocap_noise.stage == 4 else 3
    return replace(
        calibration,
        cameras=cameras,
        body_T_board=PoseEstimate(estimate.body_T_board, joint.body_T_board),
        covariance_kind=kind,
        covariances={kind: joint},
        estimates={stage: estimate},
        solution=replace(solution, graph=graph, values=found.values, estimate=estimate),
    )


def _index(calibration: Calibration, camera: str) -> int:
    names = list(calibration.cameras)
    if camera not in names:
        raise GtcalError(f"there is no camera {camera!r}; cameras: {', '.join(names)}")
    return names.index(camera)
