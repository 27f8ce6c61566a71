"""Rigs of every lens, the formats that hold them, and camera files as others publish them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from factors import (
    DOUBLE_SPHERE,
    EXTENDED_UNIFIED,
    FISHEYE62,
    FISHEYE624,
    KANNALA_BRANDT4,
    MEI_OMNI,
    PINHOLE_RADTAN,
    PINHOLE_RATIONAL,
)
from gtcal.camera import Camera
from gtcal.camera_files.formats import read_rig, write_rig
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera
from gtcal.errors import GtcalError

RADTAN = [458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0]
RADTAN_K3 = [*RADTAN[:8], -0.011]
FISHEYE = [190.97, 190.97, 254.93, 256.9, 0.0034823894, 0.000715034, -0.0020532361, 0.00020293673]
QUEST = [504.59, 504.59, 638.39, 509.42, 0.044, -0.0449, 0.0161, -0.0109, 0.0035, -0.00052, 0.00048, -4.7e-05]
ARIA = [240.514, 240.514, 320.249, 240.451, -0.02863, 0.10544, -0.07701, 0.01677, -0.0006, -1e-04]
ARIA += [0.00328, -0.00206, -0.00254, 7.0e-05, 0.0023, 2.6e-05]
KINECT = [605.1, 604.9, 638.2, 366.4, 0.4617, -2.4713, 7e-4, -3e-4, 1.4119, 0.3413, -2.3014, 1.3436]
TUM_VI_DS = [158.28600034966977, 158.2743455478755, 254.96116578191653, 256.8894394501779]
TUM_VI_DS += [-0.17213086034353243, 0.5931177593944744]
TUM_VI_EUCM = [191.14799836282189, 191.13150963902818, 254.9585771534443, 256.88154645599448]
TUM_VI_EUCM += [0.6291060881178562, 1.0418067381860868]
MIRROR = [820.0, 815.0, 320.0, 240.0, -0.2, 0.05, 1e-3, -8e-4, 1.2]
LENSES = {
    "radtan": Camera("radtan", PINHOLE_RADTAN, np.array(RADTAN), 752, 480),
    "radtan k3": Camera("radtan_k3", PINHOLE_RADTAN, np.array(RADTAN_K3), 752, 480),
    "fisheye": Camera("fisheye", KANNALA_BRANDT4, np.array(FISHEYE), 512, 512),
    "fisheye62": Camera("fisheye62", FISHEYE62, np.array(QUEST), 1280, 1024),
    "fisheye624": Camera("fisheye624", FISHEYE624, np.array(ARIA), 640, 480),
    "rational": Camera("rational", PINHOLE_RATIONAL, np.array(KINECT), 1280, 720),
    "double sphere": Camera("double_sphere", DOUBLE_SPHERE, np.array(TUM_VI_DS), 512, 512),
    "eucm": Camera("eucm", EXTENDED_UNIFIED, np.array(TUM_VI_EUCM), 512, 512),
    "mei": Camera("mei", MEI_OMNI, np.array(MIRROR), 640, 480),
    "fisheye624 fx fy": Camera("fisheye624_fxfy", FISHEYE624, np.array([240.514, 241.514, *ARIA[2:]]), 640, 480),
}
HOLD: dict[str, set[str]] = {
    "kalibr": {"radtan", "fisheye", "double sphere", "eucm", "mei"},
    "basalt": {"radtan", "radtan k3", "rational", "fisheye", "double sphere", "eucm"},
    "opencv": {"radtan", "radtan k3", "rational", "fisheye", "mei"},
    "ros": {"radtan", "radtan k3", "rational", "fisheye"},
    "ros_bag": {"radtan", "radtan k3", "rational", "fisheye"},
    "colmap": set(LENSES) - {"double sphere", "mei"},
    "aria": {"fisheye", "fisheye62", "fisheye624"},
    "hot3d": {"fisheye", "fisheye62", "fisheye624", "fisheye624 fx fy"},
    "umetrack": {"fisheye", "fisheye62"},
    "anipose": {"radtan", "radtan k3", "rational", "fisheye"},
    "pose2sim": {"radtan", "fisheye"},
    "numpy": set(LENSES),
}
"""Which lenses each format holds exactly."""
IN_FRONT = ("kalibr", "basalt", "opencv", "ros", "ros_bag", "colmap", "anipose", "pose2sim")
"""Formats whose tools project with OpenCV, or as it does: its fisheye knows nothing of what is behind the camera."""
FILES = {
    "numpy": "rig.npz",
    "ros": "rig",
    "ros_bag": "rig",
    "colmap": "rig",
    "kalibr": "rig.yaml",
    "opencv": "rig.yaml",
}
FILES |= {"anipose": "rig.toml", "pose2sim": "rig.toml"}


def file_of(folder: Path, format_name: str) -> Path:
    return folder / FILES.get(format_name, "rig.json")


def rig_of(*lenses: str, name: str | None = None) -> Rig:
    """These cameras, anywhere in ref; ``name``: of a single one."""
    random = np.random.default_rng(3)
    cameras = []
    for lens in lenses:
        camera_T_ref = np.eye(4)
        camera_T_ref[:3, :3] = Rotation.random(rng=random).as_matrix()
        camera_T_ref[:3, 3] = random.uniform(-1, 1, 3)
        camera = LENSES[lens] if name is None else replace(LENSES[lens], name=name)
        cameras.append(RigCamera(camera, camera_T_ref))
    return Rig(tuple(cameras), "platform", "the platform")


def written(folder: Path, format_name: str, rig: Rig, *, nearest: bool = False) -> Path:
    path = file_of(folder, format_name)
    write_rig(rig, path, format_name, ["made by a test"], nearest=nearest)
    return path


def points_in(camera: Camera, share: float = 0.95) -> np.ndarray:
    """Points in the camera frame whose pixels are in the image, near its border too."""
    size = np.array([camera.image_width_px, camera.image_height_px])
    pixels = np.random.default_rng(1).uniform((1 - share) * size, share * size, (200, 2))
    bearings, valid = camera.unproject(pixels)
    assert np.count_nonzero(valid) > 100
    return 2.0 * bearings[valid]


def grid_in(camera: Camera) -> np.ndarray:
    """Points in the camera frame whose pixels are spread over the image, its borders included."""
    across, down = np.linspace(0, camera.image_width_px - 1, 13), np.linspace(0, camera.image_height_px - 1, 13)
    bearings, valid = camera.unproject(np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2))
    return 2.0 * bearings[valid]


# Files as others publish them

KALIBR = """\
cam0:
  camera_model: pinhole
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  distortion_model: radtan
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  T_cam_imu:
  - [0.01779318, 0.99967549,-0.01822936, 0.07008565]
  - [-0.9998017, 0.01795239, 0.00860714,-0.01771023]
  - [0.00893160, 0.01807260, 0.99979678, 0.00399246]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: -8.121e-05
  rostopic: /cam0/image_raw
  resolution: [752, 480]
cam1:
  camera_model: pinhole
  intrinsics: [333.006, 330.345, 373.850, 253.749]
  distortion_model: equidistant
  distortion_coeffs: [-0.0335187, 0.01321143, 0.00055967, 0.00057686]
  T_cn_cnm1:
  - [ 0.99998854, 0.00216014, 0.00427195,-0.11003785]
  - [-0.00221074, 0.99992702, 0.01187697, 0.00045792]
  - [-0.00424598,-0.01188627, 0.99992034,-0.00064487]
  - [0.0, 0.0, 0.0, 1.0]
  rostopic: /cam1/image_raw
  resolution: [752, 480]
"""
OPENCV = """\
%YAML:1.0
---
calibration_time: "Thu 01 Jan 1970"
image_width: 640
image_height: 480
flags: 0
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.5746697944293521e+02, 0., 3.1950000000000000e+02, 0.,
       6.5746697944293521e+02, 2.3950000000000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -4.1802327176423804e-01, 5.0715244063187526e-01, 0., 0.,
       -5.7843597214487474e-01 ]
"""
CAMERA_INFO = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999978, 0.002789, -0.006046, -0.002816, 0.999986, -0.004401, 0.006034, 0.004417, 0.999972]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.0, 322.797939, 0.0, 0.0, 393.653800, 241.090902, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
CAMERA_INFO_MESSAGE = """\
header:
  stamp: {sec: 1, nanosec: 2}
  frame_id: camera
height: 480
width: 640
distortion_model: rational_polynomial
d: [-0.36, 0.11, 0.001, 0.0005, 0.0, 0.0, 0.0, 0.0]
k: [438.78, 0.0, 305.59, 0.0, 437.3, 243.73, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [438.78, 0.0, 305.59, 0.0, 0.0, 437.3, 243.73, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
"""
COLMAP_CAMERAS = """\
# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 3
1 SIMPLE_PINHOLE 3072 2304 2559.81 1536 1152
2 PINHOLE 3072 2304 2560.56 2560.56 1536 1152
3 SIMPLE_RADIAL 3072 2304 2559.69 1536 1152 -0.0218531
"""
HOT3D_CLIP = {
    "1201-1": {
        "T_world_from_camera": {
            "quaternion_wxyz": [0.38033435938753213, 0.758652262803538, 0.3587018888601203, -0.3887486001782246],
            "translation_xyz": [0.20201442564264127, -0.28143043241492155, -0.211900192824998],
        },
        "calibration": {
            "T_device_from_camera": {
                "quaternion_wxyz": [
                    0.9999923065791364,
                    -0.00044913078817310464,
                    0.0026718558763878185,
                    0.002836591308138461,
                ],
                "translation_xyz": [0.0004994727304480533, 0.0005231042760258964, 0.00024566218834111024],
            },
            "image_height": 480,
            "image_width": 640,
            "label": "camera-slam-left",
            "max_solid_angle": 1.4,
            "projection_model_type": "CameraModelType.FISHEYE624",
            "projection_params": [ARIA[0], *ARIA[2:]],
            "serial_number": "0072510f1b0c070107000008070e0001",
            "stream_id": "1201-1",
        },
    }
}
ARIA_FACTORY = {
    "CameraCalibrations": [
        {
            "Calibrated": True,
            "Label": "camera-slam-left",
            "Projection": {"Name": "FisheyeRadTanThinPrism", "Description": "", "Params": [ARIA[0], *ARIA[2:]]},
            "SerialNumber": "0072",
            "T_Device_Camera": {"Translation": [0.1, 0.2, 0.3], "UnitQuaternion": [0.0, [1.0, 0.0, 0.0]]},
        }
    ]
}
UMETRACK = {
    "Camera": {"ImageSizeX": 640, "ImageSizeY": 480, "DistortionModel": "FishEye62", "fx": 300, "fy": 301}
    | {"cx": 320, "cy": 240, "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4, "p1": 0.5, "p2": 0.6, "k5": 0.7, "k6": 0.8}
}
POSE2SIM = """\
[int_cam1_img]
name = "int_cam1_img"
size = [ 1088.0, 1920.0]
matrix = [ [ 1681.2, 0.0, 532.4], [ 0.0, 1681.2, 958.0], [ 0.0, 0.0, 1.0]]
distortions = [ -0.0466, 0.1194, 0.0011, -0.0003]
rotation = [ 1.2214, 1.1985, -1.2331]
translation = [ -0.4219, 0.6801, 3.9142]
fisheye = false

[metadata]
adjusted = false
error = 0.0
"""


def read_text_as(folder: Path, name: str, content: object, format_name: str | None = None, **options: object) -> Rig:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_rig(path, format_name, ReadOptions(**options)).rig


def said(path: Path, format_name: str | None) -> str | None:
    """What is said about a file, None where it is read."""
    try:
        read_rig(path, format_name)
    except GtcalError as error:
        return str(error)
    return None
