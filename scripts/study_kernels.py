"""Robust kernels against wrong corners and grossly wrong frames: how far off the result is, and how honest.

Simulated headset recordings in which a share of the corners and of the frames' mocap poses is wrong, calibrated with
every kernel of GTSAM, with and without the screening that gtcal does by default, and with graduated non-convexity.

    python scripts/study_kernels.py                          # two minutes on two cores
    python scripts/study_kernels.py --figure kernels.png
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table

from factors import ROBUST_KERNELS, RobustKernel
from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError, calibrate_observations, synchronise
from gtcal.results.calibration import pose_difference
from gtcal.simulation import CornerNoise, SimulationOptions, simulate

SHARES = (0.0, 0.1, 0.2, 0.3, 0.4)
DEFAULT, GRADUATED = "default: screened, no kernel", "GemanMcClure, graduated"
METHODS: dict[str, dict[str, object]] = {
    DEFAULT: {},
    **{
        name if name != "Null" else "no kernel": {"robust": RobustKernel.named(name), "screen": False}
        for name in ROBUST_KERNELS
    },
    GRADUATED: {"robust": RobustKernel.named("GemanMcClure"), "screen": False, "graduated": True},
    "TruncatedLeastSquares, graduated": {
        "robust": RobustKernel.named("TruncatedLeastSquares"),
        "screen": False,
        "graduated": True,
    },
}


@dataclass(frozen=True)
class Run:
    """One calibration. share: of the corners that are wrong, and half of it of the frames."""

    method: str
    share: float
    seed: int


def outcome(run: Run) -> tuple[float, float]:
    """Mean error of the cameras' positions in mm, and the NEES per degree of freedom; infinite where refused."""
    corners = CornerNoise(wrong_corner_share=run.share)
    simulation = simulate(SimulationOptions(corners=corners, swap_share=0.5 * run.share, n_frames=60), seed=run.seed)
    options = CalibrationOptions(intrinsics="exact", allow_degenerate=True, **METHODS[run.method])
    try:
        found = calibrate_observations(synchronise(simulation.recording), options)
    except GtcalError:
        return np.inf, np.inf
    errors_mm, nees = [], []
    for name, camera in found.cameras.items():
        pose, truth = camera.camera_T_ref, simulation.truth.camera_T_ref[name]
        errors_mm.append(pose_difference(inverse(pose.a_T_b), inverse(truth))[0])
        xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(pose.a_T_b) @ truth))
        nees.append(np.inf if pose.covariance is None else xi @ np.linalg.solve(pose.covariance, xi) / 6)
    return float(np.mean(errors_mm)), float(np.mean(nees))


def study(runs: int, seed: int, workers: int | None) -> dict[str, np.ndarray]:
    """By method: (shares, 2) medians over the runs of the error in mm and of the NEES per degree of freedom."""
    todo = [Run(method, share, seed + i) for method in METHODS for share in SHARES for i in range(runs)]
    found = list(in_parallel(outcome, todo, workers, "calibrating"))
    results = np.array(found).reshape(len(METHODS), len(SHARES), runs, 2)
    return dict(zip(METHODS, np.median(results, axis=2), strict=True))


def tables(found: dict[str, np.ndarray]) -> Iterator[Table]:
    """Error and NEES."""
    for column, title in enumerate(("median error of a camera's position, mm", "median NEES per degree of freedom")):
        table = Table(title=f"{title}, by the share of wrong corners (half of it of the frames too)")
        table.add_column("")
        for share in SHARES:
            table.add_column(f"{share:.0%}", justify="right")
        for method, medians in found.items():
            table.add_row(method, *(_number(value) for value in medians[:, column]))
        yield table


def _number(value: float) -> str:
    return "refused" if not np.isfinite(value) else f"{value:.2g}" if value < 100 else f"{value:,.0f}"


def draw(found: dict[str, np.ndarray], path: Path) -> None:
    """The errors over the share of outliers."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for method, medians in found.items():
        style = "-" if method in (DEFAULT, GRADUATED) else ":"
        axes.semilogy([100 * share for share in SHARES], medians[:, 0], style, marker=".", label=method)
    axes.set_xlabel("wrong corners, % (and half as many frames)")
    axes.set_ylabel("median error of a camera's position, mm")
    axes.legend(fontsize=7, ncols=2)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="recordings of each kind")
    parser.add_argument("--seed", type=int, default=30_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--figure", type=Path, help="PNG file to draw")
    arguments = parser.parse_args()
    found = study(arguments.runs, arguments.seed, arguments.workers)
    for table in tables(found):
        Console(width=120).print(table)
    if arguments.figure:
        draw(found, arguments.figure)


if __name__ == "__main__":
    main()
