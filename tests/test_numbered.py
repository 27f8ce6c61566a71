"""Recordings by number: the same calibration as by time, and what has no time is refused in a line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import replace_once

from gtcal.errors import GtcalError
from gtcal.estimation.options import CalibrationOptions
from gtcal.overview.draft import draft
from gtcal.overview.summary import summarise
from gtcal.overview.survey import survey
from gtcal.readers.pose_list import write_pose_list
from gtcal.recordings.images import numbered_folder
from gtcal.recordings.numbering import number_of_name, numbers_of, stamps_of
from gtcal.recordings.recording import Recording, load_recording, write_recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation import MocapNoise, SimulationOptions, simulate
from gtcal.workflow import calibrate

QUICK = CalibrationOptions(intrinsics="exact", effects=False, clock="trust", mocap="exact")


def by_number(recording: Recording) -> Recording:
    """The poses at the images' times, one for each, and numbers in place of the times."""
    stamps_ns = np.unique(np.concatenate([found.stamps_ns for found in recording.detections.values()]))
    bodies = {
        name: Trajectory(name, stamps_of(np.arange(len(stamps_ns))), body.interpolate(stamps_ns, 1.0).world_T_body)
        for name, body in recording.motion.trajectories.items()
    }
    detections = {
        name: replace(found, stamps_ns=stamps_of(np.searchsorted(stamps_ns, found.stamps_ns)))
        for name, found in recording.detections.items()
    }
    return replace(recording, detections=detections, numbered=True, **bodies)


@pytest.fixture(scope="module")
def stamped() -> Recording:
    return simulate(SimulationOptions(n_frames=25, mocap=MocapNoise(0.1, 0.01)), seed=5).recording


@pytest.fixture(scope="module")
def numbered(stamped: Recording) -> Recording:
    return by_number(stamped)


@pytest.fixture
def folder(numbered: Recording, tmp_path: Path) -> Path:
    write_recording(numbered, tmp_path / "recording")
    return tmp_path / "recording"


def test_by_number_is_as_good_as_by_time(stamped: Recording, numbered: Recording) -> None:
    by_time, found = calibrate(stamped, QUICK), calibrate(numbered, QUICK)
    for name, camera in found.cameras.items():
        np.testing.assert_allclose(camera.camera_T_ref.a_T_b, by_time.cameras[name].camera_T_ref.a_T_b, atol=1e-9)


def test_what_is_written_is_read_back(numbered: Recording, folder: Path) -> None:
    back = load_recording(folder)
    assert back.numbered
    for name, found in numbered.detections.items():
        np.testing.assert_array_equal(back.detections[name].stamps_ns, found.stamps_ns)
        np.testing.assert_array_equal(back.detections[name].corners_px, found.corners_px)
    for name, body in numbered.motion.trajectories.items():
        np.testing.assert_allclose(back.motion.trajectories[name].world_T_body, body.world_T_body, atol=1e-12)
    assert summarise(back).numbered


def test_no_time_means_no_jitter_no_correlation_and_no_clock(numbered: Recording) -> None:
    found = calibrate(numbered, replace(QUICK, mocap="estimate", effects=True, clock="test"))
    assert found.mocap_noise is not None
    assert found.mocap_noise.correlation_s == 0.0
    assert found.mocap_noise.jitter_s == 0.0
    assert found.clock is None
    assert not any(effect.moment or "clock" in effect.name for effect in found.effects)


def test_images_without_a_pose_are_left_out_and_counted(numbered: Recording) -> None:
    board = numbered.board_body
    assert board is not None
    fewer = Trajectory("board_body", board.stamps_ns[3:], board.world_T_body[3:])
    found = calibrate(replace(numbered, board_body=fewer), QUICK)
    assert {drop.reason for drop in found.dropped} >= {"no pose of its number in board_body"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (replace(QUICK, clock="estimate"), "--clock estimate: this recording goes by number"),
        (CalibrationOptions(segments="auto"), "--segments auto: this recording goes by number"),
    ],
)
def test_options_of_time_are_refused(numbered: Recording, options: CalibrationOptions, message: str) -> None:
    with pytest.raises(GtcalError, match=message):
        calibrate(numbered, options)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("numbered: true", "", r"platform.format: a pose_list has no time stamps; .* set numbered: true"),
        ("numbered: true", "numbered: true\nmax_gap_ms: 5.0", "max_gap_ms: has to do with time"),
        ("format: pose_list", "format: euroc_csv", "numbered: true takes a pose_list, one pose for each image"),
        ("stamp_offset_ns: 0", "stamp_offset_ns: 5", "stamp_offset_ns: has to do with time"),
        ("format: pose_list", "format: pose_list, time_unit: s", "a list of poses has no time; leave it out"),
        ("format: pose_list", "format: pose_list, quaternion: wxyz", "header says quaternion xyzw, but the manifest"),
    ],
)
def test_manifests_that_contradict_themselves(old: str, new: str, message: str, folder: Path) -> None:
    replace_once(folder / "recording.yaml", old, new)
    with pytest.raises(GtcalError, match=message) as told:
        load_recording(folder)
    assert "\n" not in str(told.value)


def test_a_list_without_numbers_has_one_pose_for_each_image(numbered: Recording, folder: Path) -> None:
    board = numbered.board_body
    assert board is not None
    fewer = board.n_samples - 1
    for n, message in ((fewer + 1, ""), (fewer, f"{fewer} poses for {fewer + 1} images")):
        rows = board.world_T_body[:n].reshape(-1, 16)
        (folder / "board_body.csv").write_text("\n".join(" ".join(map(repr, row)) for row in rows.tolist()))
        text = (folder / "recording.yaml").read_text().replace("board_body.csv", "board_body.csv, length_unit: m")
        (folder / "recording.yaml").write_text(text.replace("length_unit: m, length_unit: m", "length_unit: m"))
        if message:
            with pytest.raises(GtcalError, match=message):
                load_recording(folder)
        else:
            np.testing.assert_allclose(load_recording(folder).board_body.world_T_body, board.world_T_body)  # type: ignore[union-attr]


def test_corners_by_time_in_a_recording_by_number(folder: Path) -> None:
    replace_once(next(folder.glob("*_detections.csv")), "number,", "timestamp_ns,")
    with pytest.raises(GtcalError, match="numbered: true, but these corners have time stamps"):
        load_recording(folder)


def test_numbers_of_names(tmp_path: Path) -> None:
    assert [number_of_name(name) for name in ("0007.png", "img-12.jpg", "cam0_000003.tif")] == [7, 12, 3]
    with pytest.raises(GtcalError, match="has no number"):
        number_of_name("left.png")
    for name in ("b_10.png", "b_9.png", "b_100.png"):
        (tmp_path / name).write_bytes(b"")
    images = numbered_folder(tmp_path)
    assert numbers_of(images.stamps_ns).tolist() == [9, 10, 100]
    (tmp_path / "a_9.png").write_bytes(b"")
    with pytest.raises(GtcalError, match=r"a_9.png and b_9.png have the same number 9"):
        numbered_folder(tmp_path)


DOTS = """\
gtcal_recording: 1
capture: standing_board
numbered: true
board: {type: dot_grid, dot_columns: 10, dot_rows: 10, dot_pitch_m: 0.0254}
cameras:
"""


def arm_as_it_is(data: Path, folder: Path) -> Path:
    """The robot arm's dots, images and poses by number, each view turned at random as a detector may have it."""
    rng, rows = np.random.default_rng(0), np.loadtxt(data / "corners.csv", delimiter=",", skiprows=1)
    numbers, turns = rows[:, 0].astype(np.int64) // 10**9, rng.integers(4, size=100)
    row, column = np.divmod(rows[:, 1].astype(np.int64), 10)
    for _ in range(3):
        again = turns[numbers] > 0
        row, column = np.where(again, 9 - column, row), np.where(again, row, column)
        turns = np.maximum(turns - 1, 0)
    ids, pixels = 10 * row + column, rows[:, 2:].tolist()
    lines = [f"{n},{i},{x!r},{y!r}" for n, i, (x, y) in zip(numbers, ids, pixels, strict=True)]
    folder.mkdir()
    (folder / "corners.csv").write_text("\n".join(["number,corner_id,x_px,y_px", *lines]) + "\n")
    poses = np.loadtxt(data / "wrist.tum")[:, 1:]
    np.savetxt(folder / "wrist.txt", poses)
    camera = (data / "recording.yaml").read_text().split("cameras:\n")[1].split("platform:")[0]
    (folder / "recording.yaml").write_text(
        f"{DOTS}{camera}platform: {{trajectory: wrist.txt, format: pose_list, quaternion: xyzw, length_unit: m}}\n"
    )
    return folder


def test_init_drafts_the_arms_recording(shared: Callable[[str], Path], tmp_path: Path) -> None:
    folder = arm_as_it_is(shared("data/robot_arm_dots"), tmp_path / "arm")
    by_hand = (folder / "recording.yaml").read_text()
    (folder / "recording.yaml").unlink()
    drafted = draft(survey(folder), folder / "recording.yaml").text
    camera = by_hand.split("    model")[1].split("    detections")[0]
    lens = camera.split("parameters: ")[1].strip()
    answers = {
        "board: QUESTION": DOTS.splitlines()[3],
        "    model: QUESTION": f"    model{camera.split('    image_size_px')[0].rstrip()}",
        "    image_size_px: QUESTION": f"    parameters: {lens}\n    image_size_px: [640, 480]",
        "length_unit: QUESTION": "length_unit: m",
        "quaternion: QUESTION": "quaternion: xyzw",
    }
    for asked, answer in answers.items():
        assert asked in drafted
        drafted = drafted.replace(asked, answer)
    (folder / "recording.yaml").write_text(drafted)
    found = load_recording(folder)
    assert found.numbered
    assert found.detections["cam0"].n_views == 15


def test_a_robot_arms_dots_as_what_they_are(shared: Callable[[str], Path], tmp_path: Path) -> None:
    folder = arm_as_it_is(shared("data/robot_arm_dots"), tmp_path / "arm")
    found = calibrate(load_recording(folder), CalibrationOptions(effects=False))
    assert found.cameras["cam0"].residuals.rmse_px < 1.74
    assert found.mocap_noise is not None
    assert min(found.mocap_noise.hold_out_px.values()) < 2.04


def test_poses_by_number_of_several_cameras_serve_all(numbered: Recording, folder: Path) -> None:
    body = numbered.board_body
    assert body is not None
    write_pose_list(folder / "board_body.csv", numbers_of(body.stamps_ns)[::-1], body.world_T_body[::-1])
    np.testing.assert_allclose(load_recording(folder).board_body.world_T_body, body.world_T_body, atol=1e-12)  # type: ignore[union-attr]
