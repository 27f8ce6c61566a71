"""Poses in place of corners: how true the sigmas are, and whether poses and corners of one recording agree.

Simulated headset recordings with 0.1 mm and 0.01 deg of mocap noise on every tracked body. First each camera's poses
are the truth with noise of 0.5 mm and 0.05 deg on each axis: how often the truth lies within the intervals that the
joint estimate claims, over all unknowns, and the squared error in units of the covariance (NEES) per degree of freedom;
once with nothing said of that noise, and once with its covariances stated. Then the poses are PnP's, of the corners of
the same recording: how far they lead from what the corners themselves lead to, in the sigmas of the poses' estimate.

    python scripts/study_poses.py                 # half an hour on two cores
    python scripts/study_poses.py --keep FOLDER   # in pieces: what was computed of each recording is kept there
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table

from gtcal import CalibrationOptions, calibrate
from gtcal.baselines.closed_forms import CLOSED_FORMS
from gtcal.blas import on_one_blas_thread
from gtcal.estimation.linear import squared_distance
from gtcal.estimation.observations import synchronise
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.pose_joint import (
    JointPoses,
    PoseChain,
    PoseViews,
    differences,
    stage_1_of_poses,
    stage_2_of_poses,
    stage_3_of_poses,
)
from gtcal.files import write_text
from gtcal.pose_recordings.calibration import closed_forms
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate

MOCAP = MocapNoise(translation_mm=0.1, rotation_deg=0.01)
CAMERA_SIGMAS = np.repeat([np.deg2rad(0.05), 0.5e-3], 3)
LEVELS = {"50 %": 0.6745, "90 %": 1.6449, "95 %": 1.9600}


@dataclass(frozen=True)
class Outcome:
    """nees: per degree of freedom. errors: (P,) in sigmas, of all unknowns. methods_mm: of each closed form, how far
    the camera that is farthest off is from the joint estimate's."""

    nees: float
    errors: np.ndarray
    methods_mm: tuple[float, ...]


def of_truth(seed: int) -> Outcome:
    """Poses that are the truth with noise: against the truth."""
    return _of_truth(seed, stated=False)


def of_stated(seed: int) -> Outcome:
    """... with the covariances of that noise stated."""
    return _of_truth(seed, stated=True)


@on_one_blas_thread
def _of_truth(seed: int, *, stated: bool) -> Outcome:
    simulation = simulate(SimulationOptions(mocap=MOCAP), seed=seed)
    rng = np.random.default_rng([seed, 11])
    views = {}
    for index, (name, of_camera) in enumerate(synchronise(simulation.recording).views.items()):
        at = np.isin(simulation.truth.cameras[name].stamps_ns, of_camera.stamps_ns)
        true = simulation.scene.camera_T_board(index, simulation.frame_times_s[at])
        noise = rng.normal(size=(len(true), 6)) * CAMERA_SIGMAS
        seen = true @ np.stack([gtsam.Pose3.Expmap(xi).matrix() for xi in noise])
        covariance = np.tile(np.diag(CAMERA_SIGMAS**2), (len(true), 1, 1)) if stated else None
        views[name] = PoseViews(of_camera.stamps_ns, of_camera.frame_index, of_camera.ref_T_body, seen, covariance)
    return _outcome(views, solved(views), _truth(simulation))


@on_one_blas_thread
def of_corners(seed: int) -> Outcome:
    """Poses by PnP: against what the corners lead to."""
    simulation = simulate(SimulationOptions(mocap=MOCAP), seed=seed)
    options = CalibrationOptions(intrinsics="exact", effects=False, clock="trust")
    estimate = calibrate(simulation.recording, options).estimate
    views = {}
    for name, of_camera in synchronise(simulation.recording).views.items():
        pnp = solve_pnp(of_camera, max_views=of_camera.n_views)
        rows = pnp.view_index
        views[name] = PoseViews(
            of_camera.stamps_ns[rows], of_camera.frame_index[rows], of_camera.ref_T_body[rows], pnp.camera_T_board[:, 0]
        )
    return _outcome(views, solved(views), PoseChain(estimate.camera_T_ref, estimate.body_T_board))


def solved(views: dict[str, PoseViews]) -> JointPoses:
    """The joint estimate, as 'gtcal calibrate' finds it."""
    start = stage_1_of_poses(views, np.random.default_rng(0))
    aligned, _ = stage_2_of_poses(views, start, eps=1e-4, max_iterations=100)
    return stage_3_of_poses(views, aligned, eps=1e-6, max_iterations=100)


def _truth(simulation: Simulation) -> PoseChain:
    return PoseChain(simulation.truth.camera_T_ref, simulation.truth.body_T_board)


def _outcome(views: dict[str, PoseViews], found: JointPoses, reference: PoseChain) -> Outcome:
    xi = differences(found.chain, reference)
    nees = squared_distance(xi, found.covariance) / len(xi)
    methods = tuple(form.difference_mm for form in closed_forms(views, found))
    return Outcome(nees, xi / np.sqrt(np.diag(found.covariance)), methods)


COMPARED = {
    "noisy poses against the truth": of_truth,
    "the same, covariances stated": of_stated,
    "PnP's poses against the corners": of_corners,
}


def kept(folder: Path | None, of: Callable[[int], Outcome], seed: int) -> Outcome:
    """Of one recording, from the folder where it is there."""
    if folder is None:
        return of(seed)
    file = folder / f"{of.__name__}_{seed}.json"
    if file.is_file():
        known = json.loads(file.read_text())
        return Outcome(known["nees"], np.array(known["errors"]), tuple(known["methods_mm"]))
    found = of(seed)
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"nees": found.nees, "errors": found.errors.tolist(), "methods_mm": found.methods_mm})
    write_text(file, text)
    return found


def table_of(rows: dict[str, list[Outcome]]) -> Table:
    """A row for each of the two comparisons."""
    table = Table(title="poses in place of corners")
    for heading in ("", "recordings", "NEES/dof", *(f"within {level}" for level in LEVELS), "largest, sigmas"):
        table.add_column(heading, justify="left" if not heading else "right")
    for name, outcomes in rows.items():
        nees = np.array([outcome.nees for outcome in outcomes])
        errors = np.abs(np.stack([outcome.errors for outcome in outcomes]))
        within = (f"{np.mean(errors < sigmas):.1%}" for sigmas in LEVELS.values())
        spread = nees.std() / np.sqrt(len(nees))
        table.add_row(name, str(len(nees)), f"{nees.mean():.2f} ± {spread:.2f}", *within, f"{errors.max():.1f}")
    return table


def methods_of(outcomes: list[Outcome]) -> Table:
    """A row for each closed form."""
    table = Table(title="closed forms: the camera that is farthest from the joint estimate's place, mm")
    table.add_column("method")
    table.add_column("median", justify="right")
    table.add_column("worst", justify="right")
    for method, mm in zip(CLOSED_FORMS, np.stack([outcome.methods_mm for outcome in outcomes]).T, strict=True):
        table.add_row(method, f"{np.nanmedian(mm):.3f}", f"{np.nanmax(mm):.3f}")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--seed", type=int, default=90_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--keep", type=Path, default=os.environ.get("GTCAL_KEEP"), help="folder for what was computed")
    arguments = parser.parse_args()
    seeds = range(arguments.seed, arguments.seed + arguments.recordings)
    rows = {
        what: list(in_parallel(partial(kept, arguments.keep, of), seeds, arguments.workers, what))
        for what, of in COMPARED.items()
    }
    console = Console(width=120)
    console.print(table_of(rows))
    console.print(methods_of(rows[next(iter(COMPARED))]))


if __name__ == "__main__":
    main()
