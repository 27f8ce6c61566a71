"""What a prior on the board's pose X does: with a rich motion and a poor one, stated truly and wrongly.

Simulated headset recordings of 40 frames with a noisy mocap. The prior's mean is drawn from its own sigmas (as a ruler
and a protractor would err), or is off by five of them. Error of the board's position and of the cameras', and the NEES
per degree of freedom of the board's pose, which is 1 where the covariance is true.

    python scripts/study_priors.py                        # two minutes on two cores
    python scripts/study_priors.py --figure priors.png
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal import CalibrationOptions, calibrate_observations, synchronise
from gtcal.estimation.priors import PosePrior, Priors
from gtcal.results.calibration import pose_difference
from gtcal.simulation import MocapNoise, SimulationOptions, simulate

SIGMAS_MM = (None, 10.0, 3.0, 1.0, 0.3, 0.1)
DEG_PER_MM = 0.1
MOTIONS = {"rich": "free", "poor: turns about one axis": "single_axis"}
WRONG_SIGMAS = 5.0
NOISE = MocapNoise(translation_mm=0.3, rotation_deg=0.03)


@dataclass(frozen=True)
class Run:
    """One calibration; sigma_mm None: without a prior."""

    motion: str
    wrong: bool
    sigma_mm: float | None
    seed: int


def outcome(run: Run) -> tuple[float, float, float, bool]:
    """Errors of the board and, on average, of the cameras in mm; NEES of the board; whether it was warned of."""
    simulation = simulate(SimulationOptions(n_frames=40, motion=MOTIONS[run.motion], mocap=NOISE), seed=run.seed)
    truth = simulation.truth
    options = CalibrationOptions(intrinsics="exact", priors=_prior(run, truth.body_T_board), allow_degenerate=True)
    found = calibrate_observations(synchronise(simulation.recording), options)
    board = found.body_T_board
    cameras_mm = [
        pose_difference(inverse(camera.camera_T_ref.a_T_b), inverse(truth.camera_T_ref[name]))[0]
        for name, camera in found.cameras.items()
    ]
    xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(board.a_T_b) @ truth.body_T_board))
    nees = np.inf if board.covariance is None else float(xi @ np.linalg.solve(board.covariance, xi) / 6)
    warned = any("contradict each other" in warning for warning in found.warnings)
    return pose_difference(board.a_T_b, truth.body_T_board)[0], float(np.mean(cameras_mm)), nees, warned


def _prior(run: Run, true_T: np.ndarray) -> Priors:
    if run.sigma_mm is None:
        return Priors()
    sigmas = np.repeat([np.deg2rad(DEG_PER_MM * run.sigma_mm), 1e-3 * run.sigma_mm], 3)
    random = np.random.default_rng(run.seed)
    off = sigmas * random.standard_normal(6)
    if run.wrong:
        off *= WRONG_SIGMAS * np.sqrt(6.0) / np.linalg.norm(off / sigmas)
    stated_T = true_T @ gtsam.Pose3.Expmap(off).matrix()
    x, y, z, w = Rotation.from_matrix(stated_T[:3, :3]).as_quat()
    sigma_rad, sigma_m = (float(sigmas[0]),) * 3, (float(sigmas[3]),) * 3
    return Priors(body_T_board=PosePrior(tuple(stated_T[:3, 3]), (w, x, y, z), sigma_m, sigma_rad))


def study(runs: int, seed: int, workers: int | None) -> dict[tuple[str, bool], np.ndarray]:
    """By motion and whether the prior is wrong: (sigmas, 4) medians over the runs; of the warnings, their share."""
    cases = [(motion, wrong) for motion in MOTIONS for wrong in (False, True)]
    todo = [Run(*case, sigma, seed + i) for case in cases for sigma in SIGMAS_MM for i in range(runs)]
    found = list(in_parallel(outcome, todo, workers, "calibrating"))
    results = np.array(found, dtype=float).reshape(len(cases), len(SIGMAS_MM), runs, 4)
    medians = np.median(results, axis=2)
    medians[:, :, 3] = results[:, :, :, 3].mean(axis=2)
    return dict(zip(cases, medians, strict=True))


def table_of(found: dict[tuple[str, bool], np.ndarray]) -> Table:
    """A row per motion, truth of the prior, and sigma."""
    table = Table(title=f"a prior on X, its sigma in mm and {DEG_PER_MM:g} deg per mm; medians")
    for heading in ("motion", "prior"):
        table.add_column(heading)
    for heading in ("its sigma, mm", "error of X, mm", "of the cameras, mm", "NEES/dof of X", "warned of"):
        table.add_column(heading, justify="right")
    for (motion, wrong), rows in found.items():
        for sigma, (board_mm, cameras_mm, nees, warned) in zip(SIGMAS_MM, rows, strict=True):
            what = f"off by {WRONG_SIGMAS:g} sigma" if wrong else "true"
            cells = f"{board_mm:.2g}", f"{cameras_mm:.2g}", f"{nees:.2g}" if np.isfinite(nees) else "open"
            table.add_row(motion, what, "none" if sigma is None else f"{sigma:g}", *cells, f"{warned:.0%}")
        table.add_section()
    return table


def draw(found: dict[tuple[str, bool], np.ndarray], path: Path) -> None:
    """Error of X over the prior's sigma."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.8), layout="constrained")
    axes = figure.add_subplot()
    sigmas = SIGMAS_MM[1:]
    for (motion, wrong), rows in found.items():
        label = f"{motion}, {'off by 5 sigma' if wrong else 'true'}"
        (line,) = axes.loglog(sigmas, rows[1:, 0], "--" if wrong else "-", marker=".", label=label)
        if not wrong:
            axes.axhline(rows[0, 0], color=line.get_color(), lw=0.8, alpha=0.6)
    axes.set_xlabel("sigma of the prior on X, mm (thin lines: without a prior)")
    axes.set_ylabel("median error of X, mm")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12, help="recordings of each kind")
    parser.add_argument("--seed", type=int, default=40_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--figure", type=Path, help="PNG file to draw")
    arguments = parser.parse_args()
    found = study(arguments.runs, arguments.seed, arguments.workers)
    Console(width=120).print(table_of(found))
    if arguments.figure:
        draw(found, arguments.figure)


if __name__ == "__main__":
    main()
