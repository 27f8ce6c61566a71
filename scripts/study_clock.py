"""How well the clock offset is found: 100 simulated recordings with offsets of up to 200 ms.

Headset recordings at 30 Hz with a mocap at 120 Hz and 0.1 mm of noise: the error of the offset, its NEES (1 where the
stated sigma is true), and the cameras' position error beside that with the true clock.

    python scripts/study_clock.py                 # four minutes on two cores
"""

from __future__ import annotations

import argparse
import os

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table

from factors.rigid import inverse
from gtcal import Calibration, CalibrationOptions, calibrate
from gtcal.results.calibration import pose_difference
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate

LARGEST_S = 0.2
NOISE = MocapNoise(translation_mm=0.1, rotation_deg=0.01)


def outcome(seed: int) -> tuple[float, float, float, float]:
    """The offset's error and sigma in ms; the mean position error of the cameras in mm, with it found and with it
    known."""
    ahead_s = float(np.random.default_rng([seed, 3]).uniform(-LARGEST_S, LARGEST_S))
    late, synchronised = (
        simulate(SimulationOptions(mocap=NOISE, clock_offset_s=offset_s), seed=seed) for offset_s in (ahead_s, 0.0)
    )
    found = calibrate(late.recording, CalibrationOptions(clock="estimate"))
    known = calibrate(synchronised.recording, CalibrationOptions(clock="trust"))
    assert found.clock is not None
    offset_s, sigma_s = (next(iter(values.values())) for values in (found.clock.offset_s, found.clock.sigma_s))
    return 1e3 * (offset_s + ahead_s), 1e3 * sigma_s, position_error_mm(found, late), position_error_mm(known, late)


def position_error_mm(calibration: Calibration, simulation: Simulation) -> float:
    truth = simulation.truth.camera_T_ref
    return float(
        np.mean(
            [
                pose_difference(inverse(camera.camera_T_ref.a_T_b), inverse(truth[name]))[0]
                for name, camera in calibration.cameras.items()
            ]
        )
    )


def study(recordings: int, seed: int, workers: int | None) -> np.ndarray:
    """(recordings, 4) outcomes."""
    return np.array(list(in_parallel(outcome, range(seed, seed + recordings), workers, "recordings")))


def table_of(found: np.ndarray) -> Table:
    """One row of what matters."""
    error_ms, sigma_ms, found_mm, known_mm = found.T
    nees = (error_ms / sigma_ms) ** 2
    table = Table(title=f"{len(found)} recordings, offsets of up to {1e3 * LARGEST_S:g} ms either way")
    for heading in (
        "RMS error, ms",
        "largest, ms",
        "median sigma, ms",
        "NEES",
        "position error, mm",
        "clock known, mm",
    ):
        table.add_column(heading, justify="right")
    table.add_row(
        f"{np.sqrt(np.mean(error_ms**2)):.3f}",
        f"{np.abs(error_ms).max():.3f}",
        f"{np.median(sigma_ms):.3f}",
        f"{nees.mean():.2f} ± {nees.std() / np.sqrt(len(nees)):.2f}",
        f"{found_mm.mean():.3f}",
        f"{known_mm.mean():.3f}",
    )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--seed", type=int, default=60_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    Console(width=120).print(table_of(study(arguments.recordings, arguments.seed, arguments.workers)))


if __name__ == "__main__":
    main()
