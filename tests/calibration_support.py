"""Simulated recordings to calibrate, and how far a calibration of one is from its truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.board import AprilGrid, CharucoBoard
from gtcal.estimation.alignment import GuideViews
from gtcal.estimation.observations import Observations, Views, synchronise
from gtcal.estimation.pnp import solve_pnp
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration, pose_difference
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, fixed_cameras_rig, quest3_like_rig, simulate

HEADSET = "headset, board tracked"
KINDS = {
    HEADSET: {"rig": quest3_like_rig(), "capture": Capture.TRACKED_PLATFORM},
    "headset, AprilGrid stands": {
        "rig": quest3_like_rig(),
        "capture": Capture.STANDING_BOARD,
        "board": AprilGrid(6, 6, 0.06, 0.3),
    },
    "pinholes and fisheyes fixed": {"rig": fixed_cameras_rig(), "capture": Capture.FIXED_CAMERAS},
    "rich fisheyes fixed, ChArUco": {
        "rig": fixed_cameras_rig(2, models=("fisheye62", "fisheye624")),
        "capture": Capture.FIXED_CAMERAS,
        "board": CharucoBoard("DICT_5X5_100", 8, 6, 0.06, 0.045),
    },
    "one carried camera": {
        "rig": fixed_cameras_rig(1, models=("kannala_brandt4",)),
        "capture": Capture.TRACKED_PLATFORM,
    },
}
"""One recording of each capture kind, with other rigs, lenses and boards among them."""


@cache
def simulated(kind: str = HEADSET, *, seed: int = 0, frames: int = 60, **changes: object) -> Simulation:
    """A recording with detections; ``changes`` are fields of SimulationOptions."""
    options = {"n_frames": frames, "duration_s": frames / 1.5, **KINDS[kind], **changes}
    return simulate(SimulationOptions(**options), seed=seed)


NO_MOCAP_NOISE = MocapNoise(translation_mm=0.0, rotation_deg=0.0)


def with_exact_mocap(simulation: Simulation) -> Observations:
    """The views with the true ref_T_body: no noise, and no error of interpolation either."""
    observations = synchronise(simulation.recording)
    views = {
        name: replace(of_camera, ref_T_body=true_ref_T_body(simulation, of_camera))
        for name, of_camera in observations.views.items()
    }
    return replace(observations, views=views)


def true_ref_T_body(simulation: Simulation, views: Views) -> np.ndarray:
    truth = simulation.truth.cameras[views.camera.name]
    return truth.ref_T_body[truth.frames_of(views.stamps_ns)]


def true_camera_T_board(simulation: Simulation, views: Views) -> np.ndarray:
    camera_T_ref = simulation.truth.camera_T_ref[views.camera.name]
    return camera_T_ref @ true_ref_T_body(simulation, views) @ simulation.truth.body_T_board


def guides(observations: Observations, max_views: int = 100) -> dict[str, GuideViews]:
    """What stages 1 and 2 take."""
    return {
        name: GuideViews.of(views, solve_pnp(views, max_views=max_views)) for name, views in observations.views.items()
    }


def pose_errors(found_T: np.ndarray, true_T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance in mm and angle in deg between transforms (..., 4, 4), each (...)."""
    turns = np.swapaxes(found_T[..., :3, :3], -1, -2) @ true_T[..., :3, :3]
    angle_deg = np.rad2deg(Rotation.from_matrix(turns.reshape(-1, 3, 3)).magnitude()).reshape(turns.shape[:-2])
    return 1e3 * np.linalg.norm(found_T[..., :3, 3] - true_T[..., :3, 3], axis=-1), angle_deg


def errors_of(
    camera_T_ref: dict[str, np.ndarray], body_T_board: np.ndarray, simulation: Simulation
) -> dict[str, tuple[float, float]]:
    """How far each camera in ref, and the board in its body ('X'), are from the truth: mm and deg."""
    truth = simulation.truth
    found = {
        name: pose_difference(inverse(pose), inverse(truth.camera_T_ref[name])) for name, pose in camera_T_ref.items()
    }
    return {"X": pose_difference(body_T_board, truth.body_T_board), **found}


def errors(calibration: Calibration, simulation: Simulation) -> dict[str, tuple[float, float]]:
    """``errors_of`` a calibration."""
    camera_T_ref = {name: camera.camera_T_ref.a_T_b for name, camera in calibration.cameras.items()}
    return errors_of(camera_T_ref, calibration.body_T_board.a_T_b, simulation)


def worst(found: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """The largest of the errors in mm, and of those in deg."""
    mm, deg = np.array(list(found)).max(axis=0)
    return float(mm), float(deg)


def near(found: dict[str, tuple[float, float]], mm: float, deg: float) -> bool:
    """Whether all errors are within these limits."""
    worst_mm, worst_deg = worst(found.values())
    return worst_mm < mm and worst_deg < deg
