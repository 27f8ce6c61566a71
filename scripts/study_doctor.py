"""Whether the doctor leaves right recordings alone: 500 simulated ones of every capture, none of which has a fault.

Each has a mocap with noise and gaps, in every third correlated in time; levers of 0.1 to 20 m between the world's
origin and the bodies, axes turned at will; 12 to 80 frames; and in every fourth a motion about one axis, or without
turns, that tells little. In every fifth bodies are swapped in a twentieth of the frames: "gross views" may be right
there. Any other finding is a wrong word about a right recording.

    python scripts/study_doctor.py                # an hour and a half on two cores
    python scripts/study_doctor.py --runs 40
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from gtcal.doctor.diagnose import diagnose_recording
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording
from gtcal.simulation import MocapNoise, SimulationOptions, fixed_cameras_rig, quest3_like_rig, simulate

KINDS = {
    "tracked platform": (quest3_like_rig, Capture.TRACKED_PLATFORM),
    "standing board": (quest3_like_rig, Capture.STANDING_BOARD),
    "fixed cameras": (fixed_cameras_rig, Capture.FIXED_CAMERAS),
}
MOTIONS = ("free", "free", "free", "single_axis", "free", "free", "free", "translation")


@dataclass(frozen=True)
class Run:
    """Of one recording."""

    kind: str
    motion: str
    seed: int


def with_another_world(recording: Recording, rng: np.random.Generator) -> Recording:
    """Its origin 0.1 to 20 m away, its axes turned at will."""
    moved = np.eye(4)
    moved[:3, :3] = Rotation.random(rng=rng).as_matrix()
    away = rng.normal(size=3)
    moved[:3, 3] = np.geomspace(0.1, 20.0, 100)[rng.integers(100)] * away / np.linalg.norm(away)
    bodies = {
        name: replace(trajectory, world_T_body=moved @ trajectory.world_T_body)
        for name, trajectory in recording.motion.trajectories.items()
    }
    return replace(recording, **bodies)


def findings_of(run: Run) -> tuple[str, ...]:
    """What is said to be wrong with a right recording."""
    rng = np.random.default_rng(run.seed)
    rig, capture = KINDS[run.kind]
    options = SimulationOptions(
        rig=rig(),
        capture=capture,
        n_frames=int(np.geomspace(12, 80, 50)[rng.integers(50)]),
        duration_s=60.0,
        motion=run.motion,
        swap_share=0.05 if run.seed % 5 == 0 else 0.0,
        mocap=MocapNoise(
            translation_mm=0.2,
            rotation_deg=0.02,
            gap_share=0.05,
            correlation_s=0.5 if run.seed % 3 == 0 else 0.0,
        ),
    )
    found = diagnose_recording(with_another_world(simulate(options, seed=run.seed).recording, rng))
    unexplained = ("unexplained",) if found.unexplained else ()
    return (*(finding.fault for finding in found.findings), *unexplained)


def runs_of(count: int, seed: int) -> list[Run]:
    """By turns of each capture and motion."""
    kinds = list(KINDS)
    return [Run(kinds[i % len(kinds)], MOTIONS[i // len(kinds) % len(MOTIONS)], seed + i) for i in range(count)]


def table_of(runs: list[Run], said: list[tuple[str, ...]]) -> Table:
    """A row per capture and motion."""
    table = Table(title=f"the doctor on {len(runs)} recordings without a fault")
    for heading in ("capture", "motion"):
        table.add_column(heading)
    for heading in ("recordings", "with a finding"):
        table.add_column(heading, justify="right")
    table.add_column("said")
    for kind in KINDS:
        for motion in dict.fromkeys(MOTIONS):
            chosen = [one for run, one in zip(runs, said, strict=True) if (run.kind, run.motion) == (kind, motion)]
            if chosen:
                counts = Counter(fault for one in chosen for fault in one)
                words = ", ".join(f"{fault} ({n})" for fault, n in counts.most_common())
                table.add_row(kind, motion, str(len(chosen)), str(sum(map(bool, chosen))), words)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=500, help="recordings")
    parser.add_argument("--seed", type=int, default=70_000, help="of the first")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    runs = runs_of(arguments.runs, arguments.seed)
    said = list(in_parallel(findings_of, runs, arguments.workers, "examining"))
    Console(width=110).print(table_of(runs, said))


if __name__ == "__main__":
    main()
