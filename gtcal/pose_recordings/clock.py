"""The offset of the cameras' clock, from poses: a first guess by their turns, then as one more unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtcal.clock.coarse import offset_of_turns_s, turns_between
from gtcal.clock.find import DISAGREES_S, DISAGREES_SIGMAS, SETTLED_S, SUSPECT_SIGMAS
from gtcal.clock.offset import middle_ns
from gtcal.effects.evidence import Sums
from gtcal.effects.timing import ClockDrift, ClockOffset
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Dropped
from gtcal.estimation.pose_joint import PoseChain, PoseViews
from gtcal.pose_recordings.frames import pose_frames
from gtcal.progress import Progress, silent
from gtcal.recordings.capture import RefMotion
from gtcal.results.calibration import Clock

Views = Mapping[str, PoseViews]
Solve = Callable[[Views], PoseChain]

_MOST_ROUNDS = 8


@dataclass(frozen=True)
class _Times:
    """What is to be added to the stamps of cameras that share a clock."""

    offset_s: float
    sigma_s: float = np.inf
    drift: float = 0.0
    drift_sigma: float = 0.0


def with_pose_clock(
    views: Views, motion: RefMotion, solve: Solve, *, per_camera: bool, drift: bool, progress: Progress = silent
) -> tuple[dict[str, PoseViews], Clock, tuple[Dropped, ...]]:
    """The poses at the corrected times, the offsets, and what has no mocap pose then. solve: the chain of some cameras'
    poses.

    Raises GtcalError where the motion does not tell."""
    groups = [[name] for name in views] if per_camera else [list(views)]
    about_ns = middle_ns(views)
    found: dict[str, _Times] = {}
    for done, names in enumerate(groups):
        progress("clock offset", done, len(groups))
        own = {name: views[name] for name in names}
        found |= dict.fromkeys(names, _found(own, motion, solve, about_ns, drift=drift))
    progress("clock offset", len(groups), len(groups))
    first = next(iter(found.values()))
    clock = Clock(
        {name: times.offset_s for name, times in found.items()},
        {name: times.sigma_s for name, times in found.items()},
        corrected=True,
        drift=first.drift,
        drift_sigma=first.drift_sigma,
        middle_ns=about_ns,
    )
    moved, dropped = shifted_poses(views, motion, clock)
    return moved, clock, dropped


def tested_pose_clock(views: Views, motion: RefMotion, chain: PoseChain, solve: Solve) -> tuple[Clock | None, str]:
    """What the poses want of the clock though it was trusted, and a warning where that contradicts it, or nothing."""
    about_ns = middle_ns(views)
    try:
        found = _left(views, motion, chain, about_ns, drift=False)
        if _disagrees(found, SUSPECT_SIGMAS):
            found = _found(views, motion, solve, about_ns, drift=False)
    except (GtcalError, np.linalg.LinAlgError):
        return None, ""
    clock = Clock(dict.fromkeys(views, found.offset_s), dict.fromkeys(views, found.sigma_s), corrected=False)
    if not _disagrees(found, DISAGREES_SIGMAS):
        return clock, ""
    return clock, (
        f"the data want {clock.statement} added to the cameras' stamps, but the recording is taken as synchronised: "
        "--clock estimate finds the offset and corrects it"
    )


def shifted_poses(views: Views, motion: RefMotion, clock: Clock) -> tuple[dict[str, PoseViews], tuple[Dropped, ...]]:
    """The poses with their stamps on the mocap's clock, and its poses of those times; and what has none.

    Raises GtcalError where a camera keeps fewer than three."""
    kept: dict[str, PoseViews] = {}
    dropped: list[Dropped] = []
    for name, v in views.items():
        stamps_ns = clock.mocap_ns(name, v.stamps_ns)
        at = motion.at(stamps_ns)
        if at.ok.sum() < 3:
            raise GtcalError(f"camera {name!r}: {int(at.ok.sum())} of its poses have a mocap pose at the shifted time")
        if not at.ok.all():
            dropped.append(Dropped(name, "no mocap pose at the shifted time", int((~at.ok).sum()), 0))
        covariance = None if v.covariance is None else v.covariance[at.ok]
        kept[name] = PoseViews(
            stamps_ns[at.ok], v.frame_index[at.ok], at.ref_T_body[at.ok], v.camera_T_board[at.ok], covariance
        )
    frames = np.unique(np.concatenate([v.stamps_ns for v in kept.values()]))
    indexed = {name: replace(v, frame_index=np.searchsorted(frames, v.stamps_ns)) for name, v in kept.items()}
    return indexed, tuple(dropped)


def _found(views: Views, motion: RefMotion, solve: Solve, about_ns: int, *, drift: bool) -> _Times:
    turns = [turns_between(v.stamps_ns, v.camera_T_board) for v in views.values()]
    times = _Times(offset_of_turns_s(turns, motion))
    for _ in range(_MOST_ROUNDS):
        clock = Clock(dict.fromkeys(views, times.offset_s), {}, True, times.drift, 0.0, about_ns)
        moved, _ = shifted_poses(views, motion, clock)
        left = _left(moved, motion, solve(moved), about_ns, drift=drift)
        step_s = left.offset_s
        times = replace(left, offset_s=times.offset_s + left.offset_s, drift=times.drift + left.drift)
        if abs(step_s) < SETTLED_S:
            break
    return times


def _left(views: Views, motion: RefMotion, chain: PoseChain, about_ns: int, *, drift: bool) -> _Times:
    """What the poses want of their stamps beyond the times that they are taken at."""
    frames = pose_frames(views, motion, chain)
    if frames is None:
        raise GtcalError("too few poses to find the clock offset from: film more, or synchronise the clocks")
    sums = Sums.of(frames, [ClockOffset(), *([ClockDrift()] if drift else [])])
    offset = sums.evidence(0, [1] if drift else [])
    sigma_s = float(np.sqrt(offset.covariance[0, 0]))
    if not np.isfinite(sigma_s) or sigma_s > 1.0:
        raise GtcalError("the motion does not tell the clock offset: move faster")
    if not drift:
        return _Times(float(offset.estimate[0]), sigma_s)
    grown = sums.evidence(1, [0])
    mean_s = float(np.mean(frames.stamps_ns - about_ns)) * 1e-9  # the drift's column is nil there
    rate = float(grown.estimate[0])
    return _Times(float(offset.estimate[0]) - rate * mean_s, sigma_s, rate, float(np.sqrt(grown.covariance[0, 0])))


def _disagrees(found: _Times, sigmas: float) -> bool:
    return abs(found.offset_s) >= max(DISAGREES_S, sigmas * found.sigma_s)
