"""gtcal info: the numbers are those of the recording, and every kind of path is shown."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from calibration_support import simulated
from cli_support import all_in, files_in, run
from matplotlib.image import imread
from media_support import small_simulation
from scipy.spatial.transform import Rotation
from support import EPOCH_NS, replace_once

from gtcal.overview.kind import Kind, kind_of
from gtcal.overview.summary import Times, summarise
from gtcal.overview.summary_figure import draw_recording
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording, load_recording, write_recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.lollypop_recording import write_lollypop_recording


def turning_trajectory(body: str, *, gaps: tuple[slice, ...] = ()) -> Trajectory:
    """200 poses at 100 Hz on a line of 2 x 1 x 0 m, turning by 60 deg about z, without the samples in ``gaps``."""
    share = np.linspace(0.0, 1.0, 200)
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("z", 60.0 * share[:, None], degrees=True).as_matrix()
    poses[:, :2, 3] = share[:, None] * [2.0, 1.0]
    kept = np.ones(200, dtype=bool)
    for gap in gaps:
        kept[gap] = False
    return Trajectory(body, (EPOCH_NS + 10_000_000 * np.arange(200))[kept], poses[kept])


def test_times_count_gaps_and_lost_samples() -> None:
    stamps_ns = EPOCH_NS + 10_000_000 * np.array([0, 1, 2, 3, 5, 6, 16, 17, 18])
    times = Times(stamps_ns, 0.025)
    assert times.rate_hz == pytest.approx(100.0)
    assert times.span_s == pytest.approx(0.18)
    np.testing.assert_allclose(times.gaps_s, [0.1])
    assert times.n_lost == 1 + 9
    runs = (times.runs_ns - EPOCH_NS) // 10_000_000
    np.testing.assert_array_equal(runs, [[0, 6], [16, 18]])
    lone = Times(stamps_ns[:1], np.inf)
    assert np.isnan(lone.rate_hz)
    assert (lone.n_lost, len(lone.gaps_s), lone.span_s) == (0, 0, 0.0)


def test_the_numbers_are_those_of_the_recording(small_recording: Recording) -> None:
    platform = turning_trajectory("platform", gaps=(slice(50, 60), slice(100, 101)))
    summary = summarise(replace(small_recording, platform=platform, board_body=turning_trajectory("board_body")))
    assert summary.what.startswith("tracked_platform, AprilGrid 3 x 2")
    assert summary.start_ns == EPOCH_NS
    body = summary.bodies["platform"]
    np.testing.assert_allclose(body.range_mm, [2000.0, 1000.0, 0.0])
    assert body.largest_turn_deg == pytest.approx(30.0, abs=1.5)
    np.testing.assert_allclose(body.times.gaps_s, [0.11])
    assert body.times.n_lost == 11
    camera = summary.cameras["left"]
    given = small_recording.detections["left"]
    assert camera.n_images is None
    assert camera.coverage is not None
    assert camera.coverage.counts.sum() == given.n_corners
    in_gap = (given.stamps_ns > EPOCH_NS + 490_000_000) & (given.stamps_ns < EPOCH_NS + 600_000_000)
    assert camera.with_pose == pytest.approx(1.0 - in_gap.mean())


def test_another_clock_is_remarked(small_recording: Recording) -> None:
    assert small_recording.platform is not None
    platform = replace(small_recording.platform, stamps_ns=small_recording.platform.stamps_ns - EPOCH_NS)
    summary = summarise(replace(small_recording, platform=platform))
    assert summary.cameras["left"].with_pose == 0.0
    expected = "left: 0% of its images have a pose of every tracked body; its time has nothing in common with that of"
    assert any(line.startswith(f"{expected} platform: another clock?") for line in summary.remarks)


def test_poor_turns_and_bare_regions_are_remarked(small_recording: Recording) -> None:
    still = replace(small_recording.platform, world_T_body=np.tile(np.eye(4), (60, 1, 1)))
    detections = {
        name: replace(found, corners_px=np.minimum(found.corners_px, [300.0, np.inf]))
        for name, found in small_recording.detections.items()
    }
    recording = replace(
        small_recording, detections=detections, platform=still, board_body=replace(still, body="board_body")
    )
    remarks = summarise(recording).remarks
    assert any("hardly turned (0.0 deg rms)" in line for line in remarks)
    assert "left: no detections in the right half of the image" in remarks


@pytest.fixture(scope="module")
def with_images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with images of which only the first shows something: detection takes no time."""
    folder = tmp_path_factory.mktemp("with_images")
    recording = small_simulation().recording
    (name,) = recording.cameras
    (folder / "cam").mkdir()
    for stamp_ns in small_simulation().truth.cameras[name].stamps_ns[:3].tolist():
        cv2.imwrite(str(folder / "cam" / f"{stamp_ns}.png"), np.full((512, 640), 90, np.uint8))
    write_recording(recording, folder)
    fields = yaml.safe_load((folder / "recording.yaml").read_text())
    del fields["cameras"][name]["detections"]
    fields["cameras"][name]["images"] = "cam"
    (folder / "recording.yaml").write_text(yaml.safe_dump(fields))
    return folder


def test_images_that_were_not_looked_at_are_not_detected_unasked(with_images: Path) -> None:
    before = files_in(with_images)
    ran = run("info", with_images)
    assert ran.code == 0
    assert "the board was not looked for yet; --detect does" in ran.out
    assert files_in(with_images) == before
    ran = run("info", with_images, "--detect")
    assert "no image shows the board" in ran.out
    assert any(".gtcal" in name for name in files_in(with_images))
    assert "no image shows the board" in run("info", with_images).out, "the kept corners are not taken"


def colours(path: Path) -> int:
    """How many different colours a picture has."""
    pixels = (255 * imread(path)[..., :3]).astype(np.uint8).reshape(-1, 3)
    return len(np.unique(pixels, axis=0))


def test_a_recording_is_shown_with_its_picture(recording_folder: Path, tmp_path: Path) -> None:
    for path, figure in (
        (recording_folder, ("--figure", tmp_path / "a.png")),
        (recording_folder / "recording.yaml", ()),
    ):
        ran = run("info", path, *figure)
        assert ran.code == 0, ran.err
        parts = ["tracked_platform, AprilGrid 3 x 2", "fisheye62", "640 x 480", "platform", "board_body"]
        assert all_in(ran.out, parts)
    assert colours(tmp_path / "a.png") > 8
    assert run("info", recording_folder, "--figure", tmp_path / "a.svg", "-q").out == ""
    text = (tmp_path / "a.svg").read_text()
    assert all_in(text, ["left: ", "right: ", "platform: position in the mocap world", "time since the first stamp, s"])


@pytest.mark.long
def test_a_long_recording_is_drawn_small(small_recording: Recording, tmp_path: Path) -> None:
    """An hour of images and poses, with gaps: what is drawn does not grow with it."""
    n = 360_000
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, 0, 3] = np.sin(np.arange(n) / 1000)
    stamps_ns = EPOCH_NS + 10_000_000 * np.arange(n) + 10**9 * (np.arange(n) // 90_000)
    platform = Trajectory("platform", stamps_ns, poses)
    recording = replace(small_recording, platform=platform, board_body=replace(platform, body="board_body"))
    summary = summarise(recording)
    assert len(summary.bodies["platform"].times.gaps_s) == 3
    draw_recording(tmp_path / "a.svg", summary)
    assert (tmp_path / "a.svg").stat().st_size < 1_500_000


def test_the_real_vicon_recording(vicon_recording: Callable[..., Path]) -> None:
    summary = summarise(load_recording(vicon_recording(Capture.TRACKED_PLATFORM)))
    camera, platform = summary.cameras["cam0"], summary.bodies["platform"]
    assert camera.n_images == 30
    assert camera.with_pose == 1.0
    assert camera.coverage is not None
    assert camera.coverage.counts.sum() == 4008
    assert platform.times.rate_hz == pytest.approx(20.0, abs=0.5)
    assert summary.bodies["board_body"].range_mm.max() < 2.0
    assert platform.largest_turn_deg > 170.0


def test_a_lollypop_recording_is_shown(tmp_path: Path) -> None:
    simulation = simulate_lollypop(LollypopOptions(duration_s=3.0), seed=0)
    write_lollypop_recording(simulation.recording, tmp_path / "lollypop")
    ran = run("info", tmp_path / "lollypop", "--figure", tmp_path / "a.png")
    assert ran.code == 0, ran.err
    assert all_in(ran.out, ["Lollypop", "device_body", "platform"])
    assert kind_of(tmp_path / "lollypop") is Kind.LOLLYPOP_RECORDING


@pytest.mark.long
def test_results_are_shown_with_their_pictures(tmp_path: Path) -> None:
    write_recording(simulated(frames=20).recording, tmp_path / "board")
    calibration, verification = tmp_path / "calibration.json", tmp_path / "verification.json"
    options = ("--mocap-noise", "exact", "--clock", "trust", "-q")
    assert run("calibrate", tmp_path / "board", "-o", calibration, *options).code == 0
    simulation = simulate_lollypop(LollypopOptions(duration_s=6.0), seed=0)
    write_lollypop_recording(simulation.recording, tmp_path / "lollypop")
    run("verify", calibration, tmp_path / "lollypop", "-o", verification, "-q")
    for path, words in ((calibration, "reprojection residuals"), (verification, "verdict")):
        picture = path.with_suffix(".png")
        ran = run("info", path, "--figure", picture)
        assert ran.code == 0, ran.err
        assert all_in(ran.out, [words, "front_left", "made 2", "sha256", "written: "])
        assert colours(picture) > 8


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (None, "there is no such recording"),
        (("a.json", "{}"), r"a\.json: is no recording's manifest, no calibration and no verification of gtcal"),
        (("a.json", '{"gtcal_calibration": 1}'), r"a\.json: the field 'capture' is missing"),
        (("a.json", "{"), r"a\.json:1: is not valid JSON"),
        (("a.yaml", "gtcal_recording: 1\n"), "is missing"),
        (("a.yaml", "gtcal_recording: 1\nboard: QUESTION\n"), "a.yaml:2: board: is still an open question; replace"),
    ],
)
def test_what_can_not_be_shown_is_told(write: tuple[str, str] | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / (write[0] if write else "nothing")
    if write:
        path.write_text(write[1])
    ran = run("info", path)
    assert ran.code == 1
    assert ran.err.count("\n") == 1
    assert re.search(message, ran.err)


def test_another_kind_of_picture_is_refused(recording_folder: Path, tmp_path: Path) -> None:
    ran = run("info", recording_folder, "--figure", tmp_path / "a.pdf")
    assert ran.code == 1
    assert "a.pdf: a figure is .svg or .png" in ran.err
    assert not (tmp_path / "a.pdf").exists()


def test_an_image_that_is_gone_is_told(with_images: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(with_images, folder)
    replace_once(folder / "recording.yaml", "images: cam", "images: gone")
    ran = run("info", folder)
    assert ran.code == 1
    assert "images: there is no" in ran.err


def test_a_file_of_mocap_data_is_shown(shared: Callable[[str], Path], tmp_path: Path) -> None:
    ran = run("info", shared("data/mocap_exports/vicon_trajectories_100hz_mm.csv"))
    assert (ran.code, ran.err) == (0, "")
    for words in ("vicon_csv: ", "at 100 Hz", "; mm; ", "boite", "of its markers"):
        assert words in ran.out
    assert "no bodies and no labelled markers" in run("info", shared("data/mocap_exports/motive_no_bodies.csv")).out
    ran = run("info", shared("data/mocap_exports/motive_rigid_body_120hz_m.csv"), "--figure", tmp_path / "a.png")
    assert ran.code == 1
    assert "leave out --figure" in ran.err
