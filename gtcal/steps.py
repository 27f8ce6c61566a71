"""A calibration as the list of steps that it is, each from one frozen type to the next, to stop after any and look.

    detected   Recording -> Recording     the board's corners in every image (gtcal.detected)
    observed   Recording -> Seen          each view with the mocap's pose, each camera with a lens
    timed      Seen -> Timed              on the mocap's clock, rolling shutters straightened
    known      Timed -> Known             with what is known beforehand: from an earlier calibration, or by priors
    solved     Known -> Calibration       the stages
    judged     Known, Calibration -> ...  with a warning where it looks wrong, and what became of the clock
    asked      Known, Calibration -> ...  with what else the data want

``gtcal.calibrate`` walks them all. Each of the types holds the one before it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from gtcal.camera import Camera
from gtcal.clock.find import tested, with_clock, with_stated_readouts
from gtcal.differences.carried_over import EarlierCalibration, check_independent, known_from, with_earlier_lenses
from gtcal.differences.exchanged import check_rig
from gtcal.doctor.hint import likely_mistake, looks_wrong
from gtcal.effects.find import with_effects
from gtcal.effects.segments import in_segments
from gtcal.errors import GtcalError
from gtcal.estimation.intrinsics import calibrate_intrinsics
from gtcal.estimation.observations import Observations, synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import DisagreementError, calibrate_observations
from gtcal.estimation.told_apart import told_apart
from gtcal.files import InputFile
from gtcal.progress import Progress, silent
from gtcal.recordings.manifest import MANIFEST_NAMES
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, Clock, StageReport
from gtcal.results.carried_over import CarriedOver


@dataclass(frozen=True)
class Seen:
    """The views of a recording, each with the mocap's pose at its time as stamped, by cameras that all have a lens.

    recording: with corners. as_detected: before views of a print that looks the same after some turns were told apart,
    as ``observations`` are. reports: of what finding lenses took. options: those of all of it.
    inputs: the files that all rests on. earlier: a calibration of the same rig, if there is one."""

    recording: Recording
    as_detected: Observations
    observations: Observations
    reports: tuple[StageReport, ...]
    options: CalibrationOptions
    inputs: tuple[InputFile, ...]
    earlier: EarlierCalibration | None

    def solve(self, views: Observations, options: CalibrationOptions, progress: Progress = silent) -> Calibration:
        """The stages on some of its views."""
        return calibrate_observations(views, options, progress=progress, inputs=self.inputs, earlier=self.reports)


@dataclass(frozen=True)
class Timed:
    """... on the mocap's clock. clock: what was found of it; None where it was not looked for."""

    seen: Seen
    observations: Observations
    clock: Clock | None


@dataclass(frozen=True)
class Known:
    """... with what is known beforehand. options: with the priors that follow from the earlier calibration.
    carried_over: what was taken from that, and what has moved since."""

    timed: Timed
    observations: Observations
    options: CalibrationOptions
    carried_over: CarriedOver | None


def observed(
    recording: Recording,
    options: CalibrationOptions,
    earlier: EarlierCalibration | None = None,
    *,
    progress: Progress = silent,
) -> Seen:
    """recording: with corners for every camera. Lenses are the manifest's, or the earlier calibration's, or found.

    Raises GtcalError where the earlier calibration rests on the recording, there is no time in common, a lens can't be
    found, or two cameras stand in each other's place by the priors."""
    if earlier is not None:
        check_independent(earlier, recording.inputs)
        recording = replace(recording, cameras=with_earlier_lenses(recording.cameras, earlier))
    as_detected, reports = with_intrinsics(synchronise(recording), options, progress)
    observations = told_apart(as_detected, options)
    check_rig(observations, options)
    inputs = (*recording.inputs, *(earlier.inputs if earlier is not None else ()))
    return Seen(recording, as_detected, observations, reports, options, inputs, earlier)


def timed(seen: Seen, *, progress: Progress = silent) -> Timed:
    """Raises GtcalError where the motion does not tell the clocks' offset, DisagreementError where nothing fits."""
    with _with_a_hint(seen):
        return Timed(seen, *on_the_mocaps_clock(seen.observations, seen.options, progress))


def known(timed: Timed, *, progress: Progress = silent) -> Known:
    """Where there is an earlier calibration, the recording is calibrated by itself first and held against it. Raises as
    ``gtcal.differences.carried_over.known_from``."""
    seen = timed.seen
    if seen.earlier is None:
        return Known(timed, timed.observations, seen.options, None)
    with _with_a_hint(seen):
        found = known_from(
            seen.earlier, timed.observations, seen.options, lambda views, options: seen.solve(views, options, progress)
        )
    return Known(timed, *found)


def solved(known: Known, *, progress: Progress = silent) -> Calibration:
    """Raises GtcalError as ``gtcal.calibrate_observations``."""
    seen = known.timed.seen
    with _with_a_hint(seen):
        found = seen.solve(known.observations, known.options, progress)
    return replace(found, carried_over=known.carried_over)


def judged(known: Known, calibration: Calibration) -> Calibration:
    """With a warning where it looks like one of a recording with a fault; and its clock, tested where it was not looked
    for."""
    recording, options = known.timed.seen.recording, known.options
    if recording.path is not None and looks_wrong(calibration):
        warning = f"this does not look like a good calibration; {_doctor(recording)} may tell why"
        calibration = replace(calibration, warnings=(*calibration.warnings, warning))
    if options.clock == "test" and not recording.numbered:
        return tested(calibration, known.timed.seen.observations, options)
    return replace(calibration, clock=known.timed.clock)


def asked(known: Known, calibration: Calibration, *, progress: Progress = silent) -> Calibration:
    """With what else the data want: as findings, or, where the options ask for it, in segments of their own."""
    seen, options = known.timed.seen, known.options
    if options.segments == "auto":
        return in_segments(calibration, known.observations, options, lambda views: seen.solve(views, options, progress))
    return with_effects(calibration, known.observations, options) if options.effects else calibration


def check_time(recording: Recording, options: CalibrationOptions) -> None:
    """Raises GtcalError where a recording by number is asked for what needs time."""
    if not recording.numbered:
        return
    asked_for = {
        f"--clock {options.clock}": options.clock in ("estimate", "per_camera"),
        "--clock-drift": options.clock_drift,
        "--segments auto": options.segments == "auto",
    }
    for option, given in asked_for.items():
        if given:
            raise GtcalError(f"{option}: this recording goes by number (numbered: true), and has no time; leave it out")


@contextmanager
def _with_a_hint(seen: Seen) -> Iterator[None]:
    """Where nothing fits inside, the likely mistake is looked for. Raises DisagreementError with it."""
    try:
        yield
    except DisagreementError as error:
        hint = likely_mistake(seen.as_detected, seed=seen.options.seed, max_views=seen.options.pnp_views)
        raise DisagreementError(error.angle_deg, hint, doctor=_doctor(seen.recording)) from error


def _doctor(recording: Recording) -> str:
    """What to run to find out what is wrong with it."""
    if recording.path is None:
        return "'gtcal doctor RECORDING'"
    by_folder = recording.path.name in MANIFEST_NAMES
    return f"'gtcal doctor {recording.path.parent if by_folder else recording.path}'"


def on_the_mocaps_clock(
    observations: Observations, options: CalibrationOptions, progress: Progress = silent
) -> tuple[Observations, Clock | None]:
    """The observations with rolling shutters straightened, and with the clocks' offset where the options ask for it."""
    if options.clock in ("test", "trust"):
        return with_stated_readouts(observations, options, progress=progress), None
    return with_clock(observations, options, progress=progress)


def with_intrinsics(
    observations: Observations, options: CalibrationOptions, progress: Progress = silent
) -> tuple[Observations, tuple[StageReport, ...]]:
    """The observations with intrinsics found where the options ask for it or none are stated, and what that took."""
    views, reports = dict(observations.views), []
    wanted = [name for name, of_camera in views.items() if _is_to_be_found(of_camera.camera, options)]
    for done, name in enumerate(wanted):
        progress("intrinsics", done, len(wanted))
        started = time.perf_counter()
        found = calibrate_intrinsics(views[name])
        views[name] = replace(views[name], camera=replace(found.camera, theta_sigmas=None))
        seconds, nan = time.perf_counter() - started, float("nan")
        reports.append(StageReport(0, f"intrinsics of {name}", 0, nan, found.rmse_px, "px rmse", nan, seconds))
    if wanted:
        progress("intrinsics", len(wanted), len(wanted))
    return replace(observations, views=views), tuple(reports)


def _is_to_be_found(camera: Camera, options: CalibrationOptions) -> bool:
    return options.intrinsics in ("calibrate", "calibrate+refine") or (
        options.intrinsics == "auto" and camera.parameters is None
    )
