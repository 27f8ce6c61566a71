"""The report: the residuals it shows are the calibration's, and the page stands alone."""

from __future__ import annotations

import base64
import hashlib
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import look_at, n_pages_on_paper

import gtcal
from gtcal.board import AprilGrid
from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording, load_recording
from gtcal.report import Evidence, gather_evidence, render, write_report
from gtcal.report.evidence import CameraEvidence
from gtcal.report.plots import beyond
from gtcal.report.residual_figures import covered_share
from gtcal.report.scene import build_scene
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.results.covariance import JointCovariance
from gtcal.simulation import MocapNoise, SimulationOptions, fixed_cameras_rig, simulate, write_simulation

COLOURS = {"cam0": "#0072b2", "cam1": "#d55e00"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated recording on disk with gross mocap poses in it, and its calibration.json."""
    found = tmp_path_factory.mktemp("report")
    options = SimulationOptions(
        rig=fixed_cameras_rig(2),
        capture=Capture.FIXED_CAMERAS,
        n_frames=60,
        swap_share=0.06,
        mocap=MocapNoise(translation_mm=0.1, rotation_deg=0.01),
    )
    write_simulation(simulate(options, seed=5), found / "recording", images=False)
    write_calibration(found / "calibration.json", gtcal.calibrate(load_recording(found / "recording")))
    return found


@pytest.fixture(scope="module")
def recording(folder: Path) -> Recording:
    return load_recording(folder / "recording")


@pytest.fixture(scope="module")
def calibration(folder: Path) -> Calibration:
    """As read from file: without residuals."""
    return read_calibration(folder / "calibration.json")


@pytest.fixture(scope="module")
def evidence(calibration: Calibration, recording: Recording) -> Evidence:
    return gather_evidence(calibration, recording)


@pytest.fixture(scope="module")
def page(calibration: Calibration, evidence: Evidence) -> str:
    return render(calibration, evidence=evidence)


def test_residuals_from_the_recording_are_those_of_the_calibration(
    calibration: Calibration, evidence: Evidence
) -> None:
    assert not evidence.is_hold_out
    assert evidence.dropped == calibration.dropped
    for name, camera in evidence.cameras.items():
        found, stated = camera.statistics, calibration.cameras[name].residuals
        assert (found.n_views, found.n_corners) == (stated.n_views, stated.n_corners)
        assert found.rmse_px == pytest.approx(stated.rmse_px, rel=1e-9)
        assert found.p95_px == pytest.approx(stated.p95_px, rel=1e-9)


def test_gross_views_are_shown_as_left_out(evidence: Evidence) -> None:
    camera = evidence.cameras["cam0"]
    assert 0 < (~camera.keep_view).sum() < camera.views.n_views / 4
    kept, left_out = camera.rmse_of_views_px[camera.keep_view], camera.rmse_of_views_px[~camera.keep_view]
    assert left_out.min() > 2.0 * np.median(kept)


def test_images_are_detected_with_the_recordings_own_lenses(
    calibration: Calibration, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Corners are kept for the lens that they were found with; the calibrated lens would have them detected anew."""
    own = {name: replace(camera, parameters=None) for name, camera in recording.cameras.items()}
    given: list[Recording] = []

    def noted(asked: Recording, **_: object) -> Recording:
        given.append(asked)
        return asked

    monkeypatch.setattr("gtcal.report.evidence.detected", noted)
    found = gather_evidence(calibration, replace(recording, cameras=own))
    assert given[0].cameras == own
    assert found.cameras["cam0"].camera is calibration.cameras["cam0"].camera


@pytest.mark.long
def test_another_recording_is_a_hold_out(folder: Path, calibration: Calibration, recording: Recording) -> None:
    other = SimulationOptions(rig=fixed_cameras_rig(2), capture=Capture.FIXED_CAMERAS, n_frames=20)
    write_simulation(simulate(other, seed=6), folder / "other", images=False)
    # The simulator puts the board on its body anew each time; to hold out, the board must stay where it was.
    held_out = replace(
        load_recording(folder / "other"), detections=recording.detections, board_body=recording.board_body
    )
    found = gather_evidence(calibration, held_out)
    assert found.is_hold_out
    assert Path("cam0_detections.csv") in {Path(path.name) for path in found.changed_inputs or ()}
    text = render(calibration, evidence=found)
    assert "hold-out errors" in text
    assert ">hold-out</th>" in text


def test_a_recording_of_another_rig_is_refused(calibration: Calibration, recording: Recording) -> None:
    cameras = recording.cameras
    small = replace(cameras["cam0"], image_width_px=640)
    lone = {"cam1": recording.detections["cam1"]}
    wrong = {
        "its capture is standing_board": replace(
            recording, capture=Capture.STANDING_BOARD, platform=recording.board_body, board_body=None
        ),
        "is not the calibration's": replace(recording, board=AprilGrid(6, 6, 0.088, 0.3)),
        "lacks camera 'cam0'": replace(recording, cameras={"cam1": cameras["cam1"]}, detections=lone),
        "camera 'cam0' are 640 x 1024": replace(recording, cameras=cameras | {"cam0": small}),
    }
    for message, other in wrong.items():
        with pytest.raises(GtcalError, match=re.escape(message)):
            gather_evidence(calibration, other)


def test_the_page_needs_no_other_file_and_no_network(page: str) -> None:
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert sources
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert "default-src 'none'" in page
    outside_data = re.sub(r'"data:[^"]*"', "", page)
    assert "http" not in outside_data.replace("http-equiv", "")
    assert "url(" not in outside_data


@pytest.mark.long
def test_on_paper_it_takes_few_pages(page: str, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(page)
    assert n_pages_on_paper(tmp_path / "page.html", tmp_path) <= 5  # of two cameras; it was a page each and more


def test_what_a_histogram_does_not_show_is_said() -> None:
    values = np.array([0.1, 0.2, -7.0, 3.0])
    assert beyond(values, -1.0, 1.0, "mm") == " Beyond the axis: 2 of 4, up to -7 mm."
    assert beyond(values, -10.0, 10.0, "mm") == ""


def test_only_the_pages_own_style_and_script_may_act(page: str) -> None:
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)[1]
    assert "unsafe" not in policy
    for element, directive in (("style", "style-src"), ("script", "script-src")):
        (content,) = re.findall(rf"<{element}>(.*?)</{element}>", page, re.DOTALL)
        source = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{directive} 'sha256-{source}'" in policy
    assert not re.search(r"<[^>]*\s(style|on\w+)=", page)  # which no hash allows


def test_the_page_says_the_numbers(page: str, calibration: Calibration) -> None:
    for name, camera in calibration.cameras.items():
        assert f"{camera.residuals.rmse_px:.3f}</td>" in page
        assert f"</svg>{name}</a>" in page
    for stage in calibration.stages:
        assert stage.name in page
    for entry in calibration.provenance.inputs:
        assert entry.sha256 in page
    assert "gross view" in page
    assert page.count("<img ") == 7 * len(calibration.cameras) + 2


def test_every_picture_has_words_for_those_who_do_not_see_it(page: str) -> None:
    alternatives = re.findall(r'<img [^>]*alt="([^"]*)"', page)
    assert all(len(alternative) > 30 for alternative in alternatives)
    assert 'aria-label="3-D view' in page


def test_warnings_come_before_the_table(calibration: Calibration) -> None:
    warned = replace(calibration, warnings=("camera 'cam0' is weakly determined",))
    text = render(warned)
    assert text.index("is weakly determined") < text.index("<h2>Cameras</h2>")


def test_names_are_text_and_never_markup(calibration: Calibration) -> None:
    name = "</script><img src=x onerror=alert(1)>"
    joint = calibration.covariance
    renamed = JointCovariance(joint.kind, {name: 0}, joint.matrix[:12, :12])
    odd = replace(
        calibration,
        cameras={name: replace(calibration.cameras["cam0"], theta_covariance=None, lens_moves=())},
        covariances={joint.kind: renamed},
        warnings=(f"see {name}",),
    )
    text = render(odd)
    assert "<img src=x" not in text
    assert text.count("<img ") == 3
    assert text.count("</script>") == 2  # the scene's data and the script


def test_without_a_recording_the_page_says_what_is_missing(calibration: Calibration) -> None:
    text = render(calibration)
    assert "No recording was given" in text
    assert text.count("<img ") == len(calibration.cameras) + 2  # how sure it is, and the board: neither needs one
    assert '"boards"' not in text


def test_a_camera_without_covariance_has_no_sigma_column(calibration: Calibration) -> None:
    cameras = {
        name: replace(camera, camera_T_ref=replace(camera.camera_T_ref, covariance=None))
        for name, camera in calibration.cameras.items()
    }
    board = replace(calibration.body_T_board, covariance=None)
    text = render(replace(calibration, cameras=cameras, body_T_board=board))
    assert "no covariance was computed" in text
    assert "1-sigma, deg" not in text


def _repeated(evidence: CameraEvidence, times: int) -> CameraEvidence:
    """As if the recording went on and on."""
    views = evidence.views
    span_ns = views.stamps_ns[-1] - views.stamps_ns[0] + 33_000_000
    stamps_ns = (views.stamps_ns[None] + span_ns * np.arange(times)[:, None]).ravel()
    start = (views.view_start[None, :-1] + views.n_corners * np.arange(times)[:, None]).ravel()
    noise = np.random.default_rng(0).normal(0.0, 0.05, (times * views.n_corners, 2))
    long = replace(
        views,
        stamps_ns=stamps_ns,
        frame_index=np.arange(len(stamps_ns)),
        ref_T_body=np.tile(views.ref_T_body, (times, 1, 1)),
        view_start=np.append(start, times * views.n_corners),
        corner_ids=np.tile(views.corner_ids, times),
        corners_m=np.tile(views.corners_m, (times, 1)),
        corners_px=np.tile(views.corners_px, (times, 1)),
    )
    return replace(
        evidence,
        views=long,
        residuals_px=np.tile(evidence.residuals_px, (times, 1)) + noise,
        keep_view=np.tile(evidence.keep_view, times),
        keep_corner=np.tile(evidence.keep_corner, times),
    )


@pytest.mark.long
def test_a_long_recording_makes_no_long_page(calibration: Calibration, evidence: Evidence, page: str) -> None:
    """Figures are binned, so that the page of an hour is that of a quarter of an hour."""
    long = replace(evidence, cameras={name: _repeated(camera, 150) for name, camera in evidence.cameras.items()})
    assert len(long.cameras["cam0"].corners_px) > 200_000
    text = render(calibration, evidence=long)
    assert len(text) < 1.5 * len(page)
    assert len(text) / len(calibration.cameras) < 0.3e6


def test_coverage_is_the_share_of_the_image_with_corners(evidence: Evidence) -> None:
    camera = evidence.cameras["cam0"]
    width_px, height_px = camera.camera.image_width_px, camera.camera.image_height_px
    corners = np.random.default_rng(1).uniform((0, 0), (width_px / 2 - 1, height_px - 1), (20_000, 2))
    left_half = replace(
        camera,
        views=replace(camera.views, corners_px=corners),
        residuals_px=np.zeros((20_000, 2)),
        keep_corner=np.ones(20_000, dtype=bool),
    )
    assert covered_share(left_half) == pytest.approx(0.5)


def test_the_scene_shows_cameras_where_they_are(calibration: Calibration, evidence: Evidence) -> None:
    scene = build_scene(calibration, evidence, COLOURS)
    assert set(scene.layers) == {"cameras", "ref", "boards", "body"}
    points = np.array([point for line in scene.lines if line.layer == "cameras" for point in line.points])
    for camera in calibration.cameras.values():
        position_m = camera.camera_T_ref.position_of_a_in_b_m
        assert np.abs(points - position_m).max(axis=1).min() < 1e-4
    assert abs(np.dot(scene.up, scene.back)) < 2e-6  # they have six digits
    assert scene.up[2] > 0.9  # the simulated room's z points up


def test_the_scene_shows_the_board_in_its_size(calibration: Calibration, evidence: Evidence) -> None:
    outlines = [line.points for line in build_scene(calibration, evidence, COLOURS).lines if line.layer == "boards"]
    assert 5 < len(outlines) <= 24
    x_min, y_min, x_max, y_max = gtcal.board_from_manifest(calibration.board).bounds_m
    for outline in np.array(outlines):
        sides = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
        np.testing.assert_allclose(sides, np.tile([x_max - x_min, y_max - y_min], 2), atol=5e-4)


@pytest.mark.long
def test_gtcal_report_writes_the_page(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = folder / "pages" / "report.html"
    arguments = [str(folder / "calibration.json"), "--recording", str(folder / "recording"), "-o", str(output)]
    assert main(["report", *arguments]) == 0
    assert str(output) in capsys.readouterr().out
    assert output.read_text(encoding="utf-8").count("<figure>") == 16
    assert main(["report", str(folder / "missing.json"), "-o", str(output)]) == 1


@pytest.mark.long
def test_gtcal_calibrate_writes_a_report_if_asked(folder: Path) -> None:
    output = folder / "calibrate.html"
    arguments = [str(folder / "recording"), "-o", str(folder / "again.json"), "--report", str(output), "-q"]
    assert main(["calibrate", *arguments]) == 0
    assert output.read_text(encoding="utf-8").count("<figure>") == 16


def test_only_the_report_loads_matplotlib() -> None:
    code = "import sys, gtcal.cli.calibrate, gtcal.workflow; print({'matplotlib', 'jinja2'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.long
@pytest.mark.parametrize("width_px", [1400, 400])
def test_the_page_in_a_browser(calibration: Calibration, evidence: Evidence, tmp_path: Path, width_px: int) -> None:
    write_report(tmp_path / "report.html", calibration, evidence=evidence)
    seen = look_at(tmp_path / "report.html", tmp_path, width_px=width_px)
    assert seen.heard == []
    assert seen.console == []
    assert seen.images == 16
    assert seen.missing == []
    assert seen.window_px == width_px
    assert seen.overflow_px <= 0
    assert seen.drawn
    for step in ("dragged", "key", "zoomed", "pinched", "layer_off"):
        assert seen.steps[step] != seen.steps["start"], step
    assert seen.steps["reset"] == seen.steps["start"]
