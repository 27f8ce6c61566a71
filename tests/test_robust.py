"""The robust kernels are GTSAM's, by name, value and weight."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from factors import GAUSSIAN, ROBUST_KERNELS, RobustKernel
from factors.robust import robust_loss_and_weight

every_kernel = pytest.mark.parametrize("name", ROBUST_KERNELS)


def distances(parameter: float) -> np.ndarray:
    """From zero to far beyond the kernel's threshold (k, or for DCS its root), and the thresholds themselves."""
    thresholds = [parameter, np.sqrt(parameter)]
    return np.concatenate([[0.0, 1e-9], np.linspace(0.01, 40, 400), thresholds, [1e3]])


def loss_and_weight(robust: RobustKernel, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pairs = [robust_loss_and_weight(robust.kernel_id, robust.parameter, float(d)) for d in distance]
    return np.array(pairs).T[0], np.array(pairs).T[1]


@every_kernel
@pytest.mark.parametrize("factor", [1.0, 0.3])
def test_loss_and_weight_are_gtsams(name: str, factor: float) -> None:
    robust = RobustKernel(name, factor * ROBUST_KERNELS[name])
    estimators = gtsam.noiseModel.mEstimator
    given = estimators.Null.Create() if name == "Null" else getattr(estimators, name).Create(robust.parameter)
    distance = distances(robust.parameter)
    loss, weight = loss_and_weight(robust, distance)
    np.testing.assert_allclose(loss, [given.loss(d) for d in distance], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(weight, [given.weight(d) for d in distance], rtol=1e-12, atol=1e-15)


@every_kernel
def test_weight_times_distance_is_the_slope_of_the_loss(name: str) -> None:
    robust = RobustKernel.named(name)
    k = robust.parameter
    distance = np.array([d for d in distances(k) if 1e-3 < d < 100 and min(abs(d - k), abs(d - np.sqrt(k))) > 1e-4])
    step = 1e-5
    above, below = (loss_and_weight(robust, distance + s)[0] for s in (step, -step))
    slope = distance * loss_and_weight(robust, distance)[1]
    np.testing.assert_allclose(slope, (above - below) / (2 * step), rtol=1e-6, atol=1e-7)


@every_kernel
def test_the_noise_model_whitens_and_weighs(name: str) -> None:
    robust = RobustKernel.named(name)
    residual = np.array([3.0, -4.0])
    model = robust.noise_model(0.5, 2)
    loss, _ = robust_loss_and_weight(robust.kernel_id, robust.parameter, 10.0)
    assert model.loss(model.squaredMahalanobisDistance(residual)) == pytest.approx(loss, rel=1e-12)


def test_the_default_is_plain_least_squares() -> None:
    assert RobustKernel.named("Null") == GAUSSIAN
    assert robust_loss_and_weight(GAUSSIAN.kernel_id, GAUSSIAN.parameter, 3.0) == (4.5, 1.0)


def test_names_and_parameters_are_checked() -> None:
    with pytest.raises(ValueError, match=r"unknown robust kernel 'Hubert'; choose from Null, Fair, Huber"):
        RobustKernel.named("Hubert")
    for parameter in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match=r"robust kernel Huber: parameter=.*, expected a positive one"):
            RobustKernel("Huber", parameter)
