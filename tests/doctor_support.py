"""Recordings on disk with a fault in them: trajectories without a header, so that the manifest states everything."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gtcal.camera import Camera
from gtcal.doctor.manifest_lines import with_lines
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.recording import Recording, write_recording
from gtcal.recordings.trajectory import Trajectory, quaternions_from_poses

STATED = {"format": "euroc_csv", "quaternion": "wxyz", "length_unit": "m", "time_unit": "ns"}
"""How ``written`` writes trajectories."""

Change = Callable[[Recording], Recording]


def written(recording: Recording, folder: Path, lines: Iterable[str] = ()) -> Path:
    """The recording in a folder of its own, with these lines in its manifest in place of the true ones."""
    write_recording(replace(recording, images={}), folder)
    for body, trajectory in recording.motion.trajectories.items():
        write_bare(folder / f"{body}.csv", trajectory)
    fields = fields_of(folder)
    for body in recording.motion.trajectories:
        fields[body] = {"trajectory": f"{body}.csv", **STATED}
    write_fields(folder, with_lines(fields, lines))
    return folder


def write_bare(path: Path, trajectory: Trajectory) -> None:
    """Stamps, positions and quaternions, with no header."""
    quats = quaternions_from_poses(trajectory.world_T_body, "wxyz")
    rows = np.concatenate([trajectory.world_T_body[:, :3, 3], quats], axis=1).tolist()
    stamps = trajectory.stamps_ns.tolist()
    path.write_text("".join(f"{t},{','.join(map(repr, row))}\n" for t, row in zip(stamps, rows, strict=True)))


def fields_of(folder: Path) -> dict[str, Any]:
    return yaml.safe_load((folder / "recording.yaml").read_text())


def write_fields(folder: Path, fields: dict[str, Any]) -> None:
    (folder / "recording.yaml").write_text(yaml.safe_dump(fields, sort_keys=False))


def write_lines(folder: Path, lines: Iterable[str]) -> None:
    """What the doctor says, written in the manifest."""
    write_fields(folder, with_lines(fields_of(folder), lines))


def poses(recording: Recording, bodies: Iterable[str], change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """With the poses of these bodies changed."""
    changed = {
        body: replace(getattr(recording, body), world_T_body=change(getattr(recording, body).world_T_body))
        for body in bodies
    }
    return replace(recording, **changed)


def scaled(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda world_T_body: world_T_body * np.array([[1.0, 1.0, 1.0, factor]] * 3 + [[1.0] * 4])


def mirrored_world(world_T_body: np.ndarray) -> np.ndarray:
    """As a left-handed export gives it."""
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    return mirror @ world_T_body @ mirror


def swapped_bodies(recording: Recording) -> Recording:
    return replace(
        recording,
        platform=replace(recording.board_body, body="platform"),
        board_body=replace(recording.platform, body="board_body"),
    )


def swapped_cameras(recording: Recording, one: str, other: str) -> Recording:
    detections = recording.detections
    return replace(recording, detections=detections | {one: detections[other], other: detections[one]})


def stamps(
    recording: Recording,
    change: Callable[[np.ndarray], np.ndarray],
    *,
    bodies: bool,
    cameras: Iterable[str] | None = None,
) -> Recording:
    """With the time stamps of the bodies, or of these cameras (of all by default), changed."""
    if bodies:
        changed = {
            name: replace(trajectory, stamps_ns=change(trajectory.stamps_ns))
            for name, trajectory in recording.motion.trajectories.items()
        }
        return replace(recording, **changed)
    detections = {
        name: replace(of_camera, stamps_ns=change(of_camera.stamps_ns))
        for name, of_camera in recording.detections.items()
        if cameras is None or name in cameras
    }
    return replace(recording, detections=recording.detections | detections)


def pixels(
    recording: Recording, change: Callable[[Camera, np.ndarray], np.ndarray], cameras: Iterable[str] | None = None
) -> Recording:
    """With the pixels of these cameras' corners changed, of all by default."""
    names = recording.cameras if cameras is None else cameras
    moved = {
        name: replace(
            recording.detections[name],
            corners_px=change(recording.cameras[name], recording.detections[name].corners_px),
        )
        for name in names
    }
    return replace(recording, detections=recording.detections | moved)


def corner_ids(recording: Recording, new_ids: np.ndarray) -> Recording:
    """With corner i called new_ids[i]."""

    def renamed(of_camera: CameraDetections) -> CameraDetections:
        return replace(of_camera, corner_ids=new_ids[of_camera.corner_ids])

    return replace(recording, detections={name: renamed(d) for name, d in recording.detections.items()})


def theta(
    recording: Recording, change: Callable[[np.ndarray], np.ndarray], cameras: Iterable[str] | None = None
) -> Recording:
    """With the parameters of these cameras changed, of all by default."""
    names = recording.cameras if cameras is None else cameras
    changed = {
        name: replace(recording.cameras[name], parameters=change(recording.cameras[name].theta)) for name in names
    }
    return replace(recording, cameras=recording.cameras | changed)


def since_start(recording: Recording) -> Recording:
    """With all stamps counted from a second before the first image."""
    first = min(int(of_camera.stamps_ns[0]) for of_camera in recording.detections.values()) - 10**9
    shifted = stamps(recording, lambda ns: ns - first, bodies=False)
    return stamps(shifted, lambda ns: ns - first, bodies=True)
