"""A ROS bag: /<camera>/camera_info, and the rig as /tf_static. ROS 1 and ROS 2 bags are read, ROS 2 bags written.

Conventions as in ``gtcal.camera_files.ros``: /tf_static holds, for a camera's frame, its pose in the parent frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from factors.rigid import inverse
from gtcal.bags import opened_bag, words_of
from gtcal.camera import FloatArray
from gtcal.camera_files.fields import Field, rigid_from_quaternion
from gtcal.camera_files.lenses import Expressed
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera, rig_camera
from gtcal.camera_files.ros import (
    express_for_ros,
    frame_names,
    model_and_coefficients,
    place,
    plain_name,
    quaternion_wxyz,
    read_lens,
    read_size,
)
from gtcal.errors import GtcalError
from gtcal.files import is_there, staged

TITLE = "a ROS bag"
_INFO, _TF = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"


def recognises_folder(folder: Path) -> bool:
    """Whether this folder is a ROS 2 bag."""
    return (folder / "metadata.yaml").is_file()


def read_ros_bag(path: Path, options: ReadOptions) -> Rig:
    """The cameras whose camera_info is in the bag, by the first message of each topic, named by the topic; in the
    frame that /tf_static places all of theirs in, if any.

    Raises GtcalError where rosbags is not installed, the bag is damaged, or a camera_info holds no lens of gtcal's."""
    if not path.exists():
        raise GtcalError(f"{path}: there is no such bag")
    try:
        with opened_bag(path) as reader:
            infos = [(c.topic, _first(reader, c)) for c in reader.connections if c.msgtype == _INFO]
            first = {topic: info for topic, info in infos if info is not None}
            static = [c for c in reader.connections if c.msgtype == _TF and c.topic.endswith("tf_static")]
            messages = reader.messages(static) if static else ()  # without a choice, rosbags gives them all
            placed = _placed(path, [reader.deserialize(data, c.msgtype) for c, _, data in messages])
    except GtcalError:
        raise
    except Exception as error:  # rosbags raises errors of its own, and of sqlite, struct, ... for a damaged bag
        raise GtcalError(f"{path}: can't be read as a bag: {words_of(error)}") from error
    if not first:
        raise GtcalError(f"{path}: there is no camera_info in the bag")
    cameras = [_camera(path, topic, info, options) for topic, info in first.items()]
    frames = [info.header.frame_id for info in first.values()]
    return place(cameras, frames, placed, "/tf_static doesn't place every camera")


def write_ros_bag(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write a ROS 2 bag. The notes stand in its metadata.

    Raises GtcalError where rosbags is not installed, there is something at ``path`` already, or for a lens that ROS
    doesn't know unless ``nearest``."""
    _typestore()
    check_new(path)
    frames = frame_names(rig)
    found = {camera.name: express_for_ros(camera, nearest) for camera in rig.cameras}
    with staged(path) as aside:  # of the same name: rosbags calls what is in a bag after its folder
        _write(rig, aside, frames, found, notes)


def check_new(path: Path) -> None:
    """Raises GtcalError where there is something at ``path``."""
    if is_there(path):
        raise GtcalError(f"{path}: there is something here already; a bag is a new folder")


def _typestore() -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise GtcalError(f"{TITLE} needs the library rosbags: pip install 'gtcal[bags]'") from None
    return get_typestore(Stores.ROS2_HUMBLE)


def _first(reader: Any, connection: Any) -> Any:
    """The first message of a topic, None where it has none."""
    for _, _, data in reader.messages([connection]):
        return reader.deserialize(data, connection.msgtype)
    return None


def _camera(path: Path, topic: str, info: Any, options: ReadOptions) -> RigCamera:
    name = plain_name(topic.strip("/").removesuffix("camera_info")) or "camera"
    values = {
        "width": info.width,
        "height": info.height,
        "distortion_model": info.distortion_model,
        "k": np.asarray(getattr(info, "k", None) if hasattr(info, "k") else info.K).tolist(),
        "d": np.asarray(info.d if hasattr(info, "d") else info.D).tolist(),
        "binning_x": info.binning_x,
        "binning_y": info.binning_y,
        "roi": {"width": info.roi.width, "height": info.roi.height},
    }
    message = Field(path, topic, values)
    return rig_camera(message, name, read_lens(message), read_size(message, options), options)


def _placed(path: Path, messages: Sequence[Any]) -> dict[str, tuple[str, FloatArray]]:
    """By child frame: its parent, and parent_T_child."""
    placed = {}
    for stamped in (transform for message in messages for transform in message.transforms):
        t, q = stamped.transform.translation, stamped.transform.rotation
        quat_wxyz = Field(path, f"/tf_static.{stamped.child_frame_id}", [q.w, q.x, q.y, q.z]).unit_quaternion()
        parent_T_child = rigid_from_quaternion(quat_wxyz, np.array([t.x, t.y, t.z]))
        placed[stamped.child_frame_id.lstrip("/")] = (stamped.header.frame_id.lstrip("/"), parent_T_child)
    return placed


def _write(rig: Rig, folder: Path, frames: dict[str, str], found: dict[str, Expressed], notes: Sequence[str]) -> None:
    from rosbags.rosbag2 import Writer

    store = _typestore()
    with Writer(folder, version=9) as writer:
        writer.set_custom_data("gtcal", "; ".join(notes))
        for camera in rig.cameras:
            topic = f"/{frames[camera.name].removesuffix('_optical_frame')}/camera_info"
            info = _camera_info(store, camera, found[camera.name], frames[camera.name])
            writer.write(_latched(writer, store, topic, _INFO), 0, store.serialize_cdr(info, _INFO))
        if rig.posed:
            transforms = _transforms(store, rig, frames)
            writer.write(_latched(writer, store, "/tf_static", _TF), 0, store.serialize_cdr(transforms, _TF))


def _latched(writer: Any, store: Any, topic: str, kind: str) -> Any:
    """A topic whose last message is handed to who comes late, as tf2 wants of /tf_static."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    qos = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
    return writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=[qos])


def _header(store: Any, frame: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _camera_info(store: Any, camera: RigCamera, found: Expressed, frame: str) -> Any:
    fx, fy, cx, cy = found.theta[:4]
    model, coefficients = model_and_coefficients(found)
    return store.types[_INFO](
        header=_header(store, frame),
        height=camera.image_size_px[1],
        width=camera.image_size_px[0],
        distortion_model=model,
        d=coefficients,
        k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1]),
        r=np.eye(3).ravel(),
        p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]),
        binning_x=0,
        binning_y=0,
        roi=store.types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        ),
    )


def _transforms(store: Any, rig: Rig, frames: dict[str, str]) -> Any:
    vector, quaternion = store.types["geometry_msgs/msg/Vector3"], store.types["geometry_msgs/msg/Quaternion"]
    stamped = []
    for name, camera_T_ref in rig.poses(TITLE).items():
        ref_T_camera = inverse(camera_T_ref)
        w, x, y, z = quaternion_wxyz(ref_T_camera)
        transform = store.types["geometry_msgs/msg/Transform"](
            translation=vector(*ref_T_camera[:3, 3].tolist()), rotation=quaternion(x=x, y=y, z=z, w=w)
        )
        stamped.append(
            store.types["geometry_msgs/msg/TransformStamped"](
                header=_header(store, rig.ref), child_frame_id=frames[name], transform=transform
            )
        )
    return store.types[_TF](transforms=stamped)
