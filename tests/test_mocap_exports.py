"""Simulated recordings in the files of mocap programs: what is written is read back, whatever the format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from cli_support import run
from support import wandering_trajectory

from gtcal.cli.simulate import MocapFormatName
from gtcal.errors import GtcalError
from gtcal.readers import inspect_mocap
from gtcal.readers.mocap_exports import EXPORT_WRITERS, MocapFormat
from gtcal.recordings.recording import load_recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation import MocapNoise, write_simulation
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop_recording import load_lollypop_recording

every_format = pytest.mark.parametrize("mocap_format", EXPORT_WRITERS)


def same(found: Trajectory, written: Trajectory) -> None:
    assert np.abs(found.stamps_ns - written.stamps_ns).max() <= 2
    np.testing.assert_allclose(found.world_T_body, written.world_T_body, rtol=0, atol=1e-9)


@every_format
def test_a_recording_with_gaps_is_read_back(mocap_format: MocapFormat, tmp_path: Path) -> None:
    if mocap_format == "rosbag":
        pytest.importorskip("rosbags")
    simulation = simulated(HEADSET, frames=12, mocap=MocapNoise(0.1, 0.01, gap_share=0.1), mocap_rate_hz=119.88)
    write_simulation(simulation, tmp_path / "r", images=False, mocap_format=mocap_format)
    written = simulation.recording.motion.trajectories
    assert any(np.diff(body.stamps_ns).max() > 1e8 for body in written.values())  # there are gaps
    found = load_recording(tmp_path / "r").motion.trajectories
    assert set(found) == set(written)
    for name, trajectory in written.items():
        same(found[name], trajectory)


@every_format
def test_so_is_one_of_the_lollypop(mocap_format: MocapFormat, tmp_path: Path) -> None:
    if mocap_format == "rosbag":
        pytest.importorskip("rosbags")
    simulation = simulate_lollypop(LollypopOptions(n_frames=10, duration_s=4.0), seed=1)
    write_lollypop_simulation(simulation, tmp_path / "r", images=False, mocap_format=mocap_format)
    found = load_lollypop_recording(tmp_path / "r")
    same(found.device_body, simulation.recording.device_body)
    same(found.platform, simulation.recording.platform)


@pytest.mark.parametrize("mocap_format", ["motive_csv", "vicon_csv"])
def test_stamps_that_jitter_are_refused_where_a_format_knows_frames_only(
    mocap_format: MocapFormat, tmp_path: Path
) -> None:
    body = wandering_trajectory("board_body")
    uneven = replace(body, stamps_ns=body.stamps_ns + 50_000 * (np.arange(body.n_samples) % 3))
    with pytest.raises(GtcalError, match=r"board_body: its stamps are up to .* us off a rate of"):
        EXPORT_WRITERS[mocap_format](tmp_path, {"board_body": uneven})
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_what_motive_would(tmp_path: Path) -> None:
    arguments = ["--frames", "30", "--duration-s", "20", "--mocap-format", "motive_csv", "-q"]
    assert run("simulate", "-o", tmp_path / "r", *arguments).code == 0
    summary = inspect_mocap(tmp_path / "r" / "take.csv")
    assert summary.format == "motive_csv"
    assert {body.name for body in summary.bodies} == {"platform", "board_body"}
    assert set(get_args(MocapFormatName)) == set(EXPORT_WRITERS) == set(get_args(MocapFormat))
    assert run("calibrate", tmp_path / "r", "-o", tmp_path / "c.json", "--no-effects", "-q").code == 0


def test_bags_need_their_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    with pytest.raises(GtcalError, match=r"needs rosbags; pip install 'gtcal\[bags\]'"):
        EXPORT_WRITERS["rosbag"](tmp_path, {})
