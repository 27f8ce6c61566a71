"""Where no chain fits: would the data agree under another reading of the trajectories?

The alignment of stage 1 costs the same for any number of views, so each suspicion is simply tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.estimation.alignment import GuideViews, stage_1
from gtcal.estimation.observations import Observations
from gtcal.estimation.pnp import solve_pnp
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.trajectory import Trajectory, poses_from_quaternions, quaternions_from_poses

CONVINCING = 0.25
"""A reading is the likely truth where it leaves a quarter of the misalignment, or less."""


@dataclass(frozen=True)
class Suspicion:
    """Another reading of a trajectory. fix: what to change in the manifest, with {body} for the body's entry."""

    fix: str
    reread: Callable[[FloatArray], FloatArray]


def _as_wxyz(world_T_body: FloatArray) -> FloatArray:
    columns = quaternions_from_poses(world_T_body, "xyzw")
    return poses_from_quaternions(columns, "wxyz", world_T_body[:, :3, 3])


def _as_xyzw(world_T_body: FloatArray) -> FloatArray:
    columns = quaternions_from_poses(world_T_body, "wxyz")
    return poses_from_quaternions(columns, "xyzw", world_T_body[:, :3, 3])


def _scaled(factor: float) -> Callable[[FloatArray], FloatArray]:
    return lambda world_T_body: world_T_body * np.array([[1.0, 1.0, 1.0, factor]] * 3 + [[1.0] * 4])


SUSPICIONS = (
    Suspicion("set {body}.quaternion: wxyz", _as_wxyz),
    Suspicion("set {body}.quaternion: xyzw", _as_xyzw),
    Suspicion("set {body}.pose: body_T_world (or world_T_body, if that is what it says)", inverse),
    Suspicion("set {body}.length_unit: mm", _scaled(1e-3)),
    Suspicion("set {body}.length_unit: m", _scaled(1e3)),
)


def likely_mistake(observations: Observations, *, seed: int, max_views: int) -> str:
    """What to change in the manifest so that the data agree, with the evidence; empty where nothing helps."""
    guides = {
        name: GuideViews.of(views, solve_pnp(views, max_views=max_views)) for name, views in observations.views.items()
    }
    stated_m = _misalignment_m(guides, observations.motion, seed)
    tried = [(_misalignment_m(guides, motion, seed), fix) for fix, motion in _readings(observations.motion)]
    best_m, fix = min(tried)
    if best_m > CONVINCING * stated_m:
        return ""
    return f"they agree to {1e3 * best_m:.1f} mm instead of {1e3 * stated_m:.1f} mm if you {fix} in the manifest"


def _readings(motion: RefMotion) -> Iterator[tuple[str, RefMotion]]:
    """Other readings of the trajectories, each with what to change in the manifest."""
    for suspicion in SUSPICIONS:
        for size in range(1, len(motion.trajectories) + 1):
            for bodies in combinations(motion.trajectories, size):
                fixes = " and ".join(suspicion.fix.format(body=body) for body in bodies)
                yield fixes, _reread(motion, bodies, suspicion)
    if len(motion.trajectories) == 2:
        swapped = replace(motion, platform=motion.board_body, board_body=motion.platform)
        yield "swap the trajectories of platform and board_body", swapped


def _reread(motion: RefMotion, bodies: tuple[str, ...], suspicion: Suspicion) -> RefMotion:
    def other(name: str, trajectory: Trajectory | None) -> Trajectory | None:
        if trajectory is None or name not in bodies:
            return trajectory
        return replace(trajectory, world_T_body=suspicion.reread(trajectory.world_T_body))

    return replace(
        motion, platform=other("platform", motion.platform), board_body=other("board_body", motion.board_body)
    )


def _misalignment_m(guides: Mapping[str, GuideViews], motion: RefMotion, seed: int) -> float:
    """Median over the guiding views of the rms distance between chain and PnP, after stage 1."""
    reread = {
        name: replace(guide, views=replace(guide.views, ref_T_body=motion.at(guide.views.stamps_ns).ref_T_body))
        for name, guide in guides.items()
    }
    estimate = stage_1(reread, np.random.default_rng(seed)).estimate
    distances = [
        guide.rms_m(estimate.camera_T_ref[name], estimate.body_T_board).min(axis=1) for name, guide in reread.items()
    ]
    return float(np.median(np.concatenate(distances)))
