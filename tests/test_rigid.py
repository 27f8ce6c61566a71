"""Rigid transforms of the compiled kernels against GTSAM's Pose3."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from factors_support import poses

from factors.moments import chain
from factors.rigid import adjoint, adjoint_of_inverse, compose, inverse, skew


@pytest.fixture
def transforms() -> np.ndarray:
    """Ten transforms with rotations from small to beyond half a turn, (10, 4, 4)."""
    random = np.random.default_rng(3)
    return np.concatenate([poses(random, 2, 1e-9, 1.0), poses(random, 8, 2.5, 2.0)])


def test_compose_and_chain_are_matrix_products(transforms: np.ndarray) -> None:
    product = np.eye(4)
    compose(transforms[3], transforms[4], product)
    np.testing.assert_allclose(product, transforms[3] @ transforms[4], atol=1e-14)
    chained = chain(transforms[5], transforms, transforms[7])
    np.testing.assert_allclose(chained, transforms[5] @ transforms @ transforms[7], atol=1e-14)


def test_inverse(transforms: np.ndarray) -> None:
    np.testing.assert_allclose(inverse(transforms) @ transforms, np.broadcast_to(np.eye(4), (10, 4, 4)), atol=1e-14)
    np.testing.assert_allclose(inverse(inverse(transforms)), transforms, atol=1e-14)
    np.testing.assert_array_equal(inverse(transforms[4]), inverse(transforms)[4])


def test_the_adjoint_carries_tangents_to_the_other_side(transforms: np.ndarray) -> None:
    xi = np.array([0.02, -0.03, 0.01, 0.2, 0.1, -0.4])
    for transform in transforms:
        adjoint = np.full((6, 6), np.nan)
        adjoint_of_inverse(transform, adjoint)
        pose = gtsam.Pose3(transform)
        np.testing.assert_allclose(adjoint, pose.inverse().AdjointMap(), atol=1e-14)
        moved = pose.compose(gtsam.Pose3.Expmap(adjoint @ xi))
        np.testing.assert_allclose(moved.matrix(), gtsam.Pose3.Expmap(xi).compose(pose).matrix(), atol=1e-13)


def test_the_adjoint_is_gtsams_and_skew_is_a_cross_product() -> None:
    random = np.random.default_rng(0)
    poses = [gtsam.Pose3.Expmap(random.normal(size=6)) for _ in range(5)]
    found = adjoint(np.stack([pose.matrix() for pose in poses]))
    np.testing.assert_allclose(found, [pose.AdjointMap() for pose in poses], atol=1e-12)
    v, w = random.normal(size=(2, 4, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(v), w), np.cross(v, w), atol=1e-12)
    np.testing.assert_allclose(skew(v[0]), skew(v)[0])
