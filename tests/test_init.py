"""gtcal init: what a folder states is taken, what it doesn't is a question, and the answers give a recording."""

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
from cli_support import all_in, files_in, run
from detection_support import PINHOLE, Filmer
from media_support import image_message, write_bag, write_video
from mocap_files import write_motive
from support import EPOCH_NS, wandering_trajectory
from test_folder_layouts import CAMCHAIN, SENSOR, STAMPS_NS, body, camera
from vrs_support import image_stream, write_vrs

from gtcal.board import AprilGrid, ArucoGrid, Board, CharucoBoard
from gtcal.detection.board_guess import guess_board, guess_lone_tag
from gtcal.errors import GtcalError
from gtcal.overview.draft import draft
from gtcal.overview.survey import survey
from gtcal.readers import write_euroc_csv, write_tum
from gtcal.recordings.images import image_folder
from gtcal.recordings.recording import load_recording
from gtcal.results.calibration_file import read_calibration
from gtcal.verification.lollypop_recording import load_lollypop_recording

GREY = [np.full((48, 64), 20 * i, np.uint8) for i in range(4)]


def drafted(folder: Path) -> tuple[dict, tuple[str, ...]]:
    """The fields of the draft, and its questions."""
    found = draft(survey(folder), folder / "recording.yaml")
    return yaml.safe_load(found.text), found.questions


def answered(path: Path, answers: dict[str, str]) -> None:
    """Answer the questions in a draft, each by the name of its field."""
    text = path.read_text()
    for name, answer in answers.items():
        assert f"{name}: QUESTION" in text
        text = text.replace(f"{name}: QUESTION", f"{name}: {answer}")
    path.write_text(text)


def test_the_real_vicon_folder_calibrates_after_two_answers(shared: Callable[[str], Path], tmp_path: Path) -> None:
    folder = tmp_path / "vicon"
    shutil.copytree(shared("data/vicon_aprilgrid"), folder)
    ran = run("init", folder)
    assert ran.code == 0
    assert all_in(ran.out, ["to be answered there, 2:", "platform.length_unit, board_body.length_unit: Are the"])
    manifest = folder / "recording.yaml"
    assert all_in(manifest.read_text(), ["calib_mocap-intel_d435i.yaml. The images show its tags", "grid0/cam0/data"])
    refused = run("calibrate", folder, "-o", tmp_path / "calibration.json")
    assert refused.code == 1
    assert re.search(
        r"recording\.yaml:\d+: platform\.length_unit: is still an open question: Are the positions in m", refused.err
    )
    assert not (tmp_path / "calibration.json").exists()
    text = manifest.read_text().replace("length_unit: QUESTION", "length_unit: m")
    manifest.write_text(text.replace("# detections:", "detections:"))
    options = ("--calibrate-intrinsics", "--mocap-noise", "exact", "--clock", "trust", "-q")
    assert run("calibrate", folder, "-o", tmp_path / "calibration.json", *options).code == 0
    assert read_calibration(tmp_path / "calibration.json").rmse_px < 1.1


def test_a_draft_does_not_replace_a_manifest_unasked(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    body(tmp_path / "mocap0")
    (tmp_path / "recording.yaml").write_text("mine")
    before = files_in(tmp_path)
    refused = run("init", tmp_path)
    assert refused.code == 1
    assert "recording.yaml: is there already; --force replaces it" in refused.err
    assert ((tmp_path / "recording.yaml").read_text(), files_in(tmp_path)) == ("mine", before)
    assert run("init", tmp_path, "--force", "-q").out == ""
    assert (tmp_path / "recording.yaml").read_text() != "mine"


def test_a_draft_elsewhere_points_to_the_folder(tmp_path: Path) -> None:
    camera(tmp_path / "data" / "cam0")
    body(tmp_path / "data" / "headset")
    assert run("init", tmp_path / "data", "-o", tmp_path / "other" / "recording.yaml").code == 0
    fields = yaml.safe_load((tmp_path / "other" / "recording.yaml").read_text())
    assert fields["cameras"]["cam0"]["images"] == "../data/cam0/data"
    assert fields["platform"]["trajectory"] == "../data/headset/data.csv"


def test_lenses_and_bodies_of_a_data_set_are_found(tmp_path: Path) -> None:
    for name in ("cam0", "cam1"):
        camera(tmp_path / "mav0" / name)
    (tmp_path / "mav0" / "cam0" / "sensor.yaml").write_text(SENSOR)
    (tmp_path / "dso").mkdir()
    (tmp_path / "dso" / "camchain.yaml").write_text(CAMCHAIN)
    body(tmp_path / "mav0" / "vicon0")
    body(tmp_path / "mav0" / "state_groundtruth_estimate0")
    fields, questions = drafted(tmp_path)
    assert fields["capture"] == "standing_board"
    assert fields["cameras"]["cam0"]["model"] == "pinhole_radtan"
    assert fields["cameras"]["cam1"]["model"] == "kannala_brandt4"
    assert fields["cameras"]["cam1"]["image_list"] == "mav0/cam1/data.csv"
    assert fields["platform"] == {"trajectory": "mav0/vicon0/data.csv", "format": "euroc_csv"}
    assert [question.split(":")[0] for question in questions] == ["board"]
    (tmp_path / "recording.yaml").write_text(draft(survey(tmp_path), tmp_path / "recording.yaml").text)
    answered(tmp_path / "recording.yaml", {"board": "{preset: paper_a2}"})
    assert load_recording(tmp_path).cameras["cam1"].theta[0] == 19.0


def test_videos_bags_and_vrs_become_cameras(tmp_path: Path) -> None:
    for library in ("av", "rosbags", "pyvrs"):
        pytest.importorskip(library)
    write_video(tmp_path / "left.mkv", GREY, [0, 40, 80, 120])
    stamps_ns = [EPOCH_NS + 40_000_000 * i for i in range(4)]
    rows = [(stamp, stamp, image_message(GREY[i])) for i, stamp in enumerate(stamps_ns)]
    write_bag(tmp_path / "old.bag", {"/front/image_raw": rows})
    write_bag(tmp_path / "new", {"/rear/image_raw": rows}, storage="mcap")
    write_vrs(tmp_path / "glasses.vrs", [image_stream(GREY, [0.1, 0.2, 0.3, 0.4], stamps_ns)])
    (tmp_path / "broken.mp4").write_text("hello")
    write_euroc_csv(tmp_path / "headset.csv", wandering_trajectory("headset"))
    found = survey(tmp_path)
    assert len(found.left) == 1
    assert "broken.mp4: is not a video" in found.left[0]
    (tmp_path / "recording.yaml").write_text(draft(found, tmp_path / "recording.yaml").text)
    answers = {"board": "{preset: paper_a2}", "model": "fisheye62", "stamp_offset_ns": str(EPOCH_NS)}
    answered(tmp_path / "recording.yaml", answers)
    recording = load_recording(tmp_path)
    assert sorted(recording.images) == ["front", "glasses_1201_1", "left", "rear"]
    for name in recording.images:
        assert recording.images[name].stamps_ns.tolist() == stamps_ns
        np.testing.assert_array_equal(recording.images[name].read(2), GREY[2])


def test_names_that_are_no_stamps_are_a_question(tmp_path: Path) -> None:
    (tmp_path / "cam0").mkdir()
    for i in range(3):
        cv2.imwrite(str(tmp_path / "cam0" / f"frame_{i}.png"), GREY[i])
    write_tum(tmp_path / "board.txt", wandering_trajectory("board"))
    fields, questions = drafted(tmp_path)
    assert fields["cameras"]["cam0"]["image_list"] == "QUESTION"
    assert fields["cameras"]["cam0"]["image_size_px"] == [64, 48]
    assert any("cam0.image_list: Which CSV 'timestamp [ns],filename' lists these" in line for line in questions)
    assert fields["capture"] == "fixed_cameras"
    assert fields["board_body"] == {"trajectory": "board.txt", "format": "tum"}


def test_a_damaged_image_is_left_aside(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    camera(tmp_path / "cam1")
    (tmp_path / "cam1" / "data" / f"{STAMPS_NS[0]}.png").write_bytes(b"\x89PNG")
    body(tmp_path / "headset")
    found = survey(tmp_path)
    assert [entry.name for entry in found.cameras] == ["cam0"]
    assert "the image file is cut off" in found.left[0]
    assert "# Left aside: " in draft(found, tmp_path / "recording.yaml").text


def test_bodies_whose_names_tell_nothing_are_a_question(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    for name in ("a", "b"):
        write_euroc_csv(tmp_path / f"{name}.csv", wandering_trajectory(name))
    fields, questions = drafted(tmp_path)
    assert (fields["capture"], fields["platform"], fields["board_body"]) == ("QUESTION",) * 3
    assert [line.split(":")[0] for line in questions] == [
        "capture",
        "board",
        "cameras.cam0.model",
        "platform",
        "board_body",
    ]
    assert "{trajectory: a.csv, format: euroc_csv}; {trajectory: b.csv, format: euroc_csv}" in questions[3]


def test_what_a_file_leaves_open_is_asked(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    rows = "\n".join(f"{EPOCH_NS + 10**7 * i},0.1,0.2,0.3,0,0,0,1" for i in range(5))
    (tmp_path / "headset.csv").write_text(rows + "\n")
    fields, questions = drafted(tmp_path)
    asked = {line.split(":")[0] for line in questions if line.startswith("platform")}
    assert asked == {"platform.quaternion", "platform.length_unit", "platform.time_unit"}
    assert fields["platform"]["quaternion"] == "QUESTION"


def test_clocks_that_have_nothing_in_common_are_said(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    camera(tmp_path / "cam1")
    early = wandering_trajectory("headset")
    write_euroc_csv(tmp_path / "headset.csv", replace(early, stamps_ns=early.stamps_ns - EPOCH_NS))
    ran = run("init", tmp_path)
    text = (tmp_path / "recording.yaml").read_text()
    expected = rf"cam0 \({STAMPS_NS[0]} to .* has no time in common with headset \(.*\) \(cam1 too\): another clock"
    assert re.search(f"WARNING: {expected}", text.replace("\n# ", " "))
    assert text.count("WARNING") == 1
    assert re.search(f"warning: {expected}", ran.out)
    assert ran.out.count("Which lens model") == 1
    assert "cameras.cam0.model, cameras.cam1.model: Which lens model" in ran.out


def test_the_bodies_of_one_export_are_told_apart_by_name(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    takes = {name: wandering_trajectory(name, seed=seed).world_T_body for seed, name in enumerate(("Headset", "Board"))}
    write_motive(tmp_path / "take.csv", takes)
    fields, _ = drafted(tmp_path)
    assert fields["capture"] == "tracked_platform"
    entry = {"trajectory": "take.csv", "format": "motive_csv"}
    assert fields["platform"] == entry | {"name": "Headset"}
    assert fields["board_body"] == entry | {"name": "Board"}


@pytest.mark.parametrize("make", [lambda folder: None, lambda folder: (folder / "notes.txt").write_text("hello\n")])
def test_a_folder_with_nothing_in_it_is_told(make: Callable[[Path], object], tmp_path: Path) -> None:
    make(tmp_path)
    ran = run("init", tmp_path)
    assert ran.code == 1
    assert "holds no images, videos, bags or VRS files and no file of a mocap" in ran.err
    assert not (tmp_path / "recording.yaml").exists()
    assert "there is no such folder" in run("init", tmp_path / "nowhere").err


def views(board: Board, folder: Path, widths_away: float = 1.6) -> Path:
    filmer = Filmer(PINHOLE)
    folder.mkdir()
    for i in range(4):
        view = filmer.view(board, widths_away * max(board.width_m, board.height_m), tilt_deg=25.0)
        cv2.imwrite(str(folder / f"{EPOCH_NS + 10**9 * i}.png"), view.image)
    return folder


@pytest.mark.long
@pytest.mark.parametrize(
    ("board", "kind", "dictionary", "arranged"),
    [
        (AprilGrid(6, 5, 0.088, 0.3), "aprilgrid", "DICT_APRILTAG_36h11", (6, 5, 0)),
        (ArucoGrid("DICT_6X6_250", 5, 7, 0.04, 0.01, first_tag_id=10), "aruco_grid", "DICT_6X6_50", (5, 7, 10)),
        (CharucoBoard("DICT_5X5_100", 8, 6, 0.06, 0.045), "charuco", "DICT_5X5_50", (8, 6, 0)),
    ],
)
def test_tags_tell_the_dictionary_and_the_arrangement(
    board: Board, kind: str, dictionary: str, arranged: tuple[int, int, int], tmp_path: Path
) -> None:
    guess = guess_board(image_folder(views(board, tmp_path / "cam0")))
    assert guess is not None
    assert (guess.kind, guess.dictionary) == (kind, dictionary)
    assert (guess.columns, guess.rows, guess.first_tag_id) == arranged


def test_sizes_are_asked_where_the_tags_are_known(tmp_path: Path) -> None:
    board = AprilGrid(6, 5, 0.088, 0.3)
    views(board, tmp_path / "cam0")
    write_euroc_csv(tmp_path / "board.csv", wandering_trajectory("board"))
    fields, questions = drafted(tmp_path)
    assert fields["board"]["tag_columns"] == 6
    assert [line.split(":")[0] for line in questions] == ["board.tag_side_m", "board.tag_spacing", "cameras.cam0.model"]
    (tmp_path / "recording.yaml").write_text(draft(survey(tmp_path), tmp_path / "recording.yaml").text)
    answers = {"tag_side_m": "0.088", "tag_spacing": "0.3", "model": "pinhole_radtan"}
    answered(tmp_path / "recording.yaml", answers)
    assert load_recording(tmp_path).board == board


def test_a_tag_alone_is_a_lollypops(tmp_path: Path) -> None:
    views(ArucoGrid("DICT_6X6_250", 1, 1, 0.3, 0.075, first_tag_id=10), tmp_path / "cam0", 5.0)
    for seed, name in enumerate(("headset", "lollypop", "board")):
        write_euroc_csv(tmp_path / f"{name}.csv", wandering_trajectory(name, seed=seed))
    fields, questions = drafted(tmp_path)
    assert fields["capture"] == "tracked_platform"
    assert fields["device_body"] == {"trajectory": "lollypop.csv", "format": "euroc_csv"}
    assert "board" not in fields
    assert "board_body" not in fields
    assert [line.split(":")[0] for line in questions] == [
        "device.tag_side_m",
        "device.centre_offset_m",
        "cameras.cam0.model",
    ]
    (tmp_path / "recording.yaml").write_text(draft(survey(tmp_path), tmp_path / "recording.yaml").text)
    with pytest.raises(GtcalError, match=r"device\.tag_side_m: is still an open question: How long is the side"):
        load_lollypop_recording(tmp_path)
    answers = {"tag_side_m": "0.06", "centre_offset_m": "[0, 0, 0.01]", "model": "pinhole_radtan"}
    answered(tmp_path / "recording.yaml", answers)
    device = load_lollypop_recording(tmp_path).device
    assert (device.tag_ids.tolist(), device.faces[0].centre_in_body_m) == ([10], (0.0, 0.0, 0.01))


@pytest.mark.long
def test_the_papers_lollypop_is_offered(tmp_path: Path) -> None:
    views(ArucoGrid("DICT_5X5_50", 1, 1, 0.3, 0.075), tmp_path / "cam0", 5.0)
    write_euroc_csv(tmp_path / "wand.csv", wandering_trajectory("wand"))
    fields, questions = drafted(tmp_path)
    assert (fields["capture"], fields["device"]) == ("fixed_cameras", "QUESTION")
    assert "answer {preset: paper_lollypop}" in questions[0]


def test_images_of_no_board_show_none(tmp_path: Path) -> None:
    camera(tmp_path / "cam0")
    images = image_folder(tmp_path / "cam0" / "data")
    assert guess_board(images) is None
    assert guess_lone_tag(images) is None


@pytest.mark.long
def test_a_board_file_that_the_images_contradict_is_said(tmp_path: Path) -> None:
    views(CharucoBoard("DICT_5X5_100", 8, 6, 0.06, 0.045), tmp_path / "cam0")
    (tmp_path / "april_6x6.yaml").write_text(
        "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
    )
    text = draft(survey(tmp_path), tmp_path / "recording.yaml").text.replace("\n# ", " ")
    assert "From april_6x6.yaml. BUT the images show charuco tags of DICT_5X5_50, ids 0 to 23: check it." in text
