"""Two cameras whose images are swapped: one recording can't tell, what is known of the rig can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from scipy.spatial.transform import Rotation

from gtcal import CalibrationOptions, GtcalError, Recording, calibrate
from gtcal.differences.carried_over import EarlierCalibration
from gtcal.differences.exchanged import exchanged_cameras, known_pairs, pairs_of_priors
from gtcal.estimation.earlier import Growth
from gtcal.estimation.priors import PosePrior, Priors
from gtcal.simulation.fault import small_motion
from gtcal.simulation.simulate import simulate_take

QUICK = CalibrationOptions(effects=False, clock="trust", mocap="exact")
SIDES = ("side_left", "side_right")


def with_swapped_images(recording: Recording, cameras: tuple[str, str]) -> Recording:
    a, b = cameras
    found = recording.detections
    return replace(recording, detections={**found, a: found[b], b: found[a]})


def rig_priors(known: dict[tuple[str, str], np.ndarray], sigma_m: float | None = 0.0005) -> Priors:
    return Priors(
        camera_a_T_camera_b={
            pair: PosePrior(
                tuple(pose[:3, 3]),
                tuple(np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)),
                (0.0005, 0.0005, sigma_m),
                (0.002,) * 3,
            )
            for pair, pose in known.items()
        }
    )


@pytest.mark.parametrize("swapped", [SIDES, ("front_left", "front_right"), ("front_left", "side_right")])
def test_of_a_rig_that_is_known_two_swapped_cameras_are_named(swapped: tuple[str, str]) -> None:
    true = simulated(HEADSET).truth.camera_T_ref
    a, b = swapped
    ref_T_new_ref = small_motion((300.0, 0.0, 50.0), (0.0, 40.0, 0.0))  # ref may have been defined anew
    found = {name: pose @ ref_T_new_ref for name, pose in {**true, a: true[b], b: true[a]}.items()}
    told = exchanged_cameras(found, known_pairs(true))
    assert told is not None
    assert set(told.cameras) == set(swapped)
    assert told.exchanged_mm < 1e-6 < 5.0 < told.as_named_mm
    assert f"cameras {told.cameras[0]!r} and {told.cameras[1]!r} stand where the other one should" in told.statement


def test_a_camera_that_was_bumped_is_no_other_one() -> None:
    true = simulated(HEADSET).truth.camera_T_ref
    bumped = {**true, "side_left": small_motion((8.0, 5.0, 0.0), (0.0, 6.0, 2.0)) @ true["side_left"]}
    assert exchanged_cameras(bumped, known_pairs(true)) is None
    assert exchanged_cameras(true, known_pairs(true)) is None
    assert exchanged_cameras(true, {}) is None
    assert exchanged_cameras({"front_left": true["front_left"]}, known_pairs(true)) is None


def test_priors_of_the_rig_refuse_them_in_a_line_and_let_the_right_ones_pass() -> None:
    simulation = simulated(HEADSET)
    known = known_pairs(simulation.truth.camera_T_ref)
    options = replace(QUICK, priors=rig_priors(known))
    with pytest.raises(GtcalError, match="by the priors, cameras 'side_left' and 'side_right' stand where") as caught:
        calibrate(with_swapped_images(simulation.recording, SIDES), options)
    assert "\n" not in str(caught.value)
    assert "exchange them in the manifest" in str(caught.value)
    assert not any("contradict" in line for line in calibrate(simulation.recording, options).warnings)


def test_priors_of_places_in_ref_count_too_and_parts_of_a_pose_do_not() -> None:
    true = simulated(HEADSET).truth.camera_T_ref
    known = known_pairs(true)
    assert pairs_of_priors(rig_priors(known, sigma_m=None)) == {}
    in_ref = {
        name: PosePrior(
            tuple(np.linalg.inv(pose)[:3, 3]),
            tuple(np.roll(Rotation.from_matrix(pose[:3, :3].T).as_quat(), 1)),
            (0.001,) * 3,
            (0.001,) * 3,
        )
        for name, pose in true.items()
    }
    pairs = pairs_of_priors(Priors(ref_T_camera=in_ref))
    assert set(pairs) == set(known)
    for pair, pose in pairs.items():
        np.testing.assert_allclose(pose, known[pair], atol=1e-9)


@pytest.mark.long
def test_an_earlier_calibration_names_them_first() -> None:
    first = simulated(HEADSET, frames=60)
    options = replace(QUICK, mocap="estimate")
    earlier = EarlierCalibration(calibrate(first.recording, options), Growth())
    later = simulate_take(replace(first.options, n_frames=30), seed=0, take=2).recording
    found = calibrate(with_swapped_images(later, SIDES), options, earlier=earlier)
    assert found.carried_over is not None
    assert "cameras 'side_left' and 'side_right' stand where the other one should" in found.carried_over.moved[0]
    right = calibrate(later, options, earlier=earlier)
    assert right.carried_over is not None
    assert not any("stand where" in line for line in right.carried_over.moved)
