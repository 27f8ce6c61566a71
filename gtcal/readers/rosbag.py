"""ROS 1 and ROS 2 bags, read with rosbags, without ROS: stamped poses and transforms, odometry and TF.

A body is a topic ('/headset/pose') or, on a topic that carries several (TF), the topic and the child frame
('/tf:headset'). Time stamps are those of the messages' headers, when the mocap saw it, not when the bag received them.
Metres, xyzw and the pose of the child in the parent frame are ROS' own conventions (REP 103, tf2).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtcal.bags import opened_bag, words_of
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import check_regular
from gtcal.readers.body_trajectory import listed, trajectory_of
from gtcal.readers.mocap_take import BodyColumns, MocapTake
from gtcal.readers.poses import PoseConventions
from gtcal.readers.selection import WHOLE_FILE, BodySelection
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory

FORMAT = "rosbag"
SUFFIXES = (".bag", ".db3", ".mcap")
_STAMPED = {
    "geometry_msgs/msg/PoseStamped": False,
    "geometry_msgs/msg/PoseWithCovarianceStamped": False,
    "geometry_msgs/msg/TransformStamped": True,
    "nav_msgs/msg/Odometry": True,
}
"""Messages of one pose, and whether the name of a child frame stands before it."""
_TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

# stamp in ns, parent frame, child frame, x, y, z, qx, qy, qz, qw
_Row = tuple[int, str, str, tuple[float, ...]]


@dataclass
class _Body:
    """The messages of one body, as they come."""

    parents: set[str] = field(default_factory=set)
    stamps_ns: list[int] = field(default_factory=list)
    numbers: list[tuple[float, ...]] = field(default_factory=list)


def read_rosbag(path: Path, body: str, declared: PoseConventions, selection: BodySelection = WHOLE_FILE) -> Trajectory:
    """Read a body of a ROS 1 or 2 bag.

    Raises GtcalError naming the file, topic and frame, or the field to state, for what can't be read for sure."""
    takes = read_rosbag_takes(path)
    take = takes[_chosen(path, body, selection.name, list(takes))]
    return trajectory_of(take, body, declared, replace(selection, name=None), set())


def is_rosbag(path: Path) -> bool:
    """Whether a path is a bag by its name: a .bag, .db3 or .mcap file, or a folder with metadata.yaml."""
    return path.suffix.lower() in SUFFIXES if not path.is_dir() else (path / "metadata.yaml").is_file()


def read_rosbag_takes(path: Path) -> dict[str, MocapTake]:
    """Every body of a bag, as a take of its own since each has its own stamps.

    Raises GtcalError where the bag can't be read, or a body's messages contradict each other."""
    check_regular(path)
    if not path.exists():
        raise GtcalError(f"{path}: there is no such file")
    if not is_rosbag(path):
        raise GtcalError(f"{path}: is no bag; expected a .bag, .db3 or .mcap file or a folder with metadata.yaml")
    bodies = _bodies(path)
    if not bodies:
        kinds = ", ".join(kind.split("/")[-1] for kind in (*_STAMPED, _TF[0]))
        raise GtcalError(f"{path}: the bag holds no message of {kinds}")
    return {name: _take(path, name, messages) for name, messages in sorted(bodies.items())}


def _chosen(path: Path, body: str, name: str | None, names: list[str]) -> str:
    """The body of this name, or whose child frame has it, or the only one."""
    if name is None and len(names) == 1:
        return names[0]
    fitting = [known for known in names if name is not None and name in (known, known.partition(":")[2])]
    if len(fitting) == 1:
        return fitting[0]
    if name is None:
        raise GtcalError(f"{path}: say which one is {body}, in {body}.name; it holds {listed('bodies', names)}")
    what = f"more than one body {name!r}" if fitting else f"no body {name!r}"
    raise GtcalError(f"{path}: {body}.name: the bag holds {what}; it holds {listed('bodies', names)}")


def _bodies(path: Path) -> dict[str, _Body]:
    by_frame: dict[str, dict[str, _Body]] = {}
    try:
        with opened_bag(path) as reader:
            wanted = [c for c in reader.connections if c.msgtype in _STAMPED or c.msgtype in _TF]
            checked: set[int] = set()
            for connection, _, raw in reader.messages(connections=wanted) if wanted else ():
                unpack = _tf_rows if connection.msgtype in _TF else _stamped_rows
                rows = list(unpack(raw, reader.is2, _STAMPED.get(connection.msgtype, True)))
                if connection.id not in checked and rows:
                    checked.add(connection.id)
                    _check_unpacked(rows[0], reader.deserialize(raw, connection.msgtype))
                frames = by_frame.setdefault(connection.topic, {})
                for stamp_ns, parent, child, numbers in rows:
                    messages = frames.setdefault(child, _Body())
                    messages.parents.add(parent)
                    messages.stamps_ns.append(stamp_ns)
                    messages.numbers.append(numbers)
            is_tf = {c.topic for c in wanted if c.msgtype in _TF}
    except GtcalError:
        raise
    except Exception as error:  # the library raises what its parsers, SQLite and the like do
        raise GtcalError(f"{path}: the bag can't be read: {words_of(error)}") from error
    return {
        topic if len(frames) == 1 and topic not in is_tf else f"{topic}:{child}": messages
        for topic, frames in by_frame.items()
        for child, messages in frames.items()
    }


def _check_unpacked(row: _Row, message: Any) -> None:
    """The first message of a connection, unpacked here and by the library: a message definition that differs from
    ROS' own must not shift the numbers."""
    if hasattr(message, "transforms"):
        message = message.transforms[0]
    held = message.transform if hasattr(message, "transform") else message.pose
    pose = held.pose if hasattr(held, "pose") else held
    at, turned = (pose.translation, pose.rotation) if hasattr(pose, "rotation") else (pose.position, pose.orientation)
    numbers = (at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w)
    stamp = message.header.stamp
    if row[0] != stamp.sec * 1_000_000_000 + stamp.nanosec or row[3] != numbers:
        raise ValueError("its messages are defined otherwise than ROS defines them")


def _stamped_rows(raw: bytes, is_cdr: bool, has_child: bool) -> Iterator[_Row]:
    row, _ = _row(raw, 4 if is_cdr else 0, is_cdr, has_child)
    yield row


def _tf_rows(raw: bytes, is_cdr: bool, has_child: bool) -> Iterator[_Row]:
    offset = 4 if is_cdr else 0
    (count,) = struct.unpack_from(_order(raw, is_cdr) + "I", raw, offset)
    offset += 4
    for _ in range(count):
        row, offset = _row(raw, offset, is_cdr, has_child)
        yield row


def _order(raw: bytes, is_cdr: bool) -> str:
    """The byte order: CDR says it in its second byte, ROS 1 is always little-endian."""
    return ">" if is_cdr and raw[1] & 1 == 0 else "<"


def _row(raw: bytes, offset: int, is_cdr: bool, has_child: bool) -> tuple[_Row, int]:
    """One stamped pose at this byte, and the byte after it. CDR aligns to the size of what comes, counted from its
    fourth byte; its strings end with a zero. ROS 1 has a sequence number and no padding."""
    order = _order(raw, is_cdr)
    if is_cdr:
        offset = _aligned(offset, 4)
        seconds, nanoseconds = struct.unpack_from(order + "iI", raw, offset)
        offset += 8
    else:
        _, seconds, nanoseconds = struct.unpack_from("<3I", raw, offset)
        offset += 12
    parent, offset = _text(raw, offset, order, is_cdr)
    child = ""
    if has_child:
        child, offset = _text(raw, offset, order, is_cdr)
    if is_cdr:
        offset = _aligned(offset, 8)
    numbers = struct.unpack_from(order + "7d", raw, offset)
    return (seconds * 1_000_000_000 + nanoseconds, parent, child, numbers), offset + 56


def _text(raw: bytes, offset: int, order: str, is_cdr: bool) -> tuple[str, int]:
    if is_cdr:
        offset = _aligned(offset, 4)
    (length,) = struct.unpack_from(order + "I", raw, offset)
    offset += 4
    return raw[offset : offset + length].rstrip(b"\0").decode("utf-8", errors="replace"), offset + length


def _aligned(offset: int, size: int) -> int:
    return offset + (4 - offset) % size


def _take(path: Path, name: str, messages: _Body) -> MocapTake:
    if len(messages.parents) > 1:
        frames = ", ".join(repr(frame) for frame in sorted(messages.parents))
        raise GtcalError(f"{path}: {name}: its poses are given in the frames {frames}; expected one")
    stamps_ns = np.array(messages.stamps_ns, dtype=np.int64)
    if not stamps_ns.any():
        raise GtcalError(f"{path}: {name}: the headers of its messages have no time stamps")
    numbers = np.array(messages.numbers, dtype=np.float64)
    stamps_ns, numbers, notes = _in_order(path, name, stamps_ns, numbers)
    (parent,) = messages.parents
    return MocapTake(
        path=path,
        format=FORMAT,
        frames=np.arange(len(stamps_ns)),
        stamps_ns=stamps_ns,
        rate_hz=None,
        metres_per_unit=1.0,
        bodies={name: BodyColumns(numbers[:, :3], numbers[:, 3:], "quaternion_xyzw")},
        markers={},
        stated={"frame": parent},
        notes=notes,
        time_unit="ns",
    )


def _in_order(
    path: Path, name: str, stamps_ns: IntArray, numbers: FloatArray
) -> tuple[IntArray, FloatArray, tuple[str, ...]]:
    """The messages by time, those that repeat one left out. Raises GtcalError where two of a time differ."""
    notes = []
    if (np.diff(stamps_ns) < 0).any():
        order = np.argsort(stamps_ns, kind="stable")
        stamps_ns, numbers = stamps_ns[order], numbers[order]
        notes.append(f"messages of {name} are not in the order of their time stamps, and were sorted")
    again = np.concatenate([[False], np.diff(stamps_ns) == 0])
    before = np.flatnonzero(again) - 1
    differ = np.flatnonzero((numbers[before] != numbers[before + 1]).any(axis=1))
    if len(differ):
        stamp_ns = stamps_ns[before[differ[0]]]
        raise GtcalError(f"{path}: {name}: two messages have the time stamp {stamp_ns} ns and other poses")
    if again.any():
        notes.append(f"{int(again.sum())} messages of {name} repeat the one before, and were left out")
    return stamps_ns[~again], numbers[~again], tuple(notes)
