"""How sure it is, on the page and in the terminal."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from calibration_support import HEADSET, simulated
from cli_support import run
from markupsafe import escape

from gtcal import Calibration, CalibrationOptions, calibrate_observations, synchronise, write_calibration
from gtcal.report.page import render
from gtcal.report.uncertainty_part import noise_lines, uncertainty_part
from gtcal.simulation import MocapNoise


@pytest.fixture(scope="module", name="found")
def _found() -> Calibration:
    simulation = simulated(HEADSET, frames=90, mocap=MocapNoise(0.1, 0.01))
    return calibrate_observations(synchronise(simulation.recording), CalibrationOptions(intrinsics="refine"))


def test_the_page_tells_of_every_covariance_and_of_what_is_weak(found: Calibration) -> None:
    part = uncertainty_part(found, None, cameras=["side_left"])
    assert [kind.split(" (")[0] for kind in part.kinds] == ["naive", "frame-clustered", "errors in variables"]
    assert part.kinds[2].endswith(", taken")
    assert [row.name for row in part.rows] == [*found.cameras, "board"]
    naive_mm, _, taken_mm = (float(cell.split()[0]) for cell in part.rows[0].cells)
    assert naive_mm < taken_mm
    assert part.directions
    assert [picture.title for picture in part.pictures] == ["side_left: at 1 m", "Over the capture volume"]
    page = render(found)
    for words in (">Uncertainty<", "Stage 4 was taken: hold-out", "Weakest directions", "estimated from the recording"):
        assert words in page
    assert str(escape(part.directions[0].sentence)) in page


def test_without_a_covariance_there_is_no_such_part(found: Calibration) -> None:
    bare = replace(found, covariances={}, mocap_noise=None)
    assert uncertainty_part(bare, None, cameras=[]) is None
    assert ">Uncertainty<" not in render(bare)
    assert "not modelled" in noise_lines(None)[0]


def test_the_command_prints_and_writes_it(found: Calibration, tmp_path: Path) -> None:
    write_calibration(tmp_path / "c.json", found)
    ran = run("uncertainty", tmp_path / "c.json", "--distances-m", "0.5", "1", "-o", tmp_path / "u.json")
    assert (ran.code, ran.err) == (0, "")
    for words in ("errors in", "(taken)", "side_right", "Weakest directions:", "Mocap noise, estimated"):
        assert words in ran.out
    document = json.loads((tmp_path / "u.json").read_text())
    assert len(document["images"]) == 8
    assert all(0.0 < row["median_px"] <= row["worst_px"] for row in document["images"])
    write_calibration(tmp_path / "bare.json", replace(found, covariances={}))
    refused = run("uncertainty", tmp_path / "bare.json")
    assert (refused.code, "has no covariance" in refused.err) == (1, True)
