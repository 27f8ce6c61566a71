"""Unsynchronised clocks: the offset found, its sigma true, and said where it should not be there."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_support import HEADSET, errors, simulated, worst
from cli_support import run

from gtcal import CalibrationOptions, GtcalError, calibrate, load_recording, read_calibration, synchronise
from gtcal.camera import RollingShutter
from gtcal.clock.coarse import coarse_offset_s, offset_of_turns_s
from gtcal.clock.find import with_clock
from gtcal.clock.rolling_shutter import straightened
from gtcal.clock.shift import shifted
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations
from gtcal.estimation.residuals import chain_residuals_px, select_views
from gtcal.report import gather_evidence
from gtcal.simulation import (
    MocapNoise,
    Simulation,
    SimulationOptions,
    quest3_like_rig,
    simulate,
    write_simulation,
)

NOISE = MocapNoise(0.1, 0.01)


def options(**changes: object) -> CalibrationOptions:
    """For what clocks do: the lenses are exact, and nothing else is looked for."""
    return CalibrationOptions(intrinsics="exact", effects=False, **changes)


def late(offset_s: float | tuple[float, ...], seed: int = 0, **changes: object) -> Simulation:
    """The cameras' stamps run ahead by this, so that minus this is to be added to them."""
    return simulated(HEADSET, seed=seed, mocap=NOISE, clock_offset_s=offset_s, **changes)


@pytest.mark.parametrize("ahead_s", [-0.2, -0.0431, 0.0, 0.1167, 0.2])
def test_rotations_alone_tell_the_offset_to_a_few_ms(ahead_s: float) -> None:
    assert coarse_offset_s(synchronise(late(ahead_s).recording)) == pytest.approx(-ahead_s, abs=3e-3)


@pytest.mark.long
def test_the_offset_is_found_with_a_true_sigma_and_the_extrinsics_are_as_good_as_with_the_true_clock() -> None:
    normalised, off_mm, true_mm = [], [], []
    for seed in range(4):
        ahead_s = float(np.random.default_rng(seed).uniform(-0.2, 0.2))
        simulation, synchronised = late(ahead_s, seed), late(0.0, seed)
        found = calibrate(simulation.recording, options(clock="estimate"))
        error_s = found.clock.offset_s["side_left"] + ahead_s
        assert abs(error_s) < 3e-4
        assert (found.clock.corrected, len(set(found.clock.offset_s.values()))) == (True, 1)
        normalised.append(error_s / found.clock.sigma_s["side_left"])
        off_mm.append(np.mean([mm for mm, _ in errors(found, simulation).values()]))
        true_mm.append(
            np.mean(
                [
                    mm
                    for mm, _ in errors(
                        calibrate(synchronised.recording, options(clock="trust")), synchronised
                    ).values()
                ]
            )
        )
    assert 0.2 < np.mean(np.square(normalised)) < 2.5  # chi-squared of four
    assert np.mean(off_mm) < 1.3 * np.mean(true_mm)


@pytest.mark.long
def test_every_camera_may_have_a_clock_of_its_own() -> None:
    ahead_s = (0.03, -0.02, 0.08, 0.0)
    simulation = late(ahead_s)
    found = calibrate(simulation.recording, options(clock="per_camera"))
    np.testing.assert_allclose(list(found.clock.offset_s.values()), np.negative(ahead_s), atol=5e-4)
    assert worst(errors(found, simulation).values())[0] < 0.5
    assert "for front_left; " in found.clock.statement


def test_a_drifting_clock_is_straightened() -> None:
    simulation = simulated(HEADSET, mocap=NOISE)
    observations = synchronise(simulation.recording)
    about_ns = int(observations.frame_stamps_ns.mean())
    drifting = {}
    for name, views in observations.views.items():  # the stamps, not the poses
        grown_ns = (1e-4 * (views.stamps_ns - about_ns)).astype(np.int64)
        drifting[name] = replace(views, stamps_ns=views.stamps_ns + 20_000_000 + grown_ns)
    _, clock = with_clock(replace(observations, views=drifting), options(clock="estimate", clock_drift=True))
    assert clock.offset_s["side_left"] == pytest.approx(-0.02, abs=1e-3)
    assert clock.drift == pytest.approx(-1e-4, abs=5.0 * clock.drift_sigma)
    assert clock.drift_sigma < 3e-5
    assert "growing by -" in clock.statement


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_recording_that_is_not_synchronised_is_said_not_to_be(seed: int) -> None:
    found = calibrate(late(0.0083, seed).recording, options())
    (warning,) = [w for w in found.warnings if "the data want" in w]
    assert "-8." in warning
    assert "but the recording is taken as synchronised: --clock estimate" in warning
    assert found.clock.corrected is False
    assert not [w for w in calibrate(late(0.0, seed).recording, options()).warnings if "the data want" in w]
    assert calibrate(late(0.0083, seed).recording, options(clock="trust")).clock is None


def test_shifting_is_what_synchronising_at_other_times_gives() -> None:
    simulation = late(0.1)
    observations = synchronise(simulation.recording)
    moved = shifted(observations, dict.fromkeys(observations.views, -0.1))
    truth = simulation.truth
    for name, views in moved.views.items():
        camera = truth.cameras[name]
        rows = camera.frames_of(views.stamps_ns + 100_000_000)
        offset_m = np.linalg.norm(views.ref_T_body[:, :3, 3] - camera.ref_T_body[rows][:, :3, 3], axis=1)
        assert np.median(offset_m) < 5e-4
        np.testing.assert_array_equal(moved.frame_stamps_ns[views.frame_index], views.stamps_ns)
    with pytest.raises(GtcalError, match="none of its views has a mocap pose"):
        shifted(observations, dict.fromkeys(observations.views, 1e4))


def test_what_does_not_tell_is_refused() -> None:
    observations = synchronise(simulated(HEADSET).recording)

    def first(n: int) -> Observations:
        views = {name: select_views(v, np.arange(n)) for name, v in observations.views.items()}
        return replace(observations, views=views)

    with pytest.raises(GtcalError, match="too few views to find"):
        coarse_offset_s(first(2))
    with pytest.raises(GtcalError, match="too few views to find"):
        offset_of_turns_s([], observations.motion)  # of no camera
    with pytest.raises(GtcalError, match="clock_drift asks for a clock that is estimated"):
        CalibrationOptions(clock_drift=True)
    with pytest.raises(GtcalError, match="of a clock that all cameras share"):
        CalibrationOptions(clock="per_camera", clock_drift=True)


def printed(folder: Path) -> str:
    """What ``gtcal calibrate`` says of the recording in a folder; it writes c.json there."""
    lenses = "--intrinsics", "exact", "--no-effects"
    ran = run("calibrate", folder / "recording", "-o", folder / "c.json", "--clock", "estimate", *lenses)
    assert (ran.code, ran.err) == (0, "")
    return ran.out


def test_the_command_finds_it_keeps_it_and_the_report_uses_it(tmp_path: Path) -> None:
    write_simulation(late(0.05), tmp_path / "recording", images=False)
    shown = printed(tmp_path)
    assert re.search(r"clock: -(50|49)\.\d+ ms ± 0\.\d+ added", shown)
    calibration = read_calibration(tmp_path / "c.json")
    assert calibration.clock.offset_s["front_left"] == pytest.approx(-0.05, abs=3e-4)
    assert json.loads((tmp_path / "c.json").read_text())["clock"]["corrected"] is True
    evidence = gather_evidence(calibration, load_recording(tmp_path / "recording"))
    assert all(seen.statistics.rmse_px < 0.5 for seen in evidence.cameras.values())


@pytest.mark.long
def test_the_real_recording_wants_an_offset_near_zero(vicon_recording: Callable[..., Path]) -> None:
    wanted = CalibrationOptions(intrinsics="calibrate", clock="estimate", effects=False)
    clock = calibrate(load_recording(vicon_recording()), wanted).clock
    assert abs(clock.offset_s["cam0"]) < 0.025
    assert 0.0 < clock.sigma_s["cam0"] < 0.025


def rolling(readout_s: float | None, stamped_row: str = "first", **changes: object) -> Simulation:
    """A headset whose cameras read their rows out one after the other; ``readout_s`` is what the recording states."""
    rig = quest3_like_rig()
    true = RollingShutter(READOUT_S, stamped_row)
    rig = replace(rig, cameras=tuple(replace(camera, rolling_shutter=true) for camera in rig.cameras))
    simulation = simulate(SimulationOptions(n_frames=60, duration_s=40.0, mocap=NOISE, rig=rig, **changes), seed=0)
    stated = replace(true, readout_s=readout_s)
    cameras = {name: replace(c, rolling_shutter=stated) for name, c in simulation.recording.cameras.items()}
    return replace(simulation, recording=replace(simulation.recording, cameras=cameras))


READOUT_S = 0.02


@pytest.mark.long
@pytest.mark.parametrize("stamped_row", ["first", "middle"])
def test_a_stated_rolling_shutter_is_straightened(stamped_row: str) -> None:
    simulation = rolling(READOUT_S, stamped_row)
    found = calibrate(simulation.recording, options())
    shutterless = {name: replace(c, rolling_shutter=None) for name, c in simulation.recording.cameras.items()}
    ignored = calibrate(replace(simulation.recording, cameras=shutterless), options(clock="trust"))
    true_mm = np.mean(
        [mm for mm, _ in errors(calibrate(late(0.0).recording, options(clock="trust")), late(0.0)).values()]
    )
    assert np.mean([mm for mm, _ in errors(found, simulation).values()]) < 1.5 * true_mm
    assert np.mean([mm for mm, _ in errors(ignored, simulation).values()]) > 2.5 * true_mm
    assert abs(found.clock.offset_s["side_left"]) < 3e-4
    assert not [w for w in found.warnings if "the data want" in w]


@pytest.mark.long
def test_the_readout_time_is_found_with_the_clock_offset() -> None:
    simulation = rolling(None, clock_offset_s=0.05)
    found = calibrate(simulation.recording, options(clock="estimate"))
    assert found.clock.offset_s["side_left"] == pytest.approx(-0.05, abs=3e-4)
    for name, seconds in found.clock.readout_s.items():
        sigma_s = found.clock.readout_sigma_s[name]
        assert abs(seconds - READOUT_S) < min(4.0 * sigma_s, 1e-3)
        assert found.cameras[name].camera.rolling_shutter.readout_s == seconds
    assert worst(errors(found, simulation).values())[0] < 0.5


def test_a_rolling_shutter_of_unknown_readout_is_asked_for() -> None:
    with pytest.raises(GtcalError, match="has a rolling shutter without readout_ms; give it"):
        calibrate(rolling(None).recording, options())


@pytest.mark.long
def test_a_rolling_shutter_is_kept_in_the_files_and_the_report(tmp_path: Path) -> None:
    simulation = rolling(None, clock_offset_s=0.01)
    write_simulation(simulation, tmp_path / "recording", images=False)
    shown = printed(tmp_path)
    assert "camera 'front_left' reads its rows out in 2" in shown or "in 19." in shown
    calibration = read_calibration(tmp_path / "c.json")
    evidence = gather_evidence(calibration, load_recording(tmp_path / "recording"))
    assert all(seen.statistics.rmse_px < 0.5 for seen in evidence.cameras.values())


def test_row_shifts_are_differences_of_projections_at_the_rows_times() -> None:
    simulation = rolling(READOUT_S, mocap_rate_hz=500.0)
    observations = synchronise(simulation.recording)
    truth = simulation.truth
    theta = {name: views.camera.theta for name, views in observations.views.items()}
    estimate = Estimate(truth.body_T_board, truth.camera_T_ref, theta)
    left = np.concatenate(
        [chain_residuals_px(views, estimate) for views in straightened(observations, estimate).views.values()]
    )
    before = np.concatenate([chain_residuals_px(views, estimate) for views in observations.views.values()])
    assert np.sqrt(np.nanmean(left**2)) < 0.25 * np.sqrt(np.nanmean(before**2))
