"""How sure a calibration is, what would lower that, and that it does.

A short recording leaves something weak; gtcal names it and the motion that would help. Then the same is recorded for
longer, with more of that motion.

    python scripts/example_uncertainty.py
"""

from __future__ import annotations

import numpy as np

import gtcal
from gtcal.simulation import SimulationOptions, simulate
from gtcal.uncertainty.weak_directions import least_sure

FEW, MANY = 12, 80


def least_sure_mm(calibration: gtcal.Calibration) -> dict[str, float]:
    """By camera, the largest 1-sigma of its position along an axis of ref."""
    poses = {name: camera.camera_T_ref for name, camera in calibration.cameras.items()}
    return {name: float(np.max(pose.position_of_a_in_b_sigma_mm)) for name, pose in poses.items()}


def calibrated(n_frames: int) -> gtcal.Calibration:
    return gtcal.calibrate(simulate(SimulationOptions(n_frames=n_frames), seed=0).recording)


def main() -> tuple[dict[str, float], dict[str, float]]:
    # %% A short recording, and what it leaves weak
    short = calibrated(FEW)
    print(f"{FEW} frames:")
    for direction in least_sure(short, most=3):
        print(f"- {direction.sentence}")

    # %% Over the image, in px, of points at 1 m (in a notebook the figure shows)
    short.plot_uncertainty("front_left", distance_m=1.0)

    # %% Longer
    long = calibrated(MANY)
    before, after = least_sure_mm(short), least_sure_mm(long)
    print(f"\nlargest 1-sigma of a position, mm: {FEW} frames -> {MANY} frames")
    for name in before:
        print(f"{name:12s} {before[name]:.3f} -> {after[name]:.3f}")
    return before, after


if __name__ == "__main__":
    main()
