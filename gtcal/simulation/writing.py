"""A simulated recording on disk, with its ground truth beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gtcal.errors import GtcalError
from gtcal.progress import Progress, silent
from gtcal.readers.mocap_exports import MocapFormat
from gtcal.recordings.recording import write_recording
from gtcal.simulation.filming import film
from gtcal.simulation.ground_truth import write_ground_truth
from gtcal.simulation.simulate import Simulation
from gtcal.simulation.truth import GroundTruth


def write_simulation(
    simulation: Simulation,
    folder: Path | str,
    *,
    images: bool,
    mocap_format: MocapFormat = "euroc_csv",
    progress: Progress = silent,
) -> Path:
    """Write a simulated recording into an empty or new folder and return its manifest: with rendered images in
    place of detections where ``images``, else with the simulated detections. ``ground_truth.json`` is beside it.

    Raises GtcalError where the folder holds something or can't be written."""
    folder = Path(folder)
    check_empty(folder)
    recording, truth = simulation.recording, simulation.truth
    if images:
        sequences = film(simulation, folder / "images", progress)
        recording = replace(recording, detections={}, images=sequences)
        truth = _without_detections(truth)
    write_ground_truth(truth, folder)
    return write_recording(recording, folder, mocap_format=mocap_format)


def check_empty(folder: Path) -> None:
    """Raises GtcalError where the folder holds something."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise GtcalError(f"{folder}: holds something already; give a new or an empty folder to simulate into")


def _without_detections(truth: GroundTruth) -> GroundTruth:
    none = np.zeros(0, dtype=np.bool_)
    cameras = {name: replace(camera, wrong_corners=none) for name, camera in truth.cameras.items()}
    return replace(truth, cameras=cameras)
