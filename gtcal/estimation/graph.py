"""The factor graphs of stages 2 and 3, their variables, and the loop that minimises them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from factors import (
    AnyKernel,
    FusedReprojectionFactor,
    PointAlignmentFactor,
    factory_intrinsics_prior,
    weak_intrinsics_prior,
)
from factors.board_shape import FLAT
from gtcal.camera import Camera, FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import corner_views

BODY_T_BOARD: int = gtsam.symbol("x", 0)
"""Key of X."""


BOARD_SHAPE: int = gtsam.symbol("s", 0)
"""Key of the board's shape, where it is a variable."""


def camera_T_ref_key(camera_index: int) -> int:
    """Key of Y_c, cameras counted in the order of the recording."""
    key: int = gtsam.symbol("y", camera_index)
    return key


def theta_key(camera_index: int) -> int:
    """Key of theta_c, the intrinsics."""
    key: int = gtsam.symbol("k", camera_index)
    return key


def to_values(estimate: Estimate, *, with_theta: bool, with_shape: bool = False) -> gtsam.Values:
    """The estimate as GTSAM's values; the intrinsics and the board's shape among them where they are variables."""
    values = gtsam.Values()
    values.insert(BODY_T_BOARD, gtsam.Pose3(estimate.body_T_board))
    for index, (name, pose) in enumerate(estimate.camera_T_ref.items()):
        values.insert(camera_T_ref_key(index), gtsam.Pose3(pose))
        if with_theta:
            values.insert(theta_key(index), estimate.theta[name])
    if with_shape:
        values.insert(BOARD_SHAPE, estimate.board_shape)
    return values


def updated(estimate: Estimate, values: gtsam.Values) -> Estimate:
    """The estimate with the variables that ``values`` holds."""
    camera_T_ref, theta = {}, {}
    for index, name in enumerate(estimate.camera_T_ref):
        camera_T_ref[name] = values.atPose3(camera_T_ref_key(index)).matrix()
        free = values.exists(theta_key(index))
        theta[name] = values.atVector(theta_key(index)) if free else estimate.theta[name]
    shape = values.atVector(BOARD_SHAPE) if values.exists(BOARD_SHAPE) else estimate.board_shape
    return Estimate(values.atPose3(BODY_T_BOARD).matrix(), camera_T_ref, theta, shape)


@dataclass(frozen=True)
class AlignmentViews:
    """What stage 2 knows of one camera: mocap and PnP poses and corner moments of its views, each (V, 4, 4)."""

    ref_T_body: FloatArray
    pnp_camera_T_board: FloatArray
    corner_moments: FloatArray


def alignment_graph(views: Mapping[str, AlignmentViews]) -> gtsam.NonlinearFactorGraph:
    """E_3D over all cameras, in m^2 (halved, as GTSAM counts)."""
    graph = gtsam.NonlinearFactorGraph()
    for index, of_camera in enumerate(views.values()):
        graph.add(
            PointAlignmentFactor(
                camera_T_ref_key(index),
                BODY_T_BOARD,
                ref_T_body=of_camera.ref_T_body,
                measured_camera_T_board=of_camera.pnp_camera_T_board,
                corner_moments=of_camera.corner_moments,
            )
        )
    return graph


@dataclass(frozen=True)
class IntrinsicsPrior:
    """What is known of the intrinsics beforehand. ``sigmas`` (K,) round the stated values, or None for the
    paper's weak prior (principal point to the image centre, distortion to zero, focal length free)."""

    sigmas: FloatArray | None = None

    def factor(self, key: int, camera: Camera) -> gtsam.NonlinearFactor:
        if self.sigmas is None:
            return weak_intrinsics_prior(key, camera.model, camera.image_width_px, camera.image_height_px)
        return factory_intrinsics_prior(key, camera.theta, self.sigmas)


def reprojection_graph(
    views: Mapping[str, Views],
    estimate: Estimate,
    *,
    sigma_px: float,
    robust: AnyKernel,
    intrinsics_priors: Mapping[str, IntrinsicsPrior] | None,
    shape_sigmas: FloatArray | None = None,
) -> gtsam.NonlinearFactorGraph:
    """One fused factor per camera; with ``intrinsics_priors`` by camera, the intrinsics are variables; with
    ``shape_sigmas`` (5,), the board's shape is one, near that of a flat board as stated."""
    graph = gtsam.NonlinearFactorGraph()
    for index, (name, of_camera) in enumerate(views.items()):
        graph.add(
            FusedReprojectionFactor(
                camera_T_ref_key(index),
                BODY_T_BOARD,
                views=corner_views(of_camera, sigma_px),
                model=of_camera.camera.model,
                ref_T_body=of_camera.ref_T_body,
                theta=theta_key(index) if intrinsics_priors is not None else estimate.theta[name],
                shape=BOARD_SHAPE if shape_sigmas is not None else estimate.board_shape,
                robust=robust,
            )
        )
        if intrinsics_priors is not None:
            graph.add(intrinsics_priors[name].factor(theta_key(index), of_camera.camera))
    if shape_sigmas is not None:
        graph.add(shape_prior(shape_sigmas))
    return graph


def shape_prior(sigmas: FloatArray) -> gtsam.NonlinearFactor:
    """That the board is flat and as stated, within sigmas (5,)."""
    return gtsam.PriorFactorVector(BOARD_SHAPE, FLAT, gtsam.noiseModel.Diagonal.Sigmas(sigmas))


_LARGEST_DAMPING = 1e9

_MOST_LAST_STEPS, _LEAST_PROMISE, _ROUNDING = 4, 1e-16, 1e-12
"""A step that promises less than this share of the error is far below a millionth of a sigma."""

_SURE_PROMISE, _SURE_LENGTH = 1e-6, 1e-3
"""A step that promises less than this share of the error, and moves no pose by more (rad, m), is taken unseen: the
error is a parabola there."""


@dataclass(frozen=True)
class Minimisation:
    """Where the minimisation ended, and the graph's error at its start and after each iteration."""

    values: gtsam.Values
    errors: tuple[float, ...]
    converged: bool

    @property
    def iterations(self) -> int:
        return len(self.errors) - 1


def minimise(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *, eps: float, max_iterations: int, finish: bool = True
) -> Minimisation:
    """Levenberg-Marquardt until an iteration improves the error E by less than eps (1 + E), then, with ``finish``,
    undamped steps to the optimum itself (``finished``).

    Damped by the Hessian's diagonal: rad, m, px and distortion coefficients stand side by side in one graph."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setDiagonalDamping(True)
    parameters.setlambdaUpperBound(_LARGEST_DAMPING)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    errors, converged = [optimizer.error()], False
    while len(errors) <= max_iterations and not converged:
        optimizer.iterate()
        errors.append(optimizer.error())
        converged = not errors[-2] - errors[-1] >= eps * (1.0 + errors[-1])
    found, converged = optimizer.values(), converged and bool(np.isfinite(errors[-1]))
    if converged and finish:
        found, errors[-1] = finished(graph, found, errors[-1])
    return Minimisation(found, tuple(errors), converged)


@dataclass(frozen=True)
class _Step:
    """A Gauss-Newton step: by how much it promises to lower the error, and the error before it as the linearised graph
    has it (that of weighted squares, where a kernel is robust)."""

    step: gtsam.VectorValues
    moved: gtsam.Values
    promised: float
    error: float

    @property
    def length(self) -> float:
        """By how many rad or m it moves a pose of stages 2 and 3 at most."""
        poses = [key for key in self.moved.keys() if chr(gtsam.Symbol(key).chr()) in "xy"]  # noqa: SIM118
        return max(float(np.abs(self.step.at(key)).max()) for key in poses)


def _gauss_newton_step(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> _Step | None:
    """None where a direction is open."""
    linear = graph.linearize(values)
    try:
        step = linear.optimize()
    except RuntimeError:
        return None
    promised = -0.5 * linear.gradientAtZero().dot(step)
    return _Step(step, values.retract(step), promised, linear.error(gtsam.VectorValues.Zero(step)))


def optimum_nearby(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values | None:
    """The optimum, where values are so near to it that one step leads there; None elsewhere."""
    step = _gauss_newton_step(graph, values)
    if step is None or not step.promised <= _SURE_PROMISE * step.error or not step.length <= _SURE_LENGTH:
        return None
    return step.moved


def finished(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, error: float) -> tuple[gtsam.Values, float]:
    """Values near an optimum, of this error, and their error, after Gauss-Newton steps while these promise a gain over
    rounding and keep it. Where Levenberg-Marquardt stops, its damping leaves a share of a sigma that depends on where
    the origins are; these steps are the same in any frame."""
    for _ in range(_MOST_LAST_STEPS):
        step = _gauss_newton_step(graph, values)
        if step is None:
            break
        if step.promised <= _LEAST_PROMISE * error:
            break  # where the graph was linearised: its covariance is there
        moved_error = graph.error(step.moved)
        if not moved_error <= error * (1.0 + _ROUNDING):
            break
        values, error = step.moved, min(moved_error, error)
    return values, error
