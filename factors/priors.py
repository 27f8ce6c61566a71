"""Priors: on the intrinsics theta, a vector variable, and on poses or chains of them."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
import numpy.typing as npt

from factors.camera_models import CameraModel
from factors.reprojection import Jacobians
from factors.reprojection_kernels import FloatArray


def weak_intrinsics_prior(
    theta_key: int,
    model: CameraModel,
    image_width_px: int,
    image_height_px: int,
    *,
    sigma_centre_px: float = 50.0,
    sigma_distortion: float = 0.5,
) -> gtsam.NonlinearFactor:
    """The paper's prior: principal point to the image centre, distortion to zero (of a model that has no zero, to the
    lens that it starts from), focal length free.

    The paper names no sigmas; the defaults are wide enough not to move what the data determine.

    Raises ValueError for a sigma that is not positive."""
    mean = np.concatenate([np.zeros(4), model.undistorted])
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


class PoseMeasurementFactor(gtsam.CustomFactor):
    """A pose measured directly: diag(weights) Log(measured^-1 pose), the components along the axes of the pose's own
    frame (its right tangent), rotation first.

    pose: of a chain of one or two Pose3 variables, each as it is or inverted: (key, inverted) in order.
    weights: (6,) 1/sigma of each component, in 1/rad and 1/m; 0 leaves it free.

    Raises ValueError for a weight below zero."""

    def __init__(
        self,
        pose: Sequence[tuple[int, bool]],
        measured: npt.NDArray[np.float64],
        weights: npt.NDArray[np.float64],
    ) -> None:
        if weights.shape != (6,) or not (weights >= 0.0).all():
            raise ValueError(f"{weights=}, expected (6,) of zero or more")
        inverse_measured = gtsam.Pose3(measured).inverse()

        def residual(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
            variables = [values.atPose3(key) for key, _ in pose]
            links = [T.inverse() if inverted else T for T, (_, inverted) in zip(variables, pose, strict=True)]
            after = [gtsam.Pose3()]  # what follows each link in the chain
            for link in links[:0:-1]:
                after.insert(0, link.compose(after[0]))
            xi = gtsam.Pose3.Logmap(inverse_measured.compose(links[0]).compose(after[0]))
            if jacobians is not None:
                along = weights[:, None] * gtsam.Pose3.LogmapDerivative(xi)
                for i, (T, (_, inverted)) in enumerate(zip(variables, pose, strict=True)):
                    carried = after[i].inverse().AdjointMap()
                    jacobians[i] = np.asfortranarray(-along @ carried @ T.AdjointMap() if inverted else along @ carried)
            return np.asarray(weights * xi)

        super().__init__(None, [key for key, _ in pose], residual)  # type: ignore[call-overload]


class JointPriorFactor(gtsam.CustomFactor):
    """Several variables known together: W d with W^T W = covariance^-1 and d their distances from the means, each in
    its right tangent: Log(mean^-1 pose), rotation first, or value - mean.

    means: (4, 4) of a Pose3, (K,) of a vector. covariance: (D, D), the tangents in the order of the keys.

    Raises ValueError where the sizes differ, numpy.linalg.LinAlgError where the covariance is not positive definite."""

    def __init__(
        self, keys: Sequence[int], means: Sequence[npt.NDArray[np.float64]], covariance: npt.NDArray[np.float64]
    ) -> None:
        sizes = [6 if mean.ndim == 2 else len(mean) for mean in means]
        if covariance.shape != (sum(sizes), sum(sizes)) or len(keys) != len(means):
            raise ValueError(f"{covariance.shape=}, {len(keys)} keys, expected ({sum(sizes)},) * 2 and {len(means)}")
        scale = 1.0 / np.sqrt(np.diag(covariance))
        W = np.linalg.inv(np.linalg.cholesky(covariance * np.outer(scale, scale))) * scale
        edges = np.concatenate([[0], np.cumsum(sizes)])
        inverses = [gtsam.Pose3(mean).inverse() if mean.ndim == 2 else None for mean in means]

        def residual(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
            distance = np.empty(edges[-1])
            for i, (key, inverse, mean) in enumerate(zip(keys, inverses, means, strict=True)):
                own = slice(edges[i], edges[i + 1])
                if inverse is None:
                    distance[own] = values.atVector(key) - mean
                else:
                    distance[own] = gtsam.Pose3.Logmap(inverse.compose(values.atPose3(key)))
                if jacobians is not None:
                    along = W[:, own] if inverse is None else W[:, own] @ gtsam.Pose3.LogmapDerivative(distance[own])
                    jacobians[i] = np.asfortranarray(along)
            return np.asarray(W @ distance)

        super().__init__(None, list(keys), residual)  # type: ignore[call-overload]
