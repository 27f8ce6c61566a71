"""Camera files: what is written is read by the library it is for, to the same pixels, and read back by gtcal."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from camera_files_support import (
    HOLD,
    IN_FRONT,
    LENSES,
    grid_in,
    points_in,
    rig_of,
    written,
)
from lens_formulas import double_sphere_m, extended_unified_m
from scipy.spatial.transform import Rotation

from factors import CAMERA_MODELS
from factors.rigid import inverse
from gtcal.camera_files.formats import CAMERA_FILE_READERS, CAMERA_FILE_WRITERS, read_rig, recognised
from gtcal.errors import GtcalError

# Each format as the library that it is for reads it: by camera, points in ref -> pixels, integers at pixel centres

Projector = Callable[[np.ndarray], np.ndarray]


def opencv_projector(K, D, fisheye, camera_T_ref) -> Projector:
    rvec, tvec = cv2.Rodrigues(camera_T_ref[:3, :3].copy())[0], camera_T_ref[:3, 3]
    if fisheye:
        return lambda points: cv2.fisheye.projectPoints(points[:, None], rvec, tvec, K, np.asarray(D).reshape(4))[0][
            :, 0
        ]
    return lambda points: cv2.projectPoints(points, rvec, tvec, K, np.asarray(D))[0][:, 0]


def omnidir_projector(K, D, xi, camera_T_ref) -> Projector:
    rvec, tvec = cv2.Rodrigues(camera_T_ref[:3, :3].copy())[0], camera_T_ref[:3, 3]
    D = np.asarray(D).reshape(1, 4)
    return lambda points: cv2.omnidir.projectPoints(points[:, None], rvec, tvec, K, xi, D)[0][:, 0]


def formula_projector(formula, focal_and_centre, two, camera_T_ref) -> Projector:
    """A lens of two numbers, by the formula of its paper."""
    theta = np.array([*focal_and_centre, *two])

    def project(points):
        in_camera = points @ camera_T_ref[:3, :3].T + camera_T_ref[:3, 3]
        return theta[:2] * in_camera[:, :2] * formula(in_camera, theta)[:, None] + theta[2:4]

    return project


def matrix_of(fx, fy, cx, cy) -> np.ndarray:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def as_kalibr(path: Path) -> dict[str, Projector]:
    """PyYAML's safe_load, as Kalibr's own loader, with its chain from the first camera."""
    chain = yaml.safe_load(path.read_text())
    found, camera_T_ref = {}, np.array(chain["cam0"]["camera_T_ref"])
    for i in range(len(chain)):
        entry = chain[f"cam{i}"]
        camera_T_ref = np.array(entry["T_cn_cnm1"]) @ camera_T_ref if i else camera_T_ref
        D, numbers = np.array(entry["distortion_coeffs"], dtype=object), entry["intrinsics"]
        assert all(type(number) is float for number in [*D, *numbers])  # one without a dot is text to PyYAML
        D, model, name = D.astype(np.float64), entry["camera_model"], entry["name"]
        if model == "omni":
            found[name] = omnidir_projector(matrix_of(*numbers[1:]), D, numbers[0], camera_T_ref)
        elif model in ("ds", "eucm"):
            assert entry["distortion_model"] == "none"
            formula = {"ds": double_sphere_m, "eucm": extended_unified_m}[model]
            found[name] = formula_projector(formula, numbers[2:], numbers[:2], camera_T_ref)
        else:
            fisheye = entry["distortion_model"] == "equidistant"
            found[name] = opencv_projector(matrix_of(*numbers), D, fisheye, camera_T_ref)
    return found


def as_basalt(path: Path) -> dict[str, Projector]:
    """By the names of basalt-headers."""
    document = json.loads(path.read_text())["value0"]
    found = {}
    for i, name in enumerate(document["names"]):
        pose, lens = document["T_imu_cam"][i], document["intrinsics"][i]
        camera_T_ref = inverse(
            pose_of([pose[k] for k in ("qw", "qx", "qy", "qz")], [pose[k] for k in ("px", "py", "pz")])
        )
        k, model = lens["intrinsics"], lens["camera_type"]
        middle = [k[n] for n in ("fx", "fy", "cx", "cy")]
        if model == "ds":
            found[name] = formula_projector(double_sphere_m, middle, [k["xi"], k["alpha"]], camera_T_ref)
        elif model == "eucm":
            found[name] = formula_projector(extended_unified_m, middle, [k["alpha"], k["beta"]], camera_T_ref)
        else:
            order = {"kb4": "k1 k2 k3 k4", "pinhole-radtan8": "k1 k2 p1 p2 k3 k4 k5 k6"}[model].split()
            D = [k[n] for n in order]
            found[name] = opencv_projector(matrix_of(*middle), D, model == "kb4", camera_T_ref)
    return found


def as_opencv(path: Path) -> dict[str, Projector]:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    found = {}
    for key in storage.root().keys():  # noqa: SIM118 (cv2's nodes are no mappings)
        node = storage.getNode(key)
        K, D, T = (node.getNode(n).mat() for n in ("camera_matrix", "distortion_coefficients", "camera_T_ref"))
        name, xi = node.getNode("name").string(), node.getNode("xi")
        if not xi.empty():
            found[name] = omnidir_projector(K, D, xi.real(), T)
            continue
        found[name] = opencv_projector(K, D, bool(node.getNode("fisheye").real()), T)
    return found


def as_ros(path: Path) -> dict[str, Projector]:
    """camera_info in YAML, and the arguments of static_transform_publisher."""
    from xml.etree import ElementTree

    placed = {}
    for node in ElementTree.parse(path / "static_transforms.launch.xml").getroot():
        assert (node.get("pkg"), node.get("exec")) == ("tf2_ros", "static_transform_publisher")
        words = node.get("args").split()
        given = dict(zip(words[::2], words[1::2], strict=True))
        ref_T_camera = np.eye(4)
        quat_xyzw = [float(given[f"--{name}"]) for name in ("qx", "qy", "qz", "qw")]
        ref_T_camera[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
        ref_T_camera[:3, 3] = [float(given[f"--{name}"]) for name in "xyz"]
        assert given["--frame-id"] == "platform"
        placed[given["--child-frame-id"]] = inverse(ref_T_camera)
    found = {}
    for file in path.glob("*.yaml"):
        info = yaml.safe_load(file.read_text())
        K = np.array(info["camera_matrix"]["data"]).reshape(3, 3)
        D, fisheye = np.array(info["distortion_coefficients"]["data"]), info["distortion_model"] == "equidistant"
        name = info["camera_name"]
        found[name] = opencv_projector(K, D, fisheye, placed[f"{name}_optical_frame"])
    return found


def as_ros_bag(path: Path) -> dict[str, Projector]:
    highlevel, typesys = pytest.importorskip("rosbags.highlevel"), pytest.importorskip("rosbags.typesys")
    infos, placed = {}, {}
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/tf_static":
                placed = {t.child_frame_id: t for t in message.transforms}
            else:
                infos[connection.topic.split("/")[1]] = message
    found = {}
    for name, info in infos.items():
        stamped = placed[info.header.frame_id]
        t, q = stamped.transform.translation, stamped.transform.rotation
        ref_T_camera = np.eye(4)
        ref_T_camera[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        ref_T_camera[:3, 3] = [t.x, t.y, t.z]
        assert stamped.header.frame_id == "platform"
        fisheye = info.distortion_model == "equidistant"
        found[name] = opencv_projector(info.k.reshape(3, 3), info.d, fisheye, inverse(ref_T_camera))
    return found


def as_colmap(path: Path) -> dict[str, Projector]:
    """rig_config.json and the sparse model, both; COLMAP's pixels less half a pixel."""
    pycolmap = pytest.importorskip("pycolmap")
    (rig,) = pycolmap.read_rig_config(path / "rig_config.json")
    model = pycolmap.Reconstruction(path)
    camera_T_ref = np.array(json.loads((path / "rig_config.json").read_text())[0]["ref_camera_T_ref"])
    found = {}
    for i, entry in enumerate(rig.cameras, start=1):
        listed, sensor = model.cameras[i], pycolmap.sensor_t(pycolmap.SensorType.CAMERA, i)
        assert (listed.model, list(listed.params)) == (entry.camera.model, list(entry.camera.params))
        camera_T_rig = np.eye(4)
        if i > 1:
            camera_T_rig[:3] = entry.cam_from_rig.matrix()
            np.testing.assert_allclose(model.rigs[1].sensor_from_rig(sensor).matrix(), camera_T_rig[:3], atol=1e-12)
        else:
            assert entry.ref_sensor
            assert model.rigs[1].is_ref_sensor(sensor)

        def project(points, listed=listed, camera_T_ref=camera_T_rig @ camera_T_ref):
            in_camera = points @ camera_T_ref[:3, :3].T + camera_T_ref[:3, 3]
            return np.array(listed.img_from_cam(in_camera)) - 0.5

        found[entry.image_prefix.rstrip("/")] = project
    return found


def fisheye_pixels(theta: np.ndarray, in_camera: np.ndarray) -> np.ndarray:
    """Fisheye624 by its published formula, fx fy cx cy k0..k5 p0 p1 s0..s3, apart from gtcal's kernels."""
    x, y, z = in_camera.T
    r = np.hypot(x, y)
    a = np.arctan2(r, z)
    stretched = a * (1 + sum(k * a ** (2 * i + 2) for i, k in enumerate(theta[4:10])))
    u, v = stretched * x / r, stretched * y / r
    w, (p0, p1), (s0, s1, s2, s3) = u**2 + v**2, theta[10:12], theta[12:16]
    px = u + p0 * (w + 2 * u**2) + 2 * p1 * u * v + s0 * w + s1 * w**2
    py = v + p1 * (w + 2 * v**2) + 2 * p0 * u * v + s2 * w + s3 * w**2
    return np.stack([theta[0] * px + theta[2], theta[1] * py + theta[3]], axis=1)


def fisheye_projector(theta, device_T_camera) -> Projector:
    camera_T_ref = inverse(device_T_camera)
    return lambda points: fisheye_pixels(np.array(theta), points @ camera_T_ref[:3, :3].T + camera_T_ref[:3, 3])


def pose_of(quat_wxyz, translation) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(np.roll(quat_wxyz, -1)).as_matrix(), translation
    return pose


def as_aria(path: Path) -> dict[str, Projector]:
    """By Project Aria's documented fields; with its own library below, where that is installed."""
    document = json.loads(path.read_text())
    found = {}
    for camera in document["CameraCalibrations"]:
        pose, params = camera["T_Device_Camera"], camera["Projection"]["Params"]
        assert len(params) == 15
        w, imaginary = pose["UnitQuaternion"]
        placed = pose_of([w, *imaginary], pose["Translation"])
        found[camera["Label"]] = fisheye_projector([params[0], *params], placed)
    return found


def as_hot3d(path: Path) -> dict[str, Projector]:
    found = {}
    for camera in json.loads(path.read_text()):
        pose = camera["T_Device_Camera"]
        placed = pose_of(pose["quaternion_wxyz"], pose["translation_xyz"])
        assert len(camera["projectionParams"]) == 16
        found[camera["label"]] = fisheye_projector(camera["projectionParams"], placed)
    return found


def as_umetrack(path: Path) -> dict[str, Projector]:
    """As UmeTrack's read_camera_from_json takes the fields."""
    found = {}
    for entry in json.loads(path.read_text())["cameras"]:
        js = entry.get("Camera", entry)
        assert js["DistortionModel"] == "FishEye62"
        names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
        theta = [*(js[name] for name in names), 0, 0, 0, 0]
        found[js["name"]] = fisheye_projector(theta, inverse(np.array(js["camera_T_ref"])))
    return found


def as_toml(path: Path) -> dict[str, Projector]:
    """As aniposelib's CameraGroup.load and Pose2Sim take the fields: every table but metadata; OpenCV's projections."""
    tables = tomllib.loads(path.read_text())
    found = {}
    for key in sorted(tables):
        if key != "metadata":
            d = tables[key]
            camera_T_ref = np.eye(4)
            camera_T_ref[:3, :3] = cv2.Rodrigues(np.array(d["rotation"]))[0]
            camera_T_ref[:3, 3] = d["translation"]
            D = np.array(d["distortions"])
            found[d["name"]] = opencv_projector(np.array(d["matrix"]), D, d.get("fisheye", False), camera_T_ref)
    return found


def as_numpy(path: Path) -> dict[str, Projector]:
    with np.load(path) as file:
        arrays = dict(file)
    found = {}
    for i, name in enumerate(arrays["names"]):
        model, theta, pose = CAMERA_MODELS[str(arrays["models"][i])], arrays[f"theta_{name}"], arrays["camera_T_ref"][i]
        found[str(name)] = lambda points, m=model, t=theta, T=pose: m.project(points @ T[:3, :3].T + T[:3, 3], t)[0]
    return found


AS_READ = {
    "kalibr": as_kalibr,
    "basalt": as_basalt,
    "opencv": as_opencv,
    "ros": as_ros,
    "ros_bag": as_ros_bag,
    "colmap": as_colmap,
    "aria": as_aria,
    "hot3d": as_hot3d,
    "umetrack": as_umetrack,
    "anipose": as_toml,
    "pose2sim": as_toml,
    "numpy": as_numpy,
}


def test_every_format_is_tested() -> None:
    assert set(AS_READ) == set(HOLD) == set(CAMERA_FILE_WRITERS) == set(CAMERA_FILE_READERS) - {"gtcal"}


@pytest.mark.parametrize("format_name", CAMERA_FILE_WRITERS)
def test_the_library_it_is_for_projects_to_the_same_pixels(format_name: str, tmp_path: Path) -> None:
    rig = rig_of(*sorted(HOLD[format_name]))
    project = AS_READ[format_name](written(tmp_path, format_name, rig))
    assert len(project) == len(rig.cameras)
    for camera in rig.cameras:
        in_camera = points_in(camera.camera)
        if format_name in IN_FRONT:
            in_camera = in_camera[in_camera[:, 2] > 0]
        ref_T_camera = inverse(camera.camera_T_ref)
        in_ref = in_camera @ ref_T_camera[:3, :3].T + ref_T_camera[:3, 3]
        expected, valid = camera.camera.project(in_camera)
        assert valid.all()
        np.testing.assert_allclose(project[camera.name](in_ref), expected, atol=1e-6)


@pytest.mark.parametrize("format_name", CAMERA_FILE_WRITERS)
def test_gtcal_reads_back_what_it_wrote_and_knows_the_format(format_name: str, tmp_path: Path) -> None:
    rig = rig_of(*sorted(HOLD[format_name]))
    path = written(tmp_path, format_name, rig)
    assert recognised(path) == format_name
    again = read_rig(path, None).rig
    assert {camera.name for camera in again.cameras} == {camera.name for camera in rig.cameras}
    for camera in again.cameras:
        before = next(other for other in rig.cameras if other.name == camera.name)
        np.testing.assert_allclose(camera.camera_T_ref, before.camera_T_ref, atol=1e-12)
        assert camera.image_size_px == before.image_size_px
        points = points_in(before.camera)
        np.testing.assert_allclose(camera.camera.project(points)[0], before.camera.project(points)[0], atol=1e-9)


@pytest.mark.parametrize("format_name", CAMERA_FILE_WRITERS)
@pytest.mark.parametrize("lens", LENSES)
def test_a_lens_is_held_or_refused_with_a_loss_that_is_true(format_name: str, lens: str, tmp_path: Path) -> None:
    rig = rig_of(lens)
    if lens in HOLD[format_name]:
        written(tmp_path, format_name, rig)
        return
    with pytest.raises(
        GtcalError, match=r"can't express .* off by [\d.e+-]+ px rms and [\d.e+-]+ px at most"
    ) as refused:
        written(tmp_path, format_name, rig)
    assert not list(tmp_path.iterdir())
    stated_px = float(str(refused.value).split(" px rms and ")[1].split()[0])
    (camera,) = read_rig(written(tmp_path, format_name, rig, nearest=True), None).rig.cameras
    points = grid_in(LENSES[lens])
    found, valid = camera.camera.project(points)
    assert valid.all()
    off_px = np.linalg.norm(found - LENSES[lens].project(points)[0], axis=1)
    assert 0 < off_px.max() <= 1.05 * stated_px
    assert off_px.max() > 0.2 * stated_px


def test_project_arias_own_library_reads_its_json(tmp_path: Path) -> None:
    """It reads files of Aria glasses only: with their labels, class and origin, which a calibration has none of."""
    calibration = pytest.importorskip("projectaria_tools.core.calibration")
    labels = {"fisheye62": "camera-slam-left", "fisheye624": "camera-slam-right"}
    rig = rig_of(*labels)
    document = json.loads(written(tmp_path, "aria", rig).read_text())
    for camera in document["CameraCalibrations"]:
        camera["Label"] = labels[camera["Label"]]
    document["DeviceClassInfo"] = {"DeviceClass": "Aria", "BuildVersion": "DVT-S"}
    document["OriginSpecification"] = {"Type": "Custom", "ChildLabel": "camera-slam-left"}
    device = calibration.device_calibration_from_json_string(json.dumps(document))
    for camera in rig.cameras:
        found = device.get_camera_calib(labels[camera.name])
        placed = found.get_transform_device_camera().to_matrix()
        np.testing.assert_allclose(placed, inverse(camera.camera_T_ref), atol=1e-12)
        points = points_in(camera.camera)[:20]
        pixels = [found.project_no_checks(point) for point in points]
        np.testing.assert_allclose(pixels, camera.camera.project(points)[0], atol=1e-9)
