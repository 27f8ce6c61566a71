"""The report's verification half: the verdict first, its evidence after it, and worst frames over their images."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from browser import look_at

from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.recordings.recording import load_recording
from gtcal.report import render, write_report
from gtcal.report.overlay import overlays
from gtcal.report.scene import build_scene
from gtcal.report.verification_figures import mean_errors
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import SimulationOptions, quest3_like_rig, simulate, write_simulation
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop_recording import LollypopRecording, load_lollypop_recording
from gtcal.verification.verification import Verdict, Verification
from gtcal.verification.workflow import verify
from gtcal.workflow import calibrate

MOVED = "side_right"


@dataclass(frozen=True)
class Case:
    """A calibrated rig of which one camera has moved since, verified with images."""

    folder: Path
    calibration: Calibration
    recording: LollypopRecording
    verification: Verification


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder = tmp_path_factory.mktemp("verified")
    rig = quest3_like_rig().scaled(0.3)
    board = simulate(SimulationOptions(rig=rig, n_frames=60), seed=3)
    write_simulation(board, folder / "board", images=False)
    write_calibration(folder / "calibration.json", calibrate(load_recording(folder / "board")))
    options = LollypopOptions(
        rig=rig,
        n_frames=48,
        calibrated_in=board.scene,
        fault=RigFault(cameras={MOVED: small_motion((2.0, 0.0, 0.0), (0.0, 1.5, 0.0))}),
    )
    write_lollypop_simulation(simulate_lollypop(options, seed=2), folder / "lollypop", images=True)
    calibration = read_calibration(folder / "calibration.json")
    recording = load_lollypop_recording(folder / "lollypop")
    verification = verify(recording, calibration)
    assert verification.recording is not None
    return Case(folder, calibration, verification.recording, verification)


@pytest.fixture(scope="module")
def page(case: Case) -> str:
    return render(case.calibration, verification=case.verification)


def _of_moved(verification: Verification) -> Verification:
    """The camera that moved alone: figures take their time."""
    return replace(
        verification,
        cameras={MOVED: verification.cameras[MOVED]},
        sightings={MOVED: verification.sightings[MOVED]},
    )


def _texts(page: str) -> list[str]:
    """The headings of the page's figures, in order."""
    return re.findall(r"<h[34]>(.*?)</h[34]>\n    <img", page)


def test_the_verdict_and_its_reasons_come_first(case: Case, page: str) -> None:
    assert case.verification.verdict is Verdict.FAIL
    headline = page[: page.index("</header>")]
    assert '<div class="verdict fail">' in headline
    assert '<p class="word">Fail</p>' in headline
    assert f"camera &#39;{MOVED}&#39;: RMSE" in headline
    for tile in (case.verification.pooled_px, case.verification.pooled_mm):
        assert f"{tile.rmse:.3f}</span>" in headline
    assert headline.index("Fail") < headline.index("Calibrated with")


@pytest.mark.long
@pytest.mark.parametrize(
    ("verdict", "sign", "word"),
    [(Verdict.PASS, "✓", "Pass"), (Verdict.FAIL, "✕", "Fail"), (Verdict.INCONCLUSIVE, "?", "Inconclusive")],
)
def test_a_verdict_is_told_in_words_and_a_sign(case: Case, verdict: Verdict, sign: str, word: str) -> None:
    bare = replace(_of_moved(case.verification), verdict=verdict, sightings={}, recording=None)
    text = render(case.calibration, verification=bare)
    assert f'<span class="sign" aria-hidden="true">{sign}</span>' in text
    assert f'<p class="word">{word}</p>' in text


def test_every_camera_is_told_with_its_sigma_beside_the_finding(case: Case, page: str) -> None:
    for name, camera in case.verification.cameras.items():
        assert f"{camera.px.rmse:.3f}</td>" in page
        sigma_mm = case.calibration.cameras[name].camera_T_ref.position_of_a_in_b_sigma_mm
        assert sigma_mm is not None
        assert f"{sigma_mm.max():.3f} mm" in page
    for entry in case.verification.left_out:
        assert entry.reason.replace("'", "&#39;") in page
    assert case.verification.device.describe() in page


def test_worst_frames_come_worst_first(case: Case) -> None:
    pictures = overlays(case.verification)
    assert pictures[0].title.startswith(MOVED)
    errors_px = [float(re.findall(r": (.*) px", picture.title)[0]) for picture in pictures]
    assert errors_px == sorted(errors_px, reverse=True)
    worst_px = max(float(found.e_2d_px.max()) for found in case.verification.sightings.values())
    assert errors_px[0] == pytest.approx(worst_px, abs=0.005)
    seen = {name for name, found in case.verification.sightings.items() if len(found)}
    assert {picture.title.split(":")[0] for picture in pictures} == seen
    assert len(pictures) <= 12


def test_worst_frames_show_the_image_itself(case: Case) -> None:
    """The picture holds the frame's own pixels: another image gives another picture."""
    kind, content = overlays(case.verification)[0].uri.split(";base64,")
    assert kind == "data:image/svg+xml"
    assert b"<image" in base64.b64decode(content)
    shifted = {
        name: replace(images, paths=(*images.paths[1:], images.paths[0]))
        for name, images in case.recording.images.items()
    }
    other = replace(case.verification, recording=replace(case.recording, images=shifted))
    assert overlays(other)[0].uri != overlays(case.verification)[0].uri


def test_an_image_that_is_gone_is_one_line(case: Case) -> None:
    gone = {
        name: replace(images, paths=tuple(path.with_name("gone.png") for path in images.paths))
        for name, images in case.recording.images.items()
    }
    broken = replace(case.verification, recording=replace(case.recording, images=gone))
    with pytest.raises(GtcalError, match=r"gone\.png"):
        render(case.calibration, verification=broken)


@pytest.mark.long
def test_without_images_or_sightings_the_page_says_so(case: Case) -> None:
    imageless = replace(_of_moved(case.verification), recording=replace(case.recording, images={}))
    assert "has no images, so the worst frames" in render(case.calibration, verification=imageless)
    statistics = replace(_of_moved(case.verification), sightings={}, recording=None)
    text = render(case.calibration, verification=statistics)
    assert "was read from a file" in text
    assert "Lollypop heat map" in _texts(text)
    assert "Error over time" not in _texts(text)


def test_mean_errors_are_those_of_the_sightings(case: Case) -> None:
    """Two by two bins of the heat map lose no sighting."""
    from gtcal.report.verification_figures import _coarser

    found = case.verification.cameras[MOVED].heat_map
    counts, mean = _coarser(found)
    assert counts.sum() == found.count.sum() == len(case.verification.sightings[MOVED])
    total = [(part * counts).sum() / counts.sum() for part in mean]
    np.testing.assert_allclose(total, case.verification.sightings[MOVED].errors_px.mean(axis=0), atol=1e-9)
    assert mean_errors(found, case.calibration.cameras[MOVED].camera).uri.startswith("data:image/")


def test_the_scene_shows_where_the_lollypop_was_seen(case: Case) -> None:
    colours = dict.fromkeys(case.calibration.cameras, "#000000")
    lines = build_scene(case.calibration, None, colours, case.verification).lines
    dots = np.array([line.points[0] for line in lines if line.layer == "lollypop"])
    places_m = np.concatenate([found.ref_T_body[:, :3, 3] for found in case.verification.sightings.values()])
    assert 0 < len(dots) <= len(places_m)
    assert np.linalg.norm(dots[:, None] - places_m, axis=2).min(axis=1).max() < 2e-4


def test_a_verification_of_other_cameras_is_refused(case: Case) -> None:
    cameras = case.calibration.cameras
    lesser = replace(case.calibration, cameras={name: cameras[name] for name in cameras if name != MOVED})
    with pytest.raises(GtcalError, match=f"is of camera '{MOVED}', which the calibration hasn't"):
        render(lesser, verification=case.verification)


@pytest.mark.long
def test_the_commands_write_it(case: Case, capsys: pytest.CaptureFixture[str]) -> None:
    calibration, lollypop = str(case.folder / "calibration.json"), str(case.folder / "lollypop")
    verification, page = case.folder / "verification.json", case.folder / "verify.html"
    code = main(["verify", calibration, lollypop, "-o", str(verification), "--report", str(page), "-q"])
    assert code == Verdict.FAIL.exit_code
    assert "Worst frames first" in page.read_text(encoding="utf-8")
    both = case.folder / "both.html"
    arguments = ["--recording", str(case.folder / "board"), "--verification", str(verification), "-o", str(both)]
    assert main(["report", calibration, *arguments]) == 0
    text = both.read_text(encoding="utf-8")
    assert "Residual field" in text
    assert "Lollypop heat map" in text
    other = case.folder / "other.json"
    write_calibration(other, replace(case.calibration, sigma_px=1.0))
    assert main(["report", str(other), "--verification", str(verification), "-o", str(both)]) == 1
    assert "is the verification of another calibration" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("width_px", [1400, 400])
def test_the_page_in_a_browser(case: Case, tmp_path: Path, width_px: int) -> None:
    write_report(tmp_path / "report.html", case.calibration, verification=case.verification)
    seen = look_at(tmp_path / "report.html", tmp_path, width_px=width_px)
    assert seen.heard == []
    assert seen.console == []
    assert seen.missing == []
    assert seen.images > 12
    assert seen.overflow_px <= 0
