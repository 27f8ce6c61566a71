"""Whether letting the intrinsics move, as the default does, is ever worse than holding them where they are stated.

Simulated headset recordings of 8 to 80 frames, and with an arm that errs in place of a mocap; lenses as stated, or off
by what a good and a usual calibration leaves. Each is calibrated with the intrinsics moving near what is stated (auto),
held with their sigmas counted (fixed), and held as exact. Printed are the mean error of the cameras' places, what is
claimed of it (the root of the covariance's trace), and the NEES per degree of freedom of all extrinsics, which is 1
where claims are true; and in how many recordings auto is nearer to the truth than fixed. Of recordings that are given,
whose truth is not known: the error of views that were held out.

    python scripts/study_lens_modes.py                         # ten minutes on two cores
    python scripts/study_lens_modes.py --runs 2 MY_RECORDING
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from study_coverage import NOISY, lens_off, tangent
from systematic import Spoil, joint_errors

from factors.rigid import inverse
from gtcal import Calibration, CalibrationOptions, GtcalError, calibrate, load_recording
from gtcal.estimation.options import IntrinsicsMode
from gtcal.simulation import Simulation, SimulationOptions, simulate

MODES: tuple[IntrinsicsMode, ...] = ("auto", "fixed", "exact")

LENSES: dict[str, SimulationOptions] = {
    "nothing": NOISY,
    "0.1 %, 1 px": lens_off(0.001, 1.0),
    "0.3 %, 3 px": lens_off(0.003, 3.0),
}
FRAMES = (8, 15, 40, 80)


@dataclass(frozen=True)
class Case:
    """Of simulated recordings that are alike."""

    lens: str
    n_frames: int
    spoil: Spoil | None = None
    size: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.n_frames}, arm" if self.spoil else str(self.n_frames)


CASES = (
    *(Case(lens, n_frames) for n_frames in FRAMES for lens in LENSES),
    *(Case(lens, 40, joint_errors, 0.5) for lens in LENSES),
)


@dataclass(frozen=True)
class Judged:
    """One calibration against the truth."""

    error_mm: float
    claimed_mm: float
    nees_per_dof: float


def judged(calibration: Calibration, simulation: Simulation) -> Judged:
    """Over its cameras."""
    errors, claims, nees = [], [], []
    for name, camera in calibration.cameras.items():
        estimate, truth = camera.camera_T_ref, simulation.truth.camera_T_ref[name]
        sigmas_mm = estimate.position_of_a_in_b_sigma_mm
        assert sigmas_mm is not None
        assert estimate.covariance is not None
        errors.append(1e3 * float(np.linalg.norm((inverse(estimate.a_T_b) - inverse(truth))[:3, 3])))
        claims.append(float(np.linalg.norm(sigmas_mm)))
        xi = tangent(estimate.a_T_b, truth)
        nees.append(float(xi @ np.linalg.solve(estimate.covariance, xi)) / 6.0)
    return Judged(float(np.mean(errors)), float(np.mean(claims)), float(np.mean(nees)))


def outcome(task: tuple[Case, int]) -> dict[str, Judged] | None:
    """By mode; None where a camera chances to see too little."""
    case, seed = task
    simulation = simulate(replace(LENSES[case.lens], n_frames=case.n_frames), seed=seed)
    recording = case.spoil(simulation, case.size) if case.spoil else simulation.recording
    try:
        return {
            mode: judged(calibrate(recording, CalibrationOptions(intrinsics=mode, clock="trust")), simulation)
            for mode in MODES
        }
    except GtcalError:
        return None


def table_of(found: dict[Case, list[dict[str, Judged]]]) -> Table:
    """A row per case."""
    table = Table(title="intrinsics that move, that are held, and that are taken as exact")
    for heading in ("frames", "lenses off by"):
        table.add_column(heading)
    columns = [f"{what} {mode}" for what in ("error, mm:", "claimed, mm:", "NEES:") for mode in MODES]
    for heading in ("n", *columns, "auto is nearer"):
        table.add_column(heading, justify="right")
    for case, outcomes in found.items():
        cells = [
            f"{np.mean([getattr(one[mode], name) for one in outcomes]):.3g}"
            for name in ("error_mm", "claimed_mm", "nees_per_dof")
            for mode in MODES
        ]
        nearer = f"{np.mean([one['auto'].error_mm <= one['fixed'].error_mm for one in outcomes]):.0%}"
        table.add_row(case.name, case.lens, str(len(outcomes)), *cells, nearer)
    return table


def table_of_given(recordings: list[Path]) -> Table:
    """The held-out error of each mode."""
    table = Table(title="error of views that were held out, px")
    table.add_column("recording")
    for mode in MODES:
        table.add_column(mode, justify="right")
    for path in recordings:
        cells = []
        for mode in MODES:
            try:
                noise = calibrate(load_recording(path), CalibrationOptions(intrinsics=mode, effects=False)).mocap_noise
                cells.append(f"{noise.hold_out_px[noise.stage]:.3f}" if noise else "no noise estimate")
            except GtcalError as error:
                cells.append(f"refused: {error}")
        table.add_row(path.name, *cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="*", help="real recordings, judged by what was held out")
    parser.add_argument("--runs", type=int, default=6, help="recordings of each kind")
    parser.add_argument("--seed", type=int, default=90_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    todo = [(case, arguments.seed + i) for case in CASES for i in range(arguments.runs)]
    outcomes = iter(in_parallel(outcome, todo, arguments.workers, "calibrating"))
    found = {case: [one for _ in range(arguments.runs) if (one := next(outcomes)) is not None] for case in CASES}
    console = Console(width=140)
    console.print(table_of(found))
    if arguments.recordings:
        console.print(table_of_given(arguments.recordings))


if __name__ == "__main__":
    main()
