"""Priors on the intrinsics theta, a vector variable."""

from __future__ import annotations

import gtsam
import numpy as np
import numpy.typing as npt

from factors.camera_models import CameraModel


def weak_intrinsics_prior(
    theta_key: int,
    model: CameraModel,
    image_width_px: int,
    image_height_px: int,
    *,
    sigma_centre_px: float = 50.0,
    sigma_distortion: float = 0.5,
) -> gtsam.NonlinearFactor:
    """The paper's prior: principal point to the image centre, distortion to zero, focal length free.

    The paper names no sigmas; the defaults are wide enough not to move what the data determine.

    Raises ValueError for a sigma that is not positive."""
    mean = np.zeros(model.n_parameters)
    mean[2:4] = (image_width_px - 1) / 2, (image_height_px - 1) / 2
    sigmas = np.full(model.n_parameters, sigma_distortion)
    sigmas[2:4] = sigma_centre_px
    sigmas[:2] = np.inf
    return factory_intrinsics_prior(theta_key, mean, sigmas)


def factory_intrinsics_prior(
    theta_key: int, theta: npt.NDArray[np.float64], sigmas: npt.NDArray[np.float64]
) -> gtsam.NonlinearFactor:
    """Stay at the factory values ``theta`` (K,) with these standard deviations (K,), in the parameters' units.
    An infinite sigma leaves its parameter free.

    Raises ValueError where the shapes differ or a sigma is not positive."""
    if theta.shape != sigmas.shape:
        raise ValueError(f"{theta.shape=}, {sigmas.shape=}, expected one shape (K,)")
    if not (sigmas > 0.0).all():
        raise ValueError(f"{sigmas=}, expected positive standard deviations")
    return gtsam.PriorFactorVector(theta_key, theta, gtsam.noiseModel.Diagonal.Precisions(1.0 / sigmas**2))
