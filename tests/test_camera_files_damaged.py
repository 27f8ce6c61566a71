"""Camera files that are damaged, wrong or missing, and rigs that can't be written: one line each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from camera_files_support import (
    ARIA_FACTORY,
    CAMERA_INFO,
    CAMERA_INFO_MESSAGE,
    COLMAP_CAMERAS,
    HOLD,
    HOT3D_CLIP,
    KALIBR,
    LENSES,
    OPENCV,
    POSE2SIM,
    RADTAN,
    UMETRACK,
    read_text_as,
    rig_of,
    said,
    written,
)

from factors import PINHOLE_RADTAN
from gtcal.camera import Camera
from gtcal.camera_files.formats import CAMERA_FILE_WRITERS, read_rig, write_rig
from gtcal.camera_files.rig import Rig, RigCamera
from gtcal.errors import GtcalError

# Damage


def one_line(path: Path, format_name: str) -> str | None:
    """What is said about a file, None where it is read."""
    told = said(path, format_name)
    if told is not None:
        assert "\n" not in told
        assert path.name in told
    return told


@pytest.mark.parametrize("format_name", sorted(set(CAMERA_FILE_WRITERS) - {"ros_bag"}))
def test_a_file_cut_short_ends_in_one_line(format_name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, format_name, rig_of(*sorted(HOLD[format_name])))
    file = next(iter(sorted(path.glob("*.yaml")))) if format_name == "ros" else path
    file = path / "rig_config.json" if format_name == "colmap" else file
    whole = file.read_bytes()
    refused = 0
    for share in np.linspace(0.0, 0.97, 30):
        file.write_bytes(whole[: int(share * len(whole))])
        refused += one_line(path, format_name) is not None
    assert refused >= 12  # of a text, what is cut off may be the last cameras, or nothing but poses
    assert capfd.readouterr().err == ""


def damaged(value: object) -> list[object]:
    """What may stand in place of a value."""
    return [None, "text", -1, [], {}, float("nan"), 10**400]


def spots(value: object, way: tuple = ()) -> list[tuple]:
    """The places of all fields in a document."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = []
    for key, inner in entries:
        found += [(*way, key), *spots(inner, (*way, key))]
    return found


@pytest.mark.parametrize(
    ("name", "format_name", "document"),
    [
        ("chain.json", "kalibr", yaml.safe_load(KALIBR)),
        ("info.json", "ros", yaml.safe_load(CAMERA_INFO)),
        ("clip.json", "hot3d", HOT3D_CLIP),
        ("aria.json", "aria", ARIA_FACTORY | {"ImageSizes": [[640, 480]]}),
        ("umetrack.json", "umetrack", UMETRACK),
    ],
)
def test_every_field_that_is_missing_renamed_or_wrong_is_told_in_one_line_or_not_needed(
    name: str, format_name: str, document: dict, tmp_path: Path
) -> None:
    path, told = tmp_path / name, 0
    for way in spots(document):
        for value in damaged(document):
            broken = json.loads(json.dumps(document))
            place = broken
            for key in way[:-1]:
                place = place[key]
            place[way[-1]] = value
            path.write_text(json.dumps(broken))
            told += one_line(path, format_name) is not None
        broken = json.loads(json.dumps(document))
        place = broken
        for key in way[:-1]:
            place = place[key]
        if isinstance(place, dict):
            place[f"{way[-1]}_"] = place.pop(way[-1])
            path.write_text(json.dumps(broken))
            told += one_line(path, format_name) is not None
    assert told > 2 * len(spots(document))


@pytest.mark.parametrize(
    ("name", "content", "format_name", "message"),
    [
        (
            "c.yaml",
            KALIBR.replace("pinhole", "cata", 1),
            None,
            r"cam0\.camera_model: is 'cata', and gtcal has no such lens",
        ),
        ("c.yaml", KALIBR.replace("radtan", "fov", 1), None, r"cam0\.distortion_model: is 'fov'"),
        ("c.yaml", KALIBR.replace("resolution", "resolutoin", 1), None, r"cam0: the file doesn't state the size"),
        ("c.yaml", KALIBR.replace("intrinsics: [461.629", "intrinsics: [0"), None, r"focal lengths are 0 and 460.152"),
        ("c.yaml", KALIBR.replace("0.01779318", "0.5"), None, r"cam0\.T_cam_imu: is no rotation: its axes are off"),
        ("c.yml", OPENCV.replace("rows: 3", "rows: 4", 1), None, r"OpenCV can't read it|camera_matrix: "),
        ("c.yml", OPENCV.replace("e+02, 0., 3.19", "e+02, 2., 3.19", 1), None, r"camera_matrix: has a skew of 2 px"),
        ("i.yaml", CAMERA_INFO.replace("plumb_bob", "fisheye"), None, r"distortion_model: is 'fisheye'"),
        ("i.yaml", CAMERA_INFO_MESSAGE.replace("binning_x: 0", "binning_x: 2"), None, "the images are binned"),
        ("i.yaml", CAMERA_INFO_MESSAGE.replace("width: 0", "width: 100"), None, "the images are cropped"),
        ("cameras.txt", COLMAP_CAMERAS.replace(" 1152\n2", "\n2"), None, r"line 4: has 2 numbers; expected 3"),
        ("cameras.txt", COLMAP_CAMERAS.replace("PINHOLE", "EUCM", 1), None, r"'SIMPLE_EUCM' is no lens that gtcal has"),
        ("cameras.txt", COLMAP_CAMERAS.replace("2 PIN", "1 PIN", 1), None, r"line 5: there is a camera 1 already"),
        ("x.toml", POSE2SIM.replace("size", "sise", 1), "pose2sim", r"int_cam1_img\.size: is missing; there is 'sise'"),
        ("x.toml", POSE2SIM + "[", "pose2sim", r"x\.toml: is not valid TOML"),
        ("x.json", "[1, 2", None, r"x\.json:1: is not valid JSON"),
        ("x.json", "{}", None, r"is no camera file that gtcal knows; formats: kalibr, "),
        ("x.json", ARIA_FACTORY, "kalibr", r"there is no camera; expected cam0"),
        ("x.npz", "no zip", None, r"x\.npz: is no npz, or damaged"),
    ],
)
def test_what_is_wrong_is_named(
    name: str, content: object, format_name: str | None, message: str, tmp_path: Path
) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        read_text_as(tmp_path, name, content, format_name)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_or_of_an_unknown_format_is_told(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match="there is no such file"):
        read_rig(tmp_path / "no.yaml", None)
    (tmp_path / "c.yaml").write_text(KALIBR)
    with pytest.raises(GtcalError, match="'calibr' is no format of camera files; formats: kalibr, opencv"):
        read_rig(tmp_path / "c.yaml", "calibr")
    with pytest.raises(GtcalError, match="'calibr' is no format of an export"):
        write_rig(rig_of("radtan"), tmp_path / "x", "calibr", [])


def test_two_cameras_that_would_share_a_name_are_refused(tmp_path: Path) -> None:
    one, other = LENSES["radtan"], LENSES["radtan k3"]
    with pytest.raises(GtcalError, match="two cameras named 'radtan'"):
        Rig((RigCamera(one), RigCamera(one)), "ref", "ref")
    similar = [RigCamera(Camera(name, o.model, o.theta, 752, 480)) for name, o in (("a.b", one), ("a_b", other))]
    for format_name in ("ros", "ros_bag"):
        with pytest.raises(GtcalError, match="would have the same frame 'a_b_optical_frame' in ROS"):
            written(tmp_path / format_name, format_name, Rig(tuple(similar), "ref", "ref", "none"))
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize("format_name", ["ros", "colmap"])
def test_a_name_that_can_name_no_file_is_refused(format_name: str, tmp_path: Path) -> None:
    camera = Camera("one two", PINHOLE_RADTAN, np.array(RADTAN), 752, 480)
    with pytest.raises(GtcalError, match=r"camera 'one two': its name is to name a file"):
        written(tmp_path / "in", format_name, Rig((RigCamera(camera, np.eye(4)),), "ref", "ref"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("format_name", ["colmap", "aria", "hot3d", "anipose", "pose2sim"])
def test_a_format_of_rigs_refuses_cameras_without_poses(format_name: str, tmp_path: Path) -> None:
    lens = "radtan" if "radtan" in HOLD[format_name] else "fisheye62"
    with pytest.raises(GtcalError, match="needs every camera's pose, and there is none: nobody measured them"):
        written(tmp_path, format_name, Rig((RigCamera(LENSES[lens]),), "ref", "ref", "nobody measured them"))


def test_a_bag_is_a_new_folder_and_a_damaged_one_is_told(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    path = written(tmp_path, "ros_bag", rig_of("radtan"))
    with pytest.raises(GtcalError, match="there is something here already"):
        written(tmp_path, "ros_bag", rig_of("radtan"))
    for file in (*path.glob("*.db3"), path / "metadata.yaml"):
        whole = file.read_bytes()
        file.write_bytes(whole[: len(whole) // 3])
        said = one_line(path, "ros_bag")
        assert said is not None
        assert "is not a ROS bag that can be read" in said
        file.write_bytes(whole)
    assert one_line(path, "ros_bag") is None


def test_without_rosbags_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(GtcalError, match=r"needs the library rosbags: pip install 'gtcal\[bags\]'"):
        written(tmp_path, "ros_bag", rig_of("radtan"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("format_name", "file"),
    [
        ("pose2sim", None),
        ("anipose", None),
        ("opencv", None),
        ("kalibr", None),
        ("colmap", "cameras.txt"),
        ("colmap", "rig_config.json"),
        ("ros", "fisheye.yaml"),
        ("ros", "static_transforms.launch.xml"),
    ],
)
def test_every_line_that_is_lost_or_garbled_is_told_in_one_line_or_not_needed(
    format_name: str, file: str | None, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, format_name, rig_of("fisheye"))
    damaged_file = path if file is None else path / file
    lines = damaged_file.read_text().splitlines()
    told = 0
    for i, line in enumerate(lines):
        garbled = [
            "",
            line[: len(line) // 2],
            line.replace("=", "=-"),
            line.replace(":", ": x"),
            line.replace("0", "nan"),
        ]
        for instead in garbled:
            if instead != line:
                damaged_file.write_text("\n".join([*lines[:i], instead, *lines[i + 1 :]]) + "\n")
                said_of_it = said(path, format_name)
                told += said_of_it is not None
                assert said_of_it is None or "\n" not in said_of_it
    assert told > 0.7 * len(lines)
    assert capfd.readouterr().err == ""
