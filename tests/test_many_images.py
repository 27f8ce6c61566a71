"""Detection on several cores, and where the mocap says where the board is."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from detection_support import FISHEYE, Filmer

from gtcal import guided as guided_module
from gtcal.board import PRESETS, AprilGrid
from gtcal.camera import FloatArray
from gtcal.cli import main
from gtcal.cores import n_cores
from gtcal.detection import detect as detect_module
from gtcal.detection import many_images, view_detection
from gtcal.detection.corner_search import PredictedBoard, SeenBoard
from gtcal.detection.detect import Guidance, cached_detect, detect
from gtcal.detection.view_detection import see_board
from gtcal.errors import GtcalError
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import GreyImage, ImageSequence, image_folder
from gtcal.recordings.recording import load_recording
from gtcal.simulation import SimulationOptions, quest3_like_rig, simulate, write_simulation
from gtcal.simulation.rendering import plate_of, render
from gtcal.workflow import detected

BOARD = AprilGrid(4, 3, 0.06, 0.3)
PAPER_A2 = PRESETS["paper_a2"]
BEHIND = np.diag([1.0, -1.0, -1.0, 1.0])
BEHIND[2, 3] = -0.5


class Shot:
    """An image of BOARD, where the board is, and its corners by the search."""

    def __init__(self, filmer: Filmer, distance_m: float) -> None:
        self.camera_T_board = filmer._camera_T_board(BOARD, distance_m, None, 35.0, None)
        pose = self.camera_T_board[None]
        self.image = render(
            filmer.lens, plate_of(BOARD), filmer.backdrop, pose, np.eye(4), filmer.options, filmer.random
        )
        self.searched = see_board(self.image, BOARD, FISHEYE)

    def predicted(self, off_px: FloatArray) -> PredictedBoard:
        """So many pixels away from the truth, at the board's middle."""
        moved = self.camera_T_board.copy()
        depth_m = float((moved @ np.array([*BOARD.corners_m[:, :2].mean(axis=0), 0.0, 1.0]))[2])
        moved[:2, 3] += off_px * depth_m / FISHEYE.theta[:2]
        return PredictedBoard(FISHEYE, moved)


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    filmer = Filmer(FISHEYE, seed=3)
    return [Shot(filmer, distance_m) for distance_m in np.linspace(0.35, 0.8, 12)]


def test_a_predicted_board_is_found_as_by_the_search_and_not_where_the_prediction_is(shots: list[Shot]) -> None:
    along, apart_px = [], []
    for turn, shot in enumerate(shots):
        off_px = np.array([np.cos(turn), np.sin(turn)])
        seen = see_board(shot.image, BOARD, FISHEYE, shot.predicted(off_px))
        np.testing.assert_array_equal(seen.corner_ids, shot.searched.corner_ids)
        difference_px = seen.corners_px - shot.searched.corners_px
        along.append(difference_px @ off_px)
        apart_px.append(np.linalg.norm(difference_px, axis=1))
    assert len(np.concatenate(apart_px)) > 400
    assert np.concatenate(apart_px).max() < 0.02
    assert abs(np.concatenate(along).mean()) < 1e-4


def test_where_the_prediction_is_right_nothing_is_searched(shots: list[Shot], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_detection, "find_tags", not_called)
    for shot in shots:
        seen = see_board(shot.image, BOARD, FISHEYE, shot.predicted(np.zeros(2)))
        np.testing.assert_array_equal(seen.corner_ids, shot.searched.corner_ids)


def test_where_the_prediction_is_far_off_the_board_is_searched(shots: list[Shot]) -> None:
    for shot in shots:
        seen = see_board(shot.image, BOARD, FISHEYE, shot.predicted(np.array([90.0, 40.0])))
        np.testing.assert_array_equal(seen.corner_ids, shot.searched.corner_ids)
        np.testing.assert_allclose(seen.corners_px, shot.searched.corners_px, atol=0.02)


def test_the_board_a_pitch_away_is_not_taken_for_it(shots: list[Shot]) -> None:
    """All corners are then on others: the tags' codes tell."""
    for shot in shots:
        moved = shot.camera_T_board.copy()
        moved[:3, 3] += moved[:3, :3] @ np.array([BOARD.pitch_m, 0.0, 0.0])
        seen = see_board(shot.image, BOARD, FISHEYE, PredictedBoard(FISHEYE, moved))
        np.testing.assert_array_equal(seen.corner_ids, shot.searched.corner_ids)
        np.testing.assert_allclose(seen.corners_px, shot.searched.corners_px, atol=0.02)


def test_a_board_outside_the_image_is_not_searched(shots: list[Shot], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_detection, "find_tags", not_called)
    seen = see_board(shots[0].image, BOARD, FISHEYE, PredictedBoard(FISHEYE, BEHIND))
    assert (len(seen.corner_ids), seen.unsearched) == (0, True)


def test_a_mocap_that_puts_the_board_outside_hides_no_view(
    recording_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Every tenth image is searched all the same; where one shows the board, all are."""
    recording = load_recording(recording_dir)
    (name, camera), images = next(iter(recording.cameras.items())), next(iter(recording.images.values()))
    shown = np.flatnonzero(np.isin(images.stamps_ns, detect(images, recording.board, camera).stamps_ns))[:12]
    few = ImageSequence(images.stamps_ns[shown], tuple(images.paths[index] for index in shown))
    wrong = Guidance(predicted={index: PredictedBoard(camera, BEHIND) for index in range(12)})
    truth = detect(few, recording.board, camera)
    assert truth.n_views == 12
    with caplog.at_level(logging.WARNING, logger="gtcal"):
        found = cached_detect(recording_dir, name, few, recording.board, camera, redo=True, guide=Word(wrong))
    np.testing.assert_array_equal(found.corners_px, truth.corners_px)
    assert f"{name}: by the mocap and a first calibration the board is outside 12 images, but" in caplog.text
    nothing = SeenBoard(np.empty(0, dtype=np.int64), np.empty((0, 2)), 0)
    monkeypatch.setattr(view_detection, "_searched", lambda *_: nothing)
    n_searches = count_calls(monkeypatch, view_detection, "_searched")
    found = cached_detect(recording_dir, name, few, recording.board, camera, redo=True, guide=Word(wrong))
    assert (found.n_views, len(n_searches)) == (0, 2)


@dataclass(frozen=True)
class Word:
    """A guide that says the same of every camera."""

    guidance: Guidance
    rests_on: str = "a word"

    def __call__(self, camera_name: str) -> Guidance:
        return self.guidance


def not_called(*_: object) -> None:
    raise AssertionError("searched")


# Of a whole recording


@pytest.fixture(scope="module")
def recording_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One camera, 60 rendered images."""
    folder = tmp_path_factory.mktemp("guided") / "recording"
    rig = quest3_like_rig().scaled(0.4)
    rig = replace(rig, cameras=rig.cameras[:1], rig_T_camera=rig.rig_T_camera[:1])
    write_simulation(simulate(SimulationOptions(rig=rig, n_frames=60), seed=4), folder, images=True)
    return folder


@pytest.fixture
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guided_module, "GUIDED_FROM", 40)
    monkeypatch.setattr(guided_module, "FIRST_IMAGES", 20)
    monkeypatch.setattr(guided_module, "_FEWEST_VIEWS", 12)


def test_a_guided_recording_has_the_same_corners_and_more(
    recording_dir: Path, few_are_many: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = load_recording(shutil.copytree(recording_dir, tmp_path / "recording"))
    searched = detected(recording, guided=False, redo=True).detections["front_left"]
    n_searches = count_calls(monkeypatch, view_detection, "_searched")
    guided = detected(recording, redo=True).detections["front_left"]
    assert guided.n_corners >= searched.n_corners
    assert len(n_searches) < 30  # of 60 images, 20 to begin with
    off_px = [np.linalg.norm(ours - theirs, axis=1) for ours, theirs in in_common(guided, searched)]
    assert len(np.concatenate(off_px)) > 0.99 * searched.n_corners
    assert np.quantile(np.concatenate(off_px), 0.99) < 0.01


def in_common(a: CameraDetections, b: CameraDetections) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The pixels of the corners that both have, view by view."""
    for stamp_ns in np.intersect1d(a.stamps_ns, b.stamps_ns):
        rows = [slice(*of.view_start[(v := int(np.searchsorted(of.stamps_ns, stamp_ns))) : v + 2]) for of in (a, b)]
        _, i, j = np.intersect1d(a.corner_ids[rows[0]], b.corner_ids[rows[1]], return_indices=True)
        yield a.corners_px[rows[0]][i], b.corners_px[rows[1]][j]


def count_calls(monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str) -> list[None]:
    calls: list[None] = []
    original = getattr(module, name)

    def counted(*arguments: Any, **named: Any) -> Any:
        calls.append(None)
        return original(*arguments, **named)

    monkeypatch.setattr(module, name, counted)
    return calls


def test_a_mocap_that_does_not_fit_guides_nothing(
    recording_dir: Path, few_are_many: None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The board's poses in wrong order of time."""
    recording = load_recording(shutil.copytree(recording_dir, tmp_path / "recording"))
    assert recording.board_body is not None
    spoilt = replace(recording.board_body, world_T_body=recording.board_body.world_T_body[::-1].copy())
    wrong = replace(recording, board_body=spoilt)
    searched = detected(recording, guided=False, redo=True).detections["front_left"]
    with caplog.at_level(logging.WARNING, logger="gtcal"):
        found = detected(wrong, redo=True).detections["front_left"]
    assert "every image is searched" in caplog.text
    np.testing.assert_array_equal(found.corners_px, searched.corners_px)


@pytest.mark.long
def test_what_was_guided_by_another_mocap_is_not_reused(
    recording_dir: Path, few_are_many: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = load_recording(shutil.copytree(recording_dir, tmp_path / "recording"))
    first = detected(recording)
    looked = count_calls(monkeypatch, detect_module, "look_at")
    np.testing.assert_array_equal(
        detected(recording).detections["front_left"].corners_px, first.detections["front_left"].corners_px
    )
    assert not looked
    assert recording.platform is not None
    later = replace(recording.platform, stamps_ns=recording.platform.stamps_ns + 1)
    detected(replace(recording, platform=later))
    assert looked
    looked.clear()
    detected(recording, guided=False)
    assert looked


# On several cores


@pytest.fixture
def in_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_images, "WORTH_PROCESSES", 1)


@dataclass(frozen=True)
class Handed(ImageSequence):
    """Images that can't be sent to another process."""

    lock: Any = field(default_factory=threading.Lock)


@dataclass(frozen=True)
class Deadly(ImageSequence):
    """Ends the process that reads the third image."""

    def read(self, index: int) -> GreyImage:
        if index == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().read(index)


@pytest.mark.parametrize("kind", [ImageSequence, Handed])
def test_processes_find_what_threads_find(recording_dir: Path, in_processes: None, kind: type[ImageSequence]) -> None:
    images = image_folder(recording_dir / "images" / "front_left")
    some = kind(images.stamps_ns[::6], images.paths[::6])
    alone, together = detect(some, PAPER_A2, workers=1), detect(some, PAPER_A2, workers=2)
    for name in ("stamps_ns", "view_start", "corner_ids", "corners_px"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(together, name))
    assert alone.n_corners > 100


@pytest.mark.long
def test_a_process_that_dies_is_one_clear_error(recording_dir: Path, in_processes: None) -> None:
    images = image_folder(recording_dir / "images" / "front_left")
    with pytest.raises(GtcalError, match=r"was ended from outside.*--jobs"):
        detect(Deadly(images.stamps_ns[:8], images.paths[:8]), PAPER_A2, workers=2)
    assert detect(ImageSequence(images.stamps_ns[:8], images.paths[:8]), PAPER_A2, workers=2).n_views  # and goes on


def test_images_of_another_size_are_refused_by_a_process(recording_dir: Path, in_processes: None) -> None:
    images = image_folder(recording_dir / "images" / "front_left")
    with pytest.raises(GtcalError, match="image size is"):
        detect(images, PAPER_A2, FISHEYE, workers=2)


@pytest.mark.long
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_a_line_and_leaves_nobody_behind(recording_dir: Path, tmp_path: Path, end: int) -> None:
    folder = shutil.copytree(recording_dir, tmp_path / "recording")
    script = (
        "import sys; from gtcal.detection import many_images; many_images.WORTH_PROCESSES = 1; "
        "from gtcal.cli import main; sys.exit(main(['detect', sys.argv[1], '--no-guided', '--jobs', '2']))"
    )
    running = subprocess.Popen(
        [sys.executable, "-c", script, str(folder)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        wait_for(lambda: len(processes_of(running.pid)) > 2)
        running.send_signal(end)
        _, said = running.communicate(timeout=60)
    finally:
        running.kill()
    assert said.strip().splitlines()[-1] in ("gtcal: interrupted", "gtcal: ended by a signal (SIGTERM)")
    assert running.returncode in (130, 143)
    wait_for(lambda: not processes_of(running.pid))
    assert not (folder / ".gtcal").exists()


def processes_of(session: int) -> list[int]:
    found = subprocess.run(["ps", "-o", "pid=", "-s", str(session)], capture_output=True, text=True, check=False).stdout
    return [int(pid) for pid in found.split()]


def wait_for(true: Callable[[], bool], most_s: float = 60.0) -> None:
    end_s = time.monotonic() + most_s
    while not true():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_jobs_limit_the_cores(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("GTCAL_JOBS", "1")
    assert n_cores() == 1
    for arguments in (["schema", "--jobs", "0"], ["schema", "--jobs"], ["schema", "--jobs=many"]):
        assert main(arguments) == 2
        assert "expected a whole number of cores" in capsys.readouterr().err
    monkeypatch.setenv("GTCAL_JOBS", "1.5")
    assert main(["schema"]) == 2
    assert "GTCAL_JOBS is '1.5'" in capsys.readouterr().err


def test_jobs_are_taken_by_every_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("GTCAL_JOBS", "3")
    monkeypatch.setenv("OPENCV_FOR_THREADS_NUM", "3")
    assert main(["schema", "--jobs", "1"]) == 0
    assert os.environ["GTCAL_JOBS"] == "1"
    for _ in range(2):
        with pytest.raises(SystemExit):
            main(["detect", "--help"])
        assert capsys.readouterr().out.count("--jobs N") == 1
