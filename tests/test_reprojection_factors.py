"""The two grains of the reprojection error are one measurement, and GTSAM is told the truth about it."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from factors_support import SHAPE, THETA, A, Scene, X, Y, derivative_to, scene

from factors import GAUSSIAN, ROBUST_KERNELS, CornerViews, RobustKernel, cores
from factors import reprojection as module
from factors.board_shape import FLAT, N_SHAPE
from factors.moments import transport, triangular_factor
from factors.priors import factory_intrinsics_prior
from factors.reprojection import reprojection_moments, residuals_px, view_moments

every_kernel = pytest.mark.parametrize("kernel", ROBUST_KERNELS)
every_model = pytest.mark.parametrize(
    "label", ["quest3", *(pytest.param(label, marks=pytest.mark.long) for label in ("euroc", "tum_vi", "thin_prism"))]
)
"""Each has kernels of its own to compile."""
every_choice_of_variables = pytest.mark.parametrize(
    "free",
    [
        {},
        {"free_theta": True},
        {"free_body": True},
        {"free_body": True, "free_theta": True},
        {"free_theta": True, "free_shape": True},
    ],
)


def both_grains(seen: Scene, robust: RobustKernel, free: dict[str, bool]) -> list[gtsam.NonlinearFactorGraph]:
    return [seen.graph(fused=fused, robust=robust, **free) for fused in (False, True)]


def add_priors(
    graph: gtsam.NonlinearFactorGraph,
    seen: Scene,
    *,
    free_body: bool = False,
    free_theta: bool = False,
    free_shape: bool = False,
) -> None:
    """What a solve needs where the mocap poses, the intrinsics or the board's shape are variables."""
    if free_body:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.0005, 0.0003], 3))
        for v, ref_T_body in enumerate(seen.ref_T_body):
            graph.add(gtsam.PriorFactorPose3(A(v), gtsam.Pose3(ref_T_body), noise))
    if free_theta:
        graph.add(factory_intrinsics_prior(THETA, seen.theta, 0.01 * np.abs(seen.theta) + 1e-3))
    if free_shape:
        graph.add(gtsam.PriorFactorVector(SHAPE, FLAT, gtsam.noiseModel.Isotropic.Sigma(N_SHAPE, 1e-3)))


def hessian(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> tuple[np.ndarray, np.ndarray]:
    """Hessian and gradient, scaled to a unit diagonal so that pixels and metres compare alike."""
    matrix, vector = graph.linearize(values).hessian()
    scale = 1 / np.sqrt(np.diag(matrix))
    return matrix * np.outer(scale, scale), vector * scale


@every_model
@every_choice_of_variables
@every_kernel
def test_error_gradient_and_hessian_are_the_same(label: str, free: dict[str, bool], kernel: str) -> None:
    seen = scene(label, outlier_px=5.0)
    values = seen.initial(**free)
    corners, fused = both_grains(seen, RobustKernel.named(kernel), free)
    assert fused.size() == (seen.views.n_views if "free_body" in free else 1)
    assert fused.error(values) == pytest.approx(corners.error(values), rel=1e-11)
    (H, g), (fused_H, fused_g) = (hessian(graph, values) for graph in (corners, fused))
    np.testing.assert_allclose(fused_H, H, rtol=0, atol=1e-10)
    np.testing.assert_allclose(fused_g, g, rtol=1e-9, atol=1e-9 * np.abs(g).max())


@pytest.mark.long
@every_choice_of_variables
@every_kernel
def test_the_gradient_is_the_derivative_of_the_error(free: dict[str, bool], kernel: str) -> None:
    seen = scene(outlier_px=5.0)
    values = seen.initial(**free)
    for graph in both_grains(seen, RobustKernel.named(kernel), free):
        gradient = graph.linearize(values).gradientAtZero()
        for key in graph.keyVector():
            numeric = derivative_to(graph.error, values, key, 1e-7)
            np.testing.assert_allclose(gradient.at(key), numeric, rtol=1e-5, atol=1e-4)


@every_model
@every_choice_of_variables
def test_jacobians_equal_numeric_differentiation(label: str, free: dict[str, bool]) -> None:
    seen = scene(label)
    values = seen.initial(**free)
    body = A(1) if "free_body" in free else seen.ref_T_body[1]
    theta = THETA if "free_theta" in free else seen.theta
    shape = SHAPE if "free_shape" in free else FLAT
    n = int(seen.views.view_start[1]) + 7
    factor = seen.corner(n, body, theta, gtsam.noiseModel.Unit.Create(2), shape)
    linear = factor.linearize(values)
    np.testing.assert_array_equal(linear.getb(), -factor.unwhitenedError(values))
    stacked = linear.getA()
    start = 0
    for key in factor.keys():  # noqa: SIM118
        numeric = derivative_to(factor.unwhitenedError, values, key)
        J = stacked[:, start : start + numeric.shape[1]]
        start += numeric.shape[1]
        np.testing.assert_allclose(J, numeric, rtol=1e-6, atol=1e-5)
    assert start == stacked.shape[1]


def optimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setMaxIterations(60)
    parameters.setDiagonalDamping(True)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def assert_same_solution(seen: Scene, robust: RobustKernel, free: dict[str, bool]) -> None:
    graphs = both_grains(seen, robust, free)
    for graph in graphs:
        add_priors(graph, seen, **free)
    initial = seen.initial(**free)
    by_corners, by_views = (optimum(graph, initial) for graph in graphs)
    assert graphs[0].error(by_corners) < graphs[0].error(initial)
    marginals = [gtsam.Marginals(graph, by_corners) for graph in graphs]
    apart = by_corners.localCoordinates(by_views)
    for key in initial.keys():  # noqa: SIM118
        covariance, fused_covariance = (m.marginalCovariance(key) for m in marginals)
        sigma = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(apart.at(key) / sigma, 0.0, atol=1e-5)
        np.testing.assert_allclose((fused_covariance - covariance) / np.outer(sigma, sigma), 0.0, atol=1e-9)


@every_kernel
def test_the_optimum_and_its_covariance_are_the_same(kernel: str) -> None:
    assert_same_solution(scene(outlier_px=5.0), RobustKernel.named(kernel), {})


@every_model
@every_choice_of_variables
def test_the_same_optimum_for_every_model_and_choice_of_variables(label: str, free: dict[str, bool]) -> None:
    assert_same_solution(scene(label, outlier_px=2.0), RobustKernel.named("Huber"), free)


@pytest.mark.parametrize("fused", [False, True])
def test_covariance_with_free_intrinsics_keeps_seven_digits(fused: bool) -> None:
    """Sums of J^T J square the condition number, here 1e4: against the QR of the stacked Jacobian."""
    seen = scene(n_views=40)
    values = seen.initial(free_theta=True)
    stacked, _ = seen.graph(fused=False, free_theta=True).linearize(values).jacobian()
    root = np.linalg.inv(np.linalg.qr(stacked, mode="r"))
    expected, start = root @ root.T, 0
    marginals = gtsam.Marginals(seen.graph(fused=fused, free_theta=True), values)
    for key in values.keys():  # noqa: SIM118  # GTSAM stacks the columns in the order of the keys
        covariance = marginals.marginalCovariance(key)
        block = slice(start, start := start + len(covariance))
        sigma = np.sqrt(np.diag(expected)[block])
        np.testing.assert_allclose((covariance - expected[block, block]) / np.outer(sigma, sigma), 0.0, atol=1e-7)


def test_the_optimum_is_the_truth_without_noise() -> None:
    seen = scene(noise_px=0.0)
    solved = optimum(seen.graph(fused=True), seen.initial())
    assert seen.graph(fused=True).error(solved) == pytest.approx(0.0, abs=1e-15)


def test_a_value_only_call_gives_the_error_of_the_jacobian_call() -> None:
    seen = scene(outlier_px=5.0)
    values = seen.initial()
    for graph in both_grains(seen, GAUSSIAN, {}):
        linear = graph.linearize(values)
        assert graph.error(values) == pytest.approx(linear.error(values.zeroVectors()), rel=1e-12)


def moments_of(seen: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    camera_T_board = np.array([np.eye(4)] * seen.views.n_views)
    camera_T_board[:, 2, 3] = 0.7
    robust = RobustKernel.named("Cauchy")
    got = view_moments(seen.views, camera_T_board, seen.model, seen.theta, robust=robust, with_theta=True)
    return got.moments, got.loss, residuals_px(seen.views, camera_T_board, seen.model, seen.theta)


@pytest.mark.parametrize("n_cores", [1, 2, 3, 7])
def test_the_number_of_cores_does_not_matter(monkeypatch: pytest.MonkeyPatch, n_cores: int) -> None:
    seen = scene(n_views=6)
    alone = moments_of(seen)
    monkeypatch.setattr(module, "_CORNERS_PER_TASK", 10)
    monkeypatch.setattr(cores, "n_cores", lambda: n_cores)
    cores._threads.cache_clear()
    assert len(module._tasks(seen.views.view_start)) == n_cores
    for got, expected in zip(moments_of(seen), alone, strict=True):
        np.testing.assert_array_equal(got, expected)


def test_views_may_be_empty() -> None:
    seen = scene(n_views=2)
    start = np.array([0, 0, 20, 20, 40, 40])
    views = CornerViews(start, seen.views.corners_m, seen.views.corners_px, seen.views.sigma_px)
    bodies = np.repeat(seen.ref_T_body, [2, 3], axis=0)
    values = seen.initial()
    with_empty, without = seen.fused(views, bodies, seen.theta), seen.fused(seen.views, seen.ref_T_body, seen.theta)
    assert with_empty.error(values) == without.error(values)
    np.testing.assert_array_equal(
        with_empty.linearize(values).augmentedJacobian(), without.linearize(values).augmentedJacobian()
    )


@every_model
@every_choice_of_variables
@pytest.mark.parametrize("kernel", ["Null", "Cauchy"])
def test_beyond_the_field_the_grains_are_one_and_their_gradient_is_true(
    label: str, free: dict[str, bool], kernel: str
) -> None:
    seen = scene(label, n_views=2)
    values = seen.initial(**free)
    values.update(Y, gtsam.Pose3(gtsam.Rot3.Ry(np.radians(100.0)), np.zeros(3)).compose(values.atPose3(Y)))
    corners, fused = both_grains(seen, RobustKernel.named(kernel), free)
    assert fused.error(values) == pytest.approx(corners.error(values), rel=1e-11)
    gradients = [graph.linearize(values).gradientAtZero() for graph in (corners, fused)]
    for key in fused.keyVector():
        numeric = derivative_to(fused.error, values, key, 1e-7)
        for gradient in gradients:
            np.testing.assert_allclose(gradient.at(key), numeric, rtol=1e-5, atol=1e-6 * np.abs(numeric).max())


def test_what_has_no_direction_has_a_constant_error() -> None:
    seen = scene(n_views=1)
    camera_T_board = np.eye(4)[None].copy()
    camera_T_board[0, :3, 3] = -seen.views.corners_m[0]  # the first corner in the middle of the lens
    start = np.array([0, 1])
    views = CornerViews(start, seen.views.corners_m[:1], seen.views.corners_px[:1], seen.views.sigma_px)
    got = view_moments(views, camera_T_board, seen.model, seen.theta)
    whitened = 2.0 * seen.theta[0] / seen.views.sigma_px
    assert got.loss[0] == pytest.approx(0.5 * 2.0 * whitened**2, rel=1e-12)
    np.testing.assert_array_equal(got.moments[0, :6], 0.0)


def test_corners_beyond_the_field_are_counted() -> None:
    seen = scene(n_views=2)
    camera_T_board = np.array([np.eye(4), np.eye(4)])
    camera_T_board[:, 2, 3] = 0.7, -0.7
    got = view_moments(seen.views, camera_T_board, seen.model, seen.theta)
    np.testing.assert_array_equal(got.n_invalid, [0, 20])
    residuals = residuals_px(seen.views, camera_T_board, seen.model, seen.theta)
    np.testing.assert_array_equal(np.isnan(residuals).all(axis=1), np.repeat([False, True], 20))
    one = np.sum(residuals[:20] ** 2) / (2 * seen.views.sigma_px**2)
    assert got.loss[0] == pytest.approx(one, rel=1e-13)


def test_one_view_of_a_free_body_leaves_directions_open() -> None:
    seen = scene(n_views=1)
    values = seen.initial(free_body=True, free_theta=True)
    factor = seen.fused(seen.views, A(0), THETA)
    linear = factor.linearize(values)
    Y_c, A_t, X_b = (values.atPose3(key).matrix() for key in (Y, A(0), X))
    upper, _ = reprojection_moments(
        seen.views, Y_c, A_t[None], X_b, seen.model, values.atVector(THETA), free_body=True, free_theta=True
    )
    moments = np.triu(upper) + np.triu(upper, 1).T
    triangle = triangular_factor(upper)
    scale = 1 / np.sqrt(np.diag(moments))
    np.testing.assert_array_equal(triangle, np.triu(triangle))
    np.testing.assert_allclose((triangle.T @ triangle - moments) * np.outer(scale, scale), 0.0, atol=1e-12)
    assert (np.diag(triangle) == 0.0).sum() >= 12  # of Y, A and X only camera_T_board can be told
    augmented = linear.augmentedJacobian()
    np.testing.assert_array_equal(augmented[:, :-1], triangle[:, :-1])
    np.testing.assert_array_equal(augmented[:, -1], -triangle[:, -1])


def test_the_triangular_factor_of_nothing_is_nothing() -> None:
    np.testing.assert_array_equal(triangular_factor(np.zeros((7, 7))), 0.0)


@pytest.mark.parametrize("free_body", [False, True])
def test_transport_is_the_product_with_the_adjoint_maps(free_body: bool) -> None:
    seen = scene(n_views=1)
    X_b = seen.values.atPose3(X)
    A_t = gtsam.Pose3(seen.ref_T_body[0])
    root = np.random.default_rng(2).normal(size=(30, 9))
    maps = [A_t.compose(X_b).inverse().AdjointMap(), *([X_b.inverse().AdjointMap()] * free_body), np.eye(6)]
    carried = np.hstack([*(root[:, :6] @ adjoint for adjoint in maps), root[:, 6:]])
    got = transport((root.T @ root)[None], seen.ref_T_body, X_b.matrix(), free_body=free_body)
    np.testing.assert_allclose(np.triu(got), np.triu(carried.T @ carried), rtol=1e-11, atol=1e-11)


def test_what_does_not_fit_is_refused() -> None:
    seen = scene(n_views=2)
    corners_m, corners_px = seen.views.corners_m, seen.views.corners_px
    with pytest.raises(ValueError, match=r"corners_m.shape=\(40, 2\)"):
        CornerViews(np.array([0, 40]), corners_m[:, :2], corners_px)
    with pytest.raises(ValueError, match=r"corners_px.shape=\(39, 2\), expected \(N, 3\) and \(N, 2\) with one N"):
        CornerViews(np.array([0, 40]), corners_m, corners_px[1:])
    for start in ([0], [1, 40], [0, 39], [0, 60, 40], [0, 40, 10, 40]):
        with pytest.raises(ValueError, match="view_start must run from 0 to N=40"):
            CornerViews(np.array(start), corners_m, corners_px)
    for sigma_px in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="expected a positive standard deviation"):
            CornerViews(np.array([0, 40]), corners_m, corners_px, sigma_px)
    with pytest.raises(ValueError, match=r"views.n_views=2: a free ref_T_body needs a factor of one view"):
        seen.fused(seen.views, A(0), seen.theta)
    with pytest.raises(ValueError, match=r"ref_T_body.shape=\(1, 4, 4\), expected \(2, 4, 4\)"):
        seen.fused(seen.views, seen.ref_T_body[:1], seen.theta)


def test_intrinsics_of_another_model_are_refused() -> None:
    seen = scene(n_views=1)
    unit = gtsam.noiseModel.Unit.Create(2)
    short = seen.theta[:9]
    for make in (
        lambda theta: seen.fused(seen.views, seen.ref_T_body, theta),
        lambda theta: seen.corner(0, seen.ref_T_body[0], theta, unit),
    ):
        with pytest.raises(ValueError, match=r"theta.shape=\(9,\), expected \(12,\) for fisheye62"):
            make(short)
        values = seen.initial()
        values.insert(THETA, short)
        with pytest.raises(ValueError, match=r"theta.shape=\(9,\), expected \(12,\) for fisheye62"):
            make(THETA).error(values)
    with pytest.raises(ValueError, match=r"camera_T_board.shape=\(3, 4, 4\), expected \(1, 4, 4\)"):
        view_moments(seen.views, np.zeros((3, 4, 4)), seen.model, seen.theta)
