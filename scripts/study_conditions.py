"""Whether stages 1 and 2 find the right basin whatever the levers, the turns, the number of views and what is wrong.

Each run draws a recording at the level of poses: one to four cameras, a lever between the world's origin and the board
and one between a body and its markers (0.1 to 20 m), turns of 5 to 180 deg, 3 to 300 views a camera, and in half of the
runs up to 45 % of the frames wrong: all by one shift, swapped with another frame's pose, or the board seen turned by
half a turn. PnP errs as it does on boards (0.1 deg, 0.3 % of the depth), the mocap by 0.3 mm and 0.02 deg. A run is in
the right basin where descents on the good views, from what it found and from the truth, end at the same minimum.

    python scripts/study_conditions.py
    python scripts/study_conditions.py --runs 200 --sweep paper
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from factors import KANNALA_BRANDT4
from factors.alignment import corner_moments
from factors.board_shape import outline_of
from factors.rigid import inverse
from gtcal.board_tolerance import BoardTolerance
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.estimation.alignment import GuideViews, stage_1
from gtcal.estimation.alignment_descent import descend
from gtcal.estimation.observations import Views
from gtcal.estimation.options import SweepMode
from gtcal.estimation.procrustes import AlignmentSums, alignment_sums
from gtcal.simulation.transforms import transform

WRONGS = ("none", "one shift", "swapped frames", "half a turn")
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
SAME = 1.0 + 1e-6
ROUNDING = 1e-14
"""Of the terms of E_3D, which are squares of levers, the sum is of squares of errors."""

BOARD_M, N_CORNERS = (0.3, 0.2), 30
MOCAP_M, MOCAP_RAD = 3e-4, np.deg2rad(0.02)
PNP_RAD, PNP_DEPTH = np.deg2rad(0.1), 3e-3


@dataclass(frozen=True)
class Conditions:
    """Of one run. lever_m: of the world; turn_deg: the largest; share: of the frames that are wrong."""

    seed: int
    n_cameras: int
    lever_m: float
    body_lever_m: float
    turn_deg: float
    n_views: int
    wrong: str
    share: float


@dataclass(frozen=True)
class Outcome:
    """Where a run ended. ratio: the typical distance of the good corners at the minimum below it over that at the
    minimum below the truth. rounding: of that, by which one minimum may differ from itself."""

    conditions: Conditions
    ratio: float
    rounding: float
    n_steps: int
    seconds: float

    @property
    def right(self) -> bool:
        return self.ratio < SAME + self.rounding


def drawn(seed: int) -> Conditions:
    rng = np.random.default_rng(seed)
    lever_m, body_lever_m = np.exp(rng.uniform(np.log(0.1), np.log(20.0), 2))
    n_views = round(float(np.exp(rng.uniform(np.log(3.0), np.log(300.0)))))
    # of few frames a majority of good ones is chance: what is wrong is drawn where there are ten or more
    wrong = WRONGS[int(rng.integers(1, len(WRONGS)))] if n_views >= 10 and rng.random() < 0.5 else "none"
    return Conditions(
        seed,
        int(rng.integers(1, 5)),
        float(lever_m),
        float(body_lever_m),
        float(np.exp(rng.uniform(np.log(5.0), np.log(180.0)))),
        n_views,
        wrong,
        float(rng.uniform(0.0, 0.45)) if wrong != "none" else 0.0,
    )


def outcome(conditions: Conditions, sweep: SweepMode) -> Outcome:
    """Of one run."""
    views, truth, good = recording(conditions)
    started = time.perf_counter()
    found = stage_1(views, np.random.default_rng(conditions.seed), method=sweep)
    seconds = time.perf_counter() - started
    chain = [found.estimate.camera_T_ref[name] for name in views], found.estimate.body_T_board
    sums = sums_of(views, good)
    at_truth_m2 = minimum_m2(sums, truth)
    ratio = float(np.sqrt(minimum_m2(sums, chain) / at_truth_m2))
    rounding = ROUNDING * sum(s.constant for s in sums) / at_truth_m2
    return Outcome(conditions, ratio, rounding, found.sweep.n_steps, seconds)


Chain = tuple[list[FloatArray], FloatArray]


def recording(conditions: Conditions) -> tuple[dict[str, GuideViews], Chain, BoolArray]:
    """The views by camera, the true chain, and which frames are good."""
    rng = np.random.default_rng([1, conditions.seed])
    n = conditions.n_views
    middle_m = np.array([0.0, 0.0, rng.uniform(0.5, 2.0)])
    ref_T_board = transform(_turns(rng, n, conditions.turn_deg), rng.normal(0.0, 0.2, (n, 3)) + middle_m)
    body_T_board = _placed(rng, conditions.body_lever_m)
    world_T_ref = _placed(rng, conditions.lever_m)
    ref_T_body = world_T_ref @ ref_T_board @ inverse(body_T_board)
    measured = ref_T_body @ transform(
        Rotation.from_rotvec(MOCAP_RAD * rng.normal(size=(n, 3))), MOCAP_M * rng.normal(size=(n, 3))
    )
    good = np.ones(n, dtype=bool)
    good[rng.permutation(n)[: int(conditions.share * n)]] = False
    if conditions.wrong == "one shift":
        measured[~good] = measured[~good] @ _placed(rng, 0.4, turn=False)
    elif conditions.wrong == "swapped frames":
        measured[~good] = measured[rng.permutation(np.flatnonzero(~good))]
    views, cameras = {}, []
    for c in range(conditions.n_cameras):
        camera_T_world = transform(Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)), rng.normal(0.0, 0.1, 3)) @ inverse(
            world_T_ref
        )
        views[f"cam{c}"] = _seen(f"cam{c}", rng, camera_T_world, ref_T_body @ body_T_board, measured, conditions, good)
        cameras.append(camera_T_world)
    return views, (cameras, body_T_board), good


def _turns(rng: np.random.Generator, n: int, turn_deg: float) -> Rotation:
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Rotation.from_rotvec(np.deg2rad(turn_deg) * rng.uniform(0.0, 1.0, (n, 1)) * directions)


def _placed(rng: np.random.Generator, lever_m: float, *, turn: bool = True) -> FloatArray:
    direction = rng.normal(size=3)
    rotation = Rotation.random(rng=rng) if turn else Rotation.identity()
    return np.asarray(transform(rotation, lever_m * direction / np.linalg.norm(direction)))


def _seen(
    name: str,
    rng: np.random.Generator,
    camera_T_world: FloatArray,
    world_T_board: FloatArray,
    measured: FloatArray,
    conditions: Conditions,
    good: BoolArray,
) -> GuideViews:
    """What a camera's PnP makes of the true poses; its second pose is the first tilted the other way."""
    n = len(measured)
    camera_T_board = camera_T_world @ world_T_board
    depth = 1.0 + PNP_DEPTH * rng.normal(size=(n, 1))
    seen = camera_T_board @ transform(Rotation.from_rotvec(PNP_RAD * rng.normal(size=(n, 3))), np.zeros((n, 3)))
    seen[:, :3, 3] = camera_T_board[:, :3, 3] * depth
    if conditions.wrong == "half a turn":
        seen[~good] = seen[~good] @ HALF_TURN
    tilted = seen @ transform(Rotation.from_rotvec(np.deg2rad([20.0, 10.0, 0.0])), np.zeros(3))
    corners_m = np.c_[rng.uniform(-0.5, 0.5, (N_CORNERS, 2)) * BOARD_M, np.zeros(N_CORNERS)]
    view_start = N_CORNERS * np.arange(n + 1)
    views = Views(
        stamps_ns=np.arange(n),
        view_start=view_start,
        corner_ids=np.tile(np.arange(N_CORNERS), n),
        corners_px=np.zeros((n * N_CORNERS, 2)),
        camera=Camera(name, KANNALA_BRANDT4, np.array([500.0, 500.0, 640.0, 512.0, 0.0, 0.0, 0.0, 0.0]), 1280, 1024),
        frame_index=np.arange(n),
        ref_T_body=measured,
        corners_m=np.tile(corners_m, (n, 1)),
        outline_m=outline_of(corners_m),
        shape_sigmas=BoardTolerance().shape_sigmas(outline_of(corners_m)),
    )
    moments = corner_moments(view_start, views.corners_m)
    return GuideViews(views, np.stack([seen, tilted], axis=1), np.full(n, 0.1), moments)


def sums_of(views: dict[str, GuideViews], good: BoolArray) -> list[AlignmentSums]:
    """Of the good views, by camera."""
    return [
        alignment_sums(v.views.ref_T_body[good], v.pnp_camera_T_board[good, 0], v.corner_moments[good])
        for v in views.values()
    ]


def minimum_m2(sums: list[AlignmentSums], start: Chain) -> float:
    """E_3D at the minimum below a chain."""
    return float(descend(sums, np.stack(start[0])[None], start[1][None]).energy_m2[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10_000, help="recordings (%(default)s)")
    parser.add_argument("--sweep", choices=("converged", "paper"), default="converged", help="of stage 1 (%(default)s)")
    parser.add_argument("--workers", type=int, default=None, help="processes (as many as cores)")
    arguments = parser.parse_args()
    runs = [drawn(seed) for seed in range(arguments.runs)]
    outcomes = list(in_parallel(partial(outcome, sweep=arguments.sweep), runs, arguments.workers, "recordings"))
    console = Console()
    console.print(table_of(outcomes))
    wrong = [found.conditions for found in outcomes if not found.right]
    for conditions in wrong[:10]:
        console.print(f"wrong: {conditions}")
    if wrong:
        console.print(f"wrong by what was spoilt: {dict(Counter(conditions.wrong for conditions in wrong))}")


def table_of(outcomes: list[Outcome]) -> Table:
    """A row for each thing that may be wrong, and one for all."""
    table = Table(title="the right basin, whatever the conditions")
    for heading in ("wrong", "runs", "right basin", "steps, median", "at most", "s, median", "at most"):
        table.add_column(heading, justify="left" if heading == "wrong" else "right")
    for wrong in (*WRONGS, "all"):
        chosen = [found for found in outcomes if wrong in (found.conditions.wrong, "all")]
        if chosen:
            steps, seconds = [found.n_steps for found in chosen], [found.seconds for found in chosen]
            table.add_row(
                wrong,
                f"{len(chosen):,}",
                f"{sum(found.right for found in chosen):,}",
                f"{np.median(steps):.0f}",
                f"{max(steps)}",
                f"{np.median(seconds):.3f}",
                f"{max(seconds):.3f}",
            )
    return table


if __name__ == "__main__":
    main()
