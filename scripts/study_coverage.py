"""How far to trust a calibration's covariance: its claims against the truth, on simulated recordings.

Headset recordings with a moving board: with noise alone, intrinsics exact, in every second one refined under a weak
prior; and with systematic errors at the sizes that a lab meets, calibrated as by default. For each pose and each
camera's intrinsics: the squared error in units of the stated covariance (NEES) per degree of freedom, 1 where the
covariance is true, and how often the true value lies within the intervals that claim 50, 90 and 95 %, of each
component. Beside the default, what stage 3's naive and frame-clustered covariances give, and the mean error of stage 3
and stage 4.

    python scripts/study_coverage.py                # 1,600 recordings, an hour on two cores
    python scripts/study_coverage.py --runs 10      # of each scenario
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from scipy.stats import norm
from systematic import Spoil, bow, joint_errors, scale, slip, slow_drift

from factors.rigid import inverse
from gtcal import Calibration, CalibrationOptions, GtcalError, Recording, calibrate
from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.options import IntrinsicsMode
from gtcal.results.covariance import CLUSTERED, NAIVE, JointCovariance
from gtcal.simulation import CornerNoise, MocapNoise, Simulation, SimulationOptions, simulate
from gtcal.simulation.options import IntrinsicsError

WHITE = MocapNoise(translation_mm=0.2, rotation_deg=0.02)
OUTLIERS = CornerNoise(wrong_corner_share=0.05)
KEY_FRAMES = SimulationOptions(n_frames=80, duration_s=60.0, mocap=MocapNoise(0.0, 0.0))
DENSE = replace(KEY_FRAMES, n_frames=120, duration_s=12.0)


def lens_off(focal_share: float, centre_px: float) -> SimulationOptions:
    """The intrinsics that are stated are off by so much, 1-sigma."""
    error = IntrinsicsError(focal_share, centre_px, distortion_share=0.003)
    return replace(KEY_FRAMES, mocap=WHITE, intrinsics="perturbed", intrinsics_error=error)


SCENARIOS = {
    "pixel noise only": KEY_FRAMES,
    "white mocap noise": replace(KEY_FRAMES, mocap=WHITE),
    "correlated over 0.1 s": replace(DENSE, mocap=replace(WHITE, correlation_s=0.1)),
    "clock jitter": replace(KEY_FRAMES, mocap=MocapNoise(0.05, 0.005, jitter_s=0.001)),
    "outliers": replace(KEY_FRAMES, mocap=WHITE, corners=OUTLIERS, swap_share=0.05),
    "all of it": replace(
        DENSE, mocap=replace(WHITE, correlation_s=0.1, jitter_s=0.001), corners=OUTLIERS, swap_share=0.05
    ),
}
"""0.1 px of pixel noise in all of them. 80 key frames of a minute, or 120 frames at 10 Hz where correlation matters."""

NOISY = replace(KEY_FRAMES, mocap=WHITE)
SYSTEMATIC: dict[str, tuple[SimulationOptions, Spoil | None, float]] = {
    "lens 0.1 %, 1 px off": (lens_off(0.001, 1.0), None, 0.0),
    "lens 0.3 %, 3 px off": (lens_off(0.003, 3.0), None, 0.0),
    "lens 0.7 %, 3 px off": (lens_off(0.007, 3.0), None, 0.0),
    "print 0.2 % too large": (NOISY, scale, 0.2),
    "board bowed by 0.5 mm": (NOISY, bow, 0.5),
    "platform creeps by 0.3 mm": (NOISY, slow_drift("platform"), 0.3),
    "platform slips by 0.5 mm": (NOISY, slip("platform"), 0.5),
    "arm, joints 0.5 mm": (NOISY, joint_errors, 0.5),
    "8 frames": (replace(NOISY, n_frames=8), None, 0.0),
    "20 frames": (replace(NOISY, n_frames=20), None, 0.0),
}
"""What to simulate, what then goes wrong, and its size; with white mocap noise in all of them."""

LEVELS = (0.50, 0.90, 0.95)
DEFAULT = "default"


@dataclass(frozen=True)
class Run:
    """One recording."""

    scenario: str
    seed: int

    @property
    def intrinsics(self) -> IntrinsicsMode:
        """How they are treated."""
        if self.scenario in SYSTEMATIC:
            return "auto"
        return "refine" if self.seed % 2 else "exact"

    def recorded(self) -> tuple[Simulation, Recording]:
        """The recording, and what it was before something went wrong."""
        if self.scenario in SCENARIOS:
            simulation = simulate(SCENARIOS[self.scenario], seed=self.seed)
            return simulation, simulation.recording
        options, spoil, size = SYSTEMATIC[self.scenario]
        simulation = simulate(options, seed=self.seed)
        return simulation, spoil(simulation, size) if spoil else simulation.recording


@dataclass(frozen=True)
class Deviation:
    """How far a pose or a camera's intrinsics are from the truth, in the units of one covariance.

    what: 'X', 'Y' or 'theta'. kind: of the covariance. z: of each component."""

    run: Run
    what: str
    camera: str
    kind: str
    nees_per_dof: float
    z: FloatArray


@dataclass(frozen=True)
class Outcome:
    """Of one recording. stage: that the default took. position_errors_mm: mean over the cameras, of stages 3 and 4."""

    run: Run
    stage: int
    deviations: tuple[Deviation, ...]
    position_errors_mm: dict[int, float]


def outcome(run: Run) -> Outcome | None:
    """Simulate, calibrate and compare; None where the recording is refused: a camera chances to see too
    little."""
    simulation, recording = run.recorded()
    options = CalibrationOptions(intrinsics=run.intrinsics, clock="trust")
    try:
        found = calibrate(recording, options)
    except GtcalError:
        return None
    stage = found.mocap_noise.stage if found.mocap_noise else 3
    kinds = [(DEFAULT, stage, found.covariance_kind), (NAIVE, 3, NAIVE), (CLUSTERED, 3, CLUSTERED)]
    deviations = [
        deviation
        for name, of_stage, kind in kinds
        if kind in found.covariances
        for deviation in _deviations(run, simulation, found.estimates[of_stage], found.covariances[kind], name)
    ]
    return Outcome(run, stage, tuple(deviations), _position_errors_mm(found, simulation))


def _deviations(
    run: Run, simulation: Simulation, estimate: Estimate, covariance: JointCovariance, kind: str
) -> Iterator[Deviation]:
    truth = simulation.truth
    yield _deviation(run, "X", "", kind, tangent(estimate.body_T_board, truth.body_T_board), covariance.body_T_board)
    for name, pose in estimate.camera_T_ref.items():
        xi = tangent(pose, truth.camera_T_ref[name])
        yield _deviation(run, "Y", name, kind, xi, covariance.camera_T_ref(name))
        of_theta = covariance.theta(name)
        if of_theta is not None:
            yield _deviation(run, "theta", name, kind, truth.intrinsics[name] - estimate.theta[name], of_theta)


def tangent(found_T: FloatArray, true_T: FloatArray) -> FloatArray:
    return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(inverse(found_T) @ true_T)))


def _deviation(run: Run, what: str, camera: str, kind: str, error: FloatArray, covariance: FloatArray) -> Deviation:
    sigmas = np.sqrt(np.diag(covariance))
    z = error / sigmas
    nees = z @ np.linalg.solve(covariance / np.outer(sigmas, sigmas), z)
    return Deviation(run, what, camera, kind, float(nees) / len(z), z)


def _position_errors_mm(found: Calibration, simulation: Simulation) -> dict[int, float]:
    true_m = {name: inverse(pose)[:3, 3] for name, pose in simulation.truth.camera_T_ref.items()}
    return {
        stage: float(
            np.mean([1e3 * np.linalg.norm(inverse(T)[:3, 3] - true_m[n]) for n, T in estimate.camera_T_ref.items()])
        )
        for stage, estimate in found.estimates.items()
    }


def study(runs: int, seed: int, workers: int | None) -> list[Outcome]:
    """All scenarios, ``runs`` recordings each."""
    todo = [Run(scenario, seed + i) for scenario in (*SCENARIOS, *SYSTEMATIC) for i in range(runs)]
    return [found for found in in_parallel(outcome, todo, workers, "calibrating") if found is not None]


def tables(outcomes: list[Outcome]) -> Iterator[Table]:
    """By scenario; by unknown; by camera; and the accuracy."""
    deviations = [deviation for result in outcomes for deviation in result.deviations]
    yield _claims("by scenario", deviations, lambda d: (d.run.scenario, _intrinsics(d)))
    yield _claims("by unknown", deviations, lambda d: (f"{d.what} {d.camera}".strip(), _intrinsics(d)))
    accuracy = Table(title="mean error of a camera's position, mm")
    for heading in ("scenario", "recordings", "stage 4 taken", "stage 3", "stage 4"):
        accuracy.add_column(heading, justify="left" if heading == "scenario" else "right")
    for scenario in (*SCENARIOS, *SYSTEMATIC):
        of_it = [result for result in outcomes if result.run.scenario == scenario]
        if of_it:
            both = [result.position_errors_mm for result in of_it if 4 in result.position_errors_mm]
            errors = [f"{np.mean([errors[stage] for errors in both]):.3f}" for stage in (3, 4)]
            accuracy.add_row(scenario, str(len(of_it)), str(sum(r.stage == 4 for r in of_it)), *errors)
    yield accuracy


def _intrinsics(deviation: Deviation) -> str:
    return deviation.run.intrinsics


def _claims(title: str, deviations: list[Deviation], group_of: Callable[[Deviation], tuple[str, str]]) -> Table:
    table = Table(title=f"stated against true, {title}")
    for heading in ("", "intrinsics"):
        table.add_column(heading)
    for heading in ("NEES/dof", "within 50 %", "90 %", "95 %", "naive NEES/dof", "95 %", "clustered NEES/dof", "95 %"):
        table.add_column(heading, justify="right")
    groups: dict[tuple[str, str], list[Deviation]] = {}
    for deviation in deviations:
        groups.setdefault(group_of(deviation), []).append(deviation)
    for group in (*groups, None):
        of_group = deviations if group is None else groups[group]
        by_kind = {kind: [d for d in of_group if d.kind == kind] for kind in (DEFAULT, NAIVE, CLUSTERED)}
        cells = [_nees(by_kind[DEFAULT]), *(_within(by_kind[DEFAULT], level) for level in LEVELS)]
        for kind in (NAIVE, CLUSTERED):
            cells += [_nees(by_kind[kind]), _within(by_kind[kind], LEVELS[-1])]
        table.add_row(*(group or ("all", "")), *cells, end_section=group == list(groups)[-1])
    return table


def nees_per_dof(deviations: list[Deviation]) -> tuple[float, float]:
    """Mean, and its standard error over recordings: the unknowns of one err together."""
    weights = np.array([len(d.z) for d in deviations], dtype=float)
    values = np.array([d.nees_per_dof for d in deviations])
    _, recording = np.unique([f"{d.run.scenario} {d.run.seed}" for d in deviations], return_inverse=True)
    sums, sizes = np.bincount(recording, weights * values), np.bincount(recording, weights)
    mean = sums.sum() / sizes.sum()
    return float(mean), float(np.sqrt(((sums - mean * sizes) ** 2).sum()) / sizes.sum())


def coverage(deviations: list[Deviation], level: float) -> float:
    """Share of the components whose true value lies within the interval of this probability."""
    z = np.abs(np.concatenate([d.z for d in deviations]))
    return float((z < norm.ppf(0.5 + 0.5 * level)).mean())


def _nees(deviations: list[Deviation]) -> str:
    if not deviations:
        return "-"
    mean, error = nees_per_dof(deviations)
    return f"{mean:.2f} ± {error:.2f}" if mean < 9.5 else f"{mean:.0f} ± {error:.0f}"


def _within(deviations: list[Deviation], level: float) -> str:
    return f"{coverage(deviations, level):.1%}" if deviations else "-"


def main() -> None:
    arguments = _arguments()
    outcomes = study(arguments.runs, arguments.seed, arguments.workers)
    console = Console(width=140)
    refused = arguments.runs * (len(SCENARIOS) + len(SYSTEMATIC)) - len(outcomes)
    console.print(f"{len(outcomes)} recordings, and {refused} that a calibration refused as not determining all of it")
    for table in tables(outcomes):
        console.print(table)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100, help="recordings of each scenario")
    parser.add_argument("--seed", type=int, default=20_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    return parser.parse_args()


if __name__ == "__main__":
    main()
