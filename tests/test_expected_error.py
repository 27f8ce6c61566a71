"""The Lollypop's error against the calibration's own covariance: agreement where it holds, and only there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gtcal import (
    Calibration,
    VerificationOptions,
    calibrate_observations,
    read_verification,
    synchronise,
    verify,
    write_verification,
)
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.expected_error import expected_error
from gtcal.verification.verification import ExpectedError, Verification

NOISE = MocapNoise(0.1, 0.01, correlation_s=0.1)


@cache
def calibrated(seed: int) -> tuple[Simulation, Calibration]:
    simulation = simulate(SimulationOptions(mocap=NOISE), seed=seed)
    return simulation, calibrate_observations(synchronise(simulation.recording))


@cache
def verified(seed: int, *, moved: bool = False) -> Verification:
    simulation, calibration = calibrated(seed)
    fault = RigFault(cameras={"side_left": small_motion([0.5, 0.0, 0.0], [0.0, 0.03, 0.0])}) if moved else RigFault()
    options = LollypopOptions(mocap=NOISE, calibrated_in=simulation.scene, fault=fault)
    return verify(simulate_lollypop(options, seed=seed + 1).recording, calibration)


@pytest.mark.long
def test_a_true_calibration_agrees_with_its_covariance() -> None:
    found = [camera.expected for seed in range(5) for camera in verified(seed).cameras.values() if camera.expected]
    assert len(found) >= 18
    assert 0.7 < np.mean([expected.normalised for expected in found]) < 1.25
    assert np.mean([expected.agrees for expected in found]) > 0.9
    assert all(0.01 < expected.predicted_px < 0.1 for expected in found)


@pytest.mark.long
def test_a_camera_that_moved_since_does_not() -> None:
    cameras = verified(1, moved=True).cameras
    assert {name: camera.expected.agrees for name, camera in cameras.items()} == {
        "front_left": True,
        "front_right": True,
        "side_left": False,
        "side_right": True,
    }
    assert "larger than its covariance explains" in cameras["side_left"].expected.statement
    assert cameras["side_left"].expected.observed_px > 5.0 * cameras["side_left"].expected.predicted_px


@pytest.mark.long
def test_a_covariance_that_claims_too_much_is_found_out() -> None:
    """The naive one of stage 3, whose estimate a noisy mocap has moved."""
    noisy = MocapNoise(0.5, 0.05)
    simulation = simulate(SimulationOptions(mocap=noisy), seed=3)
    found = calibrate_observations(synchronise(simulation.recording))
    naive = found.covariances["naive"]
    third = found.estimates[3]
    cameras = {
        name: replace(camera, camera_T_ref=replace(camera.camera_T_ref, a_T_b=third.camera_T_ref[name]))
        for name, camera in found.cameras.items()
    }
    overconfident = replace(found, cameras=cameras, covariance_kind="naive", covariances={"naive": naive})
    lollypop = simulate_lollypop(LollypopOptions(calibrated_in=simulation.scene), seed=4).recording
    by_claim = [verify(lollypop, calibration) for calibration in (overconfident, found)]
    disagreeing = [sum(not c.expected.agrees for c in v.cameras.values() if c.expected) for v in by_claim]
    assert disagreeing[0] >= 2
    assert disagreeing[1] == 0


def test_it_is_kept_in_the_file_and_may_be_absent(tmp_path: Path) -> None:
    found = verified(1)
    write_verification(tmp_path / "v.json", found)
    read = read_verification(tmp_path / "v.json")
    assert read.cameras["side_left"].expected == found.cameras["side_left"].expected
    seen = found.sightings["side_left"]
    assert expected_error("side_left", seen, replace(found.calibration, covariances={})) is None
    few = verify(found.recording, replace(found.calibration, covariances={}), VerificationOptions())
    assert few.cameras["side_left"].expected is None


@pytest.mark.parametrize(("agrees", "words"), [(True, ": agrees"), (False, "drift, or an error of the model")])
def test_it_says_so(agrees: bool, words: str) -> None:
    assert words in ExpectedError(0.04, 0.05, 0.02, 1.0, 0.5, agrees).statement
