"""From views by unsynchronised clocks to a calibration: a first guess by rotations, then the offset as an unknown.

Rolling shutters are straightened on the way, with the readout time that is stated or as one more unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gtcal.clock.coarse import coarse_offset_s
from gtcal.clock.offset import middle_ns, remaining_offset
from gtcal.clock.rolling_shutter import rolling, straightened, with_readouts, without_readout
from gtcal.clock.shift import shifted
from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.progress import Progress, silent
from gtcal.results.calibration import Calibration, Clock

SETTLED_S = 2e-5
"""Steps shorter than this need no other round."""

SETTLED_PX = 0.01
"""Corners of a rolling shutter that move by less than this need no other round."""

DISAGREES_SIGMAS, DISAGREES_S = 5.0, 3e-4
"""A recording that is taken as synchronised is said not to be from here on."""

SUSPECT_SIGMAS = 2.0
"""... and looked into from here on: at wrong times the sigma is that of the errors that they make."""

_MOST_ROUNDS = 8


@dataclass(frozen=True)
class _Times:
    """What is known of the times of cameras that share a clock.

    readout_s: of the cameras whose readout time is found too. estimate: that rolling shutters are straightened with."""

    offset_s: float
    sigma_s: float = np.inf
    drift: float = 0.0
    drift_sigma: float = 0.0
    readout_s: dict[str, float] = field(default_factory=dict)
    readout_sigma_s: dict[str, float] = field(default_factory=dict)
    estimate: Estimate | None = None

    def applied(self, observations: Observations, about_ns: int) -> Observations:
        """At these times, rolling shutters straightened."""
        offsets_s = dict.fromkeys(observations.views, self.offset_s)
        moved = shifted(observations, offsets_s, drift=self.drift, middle_ns=about_ns)
        moved = with_readouts(moved, self.readout_s)
        return moved if self.estimate is None else straightened(moved, self.estimate)


def with_clock(
    observations: Observations, options: CalibrationOptions, *, progress: Progress = silent
) -> tuple[Observations, Clock]:
    """The observations at the corrected times, and the offsets: one that all cameras share, or each its own. Rolling
    shutters are straightened, and readout times that are not stated found.

    Raises GtcalError where the motion does not tell, or the views fit no chain at any offset."""
    groups = [[name] for name in observations.views] if options.clock == "per_camera" else [list(observations.views)]
    about_ns = middle_ns(observations.views)
    corrected: dict[str, Observations] = {}
    found: dict[str, _Times] = {}
    for done, names in enumerate(groups):
        progress("clock offset", done, len(groups))
        own = replace(observations, views={name: observations.views[name] for name in names})
        times = _found(own, options, about_ns)
        found |= dict.fromkeys(names, times)
        corrected |= dict.fromkeys(names, times.applied(own, about_ns))
    progress("clock offset", len(groups), len(groups))
    first = next(iter(found.values()))
    clock = Clock(
        offset_s={name: times.offset_s for name, times in found.items()},
        sigma_s={name: times.sigma_s for name, times in found.items()},
        corrected=True,
        drift=first.drift,
        drift_sigma=first.drift_sigma,
        middle_ns=about_ns,
        readout_s={name: seconds for times in found.values() for name, seconds in times.readout_s.items()},
        readout_sigma_s={name: s for times in found.values() for name, s in times.readout_sigma_s.items()},
    )
    return _together(observations, corrected, clock), clock


def _together(observations: Observations, corrected: dict[str, Observations], clock: Clock) -> Observations:
    """The frames of all cameras at their corrected times, with each camera's corrected corners."""
    moved = shifted(observations, clock.offset_s, drift=clock.drift, middle_ns=clock.middle_ns)
    views = {
        name: replace(views, camera=own.camera, corners_px=own.corners_px)
        for name, views in moved.views.items()
        for own in (corrected[name].views[name],)
    }
    return replace(moved, views=views)


def with_stated_readouts(
    observations: Observations, options: CalibrationOptions, *, progress: Progress = silent
) -> Observations:
    """The observations with rolling shutters straightened at the times as stamped; as they are where there are none.

    Raises GtcalError where a readout time is not stated, or the views fit no chain."""
    if not rolling(observations):
        return observations
    plain = replace(options, mocap="exact")
    moved = observations
    for done in range(_MOST_ROUNDS):
        progress("rolling shutter", done, _MOST_ROUNDS)
        before, moved = moved, straightened(observations, calibrate_observations(moved, plain).estimate)
        if _largest_change_px(before, moved) < SETTLED_PX:
            break
    progress("rolling shutter", _MOST_ROUNDS, _MOST_ROUNDS)
    return moved


def _largest_change_px(before: Observations, after: Observations) -> float:
    return max(
        float(np.abs(after.views[name].corners_px - before.views[name].corners_px).max()) for name in rolling(after)
    )


def _found(observations: Observations, options: CalibrationOptions, about_ns: int) -> _Times:
    """Coarse, then in rounds of solving and stepping with the mocap taken as exact; the last step counts its noise."""
    times = _Times(coarse_offset_s(observations), readout_s=dict.fromkeys(without_readout(observations), 0.0))
    plain = replace(options, mocap="exact")
    for _ in range(_MOST_ROUNDS):
        before, times = times, _stepped(observations, plain, times, about_ns)
        straight = before.estimate is not None or not rolling(observations)
        if straight and _largest_step_s(before, times) < SETTLED_S:
            break
    return _stepped(observations, options, times, about_ns)


def _largest_step_s(before: _Times, after: _Times) -> float:
    steps_s = [after.offset_s - before.offset_s, *(after.readout_s[n] - s for n, s in before.readout_s.items())]
    return max(map(abs, steps_s))


def _stepped(observations: Observations, options: CalibrationOptions, times: _Times, about_ns: int) -> _Times:
    moved = times.applied(observations, about_ns)
    calibration = calibrate_observations(moved, options)
    left = remaining_offset(
        calibration, observations.motion, options, drift=options.clock_drift, readouts=tuple(times.readout_s)
    )
    return _Times(
        offset_s=times.offset_s + left.offset_s,
        sigma_s=left.sigma_s,
        drift=times.drift + left.drift,
        drift_sigma=left.drift_sigma,
        readout_s={name: seconds + left.readout_s[name] for name, seconds in times.readout_s.items()},
        readout_sigma_s=left.readout_sigma_s,
        estimate=calibration.estimate if rolling(observations) else None,
    )


def tested(calibration: Calibration, observations: Observations, options: CalibrationOptions) -> Calibration:
    """The calibration with what the data want of the clock, and a warning where that contradicts the recording.

    observations: before rolling shutters were straightened."""
    try:
        left = remaining_offset(calibration, observations.motion, options)
    except GtcalError:
        return calibration
    found = _Times(left.offset_s, left.sigma_s)
    if not _disagrees(found, SUSPECT_SIGMAS):
        return replace(calibration, clock=_shared(calibration, found))
    try:
        found = _found(observations, options, middle_ns(observations.views))
    except GtcalError:
        return replace(calibration, clock=_shared(calibration, found))
    clock = _shared(calibration, found)
    if not _disagrees(found, DISAGREES_SIGMAS):
        return replace(calibration, clock=clock)
    warning = (
        f"the data want {clock.statement} added to the cameras' stamps, but the recording is taken as synchronised: "
        "--clock estimate finds the offset and corrects it"
    )
    return replace(calibration, clock=clock, warnings=(*calibration.warnings, warning))


def _disagrees(found: _Times, sigmas: float) -> bool:
    return abs(found.offset_s) >= max(DISAGREES_S, sigmas * found.sigma_s)


def _shared(calibration: Calibration, found: _Times) -> Clock:
    names = list(calibration.cameras)
    return Clock(dict.fromkeys(names, found.offset_s), dict.fromkeys(names, found.sigma_s), corrected=False)
