"""The paper's first table: ours against Sturm et al., per camera, on the board and on the Lollypop.

Five simulated recordings of a headset with four fisheyes, and for each an independent recording of the Lollypop. For
Sturm's method the board-to-body transform X is measured by hand: off by 2 mm and 0.5 deg, 1-sigma of each component.
The noise of pixels and mocap is such that the joint solution leaves what the paper's leaves on the board, 0.10 px; what
the two leave on the Lollypop can then be compared. The paper's own figures, of a real headset, stand below ours.

    python scripts/table1_benchmark.py                    # a minute on two cores
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table

from gtcal.baselines.compare import JOINT, PAPER, STURM, compare
from gtcal.simulation import CornerNoise, MocapNoise, SimulationOptions, simulate
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.workflow import verify

NOISE = MocapNoise(translation_mm=0.025, rotation_deg=0.0025, correlation_s=0.1)
CORNERS = CornerNoise(pixel_px=0.055)
METHODS = (JOINT, PAPER, *STURM)
PUBLISHED = {
    "published, joint": {
        "front_right": (0.12, 0.22),
        "front_left": (0.12, 0.24),
        "side_left": (0.08, 0.44),
        "side_right": (0.09, 0.35),
    },
    "published, Sturm": {
        "front_right": (1.04, 1.87),
        "front_left": (0.40, 1.91),
        "side_left": (0.81, 1.76),
        "side_right": (6.76, 8.45),
    },
}
"""Table 1 of the paper: board and Lollypop RMSE in px, pooled over five recordings of a Quest 3."""


@dataclass(frozen=True)
class HandMeasurement:
    """How well a person measures X with ruler and protractor, 1-sigma of each component."""

    mm: float = 2.0
    deg: float = 0.5

    def of(self, true_T: np.ndarray, seed: int) -> np.ndarray:
        """A measurement of it."""
        xi = np.random.default_rng([seed, 7]).standard_normal(6)
        sigmas = np.repeat([np.deg2rad(self.deg), 1e-3 * self.mm], 3)
        return np.asarray(true_T @ gtsam.Pose3.Expmap(sigmas * xi).matrix())


def outcome(seed: int) -> dict[str, dict[str, tuple[float, float]]]:
    """By method, by camera: board and Lollypop RMSE in px."""
    simulation = simulate(SimulationOptions(mocap=NOISE, corners=CORNERS), seed=seed)
    options = LollypopOptions(mocap=NOISE, corners=CORNERS, calibrated_in=simulation.scene)
    lollypop = simulate_lollypop(options, seed=seed + 1_000).recording
    measured = HandMeasurement().of(simulation.truth.body_T_board, seed)
    found = {}
    for row in compare(simulation.recording, measured_body_T_board=measured):
        if row.method not in METHODS or row.calibration is None:
            continue
        checked = verify(lollypop, row.calibration).cameras
        found[row.method] = {
            name: (camera.residuals.rmse_px, checked[name].px.rmse) for name, camera in row.calibration.cameras.items()
        }
    return found


def tables(found: list[dict[str, dict[str, tuple[float, float]]]]) -> list[Table]:
    """Board, then Lollypop: mean and standard deviation over the recordings, a column for each camera."""
    cameras = list(found[0][JOINT])
    made = []
    for column, what in enumerate(("board", "Lollypop")):
        table = Table(title=f"{what} RMSE, px: mean ± standard deviation over {len(found)} recordings")
        table.add_column("")
        for name in cameras:
            table.add_column(name, justify="right")
        for method in METHODS:
            values = [[result[method][name][column] for result in found] for name in cameras]
            cells = (f"{np.mean(of_camera):.3f} ± {np.std(of_camera, ddof=1):.3f}" for of_camera in values)
            table.add_row(method, *cells)
        table.add_section()
        for method, by_camera in PUBLISHED.items():
            table.add_row(method, *(f"{by_camera[name][column]:.2f}" for name in cameras))
        made.append(table)
    return made


def study(recordings: int, seed: int, workers: int | None) -> list[dict[str, dict[str, tuple[float, float]]]]:
    return list(in_parallel(outcome, range(seed, seed + recordings), workers, "recordings"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=5)
    parser.add_argument("--seed", type=int, default=50_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    console = Console(width=120)
    for table in tables(study(arguments.recordings, arguments.seed, arguments.workers)):
        console.print(table)


if __name__ == "__main__":
    main()
