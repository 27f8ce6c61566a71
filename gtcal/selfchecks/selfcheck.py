"""The self-checks of a recording: what can be told of a calibration without a second, independent recording."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from gtcal.errors import GtcalError
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.progress import Progress, silent
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, Provenance
from gtcal.results.provenance import provenance
from gtcal.selfchecks.chain_and_pnp import ChainAndPnp, chain_and_pnp
from gtcal.selfchecks.folds import HoldOut, hold_out
from gtcal.selfchecks.halves import SplitHalf, split_half
from gtcal.selfchecks.time_blocks import only_frames, time_blocks
from gtcal.workflow import prepared


@dataclass(frozen=True)
class SelfCheck:
    """The outcome of all checks.

    halves: None where half of the recording determines no calibration; ``notes`` say why.
    hold_outs: of the default estimate first, then by stage. cameras: chain against PnP."""

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
    blocks = time_blocks(observations, n_folds)
    folds = []
    for k in range(n_folds):
        progress("calibrating without each block of time", k, n_folds)
        folds.append(calibrate_observations(only_frames(observations, blocks != k), options))
    progress("calibrating without each block of time", n_folds, n_folds)
    assert whole.solution is not None
    views, estimate = whole.solution.views, whole.solution.estimate
    hold_outs = hold_out(folds, blocks, views)
    halves, notes = _halves(observations, options, progress)
    by_camera_px = hold_outs[0].by_camera_px
    cameras = tuple(chain_and_pnp(of_camera, estimate, by_camera_px[name]) for name, of_camera in views.items())
    made = provenance(options, (), time.perf_counter() - started)
    return SelfCheck(halves, n_folds, hold_outs, cameras, whole, notes, made)


def _halves(
    observations: Observations, options: CalibrationOptions, progress: Progress
) -> tuple[SplitHalf | None, tuple[str, ...]]:
    """The first half against the second, so that what drifts or moves in between shows; or why not."""
    blocks = time_blocks(observations, 2)
    found: list[Calibration] = []
    try:
        for half in range(2):
            progress("calibrating the halves", half, 2)
            found.append(calibrate_observations(only_frames(observations, blocks == half), options))
        progress("calibrating the halves", 2, 2)
        return split_half(*found), ()
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
