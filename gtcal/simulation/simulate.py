"""From options and a seed to a recording and its ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import IntArray
from gtcal.recordings.recording import Recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation.corners import MeasuredCorners, PosesAfter, measured_corners
from gtcal.simulation.fault import RigFault
from gtcal.simulation.noise import MocapSamples, measured_body, random_swaps
from gtcal.simulation.options import IntrinsicsError, SimulationOptions
from gtcal.simulation.scene import Scene, random_scene
from gtcal.simulation.truth import CameraTruth, GroundTruth

START_NS = 1_700_000_000_000_000_000
_MOCAP_LEAD_S = 0.5  # the mocap runs before the first frame and after the last one


@dataclass(frozen=True)
class Simulation:
    """A simulated recording at the level of detections, its ground truth, and the world it was taken in.

    frame_times_s: (F,) when the cameras took their frames, in seconds since the start, by the mocap's clock.
    """

    recording: Recording
    truth: GroundTruth
    scene: Scene
    frame_times_s: FloatArray
    options: SimulationOptions
    seed: int

    def stream(self, name: str, *indices: int) -> np.random.Generator:
        """The random numbers of one part of the images."""
        return _stream(self.seed, name, *indices)


def simulate(options: SimulationOptions, *, seed: int) -> Simulation:
    """Simulate a recording with detections in place of images.

    The seed decides everything, bit for bit. The motion, the bodies' frames and the frames' times depend on
    it and on what is filmed, not on the noise; each kind of noise has a random stream of its own.

    Raises GtcalError for a negative seed."""
    return simulate_in(scene_of(options, seed=seed), options, seed=seed)


_TAKES = 10_007  # a prime: no take of one seed is a take of the next


def seed_of_take(seed: int, take: int) -> int:
    """Of the motion and the noise of another recording of the rig of this seed. Raises GtcalError for a negative take
    or seed."""
    if min(seed, take) < 0:
        raise GtcalError(f"seed is {seed} and take {take}; expected whole numbers, 0 or more")
    return _TAKES * seed + take


def simulate_take(options: SimulationOptions, *, seed: int, take: int, fault: RigFault | None = None) -> Simulation:
    """Another recording of the rig and the board that ``simulate`` films with these options and this seed: the same
    bodies, intrinsics and place in the room, but other motion and noise. fault: what happened to the rig before.

    Raises GtcalError for a negative seed or take, or a fault of a camera that is not there."""
    fault = fault or RigFault()
    fault.check(options.rig)
    first, own_seed = scene_of(options, seed=seed), seed_of_take(seed, take)
    of_take = replace(options, rig=fault.of(options.rig))
    own = scene_of(of_take, seed=own_seed)
    scene = replace(
        own,
        rig_T_platform=first.rig_T_platform @ fault.markers,
        boardbody_T_board=first.boardbody_T_board,
        world_T_anchor=own.world_T_anchor if options.capture is Capture.TRACKED_PLATFORM else first.world_T_anchor,
    )
    simulation = simulate_in(scene, of_take, seed=own_seed)
    stated = _stated_cameras(options, _stream(seed, "intrinsics"))
    return replace(simulation, recording=replace(simulation.recording, cameras=stated))


def scene_of(options: SimulationOptions, *, seed: int) -> Scene:
    """The world that ``simulate`` films with these options and this seed.

    Raises GtcalError for a negative seed."""
    if seed < 0:
        raise GtcalError(f"seed is {seed}; expected a whole number, 0 or more")
    return random_scene(
        options.capture,
        options.rig,
        options.board,
        options.motion,
        options.limits,
        options.duration_s,
        _stream(seed, "scene"),
    )


def simulate_in(scene: Scene, options: SimulationOptions, *, seed: int) -> Simulation:
    """As ``simulate``, in a given scene with the options' rig, board and capture."""
    times_s = _frame_times(options)
    bodies = _tracked_bodies(scene, options, times_s, seed)
    corners = [_corners(scene, options, times_s, index, seed) for index in range(len(options.rig.cameras))]
    truths = [
        _camera_truth(scene, options, times_s, index, corners[index], bodies)
        for index in range(len(options.rig.cameras))
    ]
    names = [camera.name for camera in options.rig.cameras]
    recording = Recording(
        path=None,
        capture=options.capture,
        cameras=_stated_cameras(options, _stream(seed, "intrinsics")),
        board=options.board,
        detections={name: measured.detections for name, measured in zip(names, corners, strict=True)},
        images={},
        platform=_trajectory(bodies, "platform"),
        board_body=_trajectory(bodies, "board_body"),
        max_gap_s=None,
        inputs=(),
    )
    truth = GroundTruth(dict(zip(names, truths, strict=True)), scene.body_T_board)
    return Simulation(recording, truth, scene, times_s, options, seed)


_STREAMS = ("scene", "swaps", "platform", "board_body", "intrinsics", "corners", "room", "lens", "sensor")


def _stream(seed: int, name: str, *indices: int) -> np.random.Generator:
    """The random numbers of one part of the simulation."""
    return np.random.default_rng([seed, _STREAMS.index(name), *indices])


def _frame_times(options: SimulationOptions) -> FloatArray:
    """(F,) seconds since the start."""
    taken = options.n_frames_taken
    kept = np.arange(taken) if options.n_frames is None else np.linspace(0, taken - 1, options.n_frames).round()
    return kept / options.camera_rate_hz


def stamps_ns(times_s: FloatArray) -> IntArray:
    """(N,) time stamps of times (N,) in seconds since the start."""
    return START_NS + np.rint(1e9 * times_s).astype(np.int64)


def _tracked_bodies(
    scene: Scene, options: SimulationOptions, frame_times_s: FloatArray, seed: int
) -> dict[str, MocapSamples]:
    """The bodies that the capture tracks, as the mocap measured them."""
    interval_s = 1.0 / options.mocap_rate_hz
    swaps_rng = _stream(seed, "swaps")
    start_s = -_MOCAP_LEAD_S + interval_s * swaps_rng.uniform()
    times_s = np.arange(start_s, options.duration_s + _MOCAP_LEAD_S, interval_s)
    motions = {"platform": scene.world_T_platform, "board_body": scene.world_T_boardbody}
    names = options.capture.bodies
    swaps = random_swaps(frame_times_s, options.swap_share, options.swap_duration_s, interval_s, swaps_rng)
    chosen = swaps_rng.integers(len(names), size=len(swaps.centres_s))
    return {
        name: swaps.only(chosen == index).applied(
            measured_body(motions[name], times_s, options.mocap, _stream(seed, name))
        )
        for index, name in enumerate(names)
    }


def _trajectory(bodies: dict[str, MocapSamples], name: str) -> Trajectory | None:
    if name not in bodies:
        return None
    return Trajectory(name, stamps_ns(bodies[name].times_s), bodies[name].world_T_body)


def _corners(scene: Scene, options: SimulationOptions, times_s: FloatArray, index: int, seed: int) -> MeasuredCorners:
    return measured_corners(
        options.rig.cameras[index],
        camera_T_board_after(scene, index, times_s),
        stamps_ns(times_s + options.clock_offsets_s[index]),
        options.board,
        options.limits,
        options.corners,
        _stream(seed, "corners", index),
    )


def camera_T_board_after(scene: Scene, camera_index: int, times_s: FloatArray) -> PosesAfter:
    """Of views at the times (V,)."""

    def after(delays_s: FloatArray) -> FloatArray:
        at_s = times_s[:, None] + delays_s
        return scene.camera_T_board(camera_index, at_s.ravel()).reshape(*at_s.shape, 4, 4)

    return after


def _camera_truth(
    scene: Scene,
    options: SimulationOptions,
    times_s: FloatArray,
    index: int,
    corners: MeasuredCorners,
    bodies: dict[str, MocapSamples],
) -> CameraTruth:
    stamped_s = times_s + options.clock_offsets_s[index]
    return CameraTruth(
        camera=options.rig.cameras[index],
        camera_T_ref=scene.camera_T_ref(index),
        clock_offset_s=options.clock_offsets_s[index],
        stamps_ns=stamps_ns(stamped_s),
        ref_T_body=scene.ref_T_body(times_s),
        swapped=np.any([samples.swapped_at(stamped_s) for samples in bodies.values()], axis=0),
        wrong_corners=corners.wrong,
    )


def _stated_cameras(options: SimulationOptions, rng: np.random.Generator) -> dict[str, Camera]:
    """The cameras with the intrinsics that the recording states."""
    if options.intrinsics == "none":
        return {camera.name: replace(camera, parameters=None) for camera in options.rig.cameras}
    if options.intrinsics == "true":
        return {camera.name: camera for camera in options.rig.cameras}
    return {
        camera.name: replace(camera, parameters=_perturbed(camera.theta, options.intrinsics_error, rng))
        for camera in options.rig.cameras
    }


def _perturbed(theta: FloatArray, error: IntrinsicsError, rng: np.random.Generator) -> FloatArray:
    """Parameters with an error. fx and fy are wrong by the same share: it is one lens."""
    wrong = theta.copy()
    wrong[:2] *= 1.0 + error.focal_share * rng.standard_normal()
    wrong[2:4] += error.centre_px * rng.standard_normal(2)
    wrong[4:] *= 1.0 + error.distortion_share * rng.standard_normal(len(theta) - 4)
    return wrong
