"""The moment form of E_3D is the sum over its corners."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from factors_support import X, Y, derivative_to, poses

from factors import PointAlignmentFactor
from factors.alignment import corner_moments, squared_distances
from factors.moments import chain
from factors.rigid import inverse

SIGMA_M = 0.004
N_VIEWS = 6


class Aligned:
    """Views of a board, flat or not, whose PnP poses are off by millimetres; each view sees corners of its own."""

    def __init__(self, flat: bool) -> None:
        random = np.random.default_rng(11)
        self.view_start = np.cumsum([0, 4, 1, 30, 4, 12, 7])
        self.corners_m = random.uniform(-0.1, 0.5, (self.view_start[-1], 3)) * [1, 1, 0 if flat else 1]
        camera_T_ref, body_T_board = poses(random, 2, 2.0, 0.5)
        self.measured = poses(random, N_VIEWS, 2.0, 1.0)
        chain_noise = poses(random, N_VIEWS, 0.01, 0.005)
        self.ref_T_body = inverse(camera_T_ref) @ self.measured @ chain_noise @ inverse(body_T_board)
        self.moments = corner_moments(self.view_start, self.corners_m)
        self.values = gtsam.Values()
        self.values.insert(Y, gtsam.Pose3(camera_T_ref @ poses(random, 1, 0.02, 0.01)[0]))
        self.values.insert(X, gtsam.Pose3(body_T_board @ poses(random, 1, 0.02, 0.01)[0]))
        self.factor = PointAlignmentFactor(
            Y,
            X,
            ref_T_body=self.ref_T_body,
            measured_camera_T_board=self.measured,
            corner_moments=self.moments,
            sigma_m=SIGMA_M,
        )

    def residuals(self, values: gtsam.Values) -> np.ndarray:
        """Every corner's whitened residual, corner by corner, (3 N,)."""
        camera_T_board = chain(values.atPose3(Y).matrix(), self.ref_T_body, values.atPose3(X).matrix())
        apart = []
        for v in range(N_VIEWS):
            for corner in self.corners_m[slice(*self.view_start[v : v + 2])]:
                p = np.append(corner, 1.0)
                apart.append((camera_T_board[v] @ p - self.measured[v] @ p)[:3] / SIGMA_M)
        return np.concatenate(apart)


@pytest.fixture(params=[True, False], ids=["flat", "solid"])
def aligned(request: pytest.FixtureRequest) -> Aligned:
    return Aligned(request.param)


def test_error_is_the_sum_over_the_corners(aligned: Aligned) -> None:
    expected = 0.5 * np.sum(aligned.residuals(aligned.values) ** 2)
    assert aligned.factor.error(aligned.values) == pytest.approx(expected, rel=1e-11)
    linear = aligned.factor.linearize(aligned.values)
    assert linear.error(aligned.values.zeroVectors()) == pytest.approx(expected, rel=1e-11)


def test_gradient_and_hessian_are_those_of_the_corners(aligned: Aligned) -> None:
    J = np.hstack([derivative_to(aligned.residuals, aligned.values, key, 1e-5) for key in (Y, X)])
    r = aligned.residuals(aligned.values)
    linear = aligned.factor.linearize(aligned.values)
    assert linear.keys() == [Y, X]
    augmented = linear.augmentedInformation()
    scale = np.linalg.norm(J, axis=0)
    np.testing.assert_allclose((augmented[:12, :12] - J.T @ J) / np.outer(scale, scale), 0.0, atol=1e-7)
    np.testing.assert_allclose((augmented[:12, 12] + J.T @ r) / scale, 0.0, atol=1e-7 * np.linalg.norm(r))


def test_gradient_is_the_derivative_of_the_error(aligned: Aligned) -> None:
    gradient = -aligned.factor.linearize(aligned.values).augmentedInformation()[:12, 12]
    numeric = [derivative_to(aligned.factor.error, aligned.values, key, 1e-5) for key in (Y, X)]
    np.testing.assert_allclose(gradient, np.concatenate(numeric), rtol=1e-6, atol=1e-4)


def test_exact_poses_align_without_error() -> None:
    aligned = Aligned(flat=True)
    camera_T_ref, body_T_board = (aligned.values.atPose3(key).matrix() for key in (Y, X))
    factor = PointAlignmentFactor(
        Y,
        X,
        ref_T_body=aligned.ref_T_body,
        measured_camera_T_board=chain(camera_T_ref, aligned.ref_T_body, body_T_board),
        corner_moments=aligned.moments,
    )
    assert factor.error(aligned.values) == 0.0
    # the triangular factor of rows of zeros may hold numbers of the order of 1e-320, by processor
    np.testing.assert_allclose(factor.linearize(aligned.values).getb(), 0.0, atol=np.finfo(float).tiny)


def test_squared_distances_by_view(aligned: Aligned) -> None:
    camera_T_board = aligned.measured @ poses(np.random.default_rng(1), N_VIEWS, 0.1, 0.1)
    got = squared_distances(camera_T_board, aligned.measured, aligned.moments)
    for v in range(N_VIEWS):
        corners = aligned.corners_m[slice(*aligned.view_start[v : v + 2])]
        placed = [corners @ T[:3, :3].T + T[:3, 3] for T in (camera_T_board[v], aligned.measured[v])]
        assert got[v] == pytest.approx(np.sum((placed[0] - placed[1]) ** 2), rel=1e-11)


def test_corner_moments_are_sums_of_outer_products(aligned: Aligned) -> None:
    for v in range(N_VIEWS):
        corners = aligned.corners_m[slice(*aligned.view_start[v : v + 2])]
        homogeneous = np.column_stack([corners, np.ones(len(corners))])
        np.testing.assert_allclose(aligned.moments[v], homogeneous.T @ homogeneous, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("start", [[0, 0, 8], [0, 8, 8], [0, 3, 3, 8], [0, 9, 8]])
def test_views_without_corners_are_refused(start: list[int]) -> None:
    with pytest.raises(ValueError, match="every view needs a corner"):
        corner_moments(np.array(start), np.zeros((8, 3)))


def test_shapes_that_differ_are_refused() -> None:
    aligned = Aligned(flat=True)
    with pytest.raises(ValueError, match=r"corner_moments.shape=\(5, 4, 4\), expected one shape \(V, 4, 4\)"):
        PointAlignmentFactor(
            Y,
            X,
            ref_T_body=aligned.ref_T_body,
            measured_camera_T_board=aligned.measured,
            corner_moments=aligned.moments[1:],
        )
    with pytest.raises(ValueError, match="expected a positive standard deviation"):
        PointAlignmentFactor(
            Y,
            X,
            ref_T_body=aligned.ref_T_body,
            measured_camera_T_board=aligned.measured,
            corner_moments=aligned.moments,
            sigma_m=0.0,
        )
