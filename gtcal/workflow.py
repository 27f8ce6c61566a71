"""The whole way from a recording to a calibration: the walk of ``gtcal.steps``, of one recording or of several."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from factors import CalledBackKernel
from gtcal import steps
from gtcal.blas import on_one_blas_thread
from gtcal.clock.find import tested
from gtcal.detection.detect import cached_detect
from gtcal.differences.carried_over import EarlierCalibration
from gtcal.errors import GtcalError
from gtcal.estimation.earlier import SAME_DAY
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.files import fingerprint
from gtcal.guided import MocapGuide
from gtcal.progress import Progress, silent
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, StageReport

_log = logging.getLogger(__name__)


@on_one_blas_thread
def calibrate(
    recording: Recording,
    options: CalibrationOptions | None = None,
    *,
    earlier: EarlierCalibration | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Calibrate a recording; cameras that have only images are detected first.

        calibration = gtcal.calibrate(gtcal.load_recording("my_recording"))
        calibration.cameras["cam0"].camera_T_ref.a_T_b                     # (4, 4), ref to camera, m
        calibration.cameras["cam0"].camera_T_ref.position_of_a_in_b_sigma_mm  # (3,) 1-sigma of its place
        calibration.body_T_board.a_T_b                                     # X, board to its tracked body
        calibration                                                        # its tables; plot_cameras() and others draw

    recording: of ``load_recording``; ref is the mocap's world or the tracked platform, by its capture.
    options: ``CalibrationOptions``; by default intrinsics and the board's shape move near what is stated of them, and
        the mocap's noise is modelled where that earns its place.
    earlier: a calibration of the same rig, of which all that has not moved since is known already.
    progress: called as progress(what, done, of).

    Raises GtcalError with one line on what is wrong: intrinsics missing, too few views, a degenerate motion, no time
    in common, or files that contradict each other (DisagreementError, with the likely mistake if one is found)."""
    options = options or CalibrationOptions()
    if isinstance(options.robust, CalledBackKernel):
        _log.warning(
            "robust kernel %s is called back from Python for every corner: slower than those that are compiled",
            options.robust.name,
        )
    steps.check_time(recording, options)
    seen = steps.observed(detected(recording, progress=progress), options, earlier, progress=progress)
    known = steps.known(steps.timed(seen, progress=progress), progress=progress)
    calibration = steps.judged(known, steps.solved(known, progress=progress))
    return steps.asked(known, calibration, progress=progress)


def calibrate_jointly(
    recordings: Sequence[Recording],
    options: CalibrationOptions | None = None,
    *,
    earlier: EarlierCalibration | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Calibrate several recordings of one rig: all that does not move between them is shared, what moves is found anew
    and named. The rig is that of the last; each recording goes on from what those before it say together, in order.

    Raises GtcalError as ``calibrate``, and for options that calibrate stretches of a recording on their own."""
    options = options or CalibrationOptions()
    if len(recordings) > 1 and options.segments == "auto":
        raise GtcalError("segments are of one recording: calibrate each by itself, or leave them out")
    found: list[Calibration] = []
    for done, recording in enumerate(recordings):
        if found:
            before = "the recording before it" if done == 1 else f"the {done} recordings before it"
            earlier = EarlierCalibration(found[-1], SAME_DAY, source=before, inputs=found[-1].provenance.inputs)
        found.append(calibrate(recording, options, earlier=earlier, progress=progress))
    carried = [one.carried_over for one in found if one.carried_over is not None]
    if len(found) < 2:
        return found[-1]
    moved = tuple(line for one in carried for line in one.moved)
    warnings = [
        f"recording {number} of {len(found)}: {line}"
        for number, one in enumerate(found[:-1], start=1)
        for line in one.warnings
    ]
    return replace(found[-1], carried_over=replace(carried[-1], moved=moved), warnings=(*warnings, *found[-1].warnings))


def prepared(
    recording: Recording, options: CalibrationOptions, *, progress: Progress = silent
) -> tuple[Observations, tuple[StageReport, ...]]:
    """The recording's synchronised views, detected where they are images, with intrinsics and clock offset found where
    the options ask for it; and what the intrinsics took."""
    steps.check_time(recording, options)
    seen = steps.observed(detected(recording, progress=progress), options, progress=progress)
    return steps.on_the_mocaps_clock(seen.observations, options, progress)[0], seen.reports


def detected(
    recording: Recording, *, progress: Progress = silent, redo: bool = False, guided: bool = True, label: str = ""
) -> Recording:
    """The recording with detections for every camera: as the recording gives them, else from the images, which are
    kept beside the recording for the next time. ``redo`` detects in the images wherever there are some. ``guided``:
    where a camera has many images, the mocap and a calibration from some of them say where the board is in the others
    (``gtcal.guided``); else all are searched. label: of what is kept, where other boards' corners are kept too."""
    missing = [name for name in recording.images if redo or name not in recording.detections]
    if not missing:
        return recording
    folder = recording.path.parent if recording.path is not None else None
    if folder is None:
        raise GtcalError("a recording that is not on disk needs its detections given")
    guide = MocapGuide(recording, tuple(missing), _first_calibration, progress) if guided else None
    found = {
        name: cached_detect(
            folder,
            f"{name}{label}",
            recording.images[name],
            recording.board,
            recording.cameras[name],
            progress=progress,
            redo=redo,
            guide=guide,
            of_all=sum(len(recording.images[name]) for name in missing),
        )
        for name in missing
    }
    used = tuple(
        fingerprint(path) for path in sorted({path for name in missing for path in recording.images[name].inputs})
    )
    return replace(recording, detections=recording.detections | found, inputs=recording.inputs + used)


@on_one_blas_thread
def _first_calibration(recording: Recording) -> Calibration:
    """Good to a pixel or so, soon; with the clock offset that the data want."""
    options = CalibrationOptions(mocap="exact", effects=False)
    observations, _ = prepared(recording, options)
    return tested(calibrate_observations(observations, options), observations, options)
