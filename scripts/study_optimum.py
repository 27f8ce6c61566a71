"""Whether stages 3 and 4 end at one optimum, wherever in the right basin they start.

One recording of a headset is simulated, with corners up to the edge of the lenses' fields. Then every camera and the
board are turned and shifted at random, each in its own direction, by up to 5 deg and 50 mm, and the stage runs anew on
the same corners. Under such a start many corners lie outside the field. A run is at the optimum where its error is that
of the best run, to a millionth of it.

    python scripts/study_optimum.py
    python scripts/study_optimum.py --runs 50 --runs-stage-4 5
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from gtcal import CalibrationOptions, synchronise
from gtcal.camera import FloatArray
from gtcal.estimation.adjustment import Adjusted, adjust, minimised
from gtcal.estimation.errors_in_variables import adjust_with_mocap_noise, fit_mocap_noise
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.field_edge import without_edge
from gtcal.estimation.observations import Observations
from gtcal.estimation.residuals import chain_residuals_px
from gtcal.simulation import Simulation, SimulationOptions, quest3_like_rig, simulate

LARGEST_RAD, LARGEST_M = np.deg2rad(5.0), 0.05
SAME = 1e-6
EPS = 1e-9

Errors = tuple[float, ...]


def recorded(seed: int = 4, frames: int = 60) -> tuple[Simulation, Observations]:
    """A recording and its views, less those corners that tell nothing."""
    simulation = simulate(SimulationOptions(rig=quest3_like_rig(), n_frames=frames, duration_s=frames / 1.5), seed=seed)
    return simulation, without_edge(synchronise(simulation.recording))


def truth_of(simulation: Simulation, observations: Observations) -> Estimate:
    theta = {name: views.camera.theta for name, views in observations.views.items()}
    return Estimate(simulation.truth.body_T_board, dict(simulation.truth.camera_T_ref), theta)


def moved(estimate: Estimate, rng: np.random.Generator) -> Estimate:
    """Every pose turned and shifted at random; the intrinsics as they are."""
    camera_T_ref = {name: _moved(pose, rng) for name, pose in estimate.camera_T_ref.items()}
    return replace(estimate, body_T_board=_moved(estimate.body_T_board, rng), camera_T_ref=camera_T_ref)


def _moved(pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    turn, shift = (size * rng.uniform() * _direction(rng) for size in (LARGEST_RAD, LARGEST_M))
    return np.asarray(gtsam.Pose3(gtsam.Rot3.Expmap(turn), shift).matrix() @ pose)


def _direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def options_of(intrinsics: str) -> CalibrationOptions:
    return CalibrationOptions(intrinsics=intrinsics, eps=EPS)  # type: ignore[arg-type]


def stage_3(observations: Observations, truth: Estimate, intrinsics: str) -> Callable[[Estimate], Errors]:
    """From an estimate to the errors of stage 3, iteration by iteration, on the corners that stay at the truth."""
    options = options_of(intrinsics)
    solved = adjust(observations.views, truth, options)
    return lambda start: minimised(solved.screened, start, solved.sigma_px, options)[1]


def stage_4(observations: Observations, truth: Estimate, intrinsics: str) -> Callable[[Estimate], Errors]:
    """The same of stage 4, with the noise and the frames of one run."""
    options = options_of(intrinsics)
    fitted = fit_mocap_noise(adjust(observations.views, truth, options), observations.motion, options)
    if fitted is None:
        raise SystemExit("the mocap's noise can't be estimated from this recording")
    solved, fit = fitted

    def errors(start: Estimate) -> Errors:
        placed: Adjusted = replace(solved, estimate=start)
        return adjust_with_mocap_noise(placed, fit, observations.motion, options).errors

    return errors


def outside(observations: Observations, estimate: Estimate) -> float:
    """The share of the corners that the estimate puts outside their lens's field."""
    residuals = [chain_residuals_px(views, estimate) for views in observations.views.values()]
    return float(np.mean(np.isnan(np.concatenate(residuals)[:, 0])))


def study(
    run: Callable[[Estimate], Errors], truth: Estimate, observations: Observations, runs: int, console: Console
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(runs,) the error at the end over the best one's less one, the iterations, and the share of corners outside at
    the start."""
    rng = np.random.default_rng(0)
    starts = [moved(truth, rng) for _ in range(runs)]
    found = [run(start) for start in track(starts, console=console, transient=True, description="starts")]
    ends = np.array([errors[-1] for errors in found])
    iterations = np.array([len(errors) - 1.0 for errors in found])
    return ends / ends.min() - 1.0, iterations, np.array([outside(observations, start) for start in starts])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000, help="starts of stage 3 (%(default)s)")
    parser.add_argument("--runs-stage-4", type=int, default=100, help="starts of stage 4 (%(default)s)")
    arguments = parser.parse_args()
    console = Console()
    simulation, observations = recorded()
    truth = truth_of(simulation, observations)
    table = Table(title="one optimum from starts up to 5 deg and 50 mm off")
    columns = (
        "stage",
        "intrinsics",
        "starts",
        "at the optimum",
        "iterations",
        "at most",
        "outside at the start, up to",
    )
    for column in columns:
        table.add_column(column, justify="left" if column in columns[:2] else "right")
    for stage, of_stage, runs in ((3, stage_3, arguments.runs), (4, stage_4, arguments.runs_stage_4)):
        for intrinsics in ("exact", "refine"):
            run = of_stage(observations, truth, intrinsics)
            excess, iterations, share = study(run, truth, observations, runs, console)
            table.add_row(
                str(stage),
                "held" if intrinsics == "exact" else "refined",
                f"{runs:,}",
                f"{np.sum(excess < SAME):,}",
                f"{np.mean(iterations):.1f}",
                f"{iterations.max():.0f}",
                f"{share.max():.1%}",
            )
    console.print(table)


if __name__ == "__main__":
    main()
