from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from support import replace_once

from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.recordings.recording import load_recording
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop import DEVICE_PRESETS, device_from_manifest, device_manifest_schema
from gtcal.verification.lollypop_recording import (
    load_lollypop_recording,
    read_device,
    write_lollypop_recording,
)

PAPER = DEVICE_PRESETS["paper_lollypop"]

ONE_TAG: dict[str, Any] = {"dictionary": "DICT_5X5_50", "tag_id": 7, "tag_side_m": 0.05}
HALF = float(np.sqrt(0.5))
CUBE: dict[str, Any] = {
    "dictionary": "DICT_4X4_50",
    "faces": [
        {"tag_id": 1, "tag_side_m": 0.05, "centre_in_body_m": [0.0, 0.0, 0.04]},
        {
            "tag_id": 2,
            "tag_side_m": 0.05,
            "centre_in_body_m": [0.04, 0.0, 0.0],
            "quat_wxyz": [HALF, 0.0, HALF, 0.0],
        },
    ],
    "markers_m": [[0.05, 0.05, 0.05], [-0.05, 0.02, 0.03], [0.01, -0.05, -0.04]],
}
GRID: dict[str, Any] = {**ONE_TAG, "tag_columns": 2, "tag_rows": 2, "tag_gap_m": 0.01}
BLOCKS = [{"preset": "paper_lollypop"}, ONE_TAG, GRID, CUBE]


def test_the_papers_discs_have_their_centroid_in_the_tag_and_no_two_distances_alike() -> None:
    discs = PAPER.markers_in_body_m
    assert discs.shape == (6, 3)
    np.testing.assert_allclose(discs.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(PAPER.corners_m.mean(axis=0), 0.0, atol=1e-12)
    apart = np.linalg.norm(discs[:, None] - discs, axis=2)[np.triu_indices(6, 1)]
    assert np.diff(np.sort(apart)).min() > 0.003
    # no disc covers the tag or its white margin of a module
    half = PAPER.faces[0].board.tag_side_m / 2 + PAPER.faces[0].board.module_m
    assert (np.abs(discs[:, :2]).max(axis=1) - PAPER.marker_diameter_m / 2 > half).all()


@pytest.mark.parametrize("block", BLOCKS)
def test_a_device_is_read_back_as_it_was_written(block: dict[str, Any]) -> None:
    device = device_from_manifest(block)
    written = yaml.safe_load(yaml.safe_dump(device.to_manifest()))
    assert device_from_manifest(written) == device
    for given in (block, written):
        fitting = [way for way in device_manifest_schema()["oneOf"] if set(given) <= set(way["properties"])]
        assert any(set(way["required"]) <= set(given) for way in fitting)


def test_corners_of_a_face_lie_where_its_pose_puts_them() -> None:
    device = device_from_manifest(CUBE)
    assert device.n_corners == 8
    np.testing.assert_array_equal(device.corner_faces, [0] * 4 + [1] * 4)
    side = device.corners_m[4:]
    np.testing.assert_allclose(side[:, 0], 0.04, atol=1e-12)  # the face looks along the body's x
    np.testing.assert_allclose(side.mean(axis=0), [0.04, 0.0, 0.0], atol=1e-12)
    body_R_face = Rotation.from_quat([0.0, HALF, 0.0, HALF]).as_matrix()
    np.testing.assert_allclose(body_R_face @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(side, device.corners_in_face_m[4:] @ body_R_face.T + [0.04, 0, 0], atol=1e-12)
    assert device.corner_name(5) == "tag 2 corner 1"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dictionary": "DICT_9X9"}, "dictionary 'DICT_9X9' is not known"),
        ({"tag_side_m": 50.0}, "'tag_side_m' is 50; expected .* metres; 50 mm is 0.05 m"),
        ({"tag_side_m": "big"}, "tag_side_m' is 'big'; expected a number"),
        ({"tag_id": 50}, "needs the tag ids 50 to 50, but DICT_5X5_50 ends at 49"),
        ({"tag_id": True}, "'tag_id' is True; expected a whole number"),
        ({"tag_ids": 3}, "device has no field 'tag_ids'; fields: "),
        ({"tag_columns": 2}, "'tag_gap_m' is missing; a grid of tags needs"),
        ({"tape_thickness_m": 0.12}, "'tape_thickness_m' is 0.12; expected 0 to 0.01 metres"),
        ({"marker_diameter_m": 0.0}, "'marker_diameter_m' is 0; expected"),
        ({"markers_m": [[8, 48, 0]]}, "'markers_m' has a coordinate beyond 1 m; lengths are in metres"),
        ({"markers_m": [[0.01, 0.02]]}, r"'markers_m\[0\]' is .*; expected \[x, y, z\]"),
        ({"markers_m": [[0.03, 0.0, 0.0]]}, r"centroid .* lies \(30.00, 0.00, 0.00\) mm from its face's centre"),
    ],
)
def test_a_wrong_device_is_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(GtcalError, match=message) as error:
        device_from_manifest({**ONE_TAG, **change})
    assert "\n" not in str(error.value)


def test_faces_are_checked_too() -> None:
    twice = {**CUBE, "faces": [CUBE["faces"][0]] * 2}
    with pytest.raises(GtcalError, match="tag 1 is on the device twice"):
        device_from_manifest(twice)
    with pytest.raises(GtcalError, match=r"'faces\[0\].quat_wxyz' has the norm 2"):
        device_from_manifest({**CUBE, "faces": [{**CUBE["faces"][0], "quat_wxyz": [2, 0, 0, 0]}]})
    with pytest.raises(GtcalError, match="'faces' is empty"):
        device_from_manifest({**CUBE, "faces": []})
    with pytest.raises(GtcalError, match="'dictionary' is missing"):
        device_from_manifest({"tag_id": 1})
    with pytest.raises(GtcalError, match="preset 'lolly' is not known; presets: paper_lollypop"):
        device_from_manifest({"preset": "lolly"})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    simulation = simulate_lollypop(LollypopOptions(duration_s=3.0), seed=4)
    write_lollypop_simulation(simulation, tmp_path / "lollypop", images=False)
    return tmp_path / "lollypop"


def test_a_recording_is_read_back_as_it_was_written(folder: Path, tmp_path: Path) -> None:
    first = load_lollypop_recording(folder)
    again = load_lollypop_recording(write_lollypop_recording(first, tmp_path / "again"))
    assert again.device == PAPER
    for name, detections in first.detections.items():
        np.testing.assert_array_equal(again.detections[name].corners_px, detections.corners_px)
        np.testing.assert_array_equal(again.detections[name].stamps_ns, detections.stamps_ns)
    np.testing.assert_allclose(again.device_body.world_T_body, first.device_body.world_T_body, atol=1e-14)
    assert again.platform is not None
    assert {file.path.name for file in first.inputs} >= {"recording.yaml", "device_body.csv", "platform.csv"}


def test_the_device_may_be_in_a_file_of_its_own(folder: Path) -> None:
    (folder / "device.json").write_text(json.dumps(ONE_TAG))
    replace_once(folder / "recording.yaml", "device: {preset: paper_lollypop}", "device: device.json")
    assert load_lollypop_recording(folder).device == device_from_manifest(ONE_TAG)
    (folder / "device.json").write_text("{")
    with pytest.raises(GtcalError, match=r"recording.yaml: device: .*device.json: is not valid YAML or JSON"):
        load_lollypop_recording(folder)
    with pytest.raises(GtcalError, match=r"nowhere\.yaml: can't be read"):
        read_device(folder / "nowhere.yaml")


def test_board_and_lollypop_are_not_taken_for_each_other(folder: Path, recording_folder: Path) -> None:
    with pytest.raises(GtcalError, match="this is a recording of a Lollypop, which verifies"):
        load_recording(folder)
    with pytest.raises(GtcalError, match="this is a recording of a board, to calibrate from; a verification needs"):
        load_lollypop_recording(recording_folder)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("capture: tracked_platform", "capture: standing_board", "the Lollypop is tracked: set tracked_platform"),
        ("capture: tracked_platform", "capture: fixed_cameras", "platform: capture fixed_cameras has no use for it"),
        ("device_body:", "device_bodies:", "device_bodies: is not a field; did you mean 'device_body'"),
        ("{preset: paper_lollypop}", "{preset: paper}", "recording.yaml: device: device preset 'paper' is not known"),
        ("device_body.csv", "nobody.csv", "device_body.trajectory: there is no .*nobody.csv"),
        ("platform:", "board_body:", "board_body: is not a field"),
    ],
)
def test_a_wrong_manifest_is_refused_in_one_line(folder: Path, old: str, new: str, message: str) -> None:
    replace_once(folder / "recording.yaml", old, new)
    with pytest.raises(GtcalError, match=message) as error:
        load_lollypop_recording(folder)
    assert "\n" not in str(error.value)


def test_the_schema_of_a_lollypop_recording_names_what_the_manifest_has(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["schema", "--lollypop"]) == 0
    schema = json.loads(capsys.readouterr().out)
    manifest = yaml.safe_load((folder / "recording.yaml").read_text())
    assert set(manifest) <= set(schema["properties"])
    assert set(schema["required"]) == {"gtcal_recording", "capture", "device"}
    assert schema["anyOf"] == [{"required": ["cameras", "device_body"]}, {"required": ["layout"]}]
