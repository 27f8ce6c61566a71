"""Simulated recordings of the Lollypop: of a rig that is as it was calibrated, or no longer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.progress import Progress, silent
from gtcal.readers.mocap_exports import MocapFormat
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import CameraDetections
from gtcal.results.calibration import (
    Calibration,
    CameraCalibration,
    PoseEstimate,
    Provenance,
    ResidualStatistics,
)
from gtcal.simulation.corners import CornerNoise, PosesAfter, measured_corners
from gtcal.simulation.fault import RigFault
from gtcal.simulation.filming import film
from gtcal.simulation.motion import still
from gtcal.simulation.noise import MocapNoise
from gtcal.simulation.options import SimulationOptions
from gtcal.simulation.rendering import ImageOptions
from gtcal.simulation.rig import Rig, quest3_like_rig
from gtcal.simulation.scene import LEAD_S, Scene, random_scene
from gtcal.simulation.simulate import Simulation, camera_T_board_after, simulate_in, stamps_ns
from gtcal.simulation.visibility import ViewLimits
from gtcal.simulation.writing import check_empty
from gtcal.verification.lollypop import DEVICE_PRESETS, PAPER_LOLLYPOP, Lollypop
from gtcal.verification.lollypop_recording import LollypopRecording, write_lollypop_recording

_FACE_STREAM = 1000  # the random numbers of the second face's corners and on are those of cameras that do not exist


@dataclass(frozen=True)
class LollypopOptions:
    """A Lollypop recording to simulate. As in ``SimulationOptions``, and:

    rig: as calibrated. fault: what has happened to it since.
    nearest_m, farthest_m: from how far the cameras are shown the device.
    calibrated_in: the scene of the calibration's recording, whose rigid bodies are taken over; None for a scene of
        its own, with the calibration that ``LollypopSimulation.true_calibration`` gives.
    """

    device: Lollypop = field(default_factory=lambda: DEVICE_PRESETS[PAPER_LOLLYPOP])
    rig: Rig = field(default_factory=quest3_like_rig)
    fault: RigFault = field(default_factory=RigFault)
    capture: Capture = Capture.TRACKED_PLATFORM
    calibrated_in: Scene | None = None
    nearest_m: float = 0.35
    farthest_m: float = 0.7
    duration_s: float = 30.0
    camera_rate_hz: float = 30.0
    n_frames: int | None = None
    limits: ViewLimits = field(default_factory=ViewLimits)
    corners: CornerNoise = field(default_factory=CornerNoise)
    mocap_rate_hz: float = 120.0
    mocap: MocapNoise = field(default_factory=lambda: MocapNoise(translation_mm=0.05, rotation_deg=0.005))
    clock_offset_s: float = 0.0
    images: ImageOptions = field(default_factory=ImageOptions)

    def __post_init__(self) -> None:
        if self.capture is Capture.STANDING_BOARD:
            raise GtcalError("capture: the Lollypop is tracked; choose tracked_platform or fixed_cameras")
        self.fault.check(self.rig)


@dataclass(frozen=True)
class LollypopSimulation:
    """A simulated recording of the Lollypop.

    world: the simulation of its first face as a board, in the rig as it really is; its truth is the rig's.
    """

    recording: LollypopRecording
    world: Simulation
    options: LollypopOptions
    seed: int

    def true_calibration(self) -> Calibration:
        """The calibration of the rig before the fault, exact."""
        fault, scene = self.options.fault, self.world.scene
        poses = {
            camera.name: inverse(fault.cameras.get(camera.name, np.eye(4)))
            @ scene.camera_T_ref(index)
            @ inverse(fault.markers)
            for index, camera in enumerate(self.options.rig.cameras)
        }
        return exact_calibration(self.options.capture, self.options.rig.cameras, poses)


def simulate_lollypop(options: LollypopOptions, *, seed: int) -> LollypopSimulation:
    """Simulate a recording with detections in place of images. The seed decides everything; the motion does not depend
    on the noise, and hardly on the fault."""
    device = options.device
    rig = replace(options.fault.of(options.rig), nearest_m=options.nearest_m, farthest_m=options.farthest_m)
    of_first_face = SimulationOptions(
        rig=rig,
        board=device.faces[0].board,
        capture=options.capture,
        duration_s=options.duration_s,
        camera_rate_hz=options.camera_rate_hz,
        n_frames=options.n_frames,
        limits=options.limits,
        corners=options.corners,
        mocap_rate_hz=options.mocap_rate_hz,
        mocap=options.mocap,
        clock_offset_s=options.clock_offset_s,
        images=options.images,
    )
    world = simulate_in(_scene(options, rig, seed), of_first_face, seed=seed)
    seen = world.recording
    if seen.board_body is None:
        raise GtcalError("capture: the Lollypop is tracked; choose tracked_platform or fixed_cameras")
    detections = {
        camera.name: _all_faces(world, options, index, seen.detections[camera.name])
        for index, camera in enumerate(rig.cameras)
    }
    recording = LollypopRecording(
        path=None,
        capture=options.capture,
        cameras={camera.name: camera for camera in options.rig.cameras},
        device=device,
        detections=detections,
        device_body=replace(seen.board_body, body="device_body"),
        platform=seen.platform,
    )
    return LollypopSimulation(recording, world, options, seed)


def growing_fault(options: LollypopOptions, n_recordings: int, *, seed: int) -> tuple[LollypopSimulation, ...]:
    """Recordings of one rig in which the options' fault grows from nothing to all of it, evenly."""
    shares = np.linspace(0.0, 1.0, n_recordings)
    first = simulate_lollypop(replace(options, fault=RigFault()), seed=seed)
    based = replace(options, calibrated_in=first.world.scene)
    later = (
        simulate_lollypop(replace(based, fault=options.fault.scaled(float(share))), seed=seed + index)
        for index, share in enumerate(shares[1:], start=1)
    )
    return (first, *later)


def write_lollypop_simulation(
    simulation: LollypopSimulation,
    folder: Path | str,
    *,
    images: bool,
    mocap_format: MocapFormat = "euroc_csv",
    progress: Progress = silent,
) -> Path:
    """Write a simulated recording into an empty or new folder and return its manifest: with rendered images in place
    of detections where ``images``.

    Raises GtcalError where the folder holds something or can't be written."""
    folder = Path(folder)
    check_empty(folder)
    recording = simulation.recording
    if images:
        sequences = film(simulation.world, folder / "images", progress, others=others_of(recording.device))
        recording = replace(recording, detections={}, images=sequences)
    return write_lollypop_recording(recording, folder, mocap_format=mocap_format)


def others_of(device: Lollypop) -> tuple[tuple[Board, FloatArray], ...]:
    """The boards of all faces but the first, each with its place on that, board_T_other (4, 4)."""
    first, *rest = device.faces
    return tuple((face.board, inverse(first.body_T_board) @ face.body_T_board) for face in rest)


def exact_calibration(
    capture: Capture, cameras: tuple[Camera, ...], camera_T_ref: Mapping[str, FloatArray]
) -> Calibration:
    """A calibration that is the truth, with covariances of zero."""
    none = ResidualStatistics.of(np.zeros(1), 0)
    return Calibration(
        capture=capture,
        cameras={
            camera.name: CameraCalibration(
                camera, PoseEstimate(camera_T_ref[camera.name], np.zeros((6, 6))), None, none
            )
            for camera in cameras
        },
        body_T_board=PoseEstimate(np.eye(4), np.zeros((6, 6))),
        board={},
        sigma_px=0.0,
        covariance_kind="exact",
        covariances={},
        estimates={},
        mocap_noise=None,
        stages=(),
        dropped=(),
        warnings=(),
        provenance=Provenance("", (), {}, {"simulated": True}, (), 0.0),
    )


def _scene(options: LollypopOptions, rig: Rig, seed: int) -> Scene:
    face = options.device.faces[0]
    own = random_scene(
        options.capture,
        rig,
        face.board,
        "free",
        options.limits,
        options.duration_s,
        np.random.default_rng([seed, 0]),
    )
    base = options.calibrated_in or own
    off = np.eye(4)
    off[:3, 3] = options.fault.device_centre_m
    scene = replace(
        own,
        rig_T_platform=base.rig_T_platform @ options.fault.markers,
        boardbody_T_board=off @ face.body_T_board,
    )
    if options.capture is not Capture.FIXED_CAMERAS:
        return scene
    home = inverse(options.fault.markers) @ base.world_T_anchor.at(np.zeros(1))[0]
    return replace(scene, world_T_anchor=still(home, -LEAD_S, options.duration_s + LEAD_S))


def _all_faces(
    world: Simulation, options: LollypopOptions, camera_index: int, of_first: CameraDetections
) -> CameraDetections:
    """The detections of all faces, with the device's corner ids."""
    device = options.device
    if len(device.faces) == 1:
        return of_first
    face_T_first = [inverse(device.faces[0].body_T_board) @ face.body_T_board for face in device.faces]
    parts = [of_first]
    for index, face in enumerate(device.faces[1:], start=1):
        of_first_after = camera_T_board_after(world.scene, camera_index, world.frame_times_s)
        noise = world.stream("corners", _FACE_STREAM * index + camera_index)
        camera = world.options.rig.cameras[camera_index]
        stamps = stamps_ns(world.frame_times_s + options.clock_offset_s)
        parts.append(
            measured_corners(
                camera,
                _moved_by(of_first_after, face_T_first[index]),
                stamps,
                face.board,
                options.limits,
                options.corners,
                noise,
            ).detections
        )
    return _joined(parts, device)


def _moved_by(poses_after: PosesAfter, a_T_b: FloatArray) -> PosesAfter:
    return lambda delays_s: poses_after(delays_s) @ a_T_b


def _joined(parts: list[CameraDetections], device: Lollypop) -> CameraDetections:
    view_stamps = np.concatenate([np.repeat(part.stamps_ns, np.diff(part.view_start)) for part in parts])
    ids = np.concatenate([part.corner_ids + device.face_start[index] for index, part in enumerate(parts)])
    pixels = np.concatenate([part.corners_px for part in parts])
    order = np.lexsort((ids, view_stamps))
    stamps, counts = np.unique(view_stamps, return_counts=True)
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return CameraDetections(stamps, start, ids[order], pixels[order])
