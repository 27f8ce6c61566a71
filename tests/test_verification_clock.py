"""Verification with clocks that do not run alike, and with rolling shutters."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from cli_support import run

from gtcal import VerificationOptions, read_verification, verify, write_calibration
from gtcal.camera import RollingShutter
from gtcal.errors import GtcalError
from gtcal.results.calibration import Calibration, Clock
from gtcal.simulation import quest3_like_rig
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, LollypopSimulation, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.verification import Verdict


@cache
def recorded(offset_s: float = 0.0, moved: bool = False, rolling: bool = False) -> LollypopSimulation:
    """Cameras whose stamps run ahead by this."""
    rig = quest3_like_rig()
    if rolling:
        shutter = RollingShutter(0.02, "first")
        rig = replace(rig, cameras=tuple(replace(camera, rolling_shutter=shutter) for camera in rig.cameras))
    fault = RigFault(cameras={"side_left": small_motion((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))}) if moved else RigFault()
    return simulate_lollypop(LollypopOptions(rig=rig, fault=fault, clock_offset_s=offset_s), seed=3)


def with_clock(calibration: Calibration, offset_s: float) -> Calibration:
    names = list(calibration.cameras)
    return replace(calibration, clock=Clock(dict.fromkeys(names, offset_s), dict.fromkeys(names, 1e-4), corrected=True))


def test_an_offset_is_the_finding_where_the_stamps_are_trusted() -> None:
    simulation = recorded(0.008)
    found = verify(simulation.recording, simulation.true_calibration())
    (fault,) = found.faults
    assert (fault.kind, fault.camera) == ("clock_offset", None)
    assert fault.offset_s == pytest.approx(-0.008, abs=5e-4)
    assert "the cameras' clock is off: -8." in fault.sentence or "the cameras' clock is off: -7." in fault.sentence
    assert not verify(recorded().recording, recorded().true_calibration()).faults


def test_the_calibrations_offset_is_applied_unless_the_stamps_are_trusted() -> None:
    simulation = recorded(0.05)
    calibration = with_clock(simulation.true_calibration(), -0.05)
    found = verify(simulation.recording, calibration)
    assert found.verdict is Verdict.PASS
    assert not found.faults
    trusted = verify(simulation.recording, calibration, VerificationOptions(clock="trust"))
    assert trusted.verdict is Verdict.FAIL
    assert trusted.pooled_px.rmse > 5.0 * found.pooled_px.rmse


def test_an_offset_of_the_recordings_own_is_found_and_hides_no_camera_that_moved() -> None:
    simulation = recorded(0.03, moved=True)
    calibration = with_clock(simulation.true_calibration(), -0.01)
    found = verify(simulation.recording, calibration, VerificationOptions(clock="estimate"))
    offset_s, sigma_s = found.clock_offset_s
    assert abs(offset_s + 0.02) < max(4.0 * sigma_s, 5e-4)
    assert [(fault.kind, fault.camera) for fault in found.faults] == [("camera_moved", "side_left")]
    assert "-20." in found.clock_lines[0] or "-19." in found.clock_lines[0]


def test_a_rolling_shutter_of_the_calibration_is_counted_in() -> None:
    simulation = recorded(rolling=True)
    calibration = simulation.true_calibration()
    found = verify(simulation.recording, calibration)
    assert not found.faults
    ignored = replace(
        calibration,
        cameras={
            name: replace(calibrated, camera=replace(calibrated.camera, rolling_shutter=None))
            for name, calibrated in calibration.cameras.items()
        },
    )
    assert verify(simulation.recording, ignored).pooled_px.rmse > 2.0 * found.pooled_px.rmse
    unknown = RollingShutter(None, "first")
    asked = {n: replace(c, camera=replace(c.camera, rolling_shutter=unknown)) for n, c in calibration.cameras.items()}
    with pytest.raises(GtcalError, match="knows no readout time"):
        verify(simulation.recording, replace(calibration, cameras=asked))


def test_the_command_finds_it_and_keeps_it(tmp_path: Path) -> None:
    simulation = recorded(0.03)
    write_lollypop_simulation(simulation, tmp_path / "lollypop", images=False)
    write_calibration(tmp_path / "c.json", simulation.true_calibration())
    arguments = ["verify", tmp_path / "c.json", tmp_path / "lollypop", "-o", tmp_path / "v.json"]
    assert run(*arguments).code == 3
    ran = run(*arguments, "--clock", "estimate")
    assert (ran.code, ran.err) == (0, "")
    assert "added to the cameras' stamps, as the sightings want" in " ".join(ran.out.split())
    assert read_verification(tmp_path / "v.json").clock_offset_s[0] == pytest.approx(-0.03, abs=5e-4)
