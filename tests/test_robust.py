"""The robust kernels are GTSAM's, by name, value and weight."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated

from factors import GAUSSIAN, PINHOLE_RADTAN, ROBUST_KERNELS, CalledBackKernel, CornerViews, RobustKernel, kernel_of
from factors.reprojection import view_moments
from factors.robust import robust_loss_and_weight
from gtcal import CalibrationOptions, GtcalError, calibrate

estimators = gtsam.noiseModel.mEstimator

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


@every_kernel
def test_gtsams_own_estimators_are_compiled(name: str) -> None:
    k = 0.7 * ROBUST_KERNELS[name]
    given = estimators.Null.Create() if name == "Null" else getattr(estimators, name).Create(k)
    assert CalibrationOptions(robust=given).robust == RobustKernel(name, k)
    assert CalibrationOptions(robust=name).robust == RobustKernel.named(name)


def huber_of_ones_own(k: float = 1.345) -> gtsam.noiseModel.mEstimator.Custom:
    return estimators.Custom.Create(
        weight=lambda d: 1.0 if d <= k else k / d, loss=lambda d: 0.5 * d * d if d <= k else k * (d - 0.5 * k)
    )


@pytest.mark.parametrize("with_moments", [True, False])
def test_one_called_back_sums_up_to_what_the_compiled_one_does(with_moments: bool) -> None:
    random = np.random.default_rng(3)
    views, poses = (
        CornerViews(
            np.array([0, 40, 90]), random.uniform(-0.3, 0.3, (90, 3)), random.uniform(0, 600, (90, 2)), sigma_px=20.0
        ),
        np.tile(np.eye(4), (2, 1, 1)),
    )
    poses[:, 2, 3] = 1.0
    poses[1, 2, 3] = -0.1  # behind the camera, where corners have no pixel
    theta = np.array([400.0, 400.0, 300.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    ours, compiled = (
        view_moments(views, poses, PINHOLE_RADTAN, theta, robust=robust, with_theta=True, with_moments=with_moments)
        for robust in (kernel_of(huber_of_ones_own()), RobustKernel("Huber", 1.345))
    )
    assert isinstance(kernel_of(huber_of_ones_own()), CalledBackKernel)
    assert compiled.n_invalid.any()
    for name in ("moments", "loss", "n_invalid"):
        np.testing.assert_allclose(getattr(ours, name), getattr(compiled, name), rtol=1e-12)


def test_one_called_back_gives_the_same_calibration_and_says_that_it_is_slower(
    caplog: pytest.LogCaptureFixture,
) -> None:
    recording = simulated(HEADSET, frames=12).recording
    plain = {"mocap": "exact", "effects": False, "clock": "trust"}
    compiled, ours = (
        calibrate(recording, CalibrationOptions(robust=robust, **plain)) for robust in ("Huber", huber_of_ones_own())
    )
    assert "robust kernel Custom is called back from Python for every corner: slower" in caplog.text
    assert ours.provenance.options["robust"] == {"name": "Custom", "called_back": True}
    for name, camera in compiled.cameras.items():
        np.testing.assert_allclose(ours.cameras[name].camera_T_ref.a_T_b, camera.camera_T_ref.a_T_b, atol=1e-9)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (3, "robust kernel 3: expected a name (Null, Fair, "),
        (None, "robust kernel None: expected a name"),
        (gtsam.noiseModel.Unit.Create(2), "robust kernel unit (2): expected a name"),
        ("huber", "unknown robust kernel 'huber'; choose from Null, Fair, Huber"),
        (estimators.Huber.Create(1.0, estimators.Base.ReweightScheme.Scalar), "weighs each coordinate by itself"),
        (estimators.Custom.Create(lambda d: 1.0, lambda d: d), "its weight times the distance is"),
        (estimators.Custom.Create(lambda d: float("nan"), lambda d: d), "are not finite numbers"),
    ],
)
def test_what_is_no_kernel_is_refused_where_it_is_given(given: object, told: str) -> None:
    with pytest.raises(GtcalError) as refused:
        CalibrationOptions(robust=given)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_graduated_needs_one_whose_width_is_known() -> None:
    with pytest.raises(GtcalError, match=r"needs a redescending kernel .*, not 'Custom'"):
        CalibrationOptions(robust=huber_of_ones_own(), graduated=True)
