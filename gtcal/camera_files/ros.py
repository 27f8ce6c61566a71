"""ROS: camera_info in YAML, one file per camera, and the rig's static transforms as a ROS 2 launch file.

Pixels: integer coordinates are pixel centres. The lens is plumb_bob (k1 k2 p1 p2 k3), equidistant (k1..k4), or
rational_polynomial (k1 k2 p1 p2 k3 k4 k5 k6). A camera's frame is <camera>_optical_frame, x right, y down, z forward.
static_transform_publisher takes the pose of the child in the parent: frame_T_child, that is ref_T_camera, in m.
A camera_info as 'ros2 topic echo' prints it is read too.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from factors.camera_models import KANNALA_BRANDT4, PINHOLE_RADTAN, PINHOLE_RATIONAL
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, float_text, quoted, rigid_from_quaternion, row_text
from gtcal.camera_files.lenses import KB4, OPENCV_FORMS, Expressed, express
from gtcal.camera_files.opencv import focal_and_centre
from gtcal.camera_files.rig import (
    OPENCV_COUNTS,
    Lens,
    ReadOptions,
    Rig,
    RigCamera,
    image_size,
    opencv_pinhole,
    padded,
    rig_camera,
    with_pose,
)
from gtcal.documents import load_document, read_text
from gtcal.errors import GtcalError
from gtcal.files import write_folder
from gtcal.recordings.trajectory import quaternions_from_poses

TITLE = "ROS's camera_info"
LAUNCH = "static_transforms.launch.xml"
_NAMES = {PINHOLE_RADTAN: "plumb_bob", KANNALA_BRANDT4: "equidistant", PINHOLE_RATIONAL: "rational_polynomial"}
MODELS = tuple(_NAMES.values())
_K, _D, _MODEL = ("camera_matrix", "k", "K"), ("distortion_coefficients", "d", "D"), "distortion_model"
_PUBLISHER = "static_transform_publisher"
_PUBLISHED = ("x", "y", "z", "qx", "qy", "qz", "qw")


def recognises(document: object) -> bool:
    """Whether this is what a camera_info looks like."""
    return isinstance(document, dict) and _MODEL in document and any(name in document for name in _K)


def recognises_folder(folder: Path) -> bool:
    """Whether this folder holds camera_info files, and no YAML but these."""
    files = _yaml_files(folder)
    return bool(files) and all(recognises(load_document(file)) for file in files)


def _yaml_files(folder: Path) -> list[Path]:
    return sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")])


def read_ros(path: Path, options: ReadOptions) -> Rig:
    """The camera of a camera_info, named as the file says, or the cameras of a folder of them; in the parent frame of
    the folder's *.launch.xml where it places them all.

    Raises GtcalError naming file and field for what is missing, wrong or no lens of gtcal's."""
    if not path.is_dir():
        return Rig((_read_camera(path, options),), "ref", "not known", "a camera_info holds no pose")
    files = _yaml_files(path)
    if not files:
        raise GtcalError(f"{path}: there is no camera_info in this folder; expected <camera>.yaml")
    cameras = [_read_camera(file, options) for file in files]
    launches = sorted(path.glob("*.launch.xml"))
    if len(launches) > 1:
        raise GtcalError(f"{path}: there are {' and '.join(file.name for file in launches)}; keep one")
    placed = {} if not launches else _read_launch(launches[0])
    frames = [optical_frame(camera.name) for camera in cameras]
    return place(cameras, frames, placed, "no launch file places every camera")


def write_ros(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write a folder: <camera>.yaml for each camera, and static_transforms.launch.xml where there are poses.

    Raises GtcalError for a lens that ROS doesn't know unless ``nearest``, or a camera's name that can't name a file."""
    names = rig.file_names()
    frames = frame_names(rig)
    texts = {f"{names[camera.name]}.yaml": _camera_info(camera, notes, nearest) for camera in rig.cameras}
    if rig.posed:
        texts[LAUNCH] = _launch(rig, frames, notes)
    write_folder(path, texts)


def frame_names(rig: Rig) -> dict[str, str]:
    """By camera: <camera>_optical_frame, with nothing but letters, digits and underscores, as ROS wants names."""
    frames = {camera.name: optical_frame(camera.name) for camera in rig.cameras}
    for first, second in pairwise(sorted(frames, key=lambda name: frames[name])):
        if frames[first] == frames[second]:
            raise GtcalError(f"cameras {first!r} and {second!r} would have the same frame {frames[first]!r} in ROS")
    return frames


def optical_frame(name: str) -> str:
    """The frame of a camera."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"{'cam' * plain[0].isdigit()}{plain}_optical_frame"


def place(
    cameras: Sequence[RigCamera], frames: Sequence[str], placed: dict[str, tuple[str, FloatArray]], unposed: str
) -> Rig:
    """The cameras of these frames in one, given by child frame its parent and parent_T_child; without poses where that
    does not lead to one frame for all."""
    found = [_in_root(frame.lstrip("/"), placed) for frame in frames]
    roots = {root for root, _ in found}
    if len(roots) != 1 or any(frame.lstrip("/") not in placed for frame in frames):
        return Rig(tuple(cameras), "ref", "not known", unposed)
    posed = [with_pose(camera, inverse(found[i][1])) for i, camera in enumerate(cameras)]
    root = roots.pop()
    return Rig(tuple(posed), root, f"the frame {root}")


def _in_root(frame: str, placed: dict[str, tuple[str, FloatArray]]) -> tuple[str, FloatArray]:
    """The last parent of a frame, and root_T_frame."""
    root_T_frame = np.eye(4)
    for _ in placed:  # no longer than this, should the frames go in a circle
        if frame not in placed:
            break
        frame, parent_T_child = placed[frame]
        root_T_frame = parent_T_child @ root_T_frame
    return frame, root_T_frame


def model_and_coefficients(found: Expressed) -> tuple[str, FloatArray]:
    """ROS's distortion_model and D."""
    return _NAMES[found.model], found.theta[4:]


def express_for_ros(camera: RigCamera, nearest: bool) -> Expressed:
    return express(camera.camera, format_name=TITLE, forms=OPENCV_FORMS, nearest=nearest)


def read_lens(field: Field) -> Lens:
    """The lens of a camera_info, of its file or of its message."""
    middle, stated, model = focal_and_centre(field.first(*_K)), field.get(*_D), field[_MODEL]
    if not (middle[:2] > 0).all():
        raise field.first(*_K).error("holds no focal lengths: this camera was never calibrated")
    name = model.text()
    if name not in MODELS:
        raise model.error(f"is {name!r}, and gtcal has no such lens; expected {', '.join(MODELS)}")
    if stated is None or not stated.numbers().size:
        raise field.error(f"{_D[0]} holds nothing; a {name} has some, zeros where the image is rectified")
    if name == "equidistant":
        return padded(KB4, np.concatenate([middle, stated.numbers(4)]))
    return opencv_pinhole(middle, stated.numbers(*(OPENCV_COUNTS[:2] if name == "plumb_bob" else OPENCV_COUNTS[2:])))


def read_size(field: Field, options: ReadOptions) -> tuple[int, int]:
    """Width and height; binned or cropped images are refused, since their lens is another."""
    for name in ("binning_x", "binning_y"):
        if name in field and field[name].number() > 1:
            raise field[name].error("the images are binned; give the camera_info of the full image")
    if "roi" in field and any(name in field["roi"] and field["roi"][name].number() for name in ("width", "height")):
        raise field["roi"].error("the images are cropped; give the camera_info of the full image")
    width, height = field.get("image_width", "width"), field.get("image_height", "height")
    if width is None or height is None:
        raise field.error("image_width and image_height are missing")
    return image_size(field, [width, height], options)


def _read_camera(path: Path, options: ReadOptions) -> RigCamera:
    document = Field(path, "", load_document(path))
    name = document["camera_name"].text() if "camera_name" in document else path.stem
    return rig_camera(document, plain_name(name), read_lens(document), read_size(document, options), options)


def plain_name(name: str) -> str:
    """ROS names cameras by their namespaces, as narrow_stereo/left, which is no name of a file: narrow_stereo_left."""
    return name.strip("/").replace("/", "_")


def _camera_info(camera: RigCamera, notes: Sequence[str], nearest: bool) -> str:
    found = express_for_ros(camera, nearest)
    model, coefficients = model_and_coefficients(found)
    fx, fy, cx, cy = found.theta[:4]
    lines = [
        *(f"# {note}" for note in notes),
        f"# {found.said(camera.camera)}",
        f"image_width: {camera.image_size_px[0]}",
        f"image_height: {camera.image_size_px[1]}",
        f"camera_name: {quoted(camera.name)}",
        *_matrix("camera_matrix", 3, 3, np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])),
        f"distortion_model: {model}",
        *_matrix("distortion_coefficients", 1, len(coefficients), coefficients),
        *_matrix("rectification_matrix", 3, 3, np.eye(3).ravel()),
        *_matrix("projection_matrix", 3, 4, np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0])),
    ]
    return "\n".join(lines) + "\n"


def _matrix(name: str, rows: int, columns: int, values: FloatArray) -> list[str]:
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {row_text(values)}"]


def _launch(rig: Rig, frames: dict[str, str], notes: Sequence[str]) -> str:
    comment = "\n".join([*notes, "x y z qx qy qz qw: the camera's pose in ref, ref_T_camera"]).replace("--", "- -")
    lines = ["<!--", comment, "-->", "<launch>"]
    for name, camera_T_ref in rig.poses(TITLE).items():
        ref_T_camera = inverse(camera_T_ref)
        qw, qx, qy, qz = quaternion_wxyz(ref_T_camera)
        x, y, z = ref_T_camera[:3, 3]
        numbers = dict(zip(_PUBLISHED, (x, y, z, qx, qy, qz, qw), strict=True))
        arguments = [f"--{key} {float_text(value)}" for key, value in numbers.items()]
        arguments += [f"--frame-id {rig.ref}", f"--child-frame-id {frames[name]}"]
        node = frames[name].removesuffix("_optical_frame") + "_static_transform"
        lines.append(
            f"  <node pkg={quoteattr('tf2_ros')} exec={quoteattr(_PUBLISHER)} name={quoteattr(node)}\n"
            f"        args={quoteattr(' '.join(arguments))}/>"
        )
    return "\n".join([*lines, "</launch>"]) + "\n"


def quaternion_wxyz(a_T_b: FloatArray) -> list[float]:
    """Of a rigid transform (4, 4)."""
    return quaternions_from_poses(a_T_b[None], "wxyz")[0].tolist()


def _read_launch(path: Path) -> dict[str, tuple[str, FloatArray]]:
    """By child frame: its parent, and parent_T_child."""
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise GtcalError(f"{path}: is not valid XML: {error}") from None
    placed = {}
    for node in root.iter("node"):
        if node.get("exec") == _PUBLISHER:
            words = (node.get("args") or "").split()
            given = {key.removeprefix("--"): value for key, value in zip(words[::2], words[1::2], strict=False)}
            arguments = Field(path, str(node.get("name")), given)
            pose = Field(path, arguments.where, [_number(arguments[key]) for key in _PUBLISHED])
            x, y, z, *quat_xyzw = pose.numbers(7).tolist()
            quat = Field(path, arguments.where, quat_xyzw).unit_quaternion()
            parent_T_child = rigid_from_quaternion(np.roll(quat, 1), np.array([x, y, z]))
            placed[arguments["child-frame-id"].text()] = (arguments["frame-id"].text(), parent_T_child)
    return placed


def _number(field: Field) -> float:
    try:
        return float(field.value)
    except ValueError:
        raise field.error(f"is {field.value!r}; expected a number") from None
