"""Camera files as their tools' documentation and data sets publish them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from camera_files_support import (
    ARIA,
    ARIA_FACTORY,
    CAMERA_INFO,
    CAMERA_INFO_MESSAGE,
    COLMAP_CAMERAS,
    HOT3D_CLIP,
    KALIBR,
    OPENCV,
    POSE2SIM,
    UMETRACK,
    read_text_as,
    written,
)
from scipy.spatial.transform import Rotation

from factors import FISHEYE62
from factors.rigid import inverse
from gtcal.camera import Camera
from gtcal.camera_files.formats import read_rig
from gtcal.camera_files.rig import Rig, RigCamera
from gtcal.errors import GtcalError


def test_kalibrs_documented_chain(tmp_path: Path) -> None:
    rig = read_text_as(tmp_path, "chain.yaml", KALIBR)
    first, second = rig.cameras
    assert (rig.ref, first.name, second.camera.model.name) == ("imu", "cam0", "kannala_brandt4")
    chain = yaml.safe_load(KALIBR)
    np.testing.assert_allclose(first.camera_T_ref, chain["cam0"]["T_cam_imu"], atol=2e-8)
    step = second.camera_T_ref @ inverse(first.camera_T_ref)
    np.testing.assert_allclose(step, chain["cam1"]["T_cn_cnm1"], atol=2e-8)
    np.testing.assert_array_equal(first.camera.theta[4:], [-0.27695497, 0.06712482, 0.00087538, 0.00011556, 0.0])


def test_opencvs_calibration_sample(tmp_path: Path) -> None:
    rig = read_text_as(tmp_path, "camera.yml", OPENCV)
    (camera,) = rig.cameras
    assert (camera.image_size_px, camera.camera.theta[8], rig.posed) == ((640, 480), -5.7843597214487474e-01, False)


def test_four_coefficients_that_may_be_of_either_lens_are_not_guessed(tmp_path: Path) -> None:
    four = OPENCV.replace("fisheye_model: 0\n", "").replace("rows: 5", "rows: 4").replace(",\n       -5.78", "#")
    four = four.split("   data: [ -4.18")[0] + "   data: [ 0.1, 0.2, 0.3, 0.4 ]\n"
    with pytest.raises(GtcalError, match="doesn't say which; give the model: kannala_brandt4 or pinhole_radtan"):
        read_text_as(tmp_path, "camera.yml", four)
    for model in ("kannala_brandt4", "pinhole_radtan"):
        (camera,) = read_text_as(tmp_path, "camera.yml", four, model=model).cameras
        assert camera.camera.model.name == model
        np.testing.assert_array_equal(camera.camera.theta[4:8], [0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("text", [CAMERA_INFO, CAMERA_INFO_MESSAGE])
def test_camera_info_as_file_and_as_message(text: str, tmp_path: Path) -> None:
    (camera,) = read_text_as(tmp_path, "narrow_stereo.yaml", text).cameras
    assert (camera.name, camera.image_size_px, camera.camera.model.name) == (
        "narrow_stereo",
        (640, 480),
        "pinhole_radtan",
    )
    assert camera.camera.theta[4] == pytest.approx(-0.36, abs=0.01)


def test_colmaps_documented_cameras_are_half_a_pixel_away(tmp_path: Path) -> None:
    rig = read_text_as(tmp_path, "cameras.txt", COLMAP_CAMERAS)
    assert [camera.name for camera in rig.cameras] == ["1", "2", "3"]
    for camera in rig.cameras:
        np.testing.assert_array_equal(camera.camera.theta[2:4], [1535.5, 1151.5])
    assert rig.cameras[2].camera.theta[4] == -0.0218531


def test_hot3ds_clip_with_one_focal_length(tmp_path: Path) -> None:
    rig = read_text_as(tmp_path, "cameras.json", HOT3D_CLIP)
    (camera,) = rig.cameras
    assert (camera.name, camera.camera.model.name, rig.ref) == ("camera-slam-left", "fisheye624", "device")
    np.testing.assert_array_equal(camera.camera.theta, ARIA)
    expected = HOT3D_CLIP["1201-1"]["calibration"]["T_device_from_camera"]["translation_xyz"]
    np.testing.assert_allclose(inverse(camera.camera_T_ref)[:3, 3], expected, atol=1e-15)


def test_fisheye624_with_zero_thin_prism_is_fisheye62(tmp_path: Path) -> None:
    clip = json.loads(json.dumps(HOT3D_CLIP))
    params = clip["1201-1"]["calibration"]["projection_params"]
    params[11:] = [0, 0, 0, 0]
    (camera,) = read_text_as(tmp_path, "cameras.json", clip).cameras
    assert camera.camera.model.name == "fisheye62"
    np.testing.assert_array_equal(camera.camera.theta, ARIA[:12])


def test_the_hand_tracking_toolkits_fisheye62_is_in_umetracks_order(tmp_path: Path) -> None:
    clip = json.loads(json.dumps(HOT3D_CLIP))
    calibration = clip["1201-1"]["calibration"]
    calibration["projection_model_type"] = "OculusVisionFishEye62"
    calibration["projection_params"] = [300, 301, 320, 240, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    (camera,) = read_text_as(tmp_path, "cameras.json", clip).cameras
    (same,) = read_text_as(tmp_path, "umetrack.json", UMETRACK).cameras
    np.testing.assert_array_equal(camera.camera.theta, [300, 301, 320, 240, 0.1, 0.2, 0.3, 0.4, 0.7, 0.8, 0.5, 0.6])
    np.testing.assert_array_equal(same.camera.theta, camera.camera.theta)


def test_arias_factory_file_needs_the_images_size(tmp_path: Path) -> None:
    with pytest.raises(
        GtcalError, match=r"CameraCalibrations\.0: the file doesn't state the size .* give image_size_px"
    ):
        read_text_as(tmp_path, "aria.json", ARIA_FACTORY)
    (camera,) = read_text_as(tmp_path, "aria.json", ARIA_FACTORY, image_size_px=(640, 480)).cameras
    np.testing.assert_array_equal(camera.camera.theta, ARIA)
    np.testing.assert_allclose(
        inverse(camera.camera_T_ref), [[1, 0, 0, 0.1], [0, -1, 0, 0.2], [0, 0, -1, 0.3], [0, 0, 0, 1]]
    )


def test_arias_online_calibration_is_read_where_it_is_one_line(tmp_path: Path) -> None:
    line = json.dumps(ARIA_FACTORY | {"ImageSizes": [[640, 480]], "utc_timestamp_ns": 1}) + "\n"
    (camera,) = read_text_as(tmp_path, "online_calibration.jsonl", line).cameras
    np.testing.assert_array_equal(camera.camera.theta, ARIA)
    with pytest.raises(GtcalError, match="holds 3 documents, a line each; keep the one that is meant"):
        read_text_as(tmp_path, "online_calibration.jsonl", 3 * line)


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("format_name", ["umetrack", "hot3d", "aria", "colmap"])
def test_real_lenses_of_a_quest_project_as_two_libraries_have_it(
    format_name: str, index: int, shared: Callable[[str], Path], tmp_path: Path
) -> None:
    known = json.loads(shared("oracles/fisheye62_quest3.json").read_text())["cameras"][index]
    theta = np.array([known["params"][name] for name in FISHEYE62.parameter_names])
    camera = Camera(known["label"], FISHEYE62, theta, known["width_px"], known["height_px"])
    rig = Rig((RigCamera(camera, np.eye(4)),), "device", "the device")
    (again,) = read_rig(written(tmp_path, format_name, rig), None).rig.cameras
    found = again.camera.project(np.array(known["points_m"]))[0]
    np.testing.assert_allclose(found, known["pixels_projectaria_px"], atol=1e-9)


def test_a_toml_that_may_be_aniposes_or_pose2sims_is_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=r"say which format it is: anipose, .* or pose2sim"):
        read_text_as(tmp_path, "Calib.toml", POSE2SIM)
    rig = read_text_as(tmp_path, "Calib.toml", POSE2SIM, "pose2sim")
    assert rig.cameras[0].image_size_px == (1088, 1920)
    np.testing.assert_array_equal(rig.cameras[0].camera_T_ref[:3, 3], [-0.4219, 0.6801, 3.9142])
    unposed = read_text_as(tmp_path, "Calib.toml", POSE2SIM, "anipose")
    assert not unposed.posed
    assert "length_unit" in unposed.unposed
    in_mm = read_text_as(tmp_path, "Calib.toml", POSE2SIM, "anipose", length_unit="mm")
    np.testing.assert_allclose(in_mm.cameras[0].camera_T_ref[:3, 3], [-0.0004219, 0.0006801, 0.0039142])


def test_a_ros_1_bag_with_a_chain_of_frames(tmp_path: Path) -> None:
    """As a driver and a robot's description publish them: many messages, base -> link -> optical frame."""
    rosbag1, typesys = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    tf = typesys.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    store.register(tf)
    types = store.types
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](1, 2), "camera_optical")
    fx, fy, cx, cy = 438.78, 437.3, 305.59, 243.73
    info = types["sensor_msgs/msg/CameraInfo"](
        header,
        480,
        640,
        "plumb_bob",
        D=np.array([-0.36, 0.11, 0.001, 0.0005, 0.0]),
        K=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
        R=np.eye(3).ravel(),
        P=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )
    turned = Rotation.from_euler("xyz", [-90, 0, -90], degrees=True)  # a body's axes to an optical frame's

    def stamped(parent: str, child: str, x: float, quat_xyzw: list[float]):
        transform = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](x, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](*quat_xyzw)
        )
        return types["geometry_msgs/msg/TransformStamped"](replace(header, frame_id=parent), child, transform)

    static = types["tf2_msgs/msg/TFMessage"](
        [stamped("link", "camera_optical", 0.0, turned.as_quat().tolist()), stamped("base", "link", 0.3, [0, 0, 0, 1])]
    )
    with rosbag1.Writer(tmp_path / "robot.bag") as writer:
        for topic, message in (("/front/camera_info", info), ("/tf_static", static)):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=store)
            for stamp in range(3):
                writer.write(connection, stamp, store.serialize_ros1(message, message.__msgtype__))
    rig = read_rig(tmp_path / "robot.bag", None).rig
    (camera,) = rig.cameras
    assert (rig.ref, camera.name, camera.image_size_px) == ("base", "front", (640, 480))
    np.testing.assert_array_equal(camera.camera.theta, [fx, fy, cx, cy, -0.36, 0.11, 0.001, 0.0005, 0.0])
    base_T_camera = inverse(camera.camera_T_ref)
    np.testing.assert_allclose(base_T_camera[:3, 3], [0.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(base_T_camera[:3, 2], [1.0, 0.0, 0.0], atol=1e-12)  # it looks forward
