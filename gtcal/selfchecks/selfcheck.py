"""The self-checks of a recording: what can be told of a calibration without a second, independent recording."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import IntArray
from gtcal.recordings.numbering import numbers_of
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, Provenance
from gtcal.results.presented import Presented
from gtcal.results.provenance import provenance
from gtcal.selfchecks.chain_and_pnp import ChainAndPnp, chain_and_pnp
from gtcal.selfchecks.folds import HoldOut, hold_out, taken, typical_px
from gtcal.selfchecks.halves import SplitHalf, split_half
from gtcal.selfchecks.time_blocks import only_frames, time_blocks
from gtcal.workflow import prepared

FAR = 2.0
"""A block of time that is predicted worse than the others by so many times is named."""

_LEAST_FOLDS = 2


@dataclass(frozen=True, repr=False)
class SelfCheck(Presented):
    """The outcome of all checks.

    halves: None where half of the recording determines no calibration. hold_outs: of the default estimate first, then
    by stage. cameras: chain against PnP. notes: which half or block of time determines none, and which block the
    others do not predict."""

    halves: SplitHalf | None
    n_folds: int
    hold_outs: tuple[HoldOut, ...]
    cameras: tuple[ChainAndPnp, ...]
    calibration: Calibration
    notes: tuple[str, ...]
    provenance: Provenance

    @property
    def statements(self) -> tuple[str, ...]:
        """A sentence for each check."""
        halves = () if self.halves is None else (self.halves.statement,)
        return (*halves, _hold_out_statement(self.hold_outs), *(camera.statement for camera in self.cameras))


def selfcheck(
    recording: Recording,
    options: CalibrationOptions | None = None,
    *,
    n_folds: int = 5,
    progress: Progress = silent,
) -> SelfCheck:
    """Calibrate the recording, its halves, and all but each of ``n_folds`` blocks of time; and compare.

    Raises GtcalError as ``gtcal.calibrate``, or for a recording too short to be cut."""
    options = options or CalibrationOptions()
    observations, _ = prepared(recording, options, progress=progress)
    found = check_observations(observations, options, n_folds=n_folds, progress=progress)
    made = replace(found.provenance, inputs=recording.inputs)
    return replace(found, provenance=made)


def check_observations(
    observations: Observations, options: CalibrationOptions, *, n_folds: int = 5, progress: Progress = silent
) -> SelfCheck:
    """``selfcheck`` of synchronised views."""
    if n_folds < 2:
        raise GtcalError(f"n_folds: {n_folds} is less than 2")
    started = time.perf_counter()
    progress("calibrating all of it", 0, 1)
    whole = calibrate_observations(observations, options)
    progress("calibrating all of it", 1, 1)
    assert whole.solution is not None
    views, estimate = whole.solution.views, whole.solution.estimate
    blocks = time_blocks(observations, n_folds)
    folds, failed = _folds(observations, blocks, options, progress)
    hold_outs = hold_out(folds, blocks, views)
    halves, of_halves = _halves(observations, whole, options, progress)
    by_camera_px = hold_outs[0].by_camera_px
    cameras = tuple(chain_and_pnp(of_camera, estimate, by_camera_px[name]) for name, of_camera in views.items())
    notes = (*of_halves, *failed, *_not_predicted(folds, estimate, observations, blocks))
    made = provenance(options, (), time.perf_counter() - started)
    return SelfCheck(halves, n_folds, hold_outs, cameras, whole, notes, made)


def _folds(
    observations: Observations, blocks: IntArray, options: CalibrationOptions, progress: Progress
) -> tuple[dict[int, Calibration], tuple[str, ...]]:
    """By block of time, the calibration without it; and a note for each block without which there is none.

    Raises GtcalError where fewer than two are left."""
    n_folds = int(blocks.max()) + 1
    found: dict[int, Calibration] = {}
    failed: list[str] = []
    for k in range(n_folds):
        progress("calibrating without each block of time", k, n_folds)
        try:
            found[k] = calibrate_observations(only_frames(observations, blocks != k), options)
        except GtcalError as error:
            failed.append(f"{_block(observations, blocks, k)}: the rest of the recording gives no calibration: {error}")
    progress("calibrating without each block of time", n_folds, n_folds)
    if len(found) < _LEAST_FOLDS:
        raise GtcalError(f"too little can be left out of this recording to check it by itself; {failed[0]}")
    return found, tuple(failed)


def _not_predicted(
    folds: Mapping[int, Calibration], whole: Estimate, observations: Observations, blocks: IntArray
) -> tuple[str, ...]:
    """A note for each block of time that the others predict far worse than they predict one another."""
    held_out_px = {k: typical_px(taken(fold), blocks, observations.views, k) for k, fold in folds.items()}
    median_px = float(np.median(list(held_out_px.values())))
    notes = []
    for k in (k for k, found_px in held_out_px.items() if found_px > FAR * median_px):
        why = (
            "something differs in that time: a body, a camera or a clock that moved"
            if typical_px(whole, blocks, observations.views, k) > FAR * median_px
            else "only that time shows some of what is solved for: record such motion throughout"
        )
        notes.append(
            f"{_block(observations, blocks, k)}: predicted to {held_out_px[k]:.3g} px by a calibration without it, the "
            f"blocks typically to {median_px:.3g} px (medians); {why}"
        )
    return tuple(notes)


def _block(observations: Observations, blocks: IntArray, k: int) -> str:
    if observations.motion.numbered:
        numbers = numbers_of(observations.frame_stamps_ns)[blocks == k]
        return f"block {k + 1} of {int(blocks.max()) + 1} (images {numbers[0]} to {numbers[-1]})"
    frames_s = 1e-9 * (observations.frame_stamps_ns - observations.frame_stamps_ns[0])[blocks == k]
    return f"block {k + 1} of {int(blocks.max()) + 1} ({frames_s[0]:.2f} to {frames_s[-1]:.2f} s)"


def _halves(
    observations: Observations, whole: Calibration, options: CalibrationOptions, progress: Progress
) -> tuple[SplitHalf | None, tuple[str, ...]]:
    """The first half against the second, so that what drifts or moves in between shows; or why not."""
    blocks = time_blocks(observations, 2)
    progress("calibrating the halves", 0, 2)
    try:
        first = calibrate_observations(only_frames(observations, blocks == 0), options)
        progress("calibrating the halves", 1, 2)
        second = calibrate_observations(only_frames(observations, blocks == 1), options)
        progress("calibrating the halves", 2, 2)
        return split_half(first, second, whole), ()
    except GtcalError as error:
        return None, (f"no split-half check, as half of the recording determines no calibration: {error}",)


def _hold_out_statement(hold_outs: tuple[HoldOut, ...]) -> str:
    default, *by_stage = hold_outs
    best = min(by_stage, key=lambda found: found.rmse_px)
    others = ", ".join(f"stage {found.stage} {found.rmse_px:.3g} px" for found in by_stage)
    return (
        f"held-out frames are predicted to {default.rmse_px:.3g} px by the estimate taken ({others}): "
        f"{default.rmse_px / best.rmse_px - 1.0:+.1%} of the best"
    )
