"""From views by unsynchronised clocks to a calibration: a first guess by rotations, then the offset as an unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gtcal.clock.coarse import coarse_offset_s
from gtcal.clock.offset import middle_ns, remaining_offset
from gtcal.clock.shift import shifted
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.progress import Progress, silent
from gtcal.results.calibration import Calibration, Clock

SETTLED_S = 2e-5
"""Steps shorter than this need no other round."""

DISAGREES_SIGMAS, DISAGREES_S = 5.0, 3e-4
"""A recording that is taken as synchronised is said not to be from here on."""

_MOST_ROUNDS = 8


@dataclass(frozen=True)
class _Offset:
    """Of cameras that share a clock."""

    offset_s: float
    drift: float
    sigma_s: float
    drift_sigma: float


def with_clock(
    observations: Observations, options: CalibrationOptions, *, progress: Progress = silent
) -> tuple[Observations, Clock]:
    """The observations at the corrected times, and the offsets: one that all cameras share, or each its own.

    Raises GtcalError where the motion does not tell, or the views fit no chain at any offset."""
    groups = [[name] for name in observations.views] if options.clock == "per_camera" else [list(observations.views)]
    about_ns = middle_ns(observations.views)
    found: dict[str, _Offset] = {}
    for done, names in enumerate(groups):
        progress("clock offset", done, len(groups))
        own = replace(observations, views={name: observations.views[name] for name in names})
        offset = _found(own, options, about_ns)
        found |= dict.fromkeys(names, offset)
    progress("clock offset", len(groups), len(groups))
    offsets_s = {name: offset.offset_s for name, offset in found.items()}
    first = next(iter(found.values()))
    clock = Clock(
        offset_s=offsets_s,
        sigma_s={name: offset.sigma_s for name, offset in found.items()},
        corrected=True,
        drift=first.drift,
        drift_sigma=first.drift_sigma,
        middle_ns=about_ns,
    )
    return shifted(observations, offsets_s, drift=first.drift, middle_ns=about_ns), clock


def _found(observations: Observations, options: CalibrationOptions, about_ns: int) -> _Offset:
    """Coarse, then in rounds of solving and stepping with the mocap taken as exact; the last step counts its noise."""
    offset_s, drift = coarse_offset_s(observations), 0.0
    plain = replace(options, mocap="exact")
    for _ in range(_MOST_ROUNDS):
        step = _step(observations, plain, offset_s, drift, about_ns)
        offset_s, drift = offset_s + step.offset_s, drift + step.drift
        if abs(step.offset_s) < SETTLED_S:
            break
    last = _step(observations, options, offset_s, drift, about_ns)
    return _Offset(offset_s + last.offset_s, drift + last.drift, last.sigma_s, last.drift_sigma)


def _step(
    observations: Observations, options: CalibrationOptions, offset_s: float, drift: float, about_ns: int
) -> _Offset:
    moved = shifted(observations, dict.fromkeys(observations.views, offset_s), drift=drift, middle_ns=about_ns)
    calibration = calibrate_observations(moved, options)
    left = remaining_offset(calibration, observations.motion, options, drift=options.clock_drift)
    return _Offset(left.offset_s, left.drift, left.sigma_s, left.drift_sigma)


def tested(calibration: Calibration, observations: Observations, options: CalibrationOptions) -> Calibration:
    """The calibration with what the data want of the clock, and a warning where that contradicts the recording."""
    try:
        left = remaining_offset(calibration, observations.motion, options)
    except GtcalError:
        return calibration
    found = _Offset(left.offset_s, 0.0, left.sigma_s, 0.0)
    if not _disagrees(found):
        return replace(calibration, clock=_shared(calibration, found))
    try:  # at the wrong times the sigma is that of the errors they make
        found = _found(observations, options, middle_ns(observations.views))
    except GtcalError:
        return replace(calibration, clock=_shared(calibration, found))
    clock = _shared(calibration, found)
    if not _disagrees(found):
        return replace(calibration, clock=clock)
    warning = (
        f"the data want {clock.statement} added to the cameras' stamps, but the recording is taken as synchronised: "
        "--clock estimate finds the offset and corrects it"
    )
    return replace(calibration, clock=clock, warnings=(*calibration.warnings, warning))


def _disagrees(found: _Offset) -> bool:
    return abs(found.offset_s) >= max(DISAGREES_S, DISAGREES_SIGMAS * found.sigma_s)


def _shared(calibration: Calibration, found: _Offset) -> Clock:
    names = list(calibration.cameras)
    return Clock(dict.fromkeys(names, found.offset_s), dict.fromkeys(names, found.sigma_s), corrected=False)
