"""Several boards at once: read and told apart, and all cameras in one estimate."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from cli_support import run
from support import replace_once

from factors.rigid import inverse
from gtcal import CalibrationOptions, calibrate
from gtcal.board import PAPER_A2
from gtcal.camera import FloatArray
from gtcal.camera_files.calibration_rig import calibration_rig
from gtcal.camera_files.formats import read_rig, write_rig
from gtcal.errors import GtcalError
from gtcal.estimation.linear import squared_distance
from gtcal.plain_boards import Chessboard
from gtcal.recordings.recording import Recording
from gtcal.results.calibration_file import read_calibration
from gtcal.several_boards.calibration import calibrate_boards, solved_together
from gtcal.several_boards.recording import check_told_apart, load_boards, write_boards
from gtcal.simulation import SimulationOptions, quest3_like_rig
from gtcal.simulation.several import boards_like, simulate_boards
from gtcal.simulation.simulate import Simulation

RIG = replace(quest3_like_rig(), cameras=quest3_like_rig().cameras[:2], rig_T_camera=quest3_like_rig().rig_T_camera[:2])
OPTIONS = CalibrationOptions(intrinsics="exact", effects=False, clock="trust")


@pytest.fixture(scope="module")
def simulations() -> dict[str, Simulation]:
    options = SimulationOptions(rig=RIG, n_frames=25, duration_s=20.0)
    return simulate_boards(options, boards_like(PAPER_A2, 2), seed=5)


@pytest.fixture(scope="module")
def recordings(simulations: dict[str, Simulation]) -> dict[str, Recording]:
    return {name: one.recording for name, one in simulations.items()}


def _apart(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(inverse(a) @ b)))


def test_what_is_written_reads_back(recordings: dict[str, Recording], tmp_path: Path) -> None:
    back = load_boards(write_boards(recordings, tmp_path))
    assert list(back) == list(recordings)
    for name, one in recordings.items():
        assert back[name].board == one.board
        assert back[name].capture is one.capture
        stamps = one.motion.trajectories["board_body"].stamps_ns[5:9]
        poses = (motion.at(stamps).ref_T_body for motion in (back[name].motion, one.motion))
        np.testing.assert_allclose(*poses, atol=1e-12)
        for camera, found in one.detections.items():
            np.testing.assert_array_equal(back[name].detections[camera].corners_px, found.corners_px)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("first_tag_id: 24", "first_tag_id: 20", r"'board_1' and 'board_2' share 4 tags of DICT_4X4_50, 20 the first"),
        (
            "    body: {trajectory: board_2_body.csv, format: euroc_csv}\n",
            "",
            None,  # it then stands, as the platform is tracked
        ),
        (
            "board_2: front_left_board_2",
            "board_3: front_left_board_2",
            "'board_3' is none of the boards: board_1, board_2",
        ),
        ("format: euroc_csv}\ncameras", "format: eurocc}\ncameras", "boards.board_2.body.format: "),
        ("trajectory: board_2_body.csv", "trajectory: nowhere.csv", "boards.board_2: .*there is no .*nowhere.csv"),
    ],
)
def test_each_fault_is_told_in_one_line(
    old: str, new: str, message: str | None, recordings: dict[str, Recording], tmp_path: Path
) -> None:
    manifest = write_boards(recordings, tmp_path)
    replace_once(manifest, old, new)
    if message is None:
        assert load_boards(manifest)["board_2"].capture.value == "standing_board"
        return
    with pytest.raises(GtcalError, match=message) as told:
        load_boards(manifest)
    assert "\n" not in str(told.value)


def test_boards_without_tags_are_not_told_apart() -> None:
    plain = Chessboard(7, 5, 0.03)
    with pytest.raises(GtcalError, match="have no tags"):
        check_told_apart({"a": plain, "b": Chessboard(9, 6, 0.03)})
    check_told_apart({"a": plain, "b": PAPER_A2})


def test_all_else_refuses_them_in_a_line(recordings: dict[str, Recording], tmp_path: Path) -> None:
    write_boards(recordings, tmp_path)
    for command in ("doctor", "selfcheck", "compare"):
        assert "a recording of several" in run(command, tmp_path).err
    asked = run("calibrate", tmp_path, "-o", tmp_path / "x.json", "--kernel", "Huber")
    assert asked.code == 1
    assert "can't be calibrated with a robust kernel" in asked.err


def test_one_board_by_this_way_is_that_board_alone(recordings: dict[str, Recording]) -> None:
    alone = calibrate(recordings["board_1"], OPTIONS)
    joint = solved_together({"only": alone}, OPTIONS)
    assert alone.covariance is not None
    for name, camera in alone.cameras.items():
        off = _apart(camera.camera_T_ref.a_T_b, joint.camera_T_ref[name])
        covariance = camera.camera_T_ref.covariance
        assert covariance is not None
        assert squared_distance(off, covariance) < 1e-4
    np.testing.assert_allclose(joint.covariance, alone.covariance.matrix, rtol=2e-2, atol=1e-3 * 1e-9)


@pytest.mark.long
def test_the_truth_lies_where_the_joint_covariance_says(simulations: dict[str, Simulation]) -> None:
    nees = []
    for seed in range(6):
        options = SimulationOptions(rig=RIG, n_frames=40)
        sims = simulate_boards(options, boards_like(PAPER_A2, 2), seed=seed)
        alone = {name: calibrate(one.recording, OPTIONS) for name, one in sims.items()}
        joint = solved_together(alone, OPTIONS)
        truth = next(iter(sims.values())).truth.camera_T_ref
        xi = [_apart(joint.body_T_board[name], one.truth.body_T_board) for name, one in sims.items()]
        xi += [_apart(joint.camera_T_ref[name], truth[name]) for name in joint.camera_T_ref]
        nees.append(squared_distance(np.concatenate(xi), joint.covariance) / 24)
        for one in alone.values():
            for name, camera in one.cameras.items():
                columns = joint.columns_of_camera(name)
                own = camera.camera_T_ref.covariance
                assert own is not None
                assert np.trace(joint.covariance[np.ix_(columns, columns)]) < np.trace(own)
    assert 0.6 < np.mean(nees) < 1.5  # 144 degrees of freedom together


@pytest.mark.long
def test_from_the_simulation_to_the_report(tmp_path: Path) -> None:
    folder = tmp_path / "two"
    assert run("simulate", "-o", folder, "--boards", "2", "--frames", "40").code == 0
    ran = run("calibrate", folder, "-o", tmp_path / "c.json", "--report", tmp_path / "r.html")
    assert ran.code == 0
    assert "board_2" in ran.out
    back = read_calibration(tmp_path / "c.json")
    assert [board.name for board in back.other_boards] == ["board_2"]
    assert back.other_boards[0].body_T_board.covariance is not None
    assert "board_2" in (tmp_path / "r.html").read_text()
    assert run("report", tmp_path / "c.json", "--recording", folder, "-o", tmp_path / "again.html").code == 0


@pytest.mark.long
def test_boards_that_hide_each_other_in_images_are_told_apart(tmp_path: Path) -> None:
    folder = tmp_path / "two"
    small = ("--frames", "24", "--duration-s", "16", "--image-scale", "0.5")
    assert run("simulate", "-o", folder, "--boards", "2", "--images", *small).code == 0
    assert run("calibrate", folder, "-o", tmp_path / "c.json").code == 0
    found = read_calibration(tmp_path / "c.json")
    truth = json.loads((folder / "ground_truth.json").read_text())
    (other,) = found.other_boards
    (first,) = truth["boards"].keys() - {other.name}
    for estimate, expected in (
        (found.body_T_board, truth["boards"][first]),
        (other.body_T_board, truth["boards"][other.name]),
        *((camera.camera_T_ref, truth["cameras"][name]["camera_T_ref"]) for name, camera in found.cameras.items()),
    ):
        assert estimate.covariance is not None
        assert squared_distance(_apart(estimate.a_T_b, np.array(expected)), estimate.covariance) < 6 * 4.0
    assert not write_rig(calibration_rig(found), tmp_path / "rig.npz", "numpy", ["of a test"])
    back = read_rig(tmp_path / "rig.npz", "numpy").rig
    np.testing.assert_array_equal(back.other_boards[other.name], other.body_T_board.a_T_b)


def test_a_board_that_moved_is_named(recordings: dict[str, Recording]) -> None:
    bumped = recordings["board_2"]
    assert bumped.platform is not None
    slip = gtsam.Pose3.Expmap(np.array([0.0, 0.02, 0.0, 0.0, 0.01, 0.0])).matrix()
    platform = replace(bumped.platform, world_T_body=bumped.platform.world_T_body @ slip)
    found = calibrate_boards({**recordings, "board_2": replace(bumped, platform=platform)}, OPTIONS)
    assert any("by itself puts camera" in line for line in found.warnings)
