"""The paper's drift figure: one calibration over five recordings of the Lollypop, the headset donned anew before each.

A headset with four fisheye cameras is calibrated on a simulated recording of the paper's board. Every donning then
bumps its markers a little further, up to --shift-mm and --turn-deg at the last. Prints the table of 'gtcal drift' and
writes the figure.

    python scripts/figure_drift.py -o drift.png
    python scripts/figure_drift.py -o steady.png --shift-mm 0 --turn-deg 0
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from gtcal import CalibrationOptions, Drift, calibrate, verify_series
from gtcal.cli.progress import shown_progress
from gtcal.cli.verification_tables import print_drift
from gtcal.estimation.options import MocapSigmas
from gtcal.progress import Progress
from gtcal.simulation import MocapNoise, SimulationOptions, simulate
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.drift_figure import draw_drift

N_RECORDINGS = 5
MOCAP_MM, MOCAP_DEG = 0.05, 0.005
DIRECTION = np.array([0.6, 0.0, 0.8])


def drifting(shift_mm: float, turn_deg: float, seed: int, progress: Progress) -> Drift:
    """Calibrate, then verify with recordings in which the markers have moved further and further."""
    mocap = MocapNoise(MOCAP_MM, MOCAP_DEG)
    board = simulate(SimulationOptions(mocap=mocap), seed=seed)
    known = CalibrationOptions(mocap=MocapSigmas(MOCAP_MM, MOCAP_DEG))
    calibration = calibrate(board.recording, known, progress=progress)
    fault = RigFault(markers=small_motion(shift_mm * DIRECTION, turn_deg * DIRECTION))
    options = LollypopOptions(calibrated_in=board.scene, mocap=mocap, duration_s=40.0)
    recordings = []
    for index, share in enumerate(np.linspace(0.0, 1.0, N_RECORDINGS)):
        progress("simulating", index, N_RECORDINGS)
        donned = replace(options, fault=fault.scaled(float(share)))
        recordings.append((f"donning {index + 1}", simulate_lollypop(donned, seed=seed + 1 + index).recording))
    return verify_series(recordings, calibration, progress=progress)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("drift.png"), help="figure (default: %(default)s)")
    parser.add_argument("--shift-mm", type=float, default=1.2, help="of the markers at last (default: %(default)s)")
    parser.add_argument("--turn-deg", type=float, default=0.1, help="of the markers at last (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="another number, other recordings")
    arguments = parser.parse_args()
    with shown_progress() as progress:
        drift = drifting(arguments.shift_mm, arguments.turn_deg, arguments.seed, progress)
    print_drift(drift)
    draw_drift(arguments.output, drift)
    print(f"written: {arguments.output}")


if __name__ == "__main__":
    main()
