"""All methods on the same recording, judged by the same views and, if there is one, by the same Lollypop recording."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.baselines.closed_forms import CLOSED_FORMS, PoseMethod
from gtcal.baselines.marker_file import read_marker_sightings
from gtcal.baselines.markers import calibrate_on_markers
from gtcal.baselines.pose_pairs import PosePairs, pose_pairs
from gtcal.baselines.sturm import sturm
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import chain_residuals_px, norms
from gtcal.progress import Progress, silent
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, PoseEstimate, ResidualStatistics, pose_difference
from gtcal.results.covariance import NAIVE
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.workflow import verify
from gtcal.workflow import calibrate

JOINT = "joint: stages 1 to 4"
PAPER = "joint: stages 1 to 3, as the paper"
MARKERS = "P3P on markers"
STURM = {"Sturm, least squares": False, "Sturm, Huber": True}


@dataclass(frozen=True)
class Compared:
    """One method.

    calibration: None where it failed, and ``failure`` says why. board_rmse_px: over the views and corners that the
    joint solution keeps. lollypop_rmse_px: None without a Lollypop recording. difference_mm, difference_deg: from the
    joint solution, the largest of the cameras. duration_s: of the method, its PnP included."""

    method: str
    calibration: Calibration | None
    board_rmse_px: float
    lollypop_rmse_px: float | None
    difference_mm: float
    difference_deg: float
    duration_s: float
    failure: str = ""


def compare(
    recording: Recording,
    lollypop: LollypopRecording | None = None,
    options: CalibrationOptions | None = None,
    *,
    measured_body_T_board: FloatArray | None = None,
    progress: Progress = silent,
) -> tuple[Compared, ...]:
    """The joint solution first, then the others. measured_body_T_board: X as measured by hand (4, 4); Sturm's method is
    left out without it.

    Raises GtcalError where the joint solution fails."""
    options = options or CalibrationOptions()
    methods = [JOINT, PAPER, *CLOSED_FORMS, *(STURM if measured_body_T_board is not None else ())]
    progress("comparing", 0, len(methods))
    started = time.perf_counter()
    joint = calibrate(recording, options)
    found = [_compared(JOINT, joint, joint, lollypop, time.perf_counter() - started)]
    assert joint.solution is not None
    views = joint.solution.views
    for done, method in enumerate(methods[1:], start=1):
        progress("comparing", done, len(methods))
        started = time.perf_counter()
        try:
            calibration = _calibrated(method, recording, views, joint, options, measured_body_T_board)
        except (GtcalError, np.linalg.LinAlgError) as error:
            nan = float("nan")
            found.append(Compared(method, None, nan, None, nan, nan, time.perf_counter() - started, str(error)))
            continue
        found.append(_compared(method, calibration, joint, lollypop, time.perf_counter() - started))
    progress("comparing", len(methods), len(methods))
    return tuple(found)


def compare_markers(
    path: Path, recording: Recording, joint: Compared, lollypop: LollypopRecording | None, *, seed: int = 0
) -> Compared:
    """Direct calibration on the markers of a file; X is the joint solution's, which the method does not find.

    Raises GtcalError where the file is wrong."""
    assert joint.calibration is not None
    sightings, _ = read_marker_sightings(path, recording)
    started = time.perf_counter()
    nan = float("nan")
    try:
        missing = [name for name in recording.cameras if name not in sightings]
        if missing:
            raise GtcalError(f"no markers seen by camera {missing[0]!r}")
        found = {name: calibrate_on_markers(seen, seed=seed).camera_T_ref for name, seen in sightings.items()}
    except GtcalError as error:
        return Compared(MARKERS, None, nan, None, nan, nan, time.perf_counter() - started, str(error))
    estimate = replace(joint.calibration.estimate, camera_T_ref=found)
    calibration = as_calibration(MARKERS, estimate, joint.calibration)
    return _compared(MARKERS, calibration, joint.calibration, lollypop, time.perf_counter() - started)


def _calibrated(
    method: str,
    recording: Recording,
    views: Mapping[str, Views],
    joint: Calibration,
    options: CalibrationOptions,
    measured_body_T_board: FloatArray | None,
) -> Calibration:
    if method == PAPER:
        return calibrate(recording, replace(options, mocap="exact"))
    pairs = pose_pairs(views)
    if method in STURM:
        assert measured_body_T_board is not None
        return as_calibration(method, sturm(views, pairs, measured_body_T_board, huber=STURM[method]), joint)
    return as_calibration(method, _from_poses(CLOSED_FORMS[method], pairs, joint), joint)


def _from_poses(
    method: PoseMethod,
    pairs: Mapping[str, PosePairs],
    joint: Calibration,
) -> Estimate:
    body_T_board, cameras = method(pairs)
    theta = {name: camera.camera.theta for name, camera in joint.cameras.items()}
    return Estimate(body_T_board, cameras, theta)


def as_calibration(method: str, estimate: Estimate, joint: Calibration) -> Calibration:
    """An estimate as a result like any other, on the views of the joint solution; without a covariance."""
    assert joint.solution is not None
    views = joint.solution.views
    cameras = {
        name: replace(
            camera,
            camera=replace(camera.camera, parameters=estimate.theta[name]),
            camera_T_ref=PoseEstimate(estimate.camera_T_ref[name], None),
            theta_covariance=None,
            residuals=ResidualStatistics.of(norms(chain_residuals_px(views[name], estimate)), views[name].n_views),
        )
        for name, camera in joint.cameras.items()
    }
    return replace(
        joint,
        cameras=cameras,
        body_T_board=PoseEstimate(estimate.body_T_board, None),
        covariance_kind=NAIVE,
        covariances={},
        estimates={},
        mocap_noise=None,
        stages=(),
        warnings=(f"by a baseline, for comparison: {method}",),
        provenance=replace(joint.provenance, options=joint.provenance.options | {"method": method}),
        solution=None,
    )


def _compared(
    method: str, calibration: Calibration, joint: Calibration, lollypop: LollypopRecording | None, duration_s: float
) -> Compared:
    assert joint.solution is not None
    differences = [
        pose_difference(inverse(camera.camera_T_ref.a_T_b), inverse(joint.cameras[name].camera_T_ref.a_T_b))
        for name, camera in calibration.cameras.items()
    ]
    lengths = np.concatenate(
        [norms(chain_residuals_px(views, calibration.estimate)) for views in joint.solution.views.values()]
    )
    finite = lengths[np.isfinite(lengths)]
    return Compared(
        method,
        calibration,
        float(np.sqrt((finite**2).mean())),
        None if lollypop is None else lollypop_rmse_px(lollypop, calibration),
        max(mm for mm, _ in differences),
        max(deg for _, deg in differences),
        duration_s,
    )


def lollypop_rmse_px(lollypop: LollypopRecording, calibration: Calibration) -> float:
    """The verification's RMSE pooled over the sightings of all cameras."""
    found = [camera.px for camera in verify(lollypop, calibration).cameras.values() if camera.px.count]
    counts, rmses = np.array([px.count for px in found]), np.array([px.rmse for px in found])
    return float(np.sqrt((counts * rmses**2).sum() / counts.sum()))
