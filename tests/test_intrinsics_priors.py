"""What the priors on the intrinsics hold, and what they leave free."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from factors_support import CAMERAS, THETA, camera

from factors import FISHEYE62, CameraModel, factory_intrinsics_prior, weak_intrinsics_prior

every_camera = pytest.mark.parametrize("label", CAMERAS)


def at(theta: np.ndarray) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(THETA, theta)
    return values


def information(prior: gtsam.NonlinearFactor, theta: np.ndarray) -> np.ndarray:
    return prior.linearize(at(theta)).information()


def centred(model: CameraModel, focal_px: float) -> np.ndarray:
    """A 640 x 480 camera without distortion, or with what a model has in its place."""
    return np.array([focal_px, 2 * focal_px, 319.5, 239.5, *model.undistorted])


@every_camera
def test_the_papers_prior_leaves_the_focal_length_free(label: str) -> None:
    model, theta = camera(label)
    prior = weak_intrinsics_prior(THETA, model, 640, 480, sigma_centre_px=20.0, sigma_distortion=0.1)
    for focal_px in (100.0, 5000.0):
        assert prior.error(at(centred(model, focal_px))) == 0.0
    expected = np.diag([0.0, 0.0, 1 / 20.0**2, 1 / 20.0**2, *np.full(model.n_parameters - 4, 1 / 0.1**2)])
    np.testing.assert_allclose(information(prior, theta), expected, rtol=1e-12)


@every_camera
def test_the_papers_prior_pulls_to_the_centre_and_to_no_distortion(label: str) -> None:
    model, _ = camera(label)
    prior = weak_intrinsics_prior(THETA, model, 640, 480, sigma_centre_px=20.0, sigma_distortion=0.1)
    for i in range(2, model.n_parameters):
        sigma = 20.0 if i < 4 else 0.1
        theta = centred(model, 300.0)
        theta[i] += 2 * sigma
        assert prior.error(at(theta)) == pytest.approx(2.0, rel=1e-12)


@every_camera
def test_the_factory_prior_holds_each_parameter_by_its_sigma(label: str) -> None:
    model, theta = camera(label)
    sigmas = np.geomspace(1e-4, 10.0, model.n_parameters)
    sigmas[1] = np.inf
    prior = factory_intrinsics_prior(THETA, theta, sigmas)
    assert prior.error(at(theta)) == 0.0
    np.testing.assert_allclose(information(prior, theta), np.diag(1 / sigmas**2), rtol=1e-12)
    off = np.where(np.isinf(sigmas), 1e3, sigmas)
    assert prior.error(at(theta + off)) == pytest.approx(0.5 * (model.n_parameters - 1), rel=1e-9)


def test_priors_that_make_no_sense_are_refused() -> None:
    theta = np.ones(12)
    with pytest.raises(ValueError, match=r"theta.shape=\(12,\), sigmas.shape=\(11,\), expected one shape \(K,\)"):
        factory_intrinsics_prior(THETA, theta, np.ones(11))
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="expected positive standard deviations"):
            factory_intrinsics_prior(THETA, theta, np.full(12, bad))
        with pytest.raises(ValueError, match="expected positive standard deviations"):
            weak_intrinsics_prior(THETA, FISHEYE62, 640, 480, sigma_distortion=bad)
        with pytest.raises(ValueError, match="expected positive standard deviations"):
            weak_intrinsics_prior(THETA, FISHEYE62, 640, 480, sigma_centre_px=bad)
