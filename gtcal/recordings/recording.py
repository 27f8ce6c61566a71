"""A recording: cameras, board, detections or images, and the trajectories of the tracked bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from factors import CAMERA_MODELS, CameraModel
from gtcal.board import Board, board_from_manifest
from gtcal.board_tolerance import BoardTolerance, tolerance_of
from gtcal.camera import Camera, FloatArray, RollingShutter
from gtcal.camera_files.formats import read_rig
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera, agreeing
from gtcal.camera_files.ros import plain_name
from gtcal.errors import GtcalError
from gtcal.files import InputFile, check_regular, fingerprint
from gtcal.readers import TRAJECTORY_READERS, pose_list
from gtcal.readers.mocap_exports import EXPORT_WRITERS, MocapFormat
from gtcal.readers.pose_list import read_pose_list, write_pose_list
from gtcal.recordings.bag_images import bag_images
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.recordings.detection_files import DetectionFormat, read_detections, write_detections
from gtcal.recordings.detections import CameraDetections, Cornered, IntArray
from gtcal.recordings.images import Images, first_whole, image_folder, image_list, numbered_folder, shifted
from gtcal.recordings.layouts import lens_files
from gtcal.recordings.manifest import (
    MANIFEST_NAMES,
    CameraEntry,
    IntrinsicsEntry,
    Manifest,
    ShutterEntry,
    TrajectoryEntry,
    did_you_mean,
    find_manifest,
    read_manifest,
    write_manifest,
)
from gtcal.recordings.numbering import numbers_of, stamps_of
from gtcal.recordings.trajectory import Trajectory
from gtcal.recordings.video_images import video_images
from gtcal.recordings.vrs_images import vrs_images

# A principal point this far from the middle in both axes alike is that of an image of another size, not of a lens
# that sits off its sensor's middle.
_SCALE_LIMITS = (0.6, 1.6)
_SAME_SCALE = 0.15
# A capture in which nothing moves by 2 cm calibrates nothing; metres read as millimetres look like that.
_SMALLEST_MOTION_OF_MM_M = 0.02
_MOST_UNEQUAL_FOCAL_LENGTHS = 2.0


@dataclass(frozen=True)
class Recording:
    """All that a calibration is computed from.

    path: the manifest, None for a recording that is not on disk.
    cameras: by name.
    detections: by camera; cameras that only have images yet are missing.
    images: by camera; cameras that only have detections are missing.
    platform, board_body: the trajectories that ``capture`` needs, the other None.
    max_gap_s: the longest gap in a trajectory to interpolate across; None for each trajectory's own default.
    inputs: the files that it was read from, images excepted.
    board_tolerance: how near the board is to what is stated of it.
    numbered: whether images, corners and poses go together by number, in place of time.
    Raises GtcalError where a camera has neither images nor detections, detections or images belong to no camera,
    or the trajectories are not those of the capture.
    """

    path: Path | None
    capture: Capture
    cameras: dict[str, Camera]
    board: Board
    detections: dict[str, CameraDetections]
    images: dict[str, Images] = field(default_factory=dict)
    platform: Trajectory | None = None
    board_body: Trajectory | None = None
    max_gap_s: float | None = None
    inputs: tuple[InputFile, ...] = ()
    board_tolerance: BoardTolerance = field(default_factory=BoardTolerance)
    numbered: bool = False

    def __post_init__(self) -> None:
        for what, owners in (("detections", self.detections), ("images", self.images)):
            for name in owners:
                if name not in self.cameras:
                    raise GtcalError(
                        f"camera {name!r} has {what} but is not in the recording; cameras: {', '.join(self.cameras)}"
                    )
        for name in self.cameras:
            if name not in self.detections and name not in self.images:
                raise GtcalError(f"camera {name!r} has neither images nor detections")
        _ = self.motion  # checks the bodies against the capture

    @cached_property
    def motion(self) -> RefMotion:
        """ref_T_body over time."""
        return RefMotion(self.capture, self.platform, self.board_body, self.max_gap_s, self.numbered)

    @property
    def n_images(self) -> int:
        """Of all cameras; of one without images its views."""
        return sum(
            len(self.images[name]) if name in self.images else self.detections[name].n_views for name in self.cameras
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to read it, one sentence each, for the user to see."""
        return notes_of(self.images, self.motion.trajectories)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that it is read from, the images too."""
        return files_of(self.inputs, self.images)


def load_recording(path: Path | str) -> Recording:
    """Read the recording in the folder (or with the manifest file) ``path``. Images are listed, not searched for
    the board.

    Raises GtcalError, in one line that names the file and the field or row, for anything that is wrong with it."""
    manifest_path = find_manifest(Path(path))
    return recording_of(manifest_path, read_manifest(manifest_path))


def recording_of(manifest_path: Path, manifest: Manifest) -> Recording:
    """What a manifest at this path describes. Raises GtcalError as ``load_recording``."""
    loader = Loader(manifest_path, manifest.layout, numbered=manifest.numbered)
    board = loader.board(manifest.board)
    cameras = {name: loader.camera(name, entry) for name, entry in manifest.cameras.items()}
    detections = {
        name: loader.detections(name, entry.detections, board, cameras[name])
        for name, entry in manifest.cameras.items()
        if entry.detections is not None
    }
    images = {
        name: loader.images(name, entry, cameras[name]) for name, entry in manifest.cameras.items() if entry.has_images
    }
    stamps_ns = _all_stamps_ns({**detections, **images})
    trajectories = {name: loader.trajectory(name, entry, stamps_ns) for name, entry in manifest.bodies.items()}
    loader.check_millimetres(manifest.bodies, trajectories)
    return Recording(
        path=manifest_path,
        capture=Capture(manifest.capture),
        cameras=cameras,
        board=board,
        detections=detections,
        images=images,
        platform=trajectories.get("platform"),
        board_body=trajectories.get("board_body"),
        max_gap_s=None if manifest.max_gap_ms is None else manifest.max_gap_ms / 1000,
        inputs=tuple(fingerprint(file) for file in loader.used),
        board_tolerance=loader.board_tolerance(manifest.board),
        numbered=manifest.numbered,
    )


def _all_stamps_ns(seen: Mapping[str, CameraDetections | Images]) -> IntArray:
    """Of the images of all cameras, or where they have none of their views, increasing."""
    return np.unique(np.concatenate([of_camera.stamps_ns for of_camera in seen.values()]))


def write_recording(
    recording: Recording,
    folder: Path | str,
    *,
    mocap_format: MocapFormat = "euroc_csv",
    detection_format: DetectionFormat = "csv",
) -> Path:
    """Write a recording so that ``load_recording`` gives the same back: detections and trajectories with every
    digit beside the manifest, whose path is returned. Images stay where they are and are pointed to. The manifest
    comes last: before it is there, the folder is no recording.

    Raises GtcalError where the folder can't be written, or the format can't hold the trajectories."""
    folder = Path(folder)
    for name, detections in recording.detections.items():
        write_detections(folder / detections_name(name, detection_format), detections, numbered=recording.numbered)
    bodies = (
        numbered_entries(folder, recording.motion.trajectories)
        if recording.numbered
        else body_entries(folder, recording.motion.trajectories, mocap_format)
    )
    manifest = Manifest(
        gtcal_recording=1,
        capture=recording.capture.value,
        board=recording.board.to_manifest(),
        numbered=recording.numbered,
        cameras={
            name: camera_entry(
                camera,
                recording.images.get(name),
                folder,
                detections_name(name, detection_format) if name in recording.detections else None,
            )
            for name, camera in recording.cameras.items()
        },
        platform=bodies.get("platform"),
        board_body=bodies.get("board_body"),
        max_gap_ms=None if recording.max_gap_s is None else recording.max_gap_s * 1000,
    )
    write_manifest(folder / MANIFEST_NAMES[0], manifest)
    return folder / MANIFEST_NAMES[0]


def body_entries(
    folder: Path, bodies: Mapping[str, Trajectory], mocap_format: MocapFormat = "euroc_csv"
) -> dict[str, TrajectoryEntry]:
    """Write tracked bodies into the folder; the entries of a manifest there, by body.

    Raises GtcalError where they can't be written, or the format can't hold them."""
    return {
        name: TrajectoryEntry(
            trajectory=written.file,
            format=mocap_format,
            name=written.selection.name,
            rotation=written.selection.rotation,
            stamp_offset_ns=written.selection.stamp_offset_ns,
        )
        for name, written in EXPORT_WRITERS[mocap_format](folder, bodies).items()
    }


def numbered_entries(folder: Path, bodies: Mapping[str, Trajectory]) -> dict[str, TrajectoryEntry]:
    """Write the poses of bodies by number into the folder; the entries of a manifest there, by body."""
    for name, trajectory in bodies.items():
        write_pose_list(folder / f"{name}.csv", numbers_of(trajectory.stamps_ns), trajectory.world_T_body)
    return {name: TrajectoryEntry(trajectory=f"{name}.csv", format=pose_list.FORMAT) for name in bodies}


class Loader:
    """Reads what a manifest points to, and remembers which files those were. numbered: whether by number."""

    def __init__(self, manifest_path: Path, layout: str | None = None, *, numbered: bool = False) -> None:
        self.manifest_path, self.numbered = manifest_path, numbered
        self.used = [manifest_path, *(lens_files(manifest_path.parent) if layout is not None else ())]

    def board(self, block: dict[str, object]) -> Board:
        try:
            return board_from_manifest(block)
        except GtcalError as error:
            raise self.error("board", str(error)) from None

    def board_tolerance(self, block: dict[str, object]) -> BoardTolerance:
        """How near to the stated board the printed one is known to be."""
        try:
            return tolerance_of(block)[1]
        except GtcalError as error:
            raise self.error("board", str(error)) from None

    def camera(self, name: str, entry: CameraEntry) -> Camera:
        if entry.intrinsics is not None:
            return self._camera_from_file(name, entry, entry.intrinsics)
        assert entry.model is not None  # the manifest's own check, as of the size
        assert entry.image_size_px is not None
        width, height = entry.image_size_px
        model = CAMERA_MODELS[entry.model]
        shutter = _shutter(entry.rolling_shutter)
        if entry.parameters is None:
            return Camera(name, model, None, width, height, shutter)
        where = f"cameras.{name}.parameters"
        self._check_parameter_names(where, entry.model, entry.parameters)
        self._check_parameters(where, entry.parameters, width, height)
        theta = np.array([entry.parameters[parameter] for parameter in model.parameter_names])
        return Camera(name, model, theta, width, height, shutter, self._sigmas(name, entry, model))

    def _sigmas(self, name: str, entry: CameraEntry, model: CameraModel) -> FloatArray | None:
        """(K,) of the manifest's parameter_sigmas, NaN where it states none."""
        if entry.parameter_sigmas is None:
            return None
        self._check_known_parameters(f"cameras.{name}.parameter_sigmas", model.name, entry.parameter_sigmas)
        return np.array([entry.parameter_sigmas.get(parameter, np.nan) for parameter in model.parameter_names])

    def _camera_from_file(self, name: str, entry: CameraEntry, intrinsics: IntrinsicsEntry) -> Camera:
        where = f"cameras.{name}.intrinsics"
        path = self._existing(f"{where}.file", intrinsics.file)
        size = None if entry.image_size_px is None else (entry.image_size_px[0], entry.image_size_px[1])
        options = ReadOptions(model=entry.model, image_size_px=size)
        try:
            rig = read_rig(path, intrinsics.format, options).rig
            camera = agreeing(path, self._chosen(name, rig, intrinsics), options).camera
        except GtcalError as error:
            raise self.error(where, str(error)) from None
        self._use(path)
        parameters = dict(zip(camera.model.parameter_names, camera.theta.tolist(), strict=True))
        self._check_parameters(where, parameters, camera.image_width_px, camera.image_height_px)
        shutter = _shutter(entry.rolling_shutter) or camera.rolling_shutter
        stated = self._sigmas(name, entry, camera.model)
        sigmas = camera.theta_sigmas if stated is None else stated
        return replace(camera, name=name, rolling_shutter=shutter, theta_sigmas=sigmas)

    def _chosen(self, name: str, rig: Rig, intrinsics: IntrinsicsEntry) -> RigCamera:
        """The camera that the manifest names, else that of its own name, else the only one."""
        named = {camera.name: camera for camera in rig.cameras}
        listed = ", ".join(named)
        asked = None if intrinsics.camera is None else plain_name(intrinsics.camera)
        if asked is not None and asked not in named:
            raise GtcalError(f"there is no camera {intrinsics.camera!r} in {intrinsics.file}; cameras: {listed}")
        if intrinsics.camera is None and name not in named and len(named) > 1:
            raise GtcalError(f"{intrinsics.file} holds several cameras; name one with 'camera': {listed}")
        return named.get(asked or name) or next(iter(named.values()))

    def _use(self, path: Path) -> None:
        """Remember a file, once."""
        if path not in self.used:
            self.used.append(path)

    def detections(self, name: str, given: str, board: Cornered, camera: Camera) -> CameraDetections:
        path = self._existing(f"cameras.{name}.detections", given)
        self.used.append(path)
        return read_detections(path, board, camera, numbered=self.numbered)

    def images(self, name: str, entry: CameraEntry, camera: Camera) -> Images:
        images = self._images(f"cameras.{name}", entry).expecting(camera.image_width_px, camera.image_height_px)
        first_whole(images)
        return images

    def _images(self, where: str, entry: CameraEntry) -> Images:
        offset_ns = entry.stamp_offset_ns or 0
        if entry.video is not None:
            return video_images(self._existing(f"{where}.video", entry.video), offset_ns, entry.stream)
        if entry.bag is not None:
            return bag_images(self._existing(f"{where}.bag", entry.bag), entry.topic, offset_ns)
        if entry.vrs is not None:
            return vrs_images(self._existing(f"{where}.vrs", entry.vrs), entry.stream, offset_ns)
        folder = self._existing(f"{where}.images", entry.images) if entry.images is not None else None
        if entry.image_list is not None:
            listing = self._existing(f"{where}.image_list", entry.image_list)
            self.used.append(listing)
            return shifted(image_list(listing, folder), offset_ns)
        assert folder is not None  # the manifest's own check
        if self.numbered:
            return numbered_folder(folder)
        return shifted(image_folder(folder), offset_ns)

    def trajectory(self, name: str, entry: TrajectoryEntry, image_stamps_ns: IntArray | None = None) -> Trajectory:
        """Of a tracked body. image_stamps_ns: of all images, increasing, what poses by number are for; else a list
        without numbers counts from 1."""
        path = self._existing(f"{name}.trajectory", entry.trajectory)
        self.used.append(path)
        if self.numbered:
            listed = read_pose_list(path, name, entry.conventions, entry.selection, entry.angle_unit)
            given = None if image_stamps_ns is None else numbers_of(image_stamps_ns)
            numbers, world_T_body = listed.for_images(name, listed.counted if given is None else given)
            return Trajectory(name, stamps_of(numbers), world_T_body)
        return TRAJECTORY_READERS[entry.format](path, name, entry.conventions, entry.selection)

    def check_millimetres(self, bodies: dict[str, TrajectoryEntry], trajectories: dict[str, Trajectory]) -> None:
        """Metres declared as millimetres leave every body within millimetres of where it started."""
        motions_m = {
            name: float(np.ptp(trajectory.world_T_body[:, :3, 3], axis=0).max())
            for name, trajectory in trajectories.items()
        }
        largest_m = max(motions_m.values())
        declared = [name for name, entry in bodies.items() if entry.length_unit == "mm"]
        if declared and largest_m < _SMALLEST_MOTION_OF_MM_M:
            raise self.error(
                f"{declared[0]}.length_unit",
                f"as mm, no body moves by more than {1000 * largest_m:.3g} mm in the whole recording; "
                "are the positions metres? then set m",
            )

    def _existing(self, where: str, given: str) -> Path:
        path = self.manifest_path.parent / given
        try:
            check_regular(path)
        except GtcalError as error:
            raise self.error(where, str(error)) from None
        if not path.exists():
            raise self.error(where, f"there is no {path}")
        return path

    def _check_known_parameters(self, where: str, model: str, parameters: dict[str, float]) -> None:
        names = CAMERA_MODELS[model].parameter_names
        for name in parameters:
            if name not in names:
                raise self.error(
                    f"{where}.{name}",
                    f"is not a parameter of {model}{did_you_mean(name, names)}; parameters: {', '.join(names)}",
                )

    def _check_parameter_names(self, where: str, model: str, parameters: dict[str, float]) -> None:
        self._check_known_parameters(where, model, parameters)
        names = CAMERA_MODELS[model].parameter_names
        for name in names:
            if name not in parameters:
                raise self.error(f"{where}.{name}", f"is missing; {model} has {', '.join(names)}")

    def _check_parameters(self, where: str, parameters: dict[str, float], width: int, height: int) -> None:
        for name in ("fx", "fy"):
            if parameters[name] <= 0:
                raise self.error(f"{where}.{name}", f"is {parameters[name]:g}; a focal length is positive")
        ratio = parameters["fx"] / parameters["fy"]
        if not 1 / _MOST_UNEQUAL_FOCAL_LENGTHS < ratio < _MOST_UNEQUAL_FOCAL_LENGTHS:
            raise self.error(
                f"{where}.fx",
                f"is {parameters['fx']:g}, but fy is {parameters['fy']:g}; pixels are nearly square: check both",
            )
        if hint := _other_image_size(parameters["cx"], parameters["cy"], width, height):
            raise self.error(
                where,
                f"the principal point ({parameters['cx']:g}, {parameters['cy']:g}) px {hint}, not the {width} x "
                f"{height} of image_size_px; the parameters look like another image size",
            )

    def error(self, where: str, message: str) -> GtcalError:
        """An error about a field of the manifest."""
        return GtcalError(f"{self.manifest_path}: {where}: {message}")


def files_of(inputs: Iterable[InputFile], images: dict[str, Images]) -> tuple[Path, ...]:
    """The files that were read, and those of the images."""
    return (*(entry.path for entry in inputs), *(file for sequence in images.values() for file in sequence.files))


def notes_of(images: dict[str, Images], trajectories: dict[str, Trajectory]) -> tuple[str, ...]:
    """What the readers of images and trajectories have to say; the same only once."""
    notes = [note for sequence in images.values() for note in sequence.notes]
    notes += [note for trajectory in trajectories.values() for note in trajectory.notes]
    return tuple(dict.fromkeys(notes))


def _other_image_size(cx: float, cy: float, width: int, height: int) -> str:
    """Why the principal point can't be that of an image of this size, or nothing. Pixel centres are integers, so
    that the image's middle is at (width - 1) / 2."""
    across, down = (cx + 0.5) / (width / 2), (cy + 0.5) / (height / 2)
    if not (0 <= across <= 2 and 0 <= down <= 2):
        return f"lies in an image of about {round(2 * cx)} x {round(2 * cy)}"
    low, high = _SCALE_LIMITS
    alike = abs(across / down - 1) < _SAME_SCALE if down > 0 else False
    if alike and (max(across, down) < low or min(across, down) > high):
        return f"is the middle of an image of about {round(2 * cx)} x {round(2 * cy)}"
    return ""


def camera_entry(camera: Camera, images: Images | None, folder: Path, detections: str | None) -> CameraEntry:
    """The manifest's entry of a camera, for a manifest in ``folder``, its file of ``detections`` beside it; a list of
    its images is written where their names need one."""
    theta = None if camera.parameters is None else camera.parameters.tolist()
    return CameraEntry(
        model=camera.model.name,
        image_size_px=[camera.image_width_px, camera.image_height_px],
        parameters=None if theta is None else dict(zip(camera.model.parameter_names, theta, strict=True)),
        parameter_sigmas=_sigmas_entry(camera),
        detections=detections,
        rolling_shutter=_shutter_entry(camera.rolling_shutter),
        **({} if images is None else images.entry(camera.name, folder)),
    )


def _sigmas_entry(camera: Camera) -> dict[str, float] | None:
    """The parameters' sigmas, as far as they are known."""
    if camera.theta_sigmas is None:
        return None
    named = zip(camera.model.parameter_names, camera.theta_sigmas.tolist(), strict=True)
    return {parameter: sigma for parameter, sigma in named if np.isfinite(sigma)} or None


def _shutter(entry: ShutterEntry | None) -> RollingShutter | None:
    if entry is None:
        return None
    return RollingShutter(None if entry.readout_ms is None else 1e-3 * entry.readout_ms, entry.stamped_row)


def _shutter_entry(shutter: RollingShutter | None) -> ShutterEntry | None:
    if shutter is None:
        return None
    readout_ms = None if shutter.readout_s is None else 1e3 * shutter.readout_s
    return ShutterEntry(readout_ms=readout_ms, stamped_row=shutter.stamped_row)


def detections_name(camera: str, detection_format: DetectionFormat = "csv") -> str:
    """The file of a camera's detections beside the manifest."""
    return f"{camera}_detections.{detection_format}"
