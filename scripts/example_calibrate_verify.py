"""Calibrate, verify, look: the whole way in Python, cell by cell as in a notebook.

Simulates a headset's recording and one of the Lollypop; with your own files the first cell is load_recording(...) and
load_lollypop_recording(...), and the rest stays.

    python scripts/example_calibrate_verify.py
    python scripts/example_calibrate_verify.py --figures out
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.figure import Figure

import gtcal
from gtcal.simulation import SimulationOptions, simulate
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop


def main(n_frames: int = 60, n_sightings: int = 240) -> tuple[gtcal.Verification, dict[str, Figure]]:
    # %% The recordings
    board = simulate(SimulationOptions(n_frames=n_frames), seed=0)
    lollypop = simulate_lollypop(LollypopOptions(n_frames=n_sightings, calibrated_in=board.scene), seed=1)
    recording, device = board.recording, lollypop.recording

    # %% Calibrate. The result prints as the command line's tables, and in a notebook as the report.
    calibration = gtcal.calibrate(recording)
    print(calibration)

    # %% The numbers, to go on with
    camera = calibration.cameras["front_left"]
    print("\ncamera_T_ref of front_left:", camera.camera_T_ref.a_T_b, sep="\n")
    print("as a table:", calibration.to_pandas()[["x_mm", "y_mm", "z_mm", "rmse_px"]].round(3), sep="\n")

    # %% Verify with the independent recording
    verification = gtcal.verify(device, calibration)
    print("", verification, sep="\n")

    # %% Figures, of matplotlib
    return verification, {
        "cameras": calibration.plot_cameras(),
        "residuals": calibration.plot_residuals("front_left"),
        "residuals_over_time": calibration.plot_residuals_over_time("front_left"),
        "heat_maps": verification.plot_heat_maps(),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figures", type=Path, help="folder to write the figures to")
    folder = parser.parse_args().figures
    _, figures = main()
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in figures.items():
            figure.savefig(folder / f"{name}.png", dpi=150)
