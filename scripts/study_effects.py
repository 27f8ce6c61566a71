"""What the search for effects finds: power by size, false alarms, and whether sizes are within their sigmas.

Simulated headset recordings with a noisy mocap, correlated in time in every third, each with one effect of a known size
put in at 40 % of its time (changes) or all the time. Power: the share of recordings in which that effect, by its name,
is said to be no chance. NEES: the mean square of (found - true) / sigma where the effect is said to be there, which is
1 where sigmas are true. False alarms: recordings without any effect in which one is found.

    python scripts/study_effects.py                 # ten minutes on two cores
    python scripts/study_effects.py --runs 4 --clean 20
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from systematic import CAMERA, Spoil, clock, focal_length, scale, slip, turned_camera

from gtcal.estimation.options import CalibrationOptions
from gtcal.simulation import MocapNoise, SimulationOptions, simulate
from gtcal.workflow import calibrate

FRAMES, DURATION_S = 80, 60.0


@dataclass(frozen=True)
class Case:
    """An effect to put in. finding: what it is called when it is found; quantity: which of its numbers is the size."""

    spoil: Spoil
    finding: str
    quantity: int
    unit: str
    sizes: tuple[float, ...]


CASES = {
    "board's markers move": Case(slip("board_body"), "board_body markers moved", 0, "mm", (0.2, 0.5, 2.0)),
    "board's markers turn": Case(
        slip("board_body", turns=True), "board_body markers moved", 1, "deg", (0.02, 0.05, 0.2)
    ),
    "platform's markers move": Case(slip("platform"), "platform markers moved", 0, "mm", (0.2, 0.5, 2.0)),
    "platform's markers turn": Case(
        slip("platform", turns=True), "platform markers moved", 1, "deg", (0.02, 0.05, 0.2)
    ),
    "a camera turns": Case(turned_camera, f"camera {CAMERA} moved", 1, "deg", (0.01, 0.03, 0.2)),
    "clock offset": Case(clock(drifts=False), "clock offset", 0, "ms", (0.1, 0.3, 2.0)),
    "clock drift": Case(clock(drifts=True), "clock drift", 0, "us/s", (5.0, 20.0, 100.0)),
    "focal length": Case(focal_length, f"focal length of {CAMERA}", 0, "%", (0.005, 0.02, 0.2)),
    "scale": Case(scale, "scale", 0, "%", (0.02, 0.05, 0.3)),
}


@dataclass(frozen=True)
class Run:
    """case None: a clean recording."""

    case: str | None
    size: float
    seed: int


@dataclass(frozen=True)
class Outcome:
    """found: whether the effect was said to be there. deviation: (found - true) / sigma. others: what else was said."""

    found: bool
    deviation: float
    others: tuple[str, ...]


def outcome(run: Run) -> Outcome:
    noise = MocapNoise(translation_mm=0.2, rotation_deg=0.02, correlation_s=0.5 if run.seed % 3 == 0 else 0.0)
    simulation = simulate(SimulationOptions(n_frames=FRAMES, duration_s=DURATION_S, mocap=noise), seed=run.seed)
    case = CASES[run.case] if run.case else None
    recording = case.spoil(simulation, run.size) if case else simulation.recording
    # what the default solves for (lenses, the board's shape) is no effect there, so sizes are looked for without
    options = CalibrationOptions(clock="trust", intrinsics="exact" if case else "auto")
    effects = calibrate(recording, options).effects
    said = [finding for finding in effects if finding.significant]
    own = [finding for finding in said if case and finding.name == case.finding]
    others = tuple(finding.name for finding in said if finding not in own[:1])
    if not (case and own):
        return Outcome(False, float("nan"), others)
    quantity = own[0].estimate[case.quantity]
    return Outcome(True, (quantity.value - run.size) / quantity.sigma, others)


def study(runs: int, clean: int, seed: int, workers: int | None) -> dict[tuple[str | None, float], list[Outcome]]:
    """By case and size, the outcomes; of clean recordings under None."""
    kinds = {(name, size): runs for name, case in CASES.items() for size in case.sizes} | {(None, 0.0): clean}
    todo = [Run(*kind, seed + i) for kind, count in kinds.items() for i in range(count)]
    found = iter(in_parallel(outcome, todo, workers, "calibrating"))
    return {kind: [next(found) for _ in range(count)] for kind, count in kinds.items()}


def table_of(found: dict[tuple[str | None, float], list[Outcome]]) -> Table:
    """A row per effect and size, and one for the clean recordings."""
    table = Table(title="effects: size against power, and whether sizes are within their sigmas")
    table.add_column("effect")
    for heading in ("size", "found", "NEES", "something else said"):
        table.add_column(heading, justify="right")
    for (name, size), outcomes in found.items():
        deviations = np.array([one.deviation for one in outcomes if one.found])
        nees = f"{np.mean(deviations**2):.2f}" if len(deviations) else ""
        share = f"{np.mean([one.found for one in outcomes]):.0%}" if name else ""
        others = f"{np.mean([bool(one.others) for one in outcomes]):.1%}"
        label = name or f"none, {len(outcomes)} recordings"
        table.add_row(label, f"{size:g} {CASES[name].unit}" if name else "", share, nees, others)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="recordings of each effect and size")
    parser.add_argument("--clean", type=int, default=300, help="recordings without an effect")
    parser.add_argument("--seed", type=int, default=50_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    Console(width=120).print(table_of(study(arguments.runs, arguments.clean, arguments.seed, arguments.workers)))


if __name__ == "__main__":
    main()
