import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from gtcal.errors import GtcalError
from gtcal.recordings.manifest import find_manifest, manifest_schema, read_manifest, write_manifest


def valid() -> dict[str, Any]:
    return {
        "gtcal_recording": 1,
        "capture": "tracked_platform",
        "board": {"preset": "paper_a2"},
        "cameras": {
            "cam0": {"model": "fisheye62", "image_size_px": [1280, 1024], "images": "cam0"},
            "cam1": {"model": "pinhole_radtan", "image_size_px": [640, 480], "detections": "cam1.csv"},
        },
        "platform": {
            "trajectory": "body0/data.csv",
            "format": "euroc_csv",
            "quaternion": "xyzw",
            "length_unit": "m",
        },
        "board_body": {"trajectory": "board.txt", "format": "tum"},
        "max_gap_ms": 50,
    }


def changed(path: str, value: Any = None) -> dict[str, Any]:
    """The valid manifest with the field at this dotted path set, or removed where no value is given."""
    manifest = valid()
    *parents, name = path.split(".")
    place = manifest
    for parent in parents:
        place = place[parent]
    if value is None:
        del place[name]
    else:
        place[name] = value
    return manifest


def written(folder: Path, manifest: dict[str, Any]) -> Path:
    (folder / "recording.yaml").write_text(yaml.safe_dump(manifest))
    return folder / "recording.yaml"


def test_yaml_and_json_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text(json.dumps(valid()))
    assert read_manifest(tmp_path / "m.json") == read_manifest(written(tmp_path, valid()))


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    manifest = read_manifest(written(tmp_path, changed("max_gap_ms", 1e-5)))
    write_manifest(tmp_path / "again.yaml", manifest)
    assert read_manifest(tmp_path / "again.yaml") == manifest
    assert "null" not in (tmp_path / "again.yaml").read_text()


def test_yaml_is_read_as_people_mean_it(tmp_path: Path) -> None:
    text = yaml.safe_dump(valid()).replace("max_gap_ms: 50", "max_gap_ms: 5e1")
    (tmp_path / "m.yaml").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert read_manifest(tmp_path / "m.yaml").max_gap_ms == 50
    shared_fields = text.replace("board_body:\n", "board_body:\n  <<: {pose: body_T_world}\n")
    (tmp_path / "m.yaml").write_text(shared_fields)
    body = read_manifest(tmp_path / "m.yaml").board_body
    assert body is not None
    assert body.pose == "body_T_world"


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        (
            changed("cameras.cam0.model", "fisheye63"),
            r"cameras\.cam0\.model: 'fisheye63' is not a camera model; did you mean 'fisheye62'\?; choose from .*"
            "kannala_brandt4",
        ),
        (changed("capture", "handheld"), "capture: 'handheld' is not a capture kind; choose from fixed_cameras, "),
        (changed("platform.format", "euroc"), "platform.format: .*did you mean 'euroc_csv'"),
        (
            changed("cameras.cam0.modle", "x"),
            r"cameras\.cam0\.modle: is not a field; did you mean 'model'\?; fields:",
        ),
        (changed("camreas", {}), r"camreas: is not a field; did you mean 'cameras'\?; fields: gtcal_recording, "),
        (
            changed("platform.quat", "xyzw"),
            r"platform\.quat: is not a field; fields: trajectory, format, quaternion",
        ),
        (changed("cameras.cam0.model"), r"cameras\.cam0\.model: is missing; it says: The camera model"),
        (changed("cameras"), "cameras: is missing; it says: The cameras by name"),
        (changed("gtcal_recording"), "gtcal_recording: is missing"),
        (changed("gtcal_recording", 2), "gtcal_recording: is 2; expected 1"),
        (changed("cameras", {}), "cameras: is {}; "),
        (changed("cameras.cam0", "fisheye62"), r"cameras\.cam0: is 'fisheye62'; expected"),
        (
            changed("cameras.cam0.image_size_px", [1280]),
            r"cameras\.cam0\.image_size_px: is \[1280\]; .* at least 2",
        ),
        (changed("cameras.cam0.image_size_px", [1280, 0]), r"image_size_px\.1: is 0; expected greater than 0"),
        (
            changed("cameras.cam0.image_size_px", ["1280", 1]),
            r"image_size_px\.0: is '1280'; expected a valid integer",
        ),
        (changed("cameras.cam0.parameters", {"fx": float("nan")}), r"parameters\.fx: is nan; expected a finite"),
        (
            changed("cameras.cam0.parameters", [1.0, 2.0]),
            r"cameras\.cam0\.parameters: is \[1\.0, 2\.0\]; expected",
        ),
        (changed("platform.length_unit", "cm"), r"platform\.length_unit: is 'cm'; expected 'm' or 'mm'"),
        (changed("max_gap_ms", -1), "max_gap_ms: is -1; expected greater than 0"),
        (changed("cameras.cam0.images"), r"cameras\.cam0: has neither 'images' nor"),
        (changed("cameras.cam0.video", "a.mp4"), r"cameras\.cam0: has 'images' and 'video'; its images come from one"),
        (changed("cameras.cam0.topic", "/cam0"), r"cameras\.cam0\.topic: belongs to 'bag', which isn't given"),
        (changed("cameras.cam0.stream", "1"), r"cameras\.cam0\.stream: belongs to 'vrs' or 'video', which isn't given"),
        (changed("cameras.cam1.stamp_offset_ns", 5), r"cameras\.cam1\.stamp_offset_ns: belongs to 'images' or"),
        (
            changed("cameras.cam0.stamp_offset_ns", 0.5),
            r"cameras\.cam0\.stamp_offset_ns: is 0\.5; expected a valid int",
        ),
        (
            changed("cameras.cam1", {**valid()["cameras"]["cam1"], "images": "cam1", "stamp_offset_ns": 5}),
            r"cameras\.cam1\.stamp_offset_ns: shifts the stamps of images, not those of 'detections'",
        ),
        (
            changed("cameras.cam1", {"model": "fisheye62", "image_size_px": [640, 480], "video": "a.mp4"}),
            r"cameras\.cam1\.stamp_offset_ns: is missing; a video's stamps count from its first frame",
        ),
        (changed("board_body"), "board_body: is missing; capture tracked_platform needs platform and board_body"),
        (
            changed("capture", "standing_board"),
            "board_body: capture standing_board has no use .* set capture: tracked_",
        ),
        (
            changed("capture", "fixed_cameras"),
            "platform: capture fixed_cameras has no use for it, only for board_body",
        ),
    ],
)
def test_a_wrong_field_is_named_with_what_was_expected(manifest: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        read_manifest(written(tmp_path, manifest))
    assert str(caught.value).startswith(f"{tmp_path}/recording.yaml: ")
    assert "\n" not in str(caught.value)


def test_a_misspelt_field_is_named_before_the_one_it_leaves_missing(tmp_path: Path) -> None:
    manifest = changed("cameras.cam0.modell", "fisheye62")
    del manifest["cameras"]["cam0"]["model"]
    with pytest.raises(GtcalError, match=r"modell: is not a field; did you mean 'model'\?.* \(and 1 more\)$"):
        read_manifest(written(tmp_path, manifest))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("m.yaml", "a: [1\nb: 2\n", r"m\.yaml:2: is not valid YAML: "),
        ("m.yaml", "a: 1\nb: 2\na: 3\n", r"m\.yaml:3: .*the field 'a' stands twice"),
        ("m.yaml", "cameras:\n  0: {}\n", r"m\.yaml:2: .*the name '0' is no text; put it in quotes"),
        ("m.yaml", "a: \x07\n", r"m\.yaml: is not valid YAML: unacceptable character"),
        ("m.yaml", "", r"m\.yaml: is no manifest"),
        ("m.yaml", "- a\n", r"m\.yaml: is no manifest"),
        ("m.json", '{"a": 1,\n "b": }', r"m\.json:2: is not valid JSON: "),
        ("m.json", '{"a": 1, "a": 2}', r"m\.json: the field 'a' stands twice"),
    ],
)
def test_what_is_no_yaml_or_json_is_told_with_its_line(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(GtcalError, match=message) as caught:
        read_manifest(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_what_is_no_text_is_told(tmp_path: Path) -> None:
    (tmp_path / "recording.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(GtcalError, match=r"recording\.yaml: is not UTF-8"):
        read_manifest(tmp_path / "recording.yaml")


def test_the_manifest_is_found_in_its_folder(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match="nowhere: there is no such recording"):
        find_manifest(tmp_path / "nowhere")
    with pytest.raises(GtcalError, match=r"no manifest in this folder; expected recording\.yaml or"):
        find_manifest(tmp_path)
    path = written(tmp_path, valid())
    assert find_manifest(tmp_path) == find_manifest(path) == path
    (tmp_path / "recording.json").write_text("{}")
    with pytest.raises(GtcalError, match=r"recording\.yaml and recording\.json; keep one"):
        find_manifest(tmp_path)


def test_the_schema_names_fields_choices_and_what_each_capture_needs() -> None:
    schema = json.loads(json.dumps(manifest_schema()))
    assert schema["required"] == ["gtcal_recording", "capture", "board"]
    assert schema["anyOf"] == [{"required": ["cameras"]}, {"required": ["layout"]}]
    assert schema["additionalProperties"] is False
    assert "fisheye62" in schema["$defs"]["CameraEntry"]["properties"]["model"]["enum"]
    formats = ["euroc_csv", "tum", "motive_csv", "vicon_csv", "qualisys_tsv", "c3d", "trc", "rosbag", "pose_list"]
    assert schema["$defs"]["TrajectoryEntry"]["properties"]["format"]["enum"] == formats
    assert {"oneOf", "description"} <= set(schema["properties"]["board"])
    needs = {rule["if"]["properties"]["capture"]["const"]: rule["then"] for rule in schema["allOf"]}
    layout = {"required": ["layout"]}
    assert needs["standing_board"] == {
        "anyOf": [{"required": ["platform"]}, layout],
        "properties": {"board_body": False},
    }
    assert needs["tracked_platform"] == {
        "anyOf": [{"required": ["platform", "board_body"]}, layout],
        "properties": {},
    }
    for entry in ("CameraEntry", "TrajectoryEntry"):
        assert all("description" in field for field in schema["$defs"][entry]["properties"].values())


def from_a_file(**changes: Any) -> dict[str, Any]:
    """The valid manifest with the lens of cam0 in a camera file."""
    manifest = valid()
    manifest["cameras"]["cam0"] = {"intrinsics": {"file": "chain.yaml"}, "images": "cam0"} | changes
    return manifest


def test_a_file_of_intrinsics_stands_for_model_size_and_parameters(tmp_path: Path) -> None:
    entry = read_manifest(written(tmp_path, from_a_file())).cameras["cam0"]
    assert (entry.model, entry.image_size_px, entry.intrinsics.file) == (None, None, "chain.yaml")
    stated = read_manifest(written(tmp_path, from_a_file(model="fisheye62", image_size_px=[1, 2])))
    write_manifest(tmp_path / "again.yaml", stated)
    assert read_manifest(tmp_path / "again.yaml") == stated


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        (from_a_file(parameters={"fx": 1.0}), r"cameras\.cam0: has both 'intrinsics' and 'parameters'; give one"),
        (from_a_file(intrinsics={}), r"cameras\.cam0\.intrinsics\.file: is missing; it says: The file"),
        (
            from_a_file(intrinsics={"file": "x", "formt": "kalibr"}),
            r"intrinsics\.formt: is not a field; did you mean 'format'\?; fields: file, format, camera",
        ),
        (
            from_a_file(intrinsics={"file": "x", "format": "calibr"}),
            r"intrinsics\.format: 'calibr' is not a format of camera files; did you mean 'kalibr'\?",
        ),
        (from_a_file(intrinsics="chain.yaml"), r"cameras\.cam0\.intrinsics: is 'chain.yaml'; expected"),
        (changed("cameras.cam0.image_size_px"), r"cameras\.cam0\.image_size_px: is missing; it says: Width and height"),
    ],
)
def test_a_wrong_file_of_intrinsics_is_named(manifest: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        read_manifest(written(tmp_path, manifest))
    assert "\n" not in str(caught.value)


def test_the_schema_asks_for_a_lens_or_its_file() -> None:
    schema = json.loads(json.dumps(manifest_schema()))["$defs"]
    assert schema["CameraEntry"]["anyOf"] == [{"required": ["model", "image_size_px"]}, {"required": ["intrinsics"]}]
    assert "kalibr" in schema["IntrinsicsEntry"]["properties"]["format"]["enum"]
    assert all("description" in field for field in schema["IntrinsicsEntry"]["properties"].values())


def test_a_field_that_is_written_as_messages_name_it(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(yaml.safe_dump({**valid(), "platform.stamp_offset_ns": 5}))
    with pytest.raises(GtcalError, match=r"write 'stamp_offset_ns' as a field within 'platform'"):
        read_manifest(tmp_path / "m.yaml")


def test_a_result_is_no_manifest(tmp_path: Path) -> None:
    (tmp_path / "cal.json").write_text('{"gtcal_calibration": 5, "cameras": {}}')
    with pytest.raises(GtcalError, match=r"cal\.json: is a calibration of gtcal, not the manifest of a recording"):
        read_manifest(tmp_path / "cal.json")
