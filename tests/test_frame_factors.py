"""Whole frames as one factor against the plain factors, and the noise that neighbouring frames share."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from factors_support import SHAPE, THETA, A, Scene, X, Y, camera, derivative_to, poses, scene

from factors import FISHEYE62, GAUSSIAN, FusedReprojectionFactor, RobustKernel
from factors.board_shape import FLAT
from factors.frames import CameraFrames, FramesReprojection
from factors.mocap_noise import CorrelatedNoiseFactor

N_VIEWS = 6
Y2, THETA2 = gtsam.symbol("y", 1), gtsam.symbol("t", 1)
KERNELS = {"plain": GAUSSIAN, "Huber": RobustKernel.named("Huber"), "Tukey": RobustKernel("Tukey", 4.0)}


def two_cameras() -> tuple[Scene, Scene]:
    """The same board and body, seen by two lenses in the same place, one with outliers; frames 0 and 5 are seen by the
    first only, 2 by the second only."""
    first = scene("quest3", n_views=N_VIEWS, outlier_px=4.0)
    model, theta = camera("tum_vi")
    exact = scene("quest3", n_views=N_VIEWS, noise_px=0.0).views
    rays = FISHEYE62.unproject(exact.corners_px, first.theta)[0]
    pixels = model.project(rays, theta)[0] + np.random.default_rng(5).normal(scale=0.3, size=exact.corners_px.shape)
    return first, replace(first, model=model, theta=theta, views=replace(exact, corners_px=pixels))


FRAMES = np.array([0, 1, 3, 4, 5]), np.array([1, 2, 3, 4])


def values_of(first: Scene, second: Scene, *, free_theta: bool, free_shape: bool = False) -> gtsam.Values:
    values = first.initial(free_body=True, free_theta=free_theta, free_shape=free_shape)
    values.insert(Y2, values.atPose3(Y).retract(np.full(6, 3e-4)))
    if free_theta:
        values.insert(THETA2, 1.0003 * second.theta)
    return values


def seen(of_scene: Scene, rows: np.ndarray, y: int, theta: int | np.ndarray) -> CameraFrames:
    """The views at ``rows`` of a scene, each in the frame of its number."""
    views = of_scene.views
    parts = [np.arange(views.view_start[v], views.view_start[v + 1]) for v in rows]
    start = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
    corners = np.concatenate(parts)
    few = replace(views, view_start=start, corners_m=views.corners_m[corners], corners_px=views.corners_px[corners])
    return CameraFrames(few, rows, of_scene.model, y, theta)


def frames_graph(
    first: Scene, second: Scene, robust: RobustKernel, *, free_theta: bool, free_shape: bool = False
) -> gtsam.NonlinearFactorGraph:
    cameras = [
        seen(first, FRAMES[0], Y, THETA if free_theta else first.theta),
        seen(second, FRAMES[1], Y2, THETA2 if free_theta else second.theta),
    ]
    graph = gtsam.NonlinearFactorGraph()
    keys, shape = [A(f) for f in range(N_VIEWS)], SHAPE if free_shape else FLAT
    made = FramesReprojection(cameras, ref_T_body=keys, body_T_board=X, shape=shape, robust=robust)
    for factor in made.factors:
        graph.add(factor)
    return graph


def plain_graph(
    first: Scene, second: Scene, robust: RobustKernel, *, free_theta: bool, free_shape: bool = False
) -> gtsam.NonlinearFactorGraph:
    """The same in factors of one view of one camera."""
    graph = gtsam.NonlinearFactorGraph()
    for of_scene, frames, y, key in ((first, FRAMES[0], Y, THETA), (second, FRAMES[1], Y2, THETA2)):
        for f in frames:
            theta = key if free_theta else of_scene.theta
            views = of_scene.one_view(f)
            shape = SHAPE if free_shape else FLAT
            graph.add(
                FusedReprojectionFactor(
                    y, X, views=views, model=of_scene.model, ref_T_body=A(f), theta=theta, shape=shape, robust=robust
                )
            )
    return graph


def ordering_of(values: gtsam.Values) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in sorted(values.keys()):
        ordering.push_back(key)
    return ordering


@pytest.mark.parametrize("free", [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("kernel", KERNELS)
def test_frames_are_worth_their_views(kernel: str, free: tuple[bool, bool]) -> None:
    """A single frame hardly tells pose, lens and shape of the board apart: a digit is lost."""
    variables = dict(zip(("free_theta", "free_shape"), free, strict=True))
    first, second = two_cameras()
    values = values_of(first, second, **variables)
    graphs = [make(first, second, KERNELS[kernel], **variables) for make in (frames_graph, plain_graph)]
    found, expected = ([graph.error(values), *graph.linearize(values).hessian(ordering_of(values))] for graph in graphs)
    assert found[0] == pytest.approx(expected[0], rel=1e-10)
    for mine, theirs in zip(found[1:], expected[1:], strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-7 if free[1] else 1e-8, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("free_theta", [False, True])
def test_the_gradient_is_the_derivative_of_the_error(free_theta: bool) -> None:
    first, second = two_cameras()
    values = values_of(first, second, free_theta=free_theta, free_shape=free_theta)
    graph = frames_graph(first, second, KERNELS["Huber"], free_theta=free_theta, free_shape=free_theta)
    gradient = graph.linearize(values).gradientAtZero()
    for key in values.keys():  # noqa: SIM118 (gtsam.Values is no mapping)
        numeric = derivative_to(graph.error, values, key)
        np.testing.assert_allclose(gradient.at(key), numeric, rtol=1e-4, atol=1e-5 * np.abs(numeric).max())


def test_new_values_are_not_taken_for_the_old_ones() -> None:
    """The sums that the frames share are made anew when any variable of theirs has moved."""
    first, second = two_cameras()
    free = {"free_theta": True, "free_shape": True}
    values = values_of(first, second, **free)
    graph, plain = (make(first, second, GAUSSIAN, **free) for make in (frames_graph, plain_graph))
    for key in (Y, Y2, X, THETA2, SHAPE, A(3)):
        graph.error(values)
        values.update(values.retract(_step(values, key)))
        assert graph.error(values) == pytest.approx(plain.error(values), rel=1e-10)


def _step(values: gtsam.Values, key: int) -> gtsam.VectorValues:
    delta, single = values.zeroVectors(), gtsam.VectorValues()
    single.insert(key, np.full(delta.at(key).shape, 1e-3))
    delta.update(single)
    return delta


def test_what_does_not_fit_is_refused() -> None:
    first, second = two_cameras()
    with pytest.raises(ValueError, match="increasing frame numbers"):
        seen(first, np.array([0, 1, 1]), Y, first.theta)
    with pytest.raises(ValueError, match="frame 2 is seen by no camera"):
        FramesReprojection([seen(first, FRAMES[0], Y, first.theta)], ref_T_body=range(N_VIEWS), body_T_board=X)
    with pytest.raises(ValueError, match="frame numbers 1 to 4 for 3 frames"):
        FramesReprojection([seen(second, FRAMES[1], Y, second.theta)], ref_T_body=range(3), body_T_board=X)


# Noise that neighbouring frames share


def correlated(rho: float) -> tuple[CorrelatedNoiseFactor, gtsam.Values, np.ndarray, list[np.ndarray]]:
    """A factor, values near the measured poses, those, and the whitening of each."""
    random = np.random.default_rng(0)
    measured = poses(random, 2, 2.0, 1.0)
    whitening = [np.linalg.inv(np.linalg.cholesky(_covariance(random))) for _ in range(2)]
    values = gtsam.Values()
    for f, pose in enumerate(measured):
        values.insert(A(f), gtsam.Pose3(pose @ poses(random, 1, 0.3, 0.02)[0]))
    return CorrelatedNoiseFactor((A(0), A(1)), tuple(measured), tuple(whitening), rho), values, measured, whitening


def _covariance(random: np.random.Generator) -> np.ndarray:
    half = random.normal(size=(6, 6))
    return half @ half.T + 0.5 * np.eye(6)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.99])
def test_jacobians_of_correlated_noise_equal_numeric_differentiation(rho: float) -> None:
    factor, values, *_ = correlated(rho)
    linear = factor.linearize(values)
    jacobian, minus_residual = linear.jacobian()
    numeric = [derivative_to(factor.unwhitenedError, values, A(f)) for f in range(2)]
    np.testing.assert_allclose(jacobian, np.hstack(numeric), rtol=1e-5, atol=1e-6 * np.abs(jacobian).max())
    np.testing.assert_allclose(minus_residual, -factor.unwhitenedError(values), rtol=1e-12)


def test_the_chain_of_correlated_noise_has_the_joint_density_of_the_process() -> None:
    """Prior of the first and factor between: minus the log of N(0, [[1, rho], [rho, 1]]) of the whitened noise."""
    rho = 0.7
    factor, values, measured, whitening = correlated(rho)
    z = [whitening[f] @ gtsam.Pose3.Logmap(gtsam.Pose3(measured[f]).inverse() * values.atPose3(A(f))) for f in range(2)]
    inverse = np.linalg.inv([[1.0, rho], [rho, 1.0]])
    expected = 0.5 * sum(inverse[i, j] * (z[i] @ z[j]) for i in range(2) for j in range(2))
    assert 0.5 * (z[0] @ z[0]) + factor.error(values) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("rho", [-0.1, 1.0])
def test_an_impossible_correlation_is_refused(rho: float) -> None:
    with pytest.raises(ValueError, match="expected 0 <= rho < 1"):
        correlated(rho)
