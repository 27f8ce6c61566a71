"""Videos and bags written from pictures, for the tests of their readers; and one small rendered recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from gtcal.simulation import Simulation, SimulationOptions, fixed_cameras_rig, simulate


def write_video(
    path: Path,
    pictures: Sequence[np.ndarray],
    pts: Sequence[int],
    *,
    time_base: Fraction = Fraction(1, 1000),
    codec: str = "ffv1",
    pixel_format: str = "gray",
    options: dict[str, str] | None = None,
) -> Path:
    """Pictures (H, W) or (H, W, 3 rgb) as the frames of a video, each at its own time stamp."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options=options or {})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pixel_format
        stream.time_base = stream.codec_context.time_base = time_base
        for picture, stamp in zip(pictures, pts, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="gray" if picture.ndim == 2 else "rgb24")
            frame.pts, frame.time_base = stamp, time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_bag(
    path: Path,
    topics: dict[str, Sequence[tuple[int, int, object]]],
    *,
    storage: str = "ros1",
) -> Path:
    """A bag: by topic, (time of recording ns, header stamp ns, body). storage: ros1, sqlite3 or mcap. The body is of
    ``image_message`` or ``compressed_message``."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if storage == "ros1" else Stores.ROS2_HUMBLE)
    with _writer(path, storage) as writer:
        for topic, messages in topics.items():
            connection = None
            for received_ns, header_ns, make in messages:
                message = make(store, header_ns)
                kind = message.__msgtype__
                connection = connection or writer.add_connection(topic, kind, typestore=store)
                serialize = store.serialize_ros1 if storage == "ros1" else store.serialize_cdr
                writer.write(connection, received_ns, serialize(message, kind))
    return path


def _writer(path: Path, storage: str):
    if storage == "ros1":
        from rosbags.rosbag1 import Writer

        return Writer(path)
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    return Writer2(path, version=9, storage_plugin=StoragePlugin[storage.upper()])


def _header(store, stamp_ns: int):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = store.types["std_msgs/msg/Header"]
    extra = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
    return header(stamp=time, frame_id="cam", **extra)


def image_message(pixels: np.ndarray, encoding: str = "mono8", *, padding: int = 0):
    """What makes a sensor_msgs/Image; ``padding``: bytes at the end of each row."""
    height, width = pixels.shape[:2]
    rows = np.pad(pixels.reshape(height, -1).view(np.uint8), ((0, 0), (0, padding)))

    def make(store, stamp_ns: int):
        return store.types["sensor_msgs/msg/Image"](
            header=_header(store, stamp_ns),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.ravel(),
        )

    return make


def compressed_message(data: bytes, kind: str = "png"):
    """What makes a sensor_msgs/CompressedImage."""

    def make(store, stamp_ns: int):
        return store.types["sensor_msgs/msg/CompressedImage"](
            header=_header(store, stamp_ns), format=kind, data=np.frombuffer(data, np.uint8)
        )

    return make


@cache
def small_simulation() -> Simulation:
    """One camera of 640 x 512 pixels, a dozen frames: enough to calibrate from, quick to render."""
    rig = fixed_cameras_rig(1)
    camera = rig.cameras[0]
    theta = np.concatenate([camera.theta[:2] / 2, (camera.theta[2:4] + 0.5) / 2 - 0.5, camera.theta[4:]])
    halved = replace(camera, parameters=theta, image_width_px=640, image_height_px=512)
    return simulate(SimulationOptions(rig=replace(rig, cameras=(halved,)), n_frames=12, duration_s=8.0), seed=3)
