"""What else the poses want: changes, the clock, and a scale, found as in ``gtcal.effects``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.effects.effect import Effect, single
from gtcal.effects.find import FoundEffects, effects_in
from gtcal.effects.frames import Frames
from gtcal.effects.timing import BodyLag, ClockDrift, ClockOffset, moves
from gtcal.estimation.pose_joint import PoseChain, PoseViews
from gtcal.pose_recordings.frames import pose_frames
from gtcal.recordings.capture import RefMotion
from gtcal.results.effect_finding import Moment, Quantity


@dataclass(frozen=True)
class LengthScale:
    """The lengths of the tracked bodies' poses against those of the cameras': with all of them alike, X and Y_c take a
    wrong scale up; one of the two alone shows."""

    name: str = "scale"
    what: str = "lengths of the mocap and of the cameras' poses differ"
    advice: str = "measure the board again (its poses are as large as it was said to be), or calibrate the mocap"
    moment: Moment | None = None

    def columns(self, frames: Frames) -> FloatArray:
        poses = frames.ref_T_body
        columns = np.zeros((len(poses), frames.n_columns, 1))
        columns[:, 3:6, 0] = np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
        return columns

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 100.0, "%")


def find_pose_effects(
    views: Mapping[str, PoseViews], motion: RefMotion, chain: PoseChain, *, clock_free: bool, drift_free: bool
) -> FoundEffects:
    """All effects, those that are no chance first. clock_free, drift_free: whether they were solved for already."""
    nothing = FoundEffects((), (), np.zeros((0, 0)))
    try:
        frames = pose_frames(views, motion, chain)
        if frames is None:
            return nothing
        lasting: list[Effect] = [LengthScale()]
        if moves(frames):
            lasting += [] if clock_free else [ClockOffset()]
            lasting += [] if drift_free else [ClockDrift()]
            lasting += [BodyLag()] if BodyLag.possible(frames) else []
        return effects_in(frames, lasting)
    except np.linalg.LinAlgError:  # a direction that the poses leave open
        return nothing
