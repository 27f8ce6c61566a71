"""What is wrong with a recording of the Lollypop, by a calibration: other readings of the mocap's files under which the
device is where the images have it; then what a verification finds to have moved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gtcal.blas import on_one_blas_thread
from gtcal.doctor.chain_search import AS_GOOD, CONVINCING
from gtcal.doctor.findings import Diagnosis, Finding
from gtcal.doctor.mocap_readings import INVERSE, MocapReading, mocap_readings
from gtcal.errors import GtcalError
from gtcal.progress import Progress, silent
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.manifest import load_fields
from gtcal.results.calibration import Calibration
from gtcal.verification.clock import sighting_times
from gtcal.verification.lollypop_recording import LollypopRecording, detected_lollypop
from gtcal.verification.plausibility import check_fitting
from gtcal.verification.sightings import sightings_of
from gtcal.verification.verification import FaultKind, Verification, VerificationOptions
from gtcal.verification.workflow import verify

APART = "median angle between the device in the images and by the mocap"
ERRORS = "RMSE of the errors"

_WRONG_RAD = np.deg2rad(1.0)
_DO: dict[FaultKind, str] = {
    "markers_moved": "put them back as they were, or calibrate again",
    "camera_moved": "calibrate again",
    "lens_changed": "let it reach the temperature that it was calibrated at, or calibrate again",
    "device_centre": "see that the mocap's body is centred in the fiducial",
    "clock_offset": "'gtcal verify --clock estimate', or correct the time stamps",
}
_BOARD_BODY, _DEVICE_BODY = "board_body", "device_body"


@on_one_blas_thread
def diagnose_lollypop(
    recording: LollypopRecording, calibration: Calibration, *, progress: Progress = silent
) -> Diagnosis:
    """What is wrong with the recording where the calibration is right, with the manifest's lines to change."""
    try:
        check_fitting(recording, calibration)
        lenses = {name: calibration.cameras[name].camera for name in recording.cameras if name in calibration.cameras}
        recording = detected_lollypop(recording, cameras=lenses, progress=progress)
    except GtcalError as error:
        return Diagnosis((), str(error), (), None, None)
    findings, recording = _by_another_reading(recording, calibration)
    try:
        verified = verify(recording, calibration, progress=progress)
    except GtcalError as error:
        return Diagnosis(tuple(findings), str(error), (), None, None)
    return Diagnosis(
        (*findings, *_faults(verified)),
        None,
        tuple(verified.warnings),
        verified.pooled_mm.rmse if verified.pooled_mm is not None else None,
        None,
    )


def _by_another_reading(
    recording: LollypopRecording, calibration: Calibration
) -> tuple[list[Finding], LollypopRecording]:
    """The reading that explains the paths, and the recording read so; nothing where they agree, none does, or images
    and mocap share no time."""
    stated_rad = _apart_rad(recording, calibration, recording.motion)
    if not _WRONG_RAD < stated_rad < np.inf:
        return [], recording
    tried = [
        (_apart_rad(recording, calibration, reading.reread(recording.motion)), reading)
        for reading in mocap_readings(recording.motion)
        if reading.fault != "wrong capture"
    ]
    best_rad, best = min(tried, key=lambda one: one[0])
    if not best_rad <= CONVINCING * stated_rad:
        return [], recording
    others = tuple(
        " and ".join(map(_of_device, (*reading.lines, *reading.advice)))
        for angle_rad, reading in tried
        if reading is not best and angle_rad <= AS_GOOD * best_rad
    )
    finding = Finding(
        best.fault,
        _of_device(best.says),
        tuple(_stated_otherwise(recording, best)),
        () if best.lines else tuple(map(_of_device, best.advice)),
        APART,
        float(np.rad2deg(stated_rad)),
        float(np.rad2deg(best_rad)),
        "deg",
        others,
    )
    return [finding], _reread(recording, best.reread(recording.motion))


def _reread(recording: LollypopRecording, motion: RefMotion) -> LollypopRecording:
    assert motion.board_body is not None  # the device's body stands for the board's
    return replace(recording, device_body=motion.board_body, platform=motion.platform)


def _stated_otherwise(recording: LollypopRecording, reading: MocapReading) -> Iterator[str]:
    """The manifest's lines; the poses' direction is the other one of what it says."""
    said = {} if recording.path is None else load_fields(recording.path)
    for line in map(_of_device, reading.lines):
        body, _, field = line.partition(".")
        is_inverse = field.startswith("pose:") and said.get(body, {}).get("pose") == INVERSE
        yield f"{body}.pose: world_T_body" if is_inverse else line


def _of_device(line: str) -> str:
    return line.replace(_BOARD_BODY, _DEVICE_BODY)


def _apart_rad(recording: LollypopRecording, calibration: Calibration, motion: RefMotion) -> float:
    """Of the camera in which it is least; infinite where no camera sees the device while the mocap does."""
    read = _reread(recording, motion)
    options = VerificationOptions()
    times = sighting_times(calibration, options)
    found = [np.inf]
    for name in recording.cameras:
        if name in calibration.cameras:
            frames = np.unique(recording.detections[name].stamps_ns)
            _, path, _ = sightings_of(
                read,
                name,
                calibration.cameras[name],
                frames,
                times,
                max_viewing_angle_deg=options.max_viewing_angle_deg,
            )
            found += [path.angle_apart_rad] if len(path) else []
    return float(min(found))


def _faults(verified: Verification) -> list[Finding]:
    return [
        Finding(
            fault.kind.replace("_", " "),
            fault.sentence,
            (),
            (_DO[fault.kind],),
            ERRORS,
            fault.rmse_before_px,
            fault.rmse_after_px,
            "px",
            fault.also_possible,
        )
        for fault in verified.faults
    ]
