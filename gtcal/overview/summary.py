"""What a recording holds, in numbers: rates, gaps, what cameras and mocap have in common, coverage, range of motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.detection.detect import kept_detections
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import CameraDetections, IntArray
from gtcal.recordings.images import relative
from gtcal.recordings.recording import Recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.uncertainty.coverage import ImageCoverage, image_coverage, turn_coverage
from gtcal.verification.lollypop import Lollypop
from gtcal.verification.lollypop_recording import LollypopRecording

# An interval this many times the usual one is a gap between images, as it is for trajectories.
_GAP_INTERVALS = 2.5
# Less than this share of images with a pose of every body is worth a line.
_MOSTLY = 0.9


@dataclass(frozen=True)
class Times:
    """Time stamps (N,) in ns, increasing. gap_s: an interval longer than this is a gap."""

    stamps_ns: IntArray
    gap_s: float

    @property
    def span_s(self) -> float:
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9

    @cached_property
    def rate_hz(self) -> float:
        """By the median interval; NaN for a single stamp."""
        return 1e9 / float(np.median(np.diff(self.stamps_ns))) if len(self.stamps_ns) > 1 else float("nan")

    @cached_property
    def gaps_s(self) -> FloatArray:
        """The lengths of the gaps."""
        intervals_s = np.diff(self.stamps_ns) * 1e-9
        return intervals_s[intervals_s > self.gap_s]

    @property
    def n_lost(self) -> int:
        """Samples that are missing between the first and the last, at the usual rate."""
        if len(self.stamps_ns) < 2:
            return 0
        return int((np.rint(np.diff(self.stamps_ns) * 1e-9 * self.rate_hz) - 1).clip(0).sum())

    @property
    def runs_ns(self) -> IntArray:
        """(R, 2) first and last stamp of each run without a gap."""
        ends = np.flatnonzero(np.diff(self.stamps_ns) * 1e-9 > self.gap_s)
        starts = np.concatenate([[0], ends + 1])
        return np.stack([self.stamps_ns[starts], self.stamps_ns[np.append(ends, len(self.stamps_ns) - 1)]], axis=1)


@dataclass(frozen=True)
class CameraSummary:
    """One camera of a recording.

    times: of its images, or where it has none of its views. n_images: None where it has none.
    with_pose: share of these times at which every tracked body has a pose.
    detections, coverage: None where the board was not looked for yet."""

    camera: Camera
    times: Times
    n_images: int | None
    source: str
    with_pose: float
    detections: CameraDetections | None
    coverage: ImageCoverage | None


@dataclass(frozen=True)
class BodySummary:
    """One tracked body. times: of its samples."""

    trajectory: Trajectory
    times: Times

    @property
    def range_mm(self) -> FloatArray:
        """(3,) from the least to the greatest x, y and z in the mocap world."""
        return 1e3 * np.ptp(self.trajectory.world_T_body[:, :3, 3], axis=0)

    @cached_property
    def turns_deg(self) -> FloatArray:
        """(M, 3) rotation vectors from the mean attitude, in the body's frame."""
        rotations = Rotation.from_matrix(self.trajectory.world_T_body[:, :3, :3])
        turns: FloatArray = np.rad2deg((rotations.mean().inv() * rotations).as_rotvec())
        return turns

    @property
    def largest_turn_deg(self) -> float:
        """From the mean attitude."""
        return float(np.linalg.norm(self.turns_deg, axis=1).max())


@dataclass(frozen=True)
class RecordingSummary:
    """What a recording holds. remarks: what is worth knowing before one calibrates, a line each. numbered: whether
    what stands for times are the images' numbers, in s."""

    what: str
    cameras: dict[str, CameraSummary]
    bodies: dict[str, BodySummary]
    remarks: tuple[str, ...]
    numbered: bool = False

    @property
    def start_ns(self) -> int:
        """The first stamp of all; 0 where they stand for numbers."""
        if self.numbered:
            return 0
        times = [camera.times for camera in self.cameras.values()] + [body.times for body in self.bodies.values()]
        return min(int(entry.stamps_ns[0]) for entry in times)


def summarise(recording: Recording | LollypopRecording) -> RecordingSummary:
    """Of a recording as it is on disk: corners are those that are given or were kept from a detection before.

    Raises GtcalError where an image file is gone."""
    target = recording.board if isinstance(recording, Recording) else recording.device
    cameras = {name: _camera(recording, name, target) for name in recording.cameras}
    bodies = {
        _own_name(recording, name): _body(recording.motion, t) for name, t in recording.motion.trajectories.items()
    }
    what = f"{recording.capture.value}, {target.describe()}"
    return RecordingSummary(what, cameras, bodies, tuple(_remarks(recording, cameras)), recording.motion.numbered)


def _own_name(recording: Recording | LollypopRecording, body: str) -> str:
    is_device = isinstance(recording, LollypopRecording) and body == "board_body"
    return "device_body" if is_device else body


def _camera(recording: Recording | LollypopRecording, name: str, target: Board | Lollypop) -> CameraSummary:
    camera, images = recording.cameras[name], recording.images.get(name)
    found = recording.detections.get(name)
    if found is None and images is not None and recording.path is not None:
        found = kept_detections(recording.path.parent, name, images, target, camera)
    stamps_ns = images.stamps_ns if images is not None else _views(found)
    at = recording.path.parent if recording.path is not None else Path.cwd()
    source = "corners only" if images is None else ", ".join(relative(path, at) for path in images.inputs)
    return CameraSummary(
        camera=camera,
        times=Times(stamps_ns, float("inf") if recording.motion.numbered else _gap_s(stamps_ns)),
        n_images=None if images is None else len(images),
        source=f"{source} {images.source}".strip() if images is not None else source,
        with_pose=_with_pose(recording.motion, stamps_ns),
        detections=found,
        coverage=None if found is None else image_coverage(camera, found.corners_px),
    )


def _views(found: CameraDetections | None) -> IntArray:
    assert found is not None  # a recording's camera has images or detections
    return found.stamps_ns


def _gap_s(stamps_ns: IntArray) -> float:
    return _GAP_INTERVALS * float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else float("inf")


def _with_pose(motion: RefMotion, stamps_ns: IntArray) -> float:
    return float(motion.at(stamps_ns).ok.mean())


def _body(motion: RefMotion, trajectory: Trajectory) -> BodySummary:
    gap_s = float("inf") if motion.numbered else motion.gap_limit_s(trajectory)
    return BodySummary(trajectory, Times(trajectory.stamps_ns, gap_s))


def _remarks(recording: Recording | LollypopRecording, cameras: dict[str, CameraSummary]) -> Iterator[str]:
    for name, images in recording.images.items():
        yield from (f"{name}: {note}" for note in images.notes)
    for name, camera in cameras.items():
        if camera.with_pose < _MOSTLY:
            apart = _apart(recording, camera)
            yield f"{name}: {camera.with_pose:.0%} of its images have a pose of every tracked body{apart}"
        if camera.coverage is None:
            yield f"{name}: the board was not looked for yet; --detect does"
        elif camera.detections is not None and not camera.detections.n_views:
            yield f"{name}: no image shows the board"
        else:
            yield from (f"{name}: {line}" for line in camera.coverage.missing)
    yield from _turns(recording, cameras)


def _apart(recording: Recording | LollypopRecording, camera: CameraSummary) -> str:
    """Where not even the spans of time meet."""
    first, last = camera.times.stamps_ns[[0, -1]]
    for name, trajectory in recording.motion.trajectories.items():
        if last < trajectory.stamps_ns[0] or first > trajectory.stamps_ns[-1]:
            return f"; its time has nothing in common with that of {_own_name(recording, name)}: another clock?"
    return ""


def _turns(recording: Recording | LollypopRecording, cameras: dict[str, CameraSummary]) -> Iterator[str]:
    """Of the board's body in ref at the views, which is what a calibration lives on."""
    if isinstance(recording, LollypopRecording):
        return
    at = [recording.motion.at(of_camera.times.stamps_ns) for of_camera in cameras.values()]
    seen = [poses.ref_T_body[poses.ok] for poses in at]
    if any(len(p) > 1 for p in seen):
        yield from turn_coverage([p for p in seen if len(p) > 1], recording.capture).missing
