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
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from factors.reprojection import residuals_px
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import corner_views
from gtcal.recordings.recording import Recording
from gtcal.simulation import MocapNoise, Simulation, SimulationOptions, simulate
from gtcal.workflow import calibrate

CHANGED_AT, CAMERA = 0.4, "front_left"
FRAMES, DURATION_S = 80, 60.0
AXIS = np.array([1.0, 0.5, -0.3]) / np.linalg.norm([1.0, 0.5, -0.3])

Spoil = Callable[[Simulation, float], Recording]


def _slip(body: str, *, turns: bool) -> Spoil:
    """The body's markers move by mm, or turn by deg."""

    def spoilt(simulation: Simulation, size: float) -> Recording:
        recording = simulation.recording
        trajectory = getattr(recording, body)
        moved = np.eye(4)
        if turns:
            moved[:3, :3] = Rotation.from_rotvec(np.deg2rad(size) * AXIS).as_matrix()
        else:
            moved[:3, 3] = 1e-3 * size * AXIS
        after = trajectory.stamps_ns > _changed_ns(recording)
        poses = trajectory.world_T_body.copy()
        poses[after] = poses[after] @ moved
        return replace(recording, **{body: replace(trajectory, world_T_body=poses)})

    return spoilt


def _turned_camera(simulation: Simulation, size: float) -> Recording:
    """A camera turns about its centre by deg."""
    recording, truth = simulation.recording, simulation.truth
    views = synchronise(recording).views[CAMERA]
    of_camera = truth.cameras[CAMERA]
    ref_T_body = of_camera.ref_T_body[of_camera.frames_of(views.stamps_ns)]
    camera_T_board = np.ascontiguousarray(of_camera.camera_T_ref @ ref_T_body @ truth.body_T_board)
    turned = camera_T_board.copy()
    after = views.stamps_ns > _changed_ns(recording)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(np.deg2rad(size) * AXIS).as_matrix()
    turned[after] = turn @ turned[after]
    corners, model, theta = corner_views(views), views.camera.model, views.camera.theta
    moved_px = residuals_px(corners, turned, model, theta) - residuals_px(corners, camera_T_board, model, theta)
    detections = recording.detections[CAMERA].select_views(
        np.isin(recording.detections[CAMERA].stamps_ns, views.stamps_ns)
    )
    seen = replace(detections, corners_px=detections.corners_px + np.nan_to_num(moved_px))
    return replace(recording, detections=recording.detections | {CAMERA: seen})


def _clock(*, drifts: bool) -> Spoil:
    """The cameras' stamps are ahead by ms, or gain us/s."""

    def spoilt(simulation: Simulation, size: float) -> Recording:
        recording = simulation.recording
        middle_ns = _stamps(recording).mean()
        detections = {}
        for name, found in recording.detections.items():
            ahead_ns = 1e-6 * size * (found.stamps_ns - middle_ns) if drifts else np.full(found.n_views, 1e6 * size)
            detections[name] = replace(found, stamps_ns=found.stamps_ns - np.rint(ahead_ns).astype(np.int64))
        return replace(recording, detections=detections)

    return spoilt


def _focal_length(simulation: Simulation, size: float) -> Recording:
    """A camera's focal length is larger than stated by %."""
    recording = simulation.recording
    theta = recording.cameras[CAMERA].theta.copy()
    theta[:2] /= 1.0 + 0.01 * size
    stated = replace(recording.cameras[CAMERA], parameters=theta)
    return replace(recording, cameras=recording.cameras | {CAMERA: stated})


def _scale(simulation: Simulation, size: float) -> Recording:
    """The board is larger than stated by %."""
    board, stated = simulation.recording.board, 1.0 / (1.0 + 0.01 * size)
    smaller = replace(board, tag_side_m=stated * board.tag_side_m, tag_gap_m=stated * board.tag_gap_m)
    return replace(simulation.recording, board=smaller)


def _stamps(recording: Recording) -> np.ndarray:
    return np.unique(np.concatenate([found.stamps_ns for found in recording.detections.values()]))


def _changed_ns(recording: Recording) -> int:
    stamps_ns = _stamps(recording)
    return int(stamps_ns[0] + CHANGED_AT * (stamps_ns[-1] - stamps_ns[0]))


@dataclass(frozen=True)
class Case:
    """An effect to put in. finding: what it is called when it is found; quantity: which of its numbers is the size."""

    spoil: Spoil
    finding: str
    quantity: int
    unit: str
    sizes: tuple[float, ...]


CASES = {
    "board's markers move": Case(
        _slip("board_body", turns=False), "board_body markers moved", 0, "mm", (0.2, 0.5, 2.0)
    ),
    "board's markers turn": Case(
        _slip("board_body", turns=True), "board_body markers moved", 1, "deg", (0.02, 0.05, 0.2)
    ),
    "platform's markers move": Case(_slip("platform", turns=False), "platform markers moved", 0, "mm", (0.2, 0.5, 2.0)),
    "platform's markers turn": Case(
        _slip("platform", turns=True), "platform markers moved", 1, "deg", (0.02, 0.05, 0.2)
    ),
    "a camera turns": Case(_turned_camera, f"camera {CAMERA} moved", 1, "deg", (0.01, 0.03, 0.2)),
    "clock offset": Case(_clock(drifts=False), "clock offset", 0, "ms", (0.1, 0.3, 2.0)),
    "clock drift": Case(_clock(drifts=True), "clock drift", 0, "us/s", (5.0, 20.0, 100.0)),
    "focal length": Case(_focal_length, f"focal length of {CAMERA}", 0, "%", (0.005, 0.02, 0.2)),
    "scale": Case(_scale, "scale", 0, "%", (0.02, 0.05, 0.3)),
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
    effects = calibrate(recording, CalibrationOptions(clock="trust")).effects
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
