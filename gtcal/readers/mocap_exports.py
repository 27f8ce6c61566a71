"""Files of mocap programs, written: what the readers of this package read back."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import staged, write_text
from gtcal.readers.euroc_csv import write_euroc_csv
from gtcal.readers.selection import BodySelection
from gtcal.readers.tum import write_tum
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory, quaternions_from_poses

MocapFormat = Literal["euroc_csv", "tum", "motive_csv", "vicon_csv", "rosbag"]

_UNEVEN_NS = 1_000
"""Stamps may be this far from a constant rate, which is all that some formats know."""


@dataclass(frozen=True)
class WrittenBody:
    """Where a tracked body was written.

    file: in the folder. selection: which of its bodies it is, and what to read it with."""

    file: str
    selection: BodySelection


class ExportWriter(Protocol):
    """Writes tracked bodies, by name, into a folder, every digit, each file whole or not at all.

    Raises GtcalError where they can't be written, or the format can't hold them."""

    def __call__(self, folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, WrittenBody]: ...


def write_euroc_files(folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, WrittenBody]:
    """A CSV of EuRoC's for each body."""
    for name, trajectory in bodies.items():
        write_euroc_csv(folder / f"{name}.csv", trajectory)
    return {name: WrittenBody(f"{name}.csv", BodySelection()) for name in bodies}


def write_tum_files(folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, WrittenBody]:
    """A text of TUM's for each body."""
    for name, trajectory in bodies.items():
        write_tum(folder / f"{name}.txt", trajectory)
    return {name: WrittenBody(f"{name}.txt", BodySelection()) for name in bodies}


def write_motive_csv(folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, WrittenBody]:
    """One CSV of Motive's, as version 1.23 of the format: metres, quaternions, frames from 0."""
    take = _take(bodies)
    axes = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]
    blocks = []
    for poses in take.poses.values():
        seen = np.isfinite(poses[:, 0, 0])
        numbers = np.full((len(poses), 7), np.nan)
        numbers[seen, :4], numbers[:, 4:] = quaternions_from_poses(poses[seen], "xyzw"), poses[:, :3, 3]
        blocks.append(numbers)
    rate, count = f"{take.rate_hz:.6f}", str(take.n_frames)
    head = ["Format Version", "1.23", "Take Name", "simulated", "Capture Frame Rate", rate, "Export Frame Rate", rate]
    head += ["Total Frames in Take", count, "Total Exported Frames", count, "Rotation Type", "Quaternion"]
    head += ["Length Units", "Meters", "Coordinate Space", "Global"]
    columns = [(name, *axis) for name in bodies for axis in axes]
    lines = [head, [], ["", "Type", *["Rigid Body"] * len(columns)], ["", "Name", *(name for name, _, _ in columns)]]
    lines += [["", "ID", *(str(1 + list(bodies).index(name)) for name, _, _ in columns)]]
    lines += [["", "", *(kind for _, kind, _ in columns)], ["Frame", "Time (Seconds)", *(axis for *_, axis in columns)]]
    rows = np.concatenate(blocks, axis=1).tolist()
    lines += [[str(i), f"{i / take.rate_hz:.9f}", *_cells(row)] for i, row in enumerate(rows)]
    write_text(folder / "take.csv", _csv(lines))
    return {name: WrittenBody("take.csv", BodySelection(name=name, stamp_offset_ns=take.start_ns)) for name in bodies}


def write_vicon_csv(folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, WrittenBody]:
    """One CSV of Nexus', of segments: mm, helical angles in degrees, frames from 1."""
    take = _take(bodies)
    blocks = []
    for poses in take.poses.values():
        seen = np.isfinite(poses[:, 0, 0])
        numbers = np.full((len(poses), 6), np.nan)
        numbers[seen, :3] = np.rad2deg(Rotation.from_matrix(poses[seen, :3, :3]).as_rotvec())
        numbers[:, 3:] = 1e3 * poses[:, :3, 3]
        blocks.append(numbers)
    segments = {name: f"{name}:{name}" for name in bodies}
    lines = [["Segments"], [f"{take.rate_hz:g}"], ["", "", *(c for n in segments.values() for c in (n, *[""] * 5))]]
    lines += [["Frame", "Sub Frame", *("RX", "RY", "RZ", "TX", "TY", "TZ") * len(bodies)]]
    lines += [["", "", *("deg", "deg", "deg", "mm", "mm", "mm") * len(bodies)]]
    lines += [[str(i), "0", *_cells(row)] for i, row in enumerate(np.concatenate(blocks, axis=1).tolist(), start=1)]
    write_text(folder / "take.csv", _csv(lines))
    return {
        name: WrittenBody("take.csv", BodySelection(segment, rotation="helical", stamp_offset_ns=take.start_ns))
        for name, segment in segments.items()
    }


def write_rosbag(folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, WrittenBody]:
    """One ROS 2 bag, a PoseStamped for each sample on a topic of each body."""
    try:
        from rosbags.rosbag2 import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise GtcalError("writing bags needs rosbags; pip install 'gtcal[bags]'") from None
    store, kind = get_typestore(Stores.ROS2_HUMBLE), "geometry_msgs/msg/PoseStamped"
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    point, quaternion = store.types["geometry_msgs/msg/Point"], store.types["geometry_msgs/msg/Quaternion"]
    topics = {name: f"/{name}/pose" for name in bodies}
    with staged(folder / "take") as aside, Writer(aside, version=9) as writer:
        for name, trajectory in bodies.items():
            connection = writer.add_connection(topics[name], kind, typestore=store)
            quats_xyzw = quaternions_from_poses(trajectory.world_T_body, "xyzw").tolist()
            places_m = trajectory.world_T_body[:, :3, 3].tolist()
            for stamp_ns, place, quat in zip(trajectory.stamps_ns.tolist(), places_m, quats_xyzw, strict=True):
                stamp = header(stamp=time(*divmod(stamp_ns, 1_000_000_000)), frame_id="world")
                pose = store.types["geometry_msgs/msg/Pose"](position=point(*place), orientation=quaternion(*quat))
                message = store.types[kind](header=stamp, pose=pose)
                writer.write(connection, stamp_ns, store.serialize_cdr(message, kind))
    return {name: WrittenBody("take", BodySelection(name=topic)) for name, topic in topics.items()}


EXPORT_WRITERS: dict[MocapFormat, ExportWriter] = {
    "euroc_csv": write_euroc_files,
    "tum": write_tum_files,
    "motive_csv": write_motive_csv,
    "vicon_csv": write_vicon_csv,
    "rosbag": write_rosbag,
}


@dataclass(frozen=True)
class _Take:
    """Bodies frame by frame. poses: by body (N, 4, 4), NaN where it was not seen."""

    start_ns: int
    rate_hz: float
    n_frames: int
    poses: dict[str, FloatArray]


def _take(bodies: Mapping[str, Trajectory]) -> _Take:
    """Raises GtcalError where the stamps are not those of one rate."""
    start_ns = min(int(trajectory.stamps_ns[0]) for trajectory in bodies.values())
    interval_s = min(trajectory.median_interval_s for trajectory in bodies.values())
    rate_hz = round(1.0 / interval_s, 3)
    frames = {name: _frames(trajectory, start_ns, rate_hz) for name, trajectory in bodies.items()}
    n_frames = 1 + max(int(of_body[-1]) for of_body in frames.values())
    poses = {name: np.full((n_frames, 4, 4), np.nan) for name in bodies}
    for name, trajectory in bodies.items():
        poses[name][frames[name]] = trajectory.world_T_body
    return _Take(start_ns, rate_hz, n_frames, poses)


def _frames(trajectory: Trajectory, start_ns: int, rate_hz: float) -> IntArray:
    """(M,) the frame of each sample."""
    since_s = 1e-9 * (trajectory.stamps_ns - start_ns)
    frames = np.rint(since_s * rate_hz).astype(np.int64)
    off_ns = 1e9 * np.abs(frames / rate_hz - since_s)
    if off_ns.max() > _UNEVEN_NS or (np.diff(frames) <= 0).any():
        raise GtcalError(
            f"{trajectory.body}: its stamps are up to {1e-3 * off_ns.max():.0f} us off a rate of {rate_hz:g} Hz, and "
            "this format knows frames of one rate; choose another format"
        )
    return frames


def _cells(numbers: list[float]) -> list[str]:
    """Every digit, blank for NaN."""
    return ["" if number != number else repr(number) for number in numbers]


def _csv(lines: list[list[str]]) -> str:
    text = StringIO()
    csv.writer(text, lineterminator="\r\n").writerows(lines)
    return text.getvalue()
