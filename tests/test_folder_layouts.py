"""Folders as the EuRoC/ASL data sets, TUM-VI and yac lay them out open as recordings, once the board is stated."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from support import EPOCH_NS, replace_once, wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import write_euroc_csv
from gtcal.recordings.capture import Capture
from gtcal.recordings.layouts import find_layout
from gtcal.recordings.recording import load_recording
from gtcal.verification.lollypop_recording import load_lollypop_recording

BOARD = "board: {type: aprilgrid, tag_columns: 6, tag_rows: 6, tag_side_m: 0.088, tag_spacing: 0.3}\n"
HEAD = "gtcal_recording: 1\nlayout: euroc\n"
STAMPS_NS = EPOCH_NS + 50_000_000 * np.arange(4) + 7

SENSOR = """\
# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, -0.02, 1.0, 0.0, 0.0, -0.06, 0.0, 0.0, 1.0, 0.01, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [64, 48]
camera_model: pinhole
intrinsics: [45.8, 45.7, 31.5, 24.0] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""
CAMCHAIN = """\
cam0:
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.0034, 0.0007, -0.0020, 0.0002]
  distortion_model: equidistant
  intrinsics: [19.1, 19.2, 31.7, 23.9]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [0.0034, 0.0017, -0.0026, 0.0002]
  distortion_model: equidistant
  intrinsics: [19.0, 19.1, 31.6, 24.9]
  resolution: [64, 48]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
"""


def camera(folder: Path) -> None:
    (folder / "data").mkdir(parents=True)
    rows = ["#timestamp [ns],filename"]
    for stamp in STAMPS_NS.tolist():
        cv2.imwrite(str(folder / "data" / f"{stamp}.png"), np.full((48, 64), stamp % 200, np.uint8))
        rows.append(f"{stamp},{stamp}.png")
    (folder / "data.csv").write_text("\r\n".join(rows) + "\r\n")


def body(folder: Path, seed: int = 0) -> None:
    write_euroc_csv(folder / "data.csv", wandering_trajectory(folder.name, seed=seed))


@pytest.fixture
def euroc(tmp_path: Path) -> Path:
    """As EuRoC's, with a second tracked body."""
    for name in ("cam0", "cam1"):
        camera(tmp_path / "mav0" / name)
        (tmp_path / "mav0" / name / "sensor.yaml").write_text(SENSOR)
    body(tmp_path / "mav0" / "vicon0", 1)
    body(tmp_path / "mav0" / "target0", 2)
    for other in ("imu0", "state_groundtruth_estimate0"):
        body(tmp_path / "mav0" / other, 3)
    return tmp_path


@pytest.fixture
def tum_vi(tmp_path: Path) -> Path:
    for name in ("cam0", "cam1"):
        camera(tmp_path / "mav0" / name)
    body(tmp_path / "mav0" / "mocap0", 1)
    (tmp_path / "dso").mkdir()
    (tmp_path / "dso" / "camchain.yaml").write_text(CAMCHAIN)
    return tmp_path


def stated(folder: Path, text: str) -> Path:
    (folder / "recording.yaml").write_text(text)
    return folder


def test_a_euroc_folder_opens(euroc: Path) -> None:
    recording = load_recording(stated(euroc, HEAD + "capture: tracked_platform\n" + BOARD))
    assert list(recording.cameras) == ["cam0", "cam1"]
    lens = recording.cameras["cam0"]
    assert lens.model.name == "pinhole_radtan"
    expected = [45.8, 45.7, 31.5, 24.0, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0]
    assert lens.theta.tolist() == expected
    assert recording.images["cam1"].stamps_ns.tolist() == STAMPS_NS.tolist()
    for name, seed in (("platform", 1), ("board_body", 2)):
        written, read = wandering_trajectory(name, seed=seed), recording.motion.trajectories[name]
        np.testing.assert_array_equal(read.stamps_ns, written.stamps_ns)
        np.testing.assert_allclose(read.world_T_body, written.world_T_body, atol=1e-12)


def test_a_tum_vi_folder_opens(tum_vi: Path) -> None:
    recording = load_recording(stated(tum_vi, HEAD + "capture: standing_board\n" + BOARD))
    assert list(recording.motion.trajectories) == ["platform"]
    lens = recording.cameras["cam1"]
    assert lens.model.name == "kannala_brandt4"
    assert lens.theta.tolist() == [19.0, 19.1, 31.6, 24.9, 0.0034, 0.0017, -0.0026, 0.0002]
    assert (lens.image_width_px, lens.image_height_px) == (64, 48)


def test_all_that_is_tracked_is_the_board_where_the_cameras_stand(tum_vi: Path) -> None:
    recording = load_recording(stated(tum_vi, HEAD + "capture: fixed_cameras\n" + BOARD))
    assert list(recording.motion.trajectories) == ["board_body"]


def test_the_real_vicon_folder_opens(shared: Callable[[str], Path], tmp_path: Path) -> None:
    folder = tmp_path / "vicon"
    shutil.copytree(shared("data/vicon_aprilgrid"), folder)
    own = "cameras: {cam0: {model: pinhole_radtan, image_size_px: [640, 480]}}\n"
    units = "platform: {length_unit: m}\nboard_body: {length_unit: m}\n"
    recording = load_recording(stated(folder, HEAD + "capture: tracked_platform\n" + BOARD + own + units))
    assert len(recording.images["cam0"]) == 30
    assert "taken with another extension" in recording.images["cam0"].notes[0]
    assert list(recording.motion.trajectories) == list(Capture.TRACKED_PLATFORM.bodies)
    stated(folder, HEAD + "capture: tracked_platform\n" + BOARD + own)
    with pytest.raises(GtcalError, match=r"doesn't state its length_unit, .*; add platform\.length_unit"):
        load_recording(folder)


def test_what_the_manifest_states_stands(euroc: Path) -> None:
    body(euroc / "elsewhere", 4)
    text = (
        "capture: tracked_platform\n"
        "platform: {trajectory: elsewhere/data.csv, format: euroc_csv}\n"
        "cameras: {cam1: {images: mav0/cam0/data}, cam2: {model: fisheye62, image_size_px: [64, 48], "
        "images: mav0/cam1/data}}\n"
    )
    recording = load_recording(stated(euroc, HEAD + text + BOARD))
    assert list(recording.cameras) == ["cam0", "cam1", "cam2"]
    assert recording.images["cam1"].inputs[0].parent.name == "cam0"
    expected = wandering_trajectory("platform", seed=4).world_T_body
    np.testing.assert_allclose(recording.motion.trajectories["platform"].world_T_body, expected, atol=1e-12)


def test_a_lollypop_folder_opens(euroc: Path) -> None:
    (euroc / "mav0" / "target0").rename(euroc / "mav0" / "lollypop0")
    text = HEAD + "capture: tracked_platform\ndevice: {preset: paper_lollypop}\n"
    recording = load_lollypop_recording(stated(euroc, text))
    assert list(recording.motion.trajectories) == ["platform", "board_body"]
    np.testing.assert_allclose(
        recording.device_body.world_T_body, wandering_trajectory("device", seed=2).world_T_body, atol=1e-12
    )


def test_a_folder_without_a_manifest_says_what_to_do(euroc: Path) -> None:
    with pytest.raises(GtcalError, match=r"laid out as EuRoC's, but which board .*'gtcal init .*' drafts one"):
        load_recording(euroc)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD.replace("euroc", "kitti") + BOARD, "layout: 'kitti' is not a layout; choose from euroc"),
        (HEAD + BOARD, "capture: is missing"),
        (HEAD + "capture: tracked_platform\n", "board: is missing"),
        (HEAD + "capture: standing_board\n" + BOARD + "board_body: {length_unit: m}\n", "board_body"),
    ],
)
def test_what_is_open_is_told(text: str, message: str, euroc: Path) -> None:
    with pytest.raises(GtcalError, match=rf"recording\.yaml: {message}") as caught:
        load_recording(stated(euroc, text))
    assert "\n" not in str(caught.value)


def test_bodies_that_could_be_either_are_listed(euroc: Path) -> None:
    body(euroc / "mav0" / "headset", 5)
    with pytest.raises(GtcalError, match=r"platform: the layout has headset and vicon0, any of which it could be; "):
        load_recording(stated(euroc, HEAD + "capture: tracked_platform\n" + BOARD))
    shutil.rmtree(euroc / "mav0" / "target0")
    with pytest.raises(GtcalError, match=r"board_body: the layout has no folder .*; tracked bodies: headset, vicon0"):
        load_recording(
            stated(euroc, HEAD + "capture: tracked_platform\nplatform: {trajectory: a, format: tum}\n" + BOARD)
        )


def test_another_folder_is_not_laid_out_like_that(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match="is not laid out as EuRoC's"):
        load_recording(stated(tmp_path, HEAD + "capture: standing_board\n" + BOARD))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("camera_model: pinhole", "camera_model: cata", r"sensor\.yaml: camera_model: is 'cata', and gtcal has no"),
        ("radial-tangential", "fov", "distortion_model: is 'fov', and gtcal has no such lens; expected one of radtan"),
        ("[-0.28340811, 0.07395907, ", "[", "distortion_coefficients: has 2 numbers; expected 4"),
        ("1.76187114e-05]", "1.76187114e-05, 0.1]", "distortion_coefficients: has 5 numbers; expected 4"),
        ("resolution: [64, 48]", "resolution: [64, 48", r"sensor\.yaml: is not valid YAML"),
    ],
)
def test_a_lens_that_can_not_be_used_is_told(old: str, new: str, message: str, euroc: Path) -> None:
    replace_once(euroc / "mav0" / "cam0" / "sensor.yaml", old, new)
    with pytest.raises(GtcalError, match=message) as caught:
        load_recording(stated(euroc, HEAD + "capture: tracked_platform\n" + BOARD))
    assert "\n" not in str(caught.value)


def test_zeros_for_coefficients_that_the_model_has_not_say_nothing(euroc: Path) -> None:
    replace_once(euroc / "mav0" / "cam0" / "sensor.yaml", "1.76187114e-05]", "1.76187114e-05, 0.0]")
    recording = load_recording(stated(euroc, HEAD + "capture: tracked_platform\n" + BOARD))
    assert recording.cameras["cam0"].theta[-2:].tolist() == [1.76187114e-05, 0.0]


def test_a_lens_without_coefficients_is_none(euroc: Path) -> None:
    sensor = euroc / "mav0" / "cam0" / "sensor.yaml"
    sensor.write_text("".join(line for line in sensor.read_text().splitlines(True) if "coefficients" not in line))
    assert "cam0" not in find_layout(euroc).lenses


def test_opencvs_yaml_head_is_skipped(euroc: Path) -> None:
    sensor = euroc / "mav0" / "cam0" / "sensor.yaml"
    sensor.write_text("%YAML:1.0\n---\n" + sensor.read_text())
    recording = load_recording(stated(euroc, HEAD + "capture: tracked_platform\n" + BOARD))
    assert recording.cameras["cam0"].parameters is not None


def test_without_a_lens_file_the_lens_must_be_stated(tum_vi: Path) -> None:
    chain = yaml.safe_load((tum_vi / "dso" / "camchain.yaml").read_text())
    del chain["cam1"]
    (tum_vi / "dso" / "camchain.yaml").write_text(yaml.safe_dump(chain))
    with pytest.raises(GtcalError, match=r"cameras\.cam1\.model: is missing"):
        load_recording(stated(tum_vi, HEAD + "capture: standing_board\n" + BOARD))
