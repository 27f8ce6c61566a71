"""The paper's second table: what each stage is for.

A simulated headset recording with mocap noise, solved in full and with parts left out: reprojection RMSE, iterations,
error against the truth, and the share of random starts that end in the right basin. A start is another seed of stage
1's rotations, or, without stage 1, a board turned at random. Right is within 20 mm and 2 deg of the truth.

    python scripts/table2_ablation.py                 # 200 starts each, two minutes on two cores
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError, synchronise
from gtcal.estimation.adjustment import adjust
from gtcal.estimation.alignment import GuideViews, fitting_views, stage_1, stage_2, without_stage_1
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import chain_residuals_px, norms
from gtcal.results.calibration import pose_difference
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate

NOISE = MocapNoise(translation_mm=0.1, rotation_deg=0.01)
RIGHT_MM, RIGHT_DEG = 20.0, 2.0


@dataclass(frozen=True)
class Variant:
    """stages: those that are run. intrinsics: as given. far: X turned half round and a metre away."""

    name: str
    stages: tuple[int, ...] = (1, 2, 3)
    intrinsics: str = "true"
    refine: bool = False
    far: bool = False


PUBLISHED_PX = {
    "full, intrinsics fixed": "0.146",
    "without stage 3": "0.148",
    "without Procrustes (stage 1)": "0.146",
    "stage 1 only": "43.000",
}
"""Table 2 of the paper, one recording of a Quest 3. Its stage 1 alone ends far off: alternate closed forms stop short
where rotations and levers trade, by how much depends on where the mocap's origin is; ours go on to the minimum."""

VARIANTS = (
    Variant("full, intrinsics fixed"),
    Variant("full, intrinsics refined", refine=True),
    Variant("poor intrinsics, fixed", intrinsics="perturbed"),
    Variant("poor intrinsics, refined", intrinsics="perturbed", refine=True),
    Variant("X far from identity", far=True),
    Variant("without stage 3", stages=(1, 2)),
    Variant("without stage 2", stages=(1, 3)),
    Variant("stage 1 only", stages=(1,)),
    Variant("without Procrustes (stage 1)", stages=(2, 3)),
    Variant("stage 3 only", stages=(3,)),
    Variant("without Procrustes, X far from identity", stages=(2, 3), far=True),
)


@cache
def problem(variant: Variant) -> tuple[Simulation, Observations, dict[str, GuideViews], np.ndarray]:
    """The recording, its views, their PnP, and the true X."""
    simulation = simulate(SimulationOptions(mocap=NOISE, n_frames=60, intrinsics=variant.intrinsics), seed=1)
    observations = synchronise(simulation.recording)
    true_X = simulation.truth.body_T_board
    if variant.far:
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_matrix(), [1.0, -0.5, 0.7]
        views = {name: replace(v, ref_T_body=v.ref_T_body @ inverse(moved)) for name, v in observations.views.items()}
        observations, true_X = replace(observations, views=views), moved @ true_X
    guides = {name: GuideViews.of(views, solve_pnp(views, max_views=100)) for name, views in observations.views.items()}
    return simulation, observations, guides, true_X


@dataclass(frozen=True)
class Outcome:
    """Of one start. iterations: of stages 2 and 3."""

    rmse_px: float
    iterations: int
    error_mm: float
    error_deg: float

    @property
    def right(self) -> bool:
        return self.error_mm < RIGHT_MM and self.error_deg < RIGHT_DEG


def outcome(task: tuple[Variant, int]) -> Outcome:
    """Solve from one start."""
    variant, seed = task
    simulation, observations, guides, true_X = problem(variant)
    options = CalibrationOptions(intrinsics="refine" if variant.refine else "exact", mocap="exact")
    try:
        estimate, iterations = _solved(variant, seed, observations, guides, options)
    except (GtcalError, RuntimeError):
        return Outcome(np.nan, 0, np.inf, np.inf)
    lengths = np.concatenate([norms(chain_residuals_px(v, estimate)) for v in observations.views.values()])
    finite = lengths[np.isfinite(lengths)]
    differences = [pose_difference(estimate.body_T_board, true_X)]
    for name, pose in estimate.camera_T_ref.items():
        differences.append(pose_difference(inverse(pose), inverse(simulation.truth.camera_T_ref[name])))
    rmse_px = float(np.sqrt((finite**2).mean())) if finite.size else np.nan
    return Outcome(rmse_px, iterations, max(mm for mm, _ in differences), max(deg for _, deg in differences))


def _solved(
    variant: Variant, seed: int, observations: Observations, guides: dict[str, GuideViews], options: CalibrationOptions
) -> tuple[Estimate, int]:
    iterations = 0
    if 1 in variant.stages:
        aligned = stage_1(guides, np.random.default_rng(seed))
        estimate, fitting = aligned.estimate, aligned.views
    else:
        estimate = _turned(without_stage_1(guides), seed)
        fitting = fitting_views(guides, estimate)
    if 2 in variant.stages:
        estimate, minimised = stage_2(fitting, estimate, eps=options.eps, max_iterations=options.max_iterations)
        iterations += minimised.iterations
    if 3 in variant.stages:
        adjusted = adjust(observations.views, estimate, replace(options, screen=False))
        estimate, iterations = adjusted.estimate, iterations + len(adjusted.errors) - 1
    return estimate, iterations


def _turned(estimate: Estimate, seed: int) -> Estimate:
    """X and every camera turned at random, each by itself."""
    random = np.random.default_rng(seed)

    def turn(pose: np.ndarray) -> np.ndarray:
        rotation = gtsam.Pose3(gtsam.Rot3(Rotation.random(rng=random).as_matrix()), np.zeros(3))
        return np.asarray(pose @ rotation.matrix())

    cameras = {name: turn(pose) for name, pose in estimate.camera_T_ref.items()}
    return replace(estimate, body_T_board=turn(estimate.body_T_board), camera_T_ref=cameras)


def study(starts: int, workers: int | None) -> Iterator[tuple[Variant, list[Outcome]]]:
    """The outcomes of each variant."""
    tasks = [(variant, seed) for variant in VARIANTS for seed in range(starts)]
    found = list(in_parallel(outcome, tasks, workers, "solving"))
    for i, variant in enumerate(VARIANTS):
        yield variant, found[i * starts : (i + 1) * starts]


def table_of(results: Iterator[tuple[Variant, list[Outcome]]], starts: int) -> Table:
    """A row per variant; RMSE, iterations and errors are medians over the starts in the right basin, or over all."""
    table = Table(title=f"{starts} starts each; the recording has 0.1 px and 0.1 mm of noise")
    table.add_column("")
    for heading in ("RMSE, px", "iterations", "error, mm", "deg", "right basin", "published RMSE, px"):
        table.add_column(heading, justify="right")
    for variant, outcomes in results:
        right = [o for o in outcomes if o.right]
        used = right or outcomes
        medians = (
            f"{np.nanmedian([getattr(o, name) for o in used]):{form}}"
            for name, form in (("rmse_px", ".3f"), ("iterations", ".0f"), ("error_mm", ".3g"), ("error_deg", ".2g"))
        )
        table.add_row(variant.name, *medians, f"{len(right) / len(outcomes):.0%}", PUBLISHED_PX.get(variant.name, ""))
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    Console(width=120).print(table_of(study(arguments.starts, arguments.workers), arguments.starts))


if __name__ == "__main__":
    main()
