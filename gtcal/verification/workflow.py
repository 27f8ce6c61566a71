"""A calibration against an independent measurement: the Lollypop's centre as images and mocap see it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from gtcal.blas import on_one_blas_thread
from gtcal.camera import Camera
from gtcal.estimation.observations import check_overlap
from gtcal.files import InputFile
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration
from gtcal.results.provenance import provenance
from gtcal.verification.blocks import sum_covariance
from gtcal.verification.clock import STEPS, SightingTimes, remaining_offset_s, sighting_times
from gtcal.verification.depth_checks import check_poses, triangulate
from gtcal.verification.error_statistics import bias, coverage, curves, error_statistics, heat_map
from gtcal.verification.expected_error import expected_error
from gtcal.verification.faults import find_faults
from gtcal.verification.lollypop_guide import detected_where_expected
from gtcal.verification.lollypop_recording import LollypopRecording, detected_lollypop
from gtcal.verification.plausibility import check_fitting, check_related, check_seen
from gtcal.verification.sightings import Path3D, n_frames, sightings_of
from gtcal.verification.verdict import camera_verdict, overall_verdict
from gtcal.verification.verification import (
    CameraVerification,
    ErrorStatistics,
    LeftOut,
    Sightings,
    Verdict,
    Verification,
    VerificationOptions,
)


@on_one_blas_thread
def verify(
    recording: LollypopRecording,
    calibration: Calibration,
    options: VerificationOptions | None = None,
    *,
    progress: Progress = silent,
    inputs: tuple[InputFile, ...] = (),
) -> Verification:
    """Verify a calibration with a recording of the Lollypop; cameras that have only images are detected first.

        verification = gtcal.verify(gtcal.load_lollypop_recording("my_lollypop"), calibration)
        verification.verdict                       # pass, fail or inconclusive, by the options' tolerances
        verification.cameras["cam0"].px.rmse       # of e_2D, px; .mm of e_3D
        verification                               # its tables; plot_heat_maps() draws

    options: tolerances and confidence. progress: called as progress(what, done, of).
    inputs: files besides the recording's that the result rests on, for its provenance: the calibration's.

    Raises GtcalError with one line on what is wrong: the device is not in the recording, the tag's size is off by a
    factor, the mocap's body is another one, the calibration is of another rig or image size, no time in common."""
    started = time.perf_counter()
    options = options or VerificationOptions()
    warnings = list(check_fitting(recording, calibration))
    names = [name for name in recording.cameras if name in calibration.cameras]
    lenses = {name: calibration.cameras[name].camera for name in names}
    times, images = sighting_times(calibration, options), recording.images
    if options.images == "expected" and options.clock != "estimate":  # else nobody knows yet where to expect it
        recording, said = detected_where_expected(recording, calibration, times, progress=progress)
        recording = replace(recording, images={n: i for n, i in images.items() if n not in recording.detections})
        warnings += said  # and most images were not looked at
    else:
        recording = detected_lollypop(recording, cameras=lenses, progress=progress)
    check_seen(recording, names)
    frames = np.unique(np.concatenate([_stamps_ns(recording, name) for name in names]))
    _check_times(recording, lenses, times)
    sightings, paths, left_out = _compared(recording, calibration, options, names, frames, times, progress)
    check_related(paths, recording.device)
    clock_offset_s = None
    if options.clock == "estimate":
        for _ in range(STEPS):
            more_s, sigma_s = remaining_offset_s(sightings, calibration, options)
            times = replace(times, more_s=times.more_s + more_s)
            sightings, _, left_out = _compared(recording, calibration, options, names, frames, times, progress)
        clock_offset_s = (times.more_s, sigma_s)
    cameras = {
        name: replace(_camera(recording, name, seen, frames, options), expected=expected_error(name, seen, calibration))
        for name, seen in sightings.items()
    }
    triangulation, narrow = triangulate(sightings, options)
    absent = [name for name in calibration.cameras if name not in recording.cameras]
    return Verification(
        verdict=overall_verdict([*(c.verdict for c in cameras.values()), *(Verdict.INCONCLUSIVE for _ in absent)]),
        reasons=_reasons(cameras, absent),
        cameras=cameras,
        pooled_px=_pooled(sightings, "px", options),
        pooled_mm=_pooled(sightings, "mm", options),
        triangulation=triangulation,
        pose_checks=check_poses(recording, sightings),
        faults=find_faults(sightings, calibration, options),
        left_out=(*left_out, *narrow),
        warnings=tuple(warnings),
        clock_offset_s=clock_offset_s,
        device=recording.device,
        options=options,
        provenance=provenance(options, recording.inputs + inputs, time.perf_counter() - started),
        first_stamp_ns=int(frames[0]),
        last_stamp_ns=int(frames[-1]),
        sightings=sightings,
        calibration=calibration,
        recording=replace(recording, images=images),
    )


def _check_times(recording: LollypopRecording, cameras: Mapping[str, Camera], times: SightingTimes) -> None:
    """Raises GtcalError where a camera that saw the device shares no time with a trajectory."""
    for name, camera in cameras.items():
        stamps_ns = recording.detections[name].stamps_ns
        if len(stamps_ns):
            for body, trajectory in recording.motion.trajectories.items():
                check_overlap(name, times.mocap_ns(camera, stamps_ns), body, trajectory.stamps_ns)


def _compared(
    recording: LollypopRecording,
    calibration: Calibration,
    options: VerificationOptions,
    names: list[str],
    frames: IntArray,
    times: SightingTimes,
    progress: Progress,
) -> tuple[dict[str, Sightings], dict[str, Path3D], list[LeftOut]]:
    """The sightings of all cameras at these times, their paths of the device, and what was left out."""
    sightings: dict[str, Sightings] = {}
    paths: dict[str, Path3D] = {}
    left_out: list[LeftOut] = []
    for done, name in enumerate(names):
        progress("comparing the centres", done, len(names))
        sightings[name], paths[name], reasons = sightings_of(
            recording,
            name,
            calibration.cameras[name],
            frames,
            times,
            max_viewing_angle_deg=options.max_viewing_angle_deg,
        )
        left_out += reasons
    progress("comparing the centres", len(names), len(names))
    return sightings, paths, left_out


def _stamps_ns(recording: LollypopRecording, name: str) -> IntArray:
    return recording.images[name].stamps_ns if name in recording.images else recording.detections[name].stamps_ns


def _camera(
    recording: LollypopRecording, name: str, seen: Sightings, frames: IntArray, options: VerificationOptions
) -> CameraVerification:
    px = error_statistics(seen.e_2d_px, seen.frame_index, "px", options.confidence)
    mm = error_statistics(seen.e_3d_mm, seen.frame_index, "mm", options.confidence)
    covered = coverage(seen, options)
    verdict, reasons = camera_verdict(px, mm, _n_independent(seen), covered, options)
    return CameraVerification(
        camera=name,
        verdict=verdict,
        reasons=reasons,
        n_frames=n_frames(recording, name, frames),
        n_sightings=len(seen),
        px=px,
        mm=mm,
        bias=bias(seen, options.confidence),
        coverage=covered,
        curves=curves(seen),
        heat_map=heat_map(seen, options.heat_map_columns, options.heat_map_rows),
    )


def _n_independent(seen: Sightings) -> float:
    if len(seen) == 0:
        return 0.0
    of_sum = sum_covariance(seen.e_2d_px[:, None] ** 2, seen.frame_index)
    return 0.0 if of_sum is None else of_sum.n_independent


def _pooled(
    sightings: Mapping[str, Sightings], unit: Literal["px", "mm"], options: VerificationOptions
) -> ErrorStatistics:
    seen = list(sightings.values())
    frame_index = np.concatenate([s.frame_index for s in seen])
    norms = np.concatenate([s.e_2d_px if unit == "px" else s.e_3d_mm for s in seen])
    order = np.argsort(frame_index, kind="stable")
    return error_statistics(norms[order], frame_index[order], unit, options.confidence)


def _reasons(cameras: Mapping[str, CameraVerification], absent: list[str]) -> tuple[str, ...]:
    of_cameras = [f"camera {name!r}: {reason}" for name, camera in cameras.items() for reason in camera.reasons]
    return (*of_cameras, *(f"camera {name!r} of the calibration is not in the recording" for name in absent))
