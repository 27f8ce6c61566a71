from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.results.calibration_file import write_calibration
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, LollypopSimulation, growing_fault, write_lollypop_simulation
from gtcal.verification.drift import POOLED, Drift, verify_series, write_drift_csv
from gtcal.verification.drift_figure import draw_drift
from gtcal.verification.verification import Verdict

FAULTS = {
    "none": RigFault(),
    "camera": RigFault(cameras={"front_right": small_motion((0, 0.8, 0), (0, 0, 0.08))}),
    "markers": RigFault(markers=small_motion((0.8, 0, 0.4), (0, 0.08, 0))),
    "lens": RigFault(focal_shares={"side_left": 0.004}),
}


@cache
def series(kind: str) -> tuple[LollypopSimulation, ...]:
    return growing_fault(LollypopOptions(fault=FAULTS[kind], duration_s=40.0), 5, seed=20)


@cache
def drift(kind: str) -> Drift:
    simulations = series(kind)
    recordings = [(f"take {i}", simulation.recording) for i, simulation in enumerate(simulations)]
    return verify_series(recordings, simulations[0].true_calibration())


def trend_of(found: Drift, camera: str):  # type: ignore[no-untyped-def]
    return next(trend for trend in found.trends if (trend.camera, trend.unit) == (camera, "px"))


@pytest.mark.long
def test_the_rig_keeps_its_bodies_from_recording_to_recording() -> None:
    """The calibration that is true for the first recording is the one that each says was true before its fault."""
    for kind in ("camera", "markers", "lens"):
        first, *later = (simulation.true_calibration() for simulation in series(kind))
        for other in later:
            for name, camera in first.cameras.items():
                np.testing.assert_allclose(
                    other.cameras[name].camera_T_ref.a_T_b, camera.camera_T_ref.a_T_b, atol=1e-12
                )
                np.testing.assert_array_equal(other.cameras[name].camera.theta, camera.camera.theta)


def test_without_a_fault_nothing_fails_and_nothing_drifts() -> None:
    found = drift("none")
    assert found.first_failing is None
    assert not any(trend.significant for trend in found.trends)
    assert all(verification.faults == () for verification in found.verifications)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "finding", "cameras"),
    [
        ("camera", ("camera_moved", "front_right"), ["front_right"]),
        ("markers", ("markers_moved", None), ["front_left", "front_right", "side_left", "side_right"]),
        ("lens", ("lens_changed", "side_left"), ["side_left"]),
    ],
)
def test_a_growing_fault_is_found_to_grow(kind: str, finding: tuple[str, str | None], cameras: list[str]) -> None:
    found = drift(kind)
    assert found.verdict is Verdict.FAIL
    assert found.first_failing is not None
    assert 1 <= found.first_failing <= 4
    last = found.verifications[-1]
    assert [(fault.kind, fault.camera) for fault in last.faults] == [finding]
    assert trend_of(found, POOLED).slope_per_recording > 0
    growing = [camera for camera in found.cameras if trend_of(found, camera).significant]
    assert set(growing) <= set(cameras)
    assert growing
    rmse = [s.rmse for s in found.series(cameras[0], "px") if s is not None]
    assert rmse == sorted(rmse)


def test_two_recordings_have_no_trend() -> None:
    simulations = series("camera")[:2]
    recordings = [(str(i), simulation.recording) for i, simulation in enumerate(simulations)]
    found = verify_series(recordings, simulations[0].true_calibration())
    assert all(np.isnan(trend.p_value) and not trend.significant for trend in found.trends)


def test_a_wrong_recording_is_named() -> None:
    simulation = series("none")[0]
    other = series("none")[1].recording
    camera = other.cameras["front_left"]
    small = replace(other, cameras=other.cameras | {"front_left": replace(camera, image_width_px=640)})
    with pytest.raises(GtcalError, match="second: camera 'front_left' has images of 640 x 1024"):
        verify_series([("first", simulation.recording), ("second", small)], simulation.true_calibration())
    with pytest.raises(GtcalError, match="no recordings"):
        verify_series([], simulation.true_calibration())


def test_one_recording_given_twice_is_refused_whatever_it_is_called(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = (simulation.recording for simulation in series("none")[:2])
    true = series("none")[0].true_calibration()
    with pytest.raises(GtcalError, match=r"friday: is the same recording as monday: .*; give each recording once"):
        verify_series([("monday", one), ("tuesday", other), ("friday", replace(one, path=Path("copy")))], true)
    # one export of the mocap may hold two recordings
    later = {name: replace(seen, stamps_ns=seen.stamps_ns + 1) for name, seen in one.detections.items()}
    assert len(verify_series([("monday", one), ("friday", replace(one, detections=later))], true).names) == 2
    write_calibration(tmp_path / "calibration.json", true)
    write_lollypop_simulation(series("none")[0], tmp_path / "a", images=False)
    write_lollypop_simulation(series("none")[0], tmp_path / "b", images=False)
    arguments = [str(tmp_path / name) for name in ("calibration.json", "a", "b")]
    assert main(["drift", *arguments, "-o", str(tmp_path / "d.json")]) == 1
    assert "b: is the same recording as a" in capsys.readouterr().err
    assert not (tmp_path / "d.json").exists()


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_the_figure_is_written(suffix: str, tmp_path: Path) -> None:
    draw_drift(tmp_path / f"drift{suffix}", drift("camera"))
    start = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    written = (tmp_path / f"drift{suffix}").read_bytes()
    assert written.startswith(start)
    if suffix == ".svg":
        assert all(f"<!-- {text} -->".encode() in written for text in ("front_left", "tolerance", "first to fail"))


def test_a_figure_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=r"a figure is .png, .svg, .pdf, not .bmp"):
        draw_drift(tmp_path / "drift.bmp", drift("none"))


def test_the_table_as_csv(tmp_path: Path) -> None:
    found = drift("camera")
    write_drift_csv(tmp_path / "drift.csv", found)
    with (tmp_path / "drift.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 4
    assert {row["recording"] for row in rows} == set(found.names)
    assert "front_right" in rows[-1]["finding"]
    np.testing.assert_allclose(
        float(rows[0]["rmse_px"]), found.verifications[0].cameras["front_left"].px.rmse, rtol=1e-5
    )


@pytest.mark.long
def test_drift_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulations = series("markers")
    write_calibration(tmp_path / "calibration.json", simulations[0].true_calibration())
    folders = [str(tmp_path / f"take{i}") for i in range(3)]
    for folder, simulation in zip(folders, (simulations[0], simulations[2], simulations[4]), strict=True):
        write_lollypop_simulation(simulation, folder, images=False)
    outputs = ["-o", str(tmp_path / "d.json"), "--csv", str(tmp_path / "d.csv"), "--figure", str(tmp_path / "d.png")]
    assert main(["drift", str(tmp_path / "calibration.json"), *folders, *outputs]) == 3
    said = " ".join(capsys.readouterr().out.split())
    assert "the headset's markers moved by" in said
    document = json.loads((tmp_path / "d.json").read_text())
    assert document["first_failing"] in ("take1", "take2")
    assert document["recordings"][0]["verdict"] == "pass"
    assert len(document["provenance"]["inputs"]) >= 1 + 3 * 3
    assert (tmp_path / "d.png").stat().st_size > 5000
