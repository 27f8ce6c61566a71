"""A recording of several boards: to each of them it is a recording of its own, of the same cameras and platform."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, WithJsonSchema

from gtcal.board import Board, board_manifest_schema
from gtcal.board_tolerance import with_tolerance_schema
from gtcal.errors import GtcalError
from gtcal.files import write_text
from gtcal.recordings.capture import Capture
from gtcal.recordings.detection_files import write_detections
from gtcal.recordings.manifest import (
    MANIFEST_NAMES,
    CameraEntry,
    CameraName,
    Entry,
    TrajectoryEntry,
    find_manifest,
    load_fields,
    manifest_of,
    validated,
)
from gtcal.recordings.recording import Recording, body_entries, camera_entry, recording_of

BoardName = CameraName
_CAPTURES = {
    (False, True): Capture.FIXED_CAMERAS,
    (True, True): Capture.TRACKED_PLATFORM,
    (True, False): Capture.STANDING_BOARD,
}
"""By whether the platform is tracked, and the board."""


class BoardEntry(Entry):
    """One of several boards."""

    board: Annotated[dict[str, Any], WithJsonSchema(with_tolerance_schema(board_manifest_schema()))] = Field(
        description="The board, as in a recording of one."
    )
    body: TrajectoryEntry | None = Field(
        default=None, description="The tracked body that carries it; left out of a board that stands still."
    )


class SharedCameraEntry(CameraEntry):
    """One camera, as in a recording of one board, but for its corners."""

    detections: dict[BoardName, str] | None = Field(  # type: ignore[assignment]
        default=None, description="CSV of detected corners by board, in place of images."
    )


class BoardsManifest(Entry):
    """A recording of several boards that cameras see and a mocap system tracks."""

    gtcal_recording: Literal[1] = Field(description="Version of this format: 1.")
    boards: dict[BoardName, BoardEntry] = Field(min_length=2, description="The boards by name.")
    cameras: dict[CameraName, SharedCameraEntry] = Field(min_length=1, description="The cameras by name.")
    platform: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the cameras.")
    max_gap_ms: float | None = Field(default=None, gt=0, le=1e9, description="As in a recording of one board.")
    numbered: bool = Field(default=False, description="As in a recording of one board.")


def holds_boards(path: Path | str) -> bool:
    """Whether the recording at ``path`` is of several boards. Raises GtcalError where there is no manifest."""
    return "boards" in load_fields(find_manifest(Path(path)))


def load_boards(path: Path | str) -> dict[str, Recording]:
    """The recording of each board, by its name, of those cameras that may see it.

    Raises GtcalError, in one line that names the board, the file and the field, for anything that is wrong."""
    manifest_path = find_manifest(Path(path))
    fields = load_fields(manifest_path)
    manifest = validated(manifest_path, fields, BoardsManifest)
    found = {}
    for name, entry in manifest.boards.items():
        try:
            found[name] = recording_of(manifest_path, manifest_of(manifest_path, _fields_of(name, entry, manifest)))
        except GtcalError as error:
            raise GtcalError(f"boards.{name}: {error}") from None
    try:
        check_told_apart({name: recording.board for name, recording in found.items()})
    except GtcalError as error:
        raise GtcalError(f"{manifest_path}: boards: {error}") from None
    return found


def _fields_of(name: str, entry: BoardEntry, manifest: BoardsManifest) -> dict[str, Any]:
    """A manifest of this board alone."""
    cameras = {}
    for camera, given in manifest.cameras.items():
        for unknown in sorted((given.detections or {}).keys() - manifest.boards.keys()):
            raise GtcalError(
                f"cameras.{camera}.detections: {unknown!r} is none of the boards: {', '.join(manifest.boards)}"
            )
        fields = given.model_dump(exclude_none=True, exclude={"detections"})
        corners = (given.detections or {}).get(name)
        if given.detections is None or corners is not None:
            cameras[camera] = fields | ({} if corners is None else {"detections": corners})
    if not cameras:
        raise GtcalError("no camera has detections of it")
    tracked = (manifest.platform is not None, entry.body is not None)
    if tracked not in _CAPTURES:
        raise GtcalError("body: is missing; a board that is not tracked needs a tracked platform")
    bodies = {"platform": manifest.platform, "board_body": entry.body}
    return {
        "gtcal_recording": 1,
        "capture": _CAPTURES[tracked].value,
        "board": entry.board,
        "numbered": manifest.numbered,
        "cameras": cameras,
        **{body: given.model_dump(exclude_none=True) for body, given in bodies.items() if given is not None},
        **({} if manifest.max_gap_ms is None else {"max_gap_ms": manifest.max_gap_ms}),
    }


def check_told_apart(boards: Mapping[str, Board]) -> None:
    """Raises GtcalError where two boards share a tag, or none of both has any."""
    for (one, first), (other, second) in combinations(boards.items(), 2):
        tags = [_tags(board) for board in (first, second)]
        if tags[0] is None and tags[1] is None:
            raise GtcalError(f"{one!r} and {other!r} have no tags, so nothing tells which of them an image shows")
        if tags[0] is None or tags[1] is None or tags[0][0] != tags[1][0]:
            continue
        shared = sorted(tags[0][1] & tags[1][1])
        if shared:
            raise GtcalError(
                f"{one!r} and {other!r} share {len(shared)} tags of {tags[0][0]}, {shared[0]} the first: their ids "
                "have to differ (first_tag_id), or their dictionaries"
            )


def _tags(board: Board) -> tuple[str, set[int]] | None:
    """Dictionary and ids; None of a board without tags."""
    found = getattr(board, "tag_ids", None)
    return None if found is None else (str(getattr(board, "dictionary", "")), set(found.tolist()))


def write_boards(recordings: Mapping[str, Recording], folder: Path | str) -> Path:
    """Write the recordings of several boards, which share cameras and platform, as one that ``load_boards`` reads:
    corners and trajectories with every digit, or of a camera without corners its images, which stay where they are. The
    manifest, whose path is returned, comes last.

    Raises GtcalError where the folder can't be written."""
    folder = Path(folder)
    detections: dict[str, dict[str, str]] = {}
    boards: dict[str, BoardEntry] = {}
    for name, recording in recordings.items():
        for camera, found in recording.detections.items():
            file = f"{camera}_{name}_detections.csv"
            write_detections(folder / file, found)
            detections.setdefault(camera, {})[name] = file
        given = {} if recording.board_body is None else {f"{name}_body": recording.board_body}
        entries = body_entries(folder, given) if given else {}
        boards[name] = BoardEntry(board=recording.board.to_manifest(), body=entries.get(f"{name}_body"))
    shared = next(iter(recordings.values()))
    platform = None if shared.platform is None else body_entries(folder, {"platform": shared.platform})["platform"]
    cameras = {
        name: camera_entry(camera, recording.images.get(name), folder, None).model_dump(exclude_none=True)
        for recording in recordings.values()
        for name, camera in recording.cameras.items()
    }
    of_cameras = {
        name: SharedCameraEntry(**fields, detections=detections.get(name)) for name, fields in cameras.items()
    }
    manifest = BoardsManifest(
        gtcal_recording=1,
        boards=boards,
        cameras=of_cameras,
        platform=platform,
    )
    path = folder / MANIFEST_NAMES[0]
    data = manifest.model_dump(exclude_none=True, exclude_defaults=True)
    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120))
    return path
