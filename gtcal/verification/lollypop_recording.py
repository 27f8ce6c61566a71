"""A recording of the Lollypop: like that of a board, with ``device:`` and ``device_body:`` in the manifest."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema

from gtcal.camera import Camera
from gtcal.detection.detect import cached_detect
from gtcal.documents import load_plain_yaml, read_text
from gtcal.errors import GtcalError
from gtcal.files import InputFile, fingerprint
from gtcal.progress import Progress, silent
from gtcal.readers.mocap_exports import MocapFormat
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.recordings.detection_files import write_detections
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import Images
from gtcal.recordings.manifest import (
    LAYOUT_DESCRIPTION,
    MANIFEST_NAMES,
    CameraEntry,
    CameraName,
    CaptureName,
    Entry,
    LayoutName,
    TrajectoryEntry,
    check_sources,
    find_manifest,
    load_fields,
    unless_layout,
    validated,
    write_manifest,
)
from gtcal.recordings.recording import Loader, body_entries, camera_entry, detections_name, files_of, notes_of
from gtcal.recordings.trajectory import Trajectory
from gtcal.verification.lollypop import Lollypop, device_from_manifest, device_manifest_schema

_FITTING_CAPTURES = (Capture.FIXED_CAMERAS, Capture.TRACKED_PLATFORM)


class LollypopManifest(Entry):
    """A recording of a Lollypop that cameras see and a mocap system tracks."""

    gtcal_recording: Literal[1] = Field(description="Version of this format: 1.")
    capture: CaptureName = Field(
        description="fixed_cameras: fixed cameras. tracked_platform: cameras on a tracked platform (headset, rig). "
        "The Lollypop itself is tracked in both."
    )
    device: Annotated[dict[str, Any] | str, WithJsonSchema(device_manifest_schema())] = Field(
        description="The Lollypop: a preset, or its tag and markers, or the name of a file that says this."
    )
    layout: LayoutName | None = Field(default=None, description=LAYOUT_DESCRIPTION)
    cameras: dict[CameraName, CameraEntry] = Field(min_length=1, description="The cameras by name.")
    platform: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the cameras.")
    device_body: TrajectoryEntry = Field(description="The tracked body of the Lollypop.")
    max_gap_ms: float | None = Field(
        default=None,
        gt=0,
        le=1e9,
        description="Longest gap in a trajectory to interpolate across; by default as for boards.",
    )

    @property
    def bodies(self) -> dict[str, TrajectoryEntry]:
        """The tracked bodies that are given, by name."""
        return {"device_body": self.device_body} | ({} if self.platform is None else {"platform": self.platform})


def lollypop_manifest_schema() -> dict[str, Any]:
    """The JSON schema of a Lollypop recording's manifest."""
    schema = unless_layout(LollypopManifest.model_json_schema(), "cameras", "device_body")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


@dataclass(frozen=True)
class LollypopRecording:
    """All that a verification is computed from, but the calibration.

    path: the manifest, None for a recording that is not on disk.
    cameras: by name; only their image sizes matter, the lenses are the calibration's.
    detections: by camera, corner ids of ``device``; cameras that only have images yet are missing.
    platform: where the capture is tracked_platform, else None.
    max_gap_s: the longest gap in a trajectory to interpolate across; None for each trajectory's own default.
    inputs: the files that it was read from, images excepted.
    Raises GtcalError where a camera has neither images nor detections, detections or images belong to no camera, or
    the trajectories are not those of the capture.
    """

    path: Path | None
    capture: Capture
    cameras: dict[str, Camera]
    device: Lollypop
    detections: dict[str, CameraDetections]
    device_body: Trajectory
    images: dict[str, Images] = field(default_factory=dict)
    platform: Trajectory | None = None
    max_gap_s: float | None = None
    inputs: tuple[InputFile, ...] = ()

    def __post_init__(self) -> None:
        _check_bodies(self.capture, self.platform is not None)
        for name in (*self.detections, *self.images):
            if name not in self.cameras:
                raise GtcalError(
                    f"camera {name!r} has detections or images but is not in the recording; cameras: "
                    f"{', '.join(self.cameras)}"
                )
        for name in self.cameras:
            if name not in self.detections and name not in self.images:
                raise GtcalError(f"camera {name!r} has neither images nor detections")

    @cached_property
    def motion(self) -> RefMotion:
        """ref_T_body over time; body is the device's."""
        return RefMotion(self.capture, self.platform, self.device_body, self.max_gap_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to read it, one sentence each, for the user to see."""
        trajectories = {"device_body": self.device_body} | (
            {} if self.platform is None else {"platform": self.platform}
        )
        return notes_of(self.images, trajectories)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that it is read from, the images too."""
        return files_of(self.inputs, self.images)


def load_lollypop_recording(path: Path | str) -> LollypopRecording:
    """Read the recording in the folder (or with the manifest file) ``path``. Images are listed, not searched.

    Raises GtcalError, in one line that names the file and the field or row, for anything that is wrong with it."""
    manifest_path = find_manifest(Path(path))
    manifest = _read_manifest(manifest_path)
    loader = Loader(manifest_path, manifest.layout)
    device = _device(loader, manifest.device)
    cameras = {name: loader.camera(name, entry) for name, entry in manifest.cameras.items()}
    trajectories = {name: loader.trajectory(name, entry) for name, entry in manifest.bodies.items()}
    loader.check_millimetres(manifest.bodies, trajectories)
    return LollypopRecording(
        path=manifest_path,
        capture=Capture(manifest.capture),
        cameras=cameras,
        device=device,
        detections={
            name: loader.detections(name, entry.detections, device, cameras[name])
            for name, entry in manifest.cameras.items()
            if entry.detections is not None
        },
        images={
            name: loader.images(name, entry, cameras[name])
            for name, entry in manifest.cameras.items()
            if entry.has_images
        },
        platform=trajectories.get("platform"),
        device_body=trajectories["device_body"],
        max_gap_s=None if manifest.max_gap_ms is None else manifest.max_gap_ms / 1000,
        inputs=tuple(fingerprint(file) for file in loader.used),
    )


def write_lollypop_recording(
    recording: LollypopRecording, folder: Path | str, *, mocap_format: MocapFormat = "euroc_csv"
) -> Path:
    """Write a recording so that ``load_lollypop_recording`` gives the same back, as ``write_recording`` does for one
    of a board. Returns the manifest's path.

    Raises GtcalError where the folder can't be written."""
    folder = Path(folder)
    for name, detections in recording.detections.items():
        write_detections(folder / detections_name(name), detections)
    given = {"device_body": recording.device_body, "platform": recording.platform}
    trajectories = {name: trajectory for name, trajectory in given.items() if trajectory is not None}
    bodies = body_entries(folder, trajectories, mocap_format)
    manifest = LollypopManifest(
        gtcal_recording=1,
        capture=recording.capture.value,
        device=recording.device.to_manifest(),
        cameras={
            name: camera_entry(
                camera,
                recording.images.get(name),
                folder,
                detections_name(name) if name in recording.detections else None,
            )
            for name, camera in recording.cameras.items()
        },
        platform=bodies.get("platform"),
        device_body=bodies["device_body"],
        max_gap_ms=None if recording.max_gap_s is None else recording.max_gap_s * 1000,
    )
    write_manifest(folder / MANIFEST_NAMES[0], manifest)
    return folder / MANIFEST_NAMES[0]


def detected_lollypop(
    recording: LollypopRecording, *, cameras: dict[str, Camera] | None = None, progress: Progress = silent
) -> LollypopRecording:
    """The recording with detections for every camera: as the recording gives them, else from the images, kept beside
    the recording for the next time. ``cameras``: with the lenses to detect with, in place of the recording's."""
    missing = [name for name in recording.images if name not in recording.detections]
    if not missing:
        return recording
    if recording.path is None:
        raise GtcalError("a recording that is not on disk needs its detections given")
    lenses = recording.cameras | (cameras or {})
    found = {
        name: cached_detect(
            recording.path.parent, name, recording.images[name], recording.device, lenses[name], progress=progress
        )
        for name in missing
    }
    paths = sorted({path for name in missing for path in recording.images[name].inputs})
    used = tuple(fingerprint(path) for path in paths)
    return replace(recording, detections=recording.detections | found, inputs=recording.inputs + used)


def _read_manifest(path: Path) -> LollypopManifest:
    data = load_fields(path)
    if "device" not in data:
        what = "this is a recording of a board, to calibrate from" if "board" in data else "the field is missing"
        raise GtcalError(
            f"{path}: device: {what}; a verification needs a recording of the Lollypop, with 'device' (as "
            "'preset: paper_lollypop') and 'device_body' in its manifest"
        )
    manifest = validated(path, data, LollypopManifest)
    try:
        _check_bodies(Capture(manifest.capture), manifest.platform is not None)
        check_sources(manifest.cameras)
    except GtcalError as error:
        raise GtcalError(f"{path}: {error}") from None
    return manifest


def _check_bodies(capture: Capture, has_platform: bool) -> None:
    if capture not in _FITTING_CAPTURES:
        raise GtcalError(
            f"capture: {capture.value} is for a board that stands untracked; the Lollypop is tracked: set "
            "tracked_platform"
        )
    if capture is Capture.TRACKED_PLATFORM and not has_platform:
        raise GtcalError("platform: is missing; capture tracked_platform needs platform and device_body")
    if capture is Capture.FIXED_CAMERAS and has_platform:
        raise GtcalError(
            "platform: capture fixed_cameras has no use for it; leave it out, or set capture: tracked_platform"
        )


def _device(loader: Loader, given: dict[str, Any] | str) -> Lollypop:
    try:
        return device_from_manifest(given) if isinstance(given, dict) else read_device(_beside(loader, given))
    except GtcalError as error:
        raise loader.error("device", str(error)) from None


def _beside(loader: Loader, name: str) -> Path:
    path = loader.manifest_path.parent / name
    loader.used.append(path)
    return path


def read_device(path: Path) -> Lollypop:
    """The device that a file describes, YAML or JSON: a device block by itself, or within a manifest.

    Raises GtcalError where the file can't be read or describes none."""
    text = read_text(path)
    try:
        block = json.loads(text) if path.suffix.lower() == ".json" else load_plain_yaml(path, text)
    except (ValueError, RecursionError) as error:
        raise GtcalError(f"{path}: is not valid YAML or JSON: {' '.join(str(error).split())}") from error
    inner = block["device"] if isinstance(block, dict) and "device" in block else block
    try:
        return device_from_manifest(inner)
    except GtcalError as error:
        raise GtcalError(f"{path}: {error}") from None
