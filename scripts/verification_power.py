"""How often a verification cries wolf, and how often it names the camera that moved.

Simulated Lollypop recordings of a headset with four cameras: the device at about 0.5 m, 30 s. A false alarm is any
finding on a true calibration; a detection names the one camera that was turned or shifted, and only that one.

    python scripts/verification_power.py --runs 200
    python scripts/verification_power.py --runs 200 --correlation-s 0.5
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table

from gtcal.simulation import MocapNoise
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.workflow import verify

FAULTS_DEG = (0.02, 0.05, 0.1, 0.2)
FAULTS_MM = (0.2, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Run:
    """One verification: turn or shift of a camera that the seed chooses, in a direction that it chooses too."""

    seed: int
    turn_deg: float
    shift_mm: float
    mocap: MocapNoise


def outcome(run: Run) -> tuple[int, bool]:
    """The number of findings, and whether they are the camera that moved and no other."""
    options = LollypopOptions(mocap=run.mocap)
    random = np.random.default_rng([run.seed, 5])
    name = options.rig.cameras[random.integers(len(options.rig.cameras))].name
    direction = random.standard_normal(3)
    direction /= np.linalg.norm(direction)
    moved = small_motion(run.shift_mm * direction, run.turn_deg * direction)
    fault = RigFault(cameras={name: moved}) if run.turn_deg or run.shift_mm else RigFault()
    simulation = simulate_lollypop(LollypopOptions(mocap=run.mocap, fault=fault), seed=run.seed)
    found = verify(simulation.recording, simulation.true_calibration()).faults
    return len(found), [(f.kind, f.camera) for f in found] == [("camera_moved", name)]


def main() -> None:
    arguments = _arguments()
    mocap = MocapNoise(arguments.noise_mm, arguments.noise_deg, correlation_s=arguments.correlation_s)
    cases = [(0.0, 0.0), *((deg, 0.0) for deg in FAULTS_DEG), *((0.0, mm) for mm in FAULTS_MM)]
    runs = [Run(arguments.seed + seed, deg, mm, mocap) for deg, mm in cases for seed in range(arguments.runs)]
    found = list(in_parallel(outcome, runs, arguments.workers, "verifying"))
    outcomes = np.array(found).reshape(len(cases), arguments.runs, 2)
    table = Table(
        title=f"{arguments.runs} verifications each, mocap noise {mocap.translation_mm:g} mm, "
        f"{mocap.rotation_deg:g} deg, correlated over {mocap.correlation_s:g} s"
    )
    for heading in ("one camera", "any finding", "names it, and only it"):
        table.add_column(heading, justify="right")
    for (deg, mm), results in zip(cases, outcomes, strict=True):
        what = f"turned by {deg:g} deg" if deg else f"shifted by {mm:g} mm" if mm else "none moved (false alarms)"
        table.add_row(what, str((results[:, 0] > 0).sum()), str(results[:, 1].sum()) if deg or mm else "-")
    Console().print(table)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="verifications for each fault")
    parser.add_argument("--noise-mm", type=float, default=0.05, help="mocap noise of each body, 1-sigma per axis")
    parser.add_argument("--noise-deg", type=float, default=0.005)
    parser.add_argument("--correlation-s", type=float, default=0.1, help="over which the mocap noise forgets itself")
    parser.add_argument("--seed", type=int, default=10_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    return parser.parse_args()


if __name__ == "__main__":
    main()
