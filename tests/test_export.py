"""gtcal export: a calibration for other tools, from the command line. That each format's own library reads it to the
same pixels is tested in test_camera_files.py."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
import yaml
from camera_files_support import file_of, points_in, rig_of
from cli_support import files_in, run

from factors.rigid import inverse
from gtcal.camera_files.export import EXPORT_FORMATS, export_calibration
from gtcal.camera_files.formats import CAMERA_FILE_READERS, read_rig, write_rig
from gtcal.camera_files.rig import Rig
from gtcal.cli.export import Format
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import fixed_cameras_rig, quest3_like_rig
from gtcal.simulation.lollypop import exact_calibration

RIGS = {
    "headset": (Capture.TRACKED_PLATFORM, quest3_like_rig()),
    "fixed": (Capture.FIXED_CAMERAS, fixed_cameras_rig()),
}
HOLD = {
    "headset": {"colmap", "aria", "hot3d", "umetrack", "numpy"},
    "fixed": {"basalt", "opencv", "ros", "ros_bag", "colmap", "anipose", "numpy"},  # with k3
}


def calibrated(kind: str) -> Calibration:
    capture, rig = RIGS[kind]
    poses = {camera.name: inverse(rig.rig_T_camera[i]) for i, camera in enumerate(rig.cameras)}
    return exact_calibration(capture, rig.cameras, poses)


@pytest.fixture(params=RIGS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def path(kind: str, tmp_path: Path) -> Path:
    """A calibration.json."""
    write_calibration(tmp_path / "calibration.json", calibrated(kind))
    return tmp_path / "calibration.json"


@pytest.mark.parametrize("to", EXPORT_FORMATS)
def test_every_format_from_the_command_line(to: str, kind: str, path: Path, tmp_path: Path) -> None:
    """Held exactly or, with --nearest, nearly; in the frame of ref."""
    out = file_of(tmp_path / "out", to)
    ran = run("export", path, "--to", to, "-o", out)
    exact = to in HOLD[kind]
    if not exact:
        assert ran.code == 1
        assert ran.err.count("\n") == 1
        assert "give --nearest to write that, or take --to numpy, which loses nothing" in ran.err
        assert not out.exists()
        ran = run("export", path, "--to", to, "-o", out, "--nearest")
    assert ran.code == 0, ran.err
    wrote, *lost = ran.out.splitlines()
    assert wrote == f"wrote {out}"
    assert bool(lost) is not exact
    assert all(re.fullmatch(r"camera '\w+' as \w+: off by [\d.e-]+ px rms, [\d.e-]+ px at most", line) for line in lost)
    before = read_calibration(path).cameras
    again = read_rig(out, None).rig
    assert {camera.name for camera in again.cameras} == set(before)
    for camera in again.cameras:
        np.testing.assert_allclose(camera.camera_T_ref, before[camera.name].camera_T_ref.a_T_b, atol=1e-12)
        points = points_in(before[camera.name].camera)
        off_px = np.abs(camera.camera.project(points)[0] - before[camera.name].camera.project(points)[0]).max()
        assert off_px < (1e-9 if exact else 5.0)


@pytest.mark.parametrize("to", sorted(set(EXPORT_FORMATS) - {"numpy", "ros_bag"}))
def test_every_file_says_how_it_was_made_and_what_ref_is(to: str, tmp_path: Path) -> None:
    path, out = tmp_path / "calibration.json", file_of(tmp_path / "out", to)
    write_calibration(path, calibrated("headset"))
    assert run("export", path, "--to", to, "-o", out, "--nearest").code == 0
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    for file in [out] if out.is_file() else sorted(out.iterdir()):
        text = file.read_text()
        if text.count("\n") > 1:  # COLMAP wants files for the frames, images and points that there are none of
            assert f"made by gtcal export, version {version('gtcal')} from calibration.json, SHA-256 {sha256}" in text
            assert "ref is the tracked platform's body, as the mocap defines it; camera_T_ref takes coord" in text
            assert "metres; camera frame x right, y down, z forward; " in text


def test_the_launch_file_names_the_frames(kind: str, path: Path, tmp_path: Path) -> None:
    assert run("export", path, "--to", "ros", "-o", tmp_path / "out", "--nearest").code == 0
    launch = (tmp_path / "out" / "static_transforms.launch.xml").read_text()
    parent = {"headset": "platform", "fixed": "mocap_world"}[kind]
    for name in read_calibration(path).cameras:
        assert f"--frame-id {parent} --child-frame-id {name}_optical_frame" in launch


def test_numpy_loses_nothing(kind: str, path: Path, tmp_path: Path) -> None:
    calibration = read_calibration(path)
    export_calibration(calibration, tmp_path / "rig.npz", "numpy")
    with np.load(tmp_path / "rig.npz") as file:
        np.testing.assert_array_equal(file["body_T_board"], calibration.body_T_board.a_T_b)
        for i, name in enumerate(file["names"]):
            expected = calibration.cameras[str(name)]
            np.testing.assert_array_equal(file[f"theta_{name}"], expected.camera.theta)
            np.testing.assert_array_equal(file["camera_T_ref"][i], expected.camera_T_ref.a_T_b)


def test_the_nearest_lens_is_as_near_as_the_file_says(tmp_path: Path) -> None:
    calibration = calibrated("headset")
    export_calibration(calibration, tmp_path / "rig.yaml", "opencv", nearest=True)
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    for i, calibrated_camera in enumerate(calibration.cameras.values()):
        camera, node = calibrated_camera.camera, storage.getNode(f"cam{i}")
        points = points_in(camera, 0.8)
        points = points[points[:, 2] > 0]
        K, D = node.getNode("camera_matrix").mat(), node.getNode("distortion_coefficients").mat().reshape(4)
        found = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, D)[0][:, 0]
        off_px = np.linalg.norm(found - camera.project(points)[0], axis=1)
        assert 0.0 < off_px.max() <= 1.05 * node.getNode("lens_off_at_most_px").real()


def test_kalibrs_chain_leads_back_to_every_camera(tmp_path: Path) -> None:
    calibration = calibrated("headset")
    export_calibration(calibration, tmp_path / "chain.yaml", "kalibr", nearest=True)
    chain = yaml.safe_load((tmp_path / "chain.yaml").read_text())
    camera_T_ref = np.array(chain["cam0"]["camera_T_ref"])
    for i, calibrated_camera in enumerate(calibration.cameras.values()):
        camera_T_ref = np.array(chain[f"cam{i}"]["T_cn_cnm1"]) @ camera_T_ref if i else camera_T_ref
        np.testing.assert_allclose(camera_T_ref, calibrated_camera.camera_T_ref.a_T_b, atol=1e-9)


def test_a_calibration_is_a_camera_file_itself(path: Path) -> None:
    read = read_rig(path, None)
    assert read.format_name == "gtcal"
    for name, camera in read_calibration(path).cameras.items():
        found = next(other for other in read.rig.cameras if other.name == name)
        np.testing.assert_array_equal(found.camera.theta, camera.camera.theta)
        np.testing.assert_array_equal(found.camera_T_ref, camera.camera_T_ref.a_T_b)


def test_the_command_line_offers_every_format() -> None:
    assert get_args(Format) == EXPORT_FORMATS


def test_what_goes_wrong_ends_in_one_line_with_nothing_written(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.json", calibrated("fixed"))
    with pytest.raises(GtcalError, match="'calibr' is no format of an export; formats: kalibr, opencv"):
        export_calibration(calibrated("fixed"), tmp_path / "x", "calibr")
    whole = (tmp_path / "calibration.json").read_text()
    (tmp_path / "cut.json").write_text(whole[: len(whole) // 2])
    before = files_in(tmp_path)
    for source, message in (("cut.json", "is not valid JSON"), ("no.json", "can't be read")):
        for to in ("kalibr", "ros", "ros_bag"):
            ran = run("export", tmp_path / source, "--to", to, "-o", tmp_path / "out")
            assert (ran.code, ran.err.count("\n")) == (1, 1)
            assert message in ran.err
    for to in ("colmap", "ros", "ros_bag", "opencv"):
        ran = run("export", tmp_path / "calibration.json", "--to", to, "-o", tmp_path / "cut.json" / "out")
        assert (ran.code, ran.err.count("\n")) == (1, 1)
        assert "can't be written" in ran.err
    assert files_in(tmp_path) == before
    assert run("export", tmp_path / "calibration.json", "--to", "calibr", "-o", tmp_path / "out").code == 2


NAMES = ["café", "камера 1", "相机", "x😀", "left 'front\"", "a: b #c", "007", "a=b"]


@pytest.mark.parametrize("to", EXPORT_FORMATS)
def test_a_name_is_kept_or_said_to_be_another_or_refused(to: str, tmp_path: Path) -> None:
    """By reading again what was written, before it is put in place."""
    rig = rig_of("fisheye62", "fisheye")
    for name in NAMES:
        cameras = (replace(rig.cameras[0], camera=replace(rig.cameras[0].camera, name=name)), rig.cameras[1])
        out = file_of(tmp_path / str(NAMES.index(name)), to)
        named = replace(rig, cameras=cameras)
        if to in ("ros", "colmap") and not re.fullmatch(r"\w+", name, re.ASCII):  # it is to name a file
            with pytest.raises(GtcalError, match=re.escape(repr(name))):
                write_rig(named, out, to, [], nearest=True)
            assert not out.exists()
            continue
        lost = write_rig(named, out, to, [], nearest=True)
        read = [camera.name for camera in read_rig(out, to).rig.cameras]
        assert name in read or any(f"camera {name!r} is called " in line for line in lost)
        assert name in read or to == "ros_bag"


def test_what_can_not_be_read_again_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, options: object) -> Rig:
        raise GtcalError(f"{path}: cam0: is missing")

    monkeypatch.setitem(CAMERA_FILE_READERS, "kalibr", refuse)
    (tmp_path / "out.yaml").write_text("old")
    with pytest.raises(GtcalError, match=r"can't hold these cameras: out\.yaml: cam0: is missing"):
        write_rig(rig_of("radtan"), tmp_path / "out.yaml", "kalibr", [])
    assert files_in(tmp_path) == {"out.yaml"}
    assert (tmp_path / "out.yaml").read_text() == "old"


def test_a_bag_holds_no_hidden_file(tmp_path: Path) -> None:
    """Its data are called after it, so that 'cp bag/*' takes all of it."""
    write_rig(rig_of("radtan"), tmp_path / "bag", "ros_bag", [])
    assert files_in(tmp_path) == {"bag/bag.db3", "bag/metadata.yaml"}
    assert "- bag.db3" in (tmp_path / "bag" / "metadata.yaml").read_text()
