"""A recording that grows: what is still weak is said after each change, and when it is enough."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from cli_support import run
from media_support import small_simulation

from gtcal import CalibrationOptions, GtcalError, calibrate
from gtcal.overview.live import MOST_VIEWS, Enough, Watcher, watch
from gtcal.recordings.recording import Recording, write_recording
from gtcal.simulation import MocapNoise, write_simulation
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.lollypop_recording import write_lollypop_recording

NOISY = MocapNoise(translation_mm=0.1, rotation_deg=0.01)


def until(recording: Recording, share: float) -> Recording:
    """The recording as it was after this share of its time."""
    bodies = {}
    for name, body in recording.motion.trajectories.items():
        n = int(share * body.n_samples)
        bodies[name] = replace(body, stamps_ns=body.stamps_ns[:n], world_T_body=body.world_T_body[:n])
    end_ns = min(body.stamps_ns[-1] for body in bodies.values())
    detections = {name: seen.select_views(seen.stamps_ns < end_ns) for name, seen in recording.detections.items()}
    return replace(recording, detections=detections, **bodies)


def write_over(recording: Recording, folder: Path) -> None:
    """What a recorder leaves: the same files, longer."""
    shutil.rmtree(folder, ignore_errors=True)
    write_recording(recording, folder)


@pytest.mark.long
def test_it_grows_surer_says_what_is_missing_and_when_it_is_enough(tmp_path: Path) -> None:
    whole = simulated(HEADSET, seed=1, frames=120, mocap=NOISY, duration_s=80.0).recording
    looks = []
    for share in (0.1, 0.3, 1.0):
        write_over(until(whole, share), tmp_path / "r")
        looks.append(next(watch(tmp_path / "r", Enough(mm=0.035, deg=0.005))))
    largest = [max(look.sigma_mm.values()) for look in looks]
    assert all(np.diff(largest) < 0.0)
    assert not looks[0].is_enough
    assert any("camera" in line or "turn" in line for line in looks[0].advice)
    assert looks[-1].is_enough
    assert looks[-1].advice == ("enough: every camera is as sure as was asked for",)
    assert looks[-1].n_views["front_left"] > looks[0].n_views["front_left"] > 0


@pytest.mark.long
def test_a_look_is_about_as_sure_as_the_calibration_will_be(tmp_path: Path) -> None:
    """Some of the views are looked at; what they make of all is what calibrating all of them gives."""
    recording = simulated(HEADSET, seed=1, frames=120, mocap=NOISY, duration_s=80.0).recording
    write_over(recording, tmp_path / "r")
    look = next(watch(tmp_path / "r"))
    assert look.n_views["front_left"] > 4 * MOST_VIEWS
    calibration = calibrate(recording, CalibrationOptions(effects=False))
    for name, camera in calibration.cameras.items():
        assert 0.5 < look.sigma_mm[name] / camera.camera_T_ref.position_of_a_in_b_sigma_mm.max() < 2.0


def test_half_written_files_are_a_line_and_not_the_end(tmp_path: Path) -> None:
    whole = simulated(HEADSET, seed=1, frames=40).recording
    write_over(whole, tmp_path / "r")
    (tmp_path / "r" / "platform.csv").write_bytes((tmp_path / "r" / "platform.csv").read_bytes()[:-20])
    looks = watch(tmp_path / "r", poll_s=0.01)
    assert "platform.csv" in next(looks).problem
    write_over(whole, tmp_path / "r")
    assert next(looks).sigma_mm
    with pytest.raises(GtcalError, match="enough: mm is 0"):
        Enough(mm=0.0)


def test_images_are_detected_once_and_new_ones_as_they_come(tmp_path: Path) -> None:
    write_simulation(small_simulation(), tmp_path / "r", images=True)
    images = sorted((tmp_path / "r").glob("cam*/*.png")) or sorted((tmp_path / "r").rglob("*.png"))
    kept = images[-1].read_bytes()
    images[-1].unlink()
    watcher = Watcher(tmp_path / "r", Enough())
    watcher.look()
    before = {name: set(seen) for name, seen in watcher.seen.items()}
    assert sum(map(len, before.values())) > 0
    images[-1].write_bytes(kept)
    watcher.look()
    after = {name: set(seen) for name, seen in watcher.seen.items()}
    assert all(before[name] <= after[name] for name in before)
    assert int(images[-1].stem) in set().union(*after.values()) - set().union(*before.values())


def test_what_is_no_recording_ends_with_a_line(tmp_path: Path) -> None:
    write_lollypop_recording(simulate_lollypop(LollypopOptions(n_frames=10), seed=1).recording, tmp_path / "lollypop")
    (tmp_path / "calibration.json").write_text('{"gtcal_calibration": 1}')
    (tmp_path / "images").mkdir()
    told = {
        "absent": "there is no such recording",
        "images": "there is no manifest in this folder",
        "calibration.json": "is a calibration of gtcal, not the manifest of a recording",
        "lollypop": "this is a recording of a Lollypop",
    }
    for name, message in told.items():
        ran = run("info", tmp_path / name, "--live")
        assert (ran.code, ran.out, ran.err.count("\n")) == (1, "", 1)
        assert message in ran.err


def test_it_goes_without_a_figure(tmp_path: Path) -> None:
    ran = run("info", tmp_path, "--live", "--figure", tmp_path / "x.png")
    assert ran.code == 1
    assert "--live prints what it sees" in ran.err


@pytest.mark.long
def test_the_command_watches_until_it_is_ended(tmp_path: Path) -> None:
    write_over(simulated(HEADSET, seed=1, frames=60, mocap=NOISY).recording, tmp_path / "r")
    arguments = [sys.executable, "-m", "gtcal", "info", str(tmp_path / "r"), "--live"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = []
        while not any(line.startswith("asked for: 0.2 mm, 0.02 deg") for line in lines):
            lines.append(process.stdout.readline())
            assert lines[-1]
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert rest[1] == "gtcal: interrupted\n"
    assert any("front_left" in line for line in lines)
