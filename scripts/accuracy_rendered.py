"""How near the truth a calibration from rendered images comes.

A headset with four fisheye cameras and the paper's board are rendered once; the real detector finds the corners; then
the mocap gets two levels of noise, and each time the calibration is compared with the truth, without and with stage 4
(the mocap's noise modelled). Prints per camera the RMSE over the board's corners and the error of the extrinsic.

    python scripts/accuracy_rendered.py --frames 100 --image-scale 0.5
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress as Bars
from rich.table import Table

from factors.rigid import inverse
from gtcal import CalibrationOptions, calibrate, detected, load_recording
from gtcal.estimation.options import MocapSigmas
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import pose_difference
from gtcal.simulation import (
    GroundTruth,
    MocapNoise,
    Simulation,
    SimulationOptions,
    quest3_like_rig,
    simulate,
    write_simulation,
)

NOISES = (MocapNoise(translation_mm=0.05, rotation_deg=0.005), MocapNoise(translation_mm=0.2, rotation_deg=0.02))


def simulated(noise: MocapNoise, frames: int, image_scale: float, seed: int) -> Simulation:
    """The seed decides motion and images; the mocap's noise does not touch them."""
    options = SimulationOptions(rig=quest3_like_rig().scaled(image_scale), n_frames=frames, mocap=noise)
    return simulate(options, seed=seed)


def detections_from_images(simulation: Simulation, console: Console) -> Recording:
    with tempfile.TemporaryDirectory() as folder, Bars(console=console, transient=True) as bars:
        tasks = {}

        def progress(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what)
            bars.update(tasks[what], completed=done, total=total)

        manifest = write_simulation(simulation, Path(folder) / "recording", images=True, progress=progress)
        return detected(load_recording(manifest), progress=progress)


def add_rows(
    table: Table, noise: MocapNoise, recording: Recording, truth: GroundTruth, options: CalibrationOptions
) -> None:
    calibration = calibrate(recording, options)
    noise_modelled = calibration.mocap_noise is not None and calibration.mocap_noise.stage == 4
    for name, camera in calibration.cameras.items():
        found, true = inverse(camera.camera_T_ref.a_T_b), inverse(truth.camera_T_ref[name])
        position_mm, rotation_deg = pose_difference(found, true)
        table.add_row(
            f"{noise.translation_mm:g} mm, {noise.rotation_deg:g} deg",
            "4" if noise_modelled else "3",
            name,
            str(camera.residuals.n_views),
            f"{camera.residuals.rmse_px:.3f}",
            f"{position_mm:.3f}",
            f"{rotation_deg:.4f}",
        )
    table.add_section()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100, help="frames per camera (default: %(default)s)")
    parser.add_argument("--image-scale", type=float, default=0.5, help="share of 1280 x 1024 (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="another number, another recording")
    arguments = parser.parse_args()
    console = Console(width=110)
    given = arguments.frames, arguments.image_scale, arguments.seed
    detections = detections_from_images(simulated(NOISES[0], *given), console).detections
    table = Table(
        "mocap noise of each body", "stage", "camera", title=f"{arguments.frames} frames, seed {arguments.seed}"
    )
    for heading in ("views", "board RMSE, px", "position error, mm", "rotation error, deg"):
        table.add_column(heading, justify="right")
    for noise in NOISES:
        simulation = simulated(noise, *given)
        recording = replace(simulation.recording, detections=detections)
        for mocap in ("exact", MocapSigmas(noise.translation_mm, noise.rotation_deg)):
            add_rows(table, noise, recording, simulation.truth, CalibrationOptions(mocap=mocap))
    console.print(table)


if __name__ == "__main__":
    main()
