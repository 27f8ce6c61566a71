"""What a board that is not as stated does to a calibration: with the board taken as flat and as stated, and with its
shape solved for.

Simulated headset recordings whose board is bowed along its long side, or printed larger than stated, or both. For each:
how far the cameras are off, what is claimed, and the squared error in units of the stated covariance (NEES) per degree
of freedom, 1 where that is true. Before: the board exact, intrinsics held or refined freely; after: the default.

    python scripts/study_board.py              # 240 recordings, ten minutes on two cores
    python scripts/study_board.py --runs 3
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from systematic import Spoil, bow, scale

from factors.rigid import inverse
from gtcal import Calibration, CalibrationOptions, GtcalError, Recording, calibrate
from gtcal.estimation.linear import squared_distance
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate

NOISE = MocapNoise(translation_mm=0.1, rotation_deg=0.01)
BOARDS: dict[str, tuple[Spoil, float] | None] = {
    "flat": None,
    "bow 0.5 mm": (bow, 0.5),
    "bow 1 mm": (bow, 1.0),
    "scale 0.1 % off": (scale, 0.1),
    "scale 0.2 % off": (scale, 0.2),
}
_BARE = CalibrationOptions(effects=False, clock="trust")
WAYS = {
    "board exact, intrinsics held": replace(_BARE, board="exact", intrinsics="fixed"),
    "board exact, intrinsics refined": replace(_BARE, board="exact", intrinsics="refine"),
    "board exact, intrinsics auto": replace(_BARE, board="exact"),
    "default": _BARE,
}
SHOWN = ("error, mm", "claimed, mm", "NEES/dof, mean", "median")


@dataclass(frozen=True)
class Run:
    """One recording, and one way to calibrate it."""

    board: str
    way: str
    seed: int

    def recorded(self) -> tuple[Simulation, Recording]:
        """As simulated, and as recorded with this board."""
        simulation = simulate(SimulationOptions(n_frames=80, duration_s=60.0, mocap=NOISE), seed=self.seed)
        spoilt = BOARDS[self.board]
        return simulation, simulation.recording if spoilt is None else spoilt[0](simulation, spoilt[1])


@dataclass(frozen=True)
class Outcome:
    """Means over the cameras."""

    run: Run
    error_mm: float
    claimed_mm: float
    nees_per_dof: float


def outcome(run: Run) -> Outcome | None:
    """None where the recording is refused: a camera chances to see too little."""
    simulation, recording = run.recorded()
    try:
        found = calibrate(recording, WAYS[run.way])
    except GtcalError:
        return None
    return Outcome(run, *np.mean(list(_by_camera(found, simulation)), axis=0))


def _by_camera(found: Calibration, simulation: Simulation) -> Iterator[tuple[float, float, float]]:
    for name, camera in found.cameras.items():
        pose, true_pose = camera.camera_T_ref, simulation.truth.camera_T_ref[name]
        sigma_mm = pose.position_of_a_in_b_sigma_mm
        assert sigma_mm is not None
        assert pose.covariance is not None
        xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(pose.a_T_b) @ true_pose))
        error_mm = 1e3 * float(np.linalg.norm(inverse(pose.a_T_b)[:3, 3] - inverse(true_pose)[:3, 3]))
        yield error_mm, float(np.linalg.norm(sigma_mm)), squared_distance(xi, pose.covariance) / 6.0


def study(runs: int, seed: int, workers: int | None) -> list[Outcome]:
    """Every board, every way, ``runs`` recordings each."""
    todo = [Run(board, way, seed + i) for board in BOARDS for way in WAYS for i in range(runs)]
    return [found for found in in_parallel(outcome, todo, workers, "calibrating") if found is not None]


def table_of(outcomes: list[Outcome]) -> Table:
    """A row for each board and way."""
    table = Table(title="a board that is not as stated: cameras' positions, over all of them")
    for heading in ("board", "calibrated with"):
        table.add_column(heading)
    for heading in SHOWN:
        table.add_column(heading, justify="right")
    for board in BOARDS:
        for way in WAYS:
            of_it = [one for one in outcomes if (one.run.board, one.run.way) == (board, way)]
            if not of_it:
                continue
            nees = np.array([one.nees_per_dof for one in of_it])
            means = (np.mean([getattr(one, field) for one in of_it]) for field in ("error_mm", "claimed_mm"))
            cells = [*(f"{mean:.3f}" for mean in means), f"{nees.mean():.2f}", f"{np.median(nees):.2f}"]
            table.add_row(board, way, *cells, end_section=way == list(WAYS)[-1])
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12, help="recordings of each board, the same for each way")
    parser.add_argument("--seed", type=int, default=70_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    outcomes = study(arguments.runs, arguments.seed, arguments.workers)
    Console(width=120).print(table_of(outcomes))


if __name__ == "__main__":
    main()
