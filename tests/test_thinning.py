"""Long recordings: what is found from a part of them first is what is found from all of them at once."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from gtcal import Calibration, CalibrationOptions, synchronise
from gtcal.estimation import clustered, hold_out, thinning
from gtcal.estimation.adjustment import adjust
from gtcal.estimation.clustered import weight_of_lenses
from gtcal.estimation.frame_statistics import frames_of
from gtcal.estimation.observations import Observations
from gtcal.estimation.residuals import select_views
from gtcal.estimation.solver import calibrate_observations
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate

N_FRAMES = 160


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    noise = MocapNoise(translation_mm=0.2, rotation_deg=0.02)
    return simulate(SimulationOptions(n_frames=N_FRAMES, duration_s=80.0, mocap=noise, swap_share=0.02), seed=3)


@pytest.fixture(scope="module")
def observations(simulation: Simulation) -> Observations:
    return synchronise(simulation.recording)


def apart_in_sigmas(one: Calibration, other: Calibration) -> float:
    """The largest component, over the cameras."""
    steps = []
    for name, camera in one.cameras.items():
        here, there = camera.camera_T_ref, other.cameras[name].camera_T_ref
        assert here.covariance is not None
        xi = gtsam.Pose3(here.a_T_b).localCoordinates(gtsam.Pose3(there.a_T_b))
        steps.append(np.abs(xi / np.sqrt(np.diag(here.covariance))).max())
    return float(max(steps))


def test_from_a_part_first_is_from_all_at_once(observations: Observations, monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = calibrate_observations(observations)
    monkeypatch.setattr(thinning, "MOST_FRAMES", 40)
    monkeypatch.setattr(thinning, "LEAST_VIEWS", 20)
    assert thinning.is_long(observations.views)
    from_a_part = calibrate_observations(observations)
    assert at_once.mocap_noise is not None
    assert from_a_part.mocap_noise is not None
    assert from_a_part.mocap_noise.stage == at_once.mocap_noise.stage == 4
    views, others = ([one.n_views for one in found.dropped] for found in (from_a_part, at_once))
    assert views == others
    assert apart_in_sigmas(from_a_part, at_once) < 0.02
    stage_3 = {which: found.estimates[3] for which, found in (("all", at_once), ("part", from_a_part))}
    np.testing.assert_allclose(stage_3["part"].body_T_board, stage_3["all"].body_T_board, atol=2e-5)


def test_a_part_is_spread_evenly_and_leaves_no_camera_with_a_handful(
    observations: Observations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(thinning, "MOST_FRAMES", 40)
    monkeypatch.setattr(thinning, "LEAST_VIEWS", 12)
    names = list(observations.views)
    seldom = select_views(observations.views[names[0]], np.arange(1, 61, 4))
    few = thinning.thinned({**observations.views, names[0]: seldom})
    assert few[names[0]].n_views == 12  # of which the chosen frames alone would leave fewer
    assert len(frames_of({names[1]: few[names[1]], names[2]: few[names[2]]})) <= 40
    gaps = np.diff(few[names[1]].frame_index)
    assert gaps.min() == 4


@pytest.mark.long
def test_some_frames_weigh_the_lenses_as_all_do(
    simulation: Simulation, observations: Observations, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = CalibrationOptions()
    truth = calibrate_observations(observations, replace(options, mocap="exact")).estimate
    adjusted = adjust(observations.views, truth, options)
    of_all = weight_of_lenses(adjusted, options, N_FRAMES)
    monkeypatch.setattr(clustered, "MOST_WEIGHED", 80)
    assert abs(np.log(weight_of_lenses(adjusted, options, N_FRAMES) / of_all)) < np.log(1.5)


@pytest.mark.long
def test_the_hold_out_error_is_that_of_blocks_cut_short(
    observations: Observations, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = calibrate_observations(observations).mocap_noise
    monkeypatch.setattr(hold_out, "MOST_IN_FOLD", 8)
    cut = calibrate_observations(observations).mocap_noise
    assert whole is not None
    assert cut is not None
    assert cut.hold_out_px != whole.hold_out_px
    for stage, error_px in whole.hold_out_px.items():
        assert cut.hold_out_px[stage] == pytest.approx(error_px, rel=0.15)
