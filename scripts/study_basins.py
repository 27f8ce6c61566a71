"""From how many random board-to-body transforms X the alignment finds the right basin.

One recording is simulated and PnP is done once. Then the board's body gets a random frame, as with markers glued on
elsewhere (ref_T_body' = ref_T_body * D, body_T_board' = D^-1 * X: the images stay the same), and stages 1 and 2 start
anew: 1,000 times for each rig. A run is in the right basin where every camera comes within 5 mm and 0.5 deg of the
truth; stage 3, which needs only the basin, is not run.

    python scripts/study_basins.py
    python scripts/study_basins.py --runs 200 --frames 15 --swaps 0.2
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from factors.rigid import inverse
from gtcal import synchronise
from gtcal.camera import FloatArray
from gtcal.estimation.alignment import GuideViews, stage_1, stage_2
from gtcal.estimation.pnp import solve_pnp
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import pose_difference
from gtcal.simulation import GroundTruth, SimulationOptions, fixed_cameras_rig, quest3_like_rig, simulate
from gtcal.simulation.transforms import random_transform

RIGS = {
    "headset": {"rig": quest3_like_rig(), "capture": Capture.TRACKED_PLATFORM},
    "fixed cameras": {"rig": fixed_cameras_rig(), "capture": Capture.FIXED_CAMERAS},
}
LARGEST_SHIFT_M = 0.5
BASIN_MM, BASIN_DEG = 5.0, 0.5


def study(guides: Mapping[str, GuideViews], truth: GroundTruth, runs: int, console: Console) -> FloatArray:
    """The largest error over the cameras of every run, (runs, 2) in mm and deg."""
    rng = np.random.default_rng(0)
    found = []
    for run in track(range(runs), console=console, transient=True, description="runs"):
        D = random_transform(rng, rng.uniform(0.0, LARGEST_SHIFT_M))
        found.append(worst_error(rebased(guides, D), truth, np.random.default_rng(run)))
    return np.array(found)


def rebased(guides: Mapping[str, GuideViews], D: FloatArray) -> dict[str, GuideViews]:
    return {
        name: replace(guide, views=replace(guide.views, ref_T_body=guide.views.ref_T_body @ D))
        for name, guide in guides.items()
    }


def worst_error(guides: Mapping[str, GuideViews], truth: GroundTruth, rng: np.random.Generator) -> FloatArray:
    aligned = stage_1(guides, rng)
    estimate, _ = stage_2(aligned.views, aligned.estimate, eps=1e-4, max_iterations=100)
    differences = [
        pose_difference(inverse(estimate.camera_T_ref[name]), inverse(truth.camera_T_ref[name])) for name in guides
    ]
    return np.max(differences, axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000, help="random X for each rig (default: 1000)")
    parser.add_argument("--frames", type=int, default=30, help="frames of the recording (default: 30)")
    parser.add_argument("--swaps", type=float, default=0.0, help="share of frames with a mocap swap (default: 0)")
    parser.add_argument("--seed", type=int, default=0, help="of the recording (default: 0)")
    arguments = parser.parse_args()
    console = Console()
    table = Table("rig", "views", "runs", "right basin", "worst, mm", "deg", "s")
    for name, rig in RIGS.items():
        options = SimulationOptions(**rig, n_frames=arguments.frames, swap_share=arguments.swaps)
        simulation = simulate(options, seed=arguments.seed)
        views = synchronise(simulation.recording).views
        guides = {camera: GuideViews.of(seen, solve_pnp(seen, max_views=100)) for camera, seen in views.items()}
        started = time.perf_counter()
        errors = study(guides, simulation.truth, arguments.runs, console)
        seconds = time.perf_counter() - started
        right = int((errors <= (BASIN_MM, BASIN_DEG)).all(axis=1).sum())
        n_views = sum(of_camera.n_views for of_camera in views.values())
        mm, deg = errors.max(axis=0)
        table.add_row(name, str(n_views), str(arguments.runs), str(right), f"{mm:.2f}", f"{deg:.3f}", f"{seconds:.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
