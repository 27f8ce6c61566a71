"""A recording whose cameras have poses of the board, camera_T_board over time or by number, in place of corners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Dropped, check_overlap
from gtcal.estimation.pose_joint import PoseViews
from gtcal.files import InputFile, fingerprint
from gtcal.readers import pose_list
from gtcal.readers.mocap_take import RotationKind
from gtcal.readers.pose_list import AngleUnit
from gtcal.readers.poses import LengthUnit, PoseDirection, TimeUnit
from gtcal.recordings.capture import Capture, RefMotion, check_bodies
from gtcal.recordings.manifest import (
    CameraName,
    CaptureName,
    Entry,
    TrajectoryEntry,
    TrajectoryFormat,
    check_numbered_bodies,
    find_manifest,
    load_fields,
    validated,
)
from gtcal.recordings.recording import Loader
from gtcal.recordings.text_table import open_table
from gtcal.recordings.trajectory import Gap, QuaternionOrder, Trajectory

_DIRECTIONS: dict[str, PoseDirection] = {"camera_T_board": "world_T_body", "board_T_camera": "body_T_world"}
_FORMATS = {".csv": "euroc_csv", ".tum": "tum", ".txt": "tum"}
_SYMMETRIC = 1e-6


class ViewsEntry(Entry):
    """The measured poses of the board in one camera, and what their file leaves unsaid."""

    file: str = Field(description="The file, relative to the manifest.")
    format: TrajectoryFormat = Field(description="euroc_csv or tum; by number pose_list.")
    pose: Literal["camera_T_board", "board_T_camera"] = Field(
        default="camera_T_board", description="What a row holds: the board's pose in the camera, or its inverse."
    )
    quaternion: QuaternionOrder | None = Field(default=None, description="As for a tracked body.")
    length_unit: LengthUnit | None = Field(default=None, description="As for a tracked body.")
    time_unit: TimeUnit | None = Field(default=None, description="As for a tracked body.")
    rotation: RotationKind | None = Field(default=None, description="As for a pose_list of a tracked body.")
    angle_unit: AngleUnit | None = Field(default=None, description="As for a pose_list of a tracked body.")
    stamp_offset_ns: int = Field(default=0, description="Added to the file's time stamps.")
    covariance: str | None = Field(
        default=None,
        description="CSV with 36 numbers for each pose, in the same order: row by row the 6 x 6 covariance of xi in "
        "camera_T_board * Exp(xi), rotation first (rad), then translation (m), along the board's axes.",
    )

    def as_trajectory(self) -> TrajectoryEntry:
        """As the entry of the board tracked by the camera."""
        fields = self.model_dump(exclude={"file", "pose", "covariance"})
        return TrajectoryEntry(trajectory=self.file, pose=_DIRECTIONS[self.pose], **fields)


class PoseCameraEntry(Entry):
    """One camera, by the poses of the board that were found for it."""

    views: ViewsEntry | str = Field(
        description="The poses: a file whose format its name (.csv: euroc_csv, .tum, .txt: tum; by number a pose_list) "
        "and whose conventions its header tell, or the file with what it leaves unsaid."
    )


class PoseManifest(Entry):
    """A recording of poses that cameras have of a board, and of what a mocap or an arm tracks."""

    gtcal_recording: Literal[1] = Field(description="Version of this format: 1.")
    capture: CaptureName = Field(description="As in a recording of corners.")
    numbered: bool = Field(default=False, description="As in a recording of corners: poses go together by number.")
    cameras: dict[CameraName, PoseCameraEntry] = Field(min_length=1, description="The cameras by name.")
    platform: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the cameras.")
    board_body: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the board.")
    max_gap_ms: float | None = Field(default=None, gt=0, le=1e9, description="As in a recording of corners.")

    @property
    def bodies(self) -> dict[str, TrajectoryEntry]:
        """The tracked bodies that are given, by name."""
        given = {"platform": self.platform, "board_body": self.board_body}
        return {name: entry for name, entry in given.items() if entry is not None}


@dataclass(frozen=True)
class PoseRecording:
    """views: by camera, those with a pose of every tracked body. dropped: the others. n_frames: distinct times."""

    path: Path
    capture: Capture
    views: dict[str, PoseViews]
    motion: RefMotion
    dropped: tuple[Dropped, ...]
    inputs: tuple[InputFile, ...]
    notes: tuple[str, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that it is read from."""
        return tuple(entry.path for entry in self.inputs)


def holds_poses(path: Path | str) -> bool:
    """Whether the recording at ``path`` has poses in place of corners. Raises GtcalError where there is no manifest."""
    cameras = load_fields(find_manifest(Path(path))).get("cameras")
    return isinstance(cameras, Mapping) and any(isinstance(c, Mapping) and "views" in c for c in cameras.values())


@dataclass(frozen=True)
class PoseParts:
    """What the files of a recording of poses hold, before views and mocap are put together. entries: what was said of
    each camera's poses; seen: these, each camera's as the trajectory of the board in it. body_offsets_ns: what is added
    to each body's stamps."""

    path: Path
    entries: dict[str, ViewsEntry]
    seen: dict[str, Trajectory]
    covariances: dict[str, FloatArray]
    motion: RefMotion
    body_offsets_ns: dict[str, int]
    inputs: tuple[InputFile, ...]
    notes: tuple[str, ...]


def load_pose_recording(path: Path | str) -> PoseRecording:
    """Read the recording of poses in the folder (or with the manifest file) ``path``.

    Raises GtcalError, in one line that names the file and the field or row, for anything that is wrong with it."""
    parts = load_pose_parts(path)
    views, dropped = _synchronised(parts.seen, parts.covariances, parts.motion)
    return PoseRecording(
        parts.path, parts.motion.capture, views, parts.motion, tuple(dropped), parts.inputs, parts.notes
    )


def load_pose_parts(path: Path | str) -> PoseParts:
    """What its files hold, each by itself. Raises GtcalError as ``load_pose_recording``."""
    manifest_path = find_manifest(Path(path))
    fields = load_fields(manifest_path)
    _check_all_have_poses(manifest_path, fields["cameras"])
    manifest = validated(manifest_path, fields, PoseManifest)
    loader = Loader(manifest_path, numbered=manifest.numbered)
    entries = {name: _entry(camera.views, manifest.numbered) for name, camera in manifest.cameras.items()}
    try:
        check_bodies(Capture(manifest.capture), set(manifest.bodies))
        of_views = {f"cameras.{name}.views": entry.as_trajectory() for name, entry in entries.items()}
        check_numbered_bodies({**of_views, **manifest.bodies}, numbered=manifest.numbered)
    except GtcalError as error:
        raise GtcalError(f"{manifest_path}: {error}") from None
    seen = {name: loader.trajectory(f"cameras.{name}.views", entry.as_trajectory()) for name, entry in entries.items()}
    covariances = {
        name: _covariances(loader, name, entry.covariance, seen[name])
        for name, entry in entries.items()
        if entry.covariance is not None
    }
    stamps_ns = np.unique(np.concatenate([poses.stamps_ns for poses in seen.values()]))
    bodies = {name: loader.trajectory(name, entry, stamps_ns) for name, entry in manifest.bodies.items()}
    loader.check_millimetres(manifest.bodies, bodies)
    motion = RefMotion(
        Capture(manifest.capture),
        bodies.get("platform"),
        bodies.get("board_body"),
        None if manifest.max_gap_ms is None else manifest.max_gap_ms / 1000,
        manifest.numbered,
    )
    notes = [note for trajectory in (*seen.values(), *bodies.values()) for note in trajectory.notes]
    return PoseParts(
        manifest_path,
        entries,
        seen,
        covariances,
        motion,
        {name: entry.stamp_offset_ns for name, entry in manifest.bodies.items()},
        tuple(fingerprint(file) for file in loader.used),
        tuple(dict.fromkeys(notes)),
    )


def _check_all_have_poses(manifest: Path, cameras: Mapping[str, Any]) -> None:
    for name, camera in cameras.items():
        if not isinstance(camera, Mapping) or "views" not in camera:
            raise GtcalError(
                f"{manifest}: cameras.{name}: has no 'views', but other cameras have: poses and corners can't be "
                "calibrated together; give all cameras one or the other"
            )


def _entry(views: ViewsEntry | str, numbered: bool) -> ViewsEntry:
    if not isinstance(views, str):
        return views
    return ViewsEntry(
        file=views, format=pose_list.FORMAT if numbered else _FORMATS.get(Path(views).suffix, "euroc_csv")
    )


def _covariances(loader: Loader, name: str, file: str, poses: Trajectory) -> FloatArray:
    """(N, 6, 6) of a camera's poses. Raises GtcalError with file and line where one is no covariance."""
    path = loader.manifest_path.parent / file
    table = open_table(path, ",")
    rows = table.read([(f"c{i}", "number") for i in range(36)])
    loader.used.append(path)
    if len(rows) != poses.n_samples:
        raise GtcalError(f"{path}: {len(rows)} covariances for the {poses.n_samples} poses of camera {name!r}")
    found = np.stack([rows[f"c{i}"] for i in range(36)], axis=1).reshape(-1, 6, 6)
    size = np.sqrt(np.einsum("vii->vi", np.abs(found)))
    alike = found / np.maximum(size[:, :, None] * size[:, None], 1e-300)
    for row, matrix in enumerate(alike):
        if np.abs(matrix - matrix.T).max() > _SYMMETRIC or np.linalg.eigvalsh(matrix)[0] <= 0.0:
            raise table.error(row, "is no covariance: not symmetric, or not positive in every direction")
    return np.asarray(0.5 * (found + np.swapaxes(found, 1, 2)))


def _synchronised(
    seen: Mapping[str, Trajectory], covariances: Mapping[str, FloatArray], motion: RefMotion
) -> tuple[dict[str, PoseViews], list[Dropped]]:
    frames = np.unique(np.concatenate([poses.stamps_ns for poses in seen.values()]))
    views, dropped = {}, []
    for name, poses in seen.items():
        for body, trajectory in ({} if motion.numbered else motion.trajectories).items():
            check_overlap(name, poses.stamps_ns, body, trajectory.stamps_ns)
        at = motion.at(poses.stamps_ns)
        for body, gaps in at.gaps.items():
            if lost := int((gaps != Gap.NONE).sum()):
                what = "no pose of its number in" if motion.numbered else "no pose near that time in"
                dropped.append(Dropped(name, f"{what} {body}", lost, 0))
        if at.ok.sum() < 3:
            raise GtcalError(
                f"camera {name!r}: {int(at.ok.sum())} of its {len(at.ok)} poses have one of every tracked "
                "body; 3 or more are needed"
            )
        views[name] = PoseViews(
            poses.stamps_ns[at.ok],
            np.searchsorted(frames, poses.stamps_ns[at.ok]),
            at.ref_T_body[at.ok],
            poses.world_T_body[at.ok],
            covariances[name][at.ok] if name in covariances else None,
        )
    return views, dropped
