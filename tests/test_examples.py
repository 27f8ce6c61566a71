"""The worked examples of scripts/, each in small: that they run, and that what they show is so."""

from __future__ import annotations

import example_calibrate_verify
import example_own_camera_model
import example_own_effect
import example_uncertainty
import numpy as np
import pytest
from factors_support import numeric_derivative

from factors import CAMERA_MODELS
from gtcal.verification.verification import Verdict


def test_calibrate_and_verify(capsys: pytest.CaptureFixture[str]) -> None:
    verification, figures = example_calibrate_verify.main(n_frames=30, n_sightings=140)
    shown = capsys.readouterr().out
    assert verification.verdict is Verdict.PASS
    assert "where they are" in shown
    assert "PASS: the calibration holds" in shown
    assert set(figures) == {"cameras", "residuals", "residuals_over_time", "heat_maps"}


@pytest.mark.long
def test_more_of_the_motion_lowers_the_uncertainty() -> None:
    before, after = example_uncertainty.main()
    assert all(after[name] < 0.6 * before[name] for name in before)


@pytest.mark.long
def test_an_own_camera_model(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(example_own_camera_model, "register_camera_model", _registered_for(monkeypatch))
    calibration = example_own_camera_model.main()
    assert calibration.rmse_px < 0.3
    model, theta = example_own_camera_model.FIELD_OF_VIEW, np.array([560.0, 561.0, 640.0, 512.0, 0.95])
    points = np.random.default_rng(0).normal(loc=(0.0, 0.0, 2.0), size=(50, 3))
    pixels, valid, J_point, J_theta = model.project_with_jacobians(points, theta)
    assert valid.all()
    by_theta = numeric_derivative(lambda t: model.project(points, t)[0], theta, 1e-6)
    np.testing.assert_allclose(J_theta, by_theta, rtol=1e-6, atol=1e-5)
    by_point = numeric_derivative(lambda p: model.project(p, theta)[0], points, 1e-6)
    np.testing.assert_allclose(J_point, by_point, rtol=1e-5, atol=1e-4)
    back, found = model.unproject(pixels, theta)
    assert found.all()
    np.testing.assert_allclose(back, points / np.linalg.norm(points, axis=1, keepdims=True), atol=1e-9)


def _registered_for(monkeypatch: pytest.MonkeyPatch):
    """For the time of a test: others look at every model there is."""

    def register(model):
        monkeypatch.setitem(CAMERA_MODELS, model.name, model)
        return model

    return register


@pytest.mark.long
def test_an_own_effect() -> None:
    clean, creeping = example_own_effect.main(n_frames=200).values()
    assert not clean.significant
    assert creeping.significant
    assert creeping.name == "creep of the board along its x axis" or creeping.p_value < 1e-6
