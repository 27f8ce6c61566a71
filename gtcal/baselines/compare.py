"""All methods on the same recording, judged by the same views and, if there is one, by the same Lollypop recording."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.baselines.closed_forms import CLOSED_FORMS
from gtcal.baselines.marker_file import read_marker_sightings
from gtcal.baselines.markers import calibrate_on_markers
from gtcal.baselines.pose_pairs import PosePairs, pose_pairs
from gtcal.baselines.sturm import sturm
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import chain_residuals_px, norms, select_views
from gtcal.progress import Progress, silent
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, PoseEstimate, ResidualStatistics, pose_difference
from gtcal.results.covariance import NAIVE
from gtcal.results.presented import Presented
from gtcal.simulation.truth import GroundTruth
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.workflow import verify
from gtcal.workflow import calibrate

JOINT = "joint: stages 1 to 4"
PAPER = "joint: stages 1 to 3, as the paper"
MARKERS = "P3P on markers"
STURM = {"Sturm, least squares": False, "Sturm, Huber": True}
_BLOCKS = 10


@dataclass(frozen=True)
class Compared:
    """One method.

    calibration: None where it failed, and ``failure`` says why. board_rmse_px: over the views and corners that the
    joint solution keeps. lollypop_rmse_px: None without a Lollypop recording. difference_mm, difference_deg: from the
    joint solution, the largest of the cameras. duration_s: of the method, its PnP included.
    sigma_mm, sigma_deg: the largest 1-sigma of a camera's place along an axis, of its attitude about one: by the
        method's covariance; where it has none, by the scatter with each tenth of the frames left out (jackknife), which
        does not see what errs alike in all frames. None where neither is known.
    truth_mm, truth_deg: from the truth, the largest of the cameras; None where it is not known."""

    method: str
    calibration: Calibration | None = field(repr=False)
    board_rmse_px: float
    lollypop_rmse_px: float | None
    difference_mm: float
    difference_deg: float
    duration_s: float
    failure: str = ""
    sigma_mm: float | None = None
    sigma_deg: float | None = None
    truth_mm: float | None = None
    truth_deg: float | None = None


@dataclass(frozen=True, repr=False)
class Comparison(Presented):
    """The methods, of which the first is the joint solution; also to be gone through one by one."""

    methods: tuple[Compared, ...]

    def __iter__(self) -> Iterator[Compared]:
        return iter(self.methods)

    def __len__(self) -> int:
        return len(self.methods)

    def __getitem__(self, method: str) -> Compared:
        """A method by its name. Raises GtcalError where it was not tried."""
        for row in self.methods:
            if row.method == method:
                return row
        raise GtcalError(f"there is no method {method!r}; methods: {', '.join(row.method for row in self.methods)}")

    @property
    def joint(self) -> Calibration:
        """gtcal's own calibration, which the others are held against."""
        calibration = self.methods[0].calibration
        assert calibration is not None
        return calibration


def compare(
    recording: Recording,
    lollypop: LollypopRecording | None = None,
    options: CalibrationOptions | None = None,
    *,
    measured_body_T_board: FloatArray | None = None,
    truth: GroundTruth | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Calibrate a recording by the joint solution and by other methods, and judge each by the same views.

        comparison = gtcal.compare(recording, lollypop)
        comparison                                # the table
        comparison["Shah (AX = ZB)"].calibration  # one method's

    lollypop: a recording to judge by, as an error that is in the whole recording is in its views too.
    measured_body_T_board: X as measured by hand, (4, 4); Sturm's method is left out without it.
    truth: of a simulated recording. progress: called as progress(what, done, of).

    Raises GtcalError where the joint solution fails."""
    options = options or CalibrationOptions()
    methods = [JOINT, PAPER, *CLOSED_FORMS, *(STURM if measured_body_T_board is not None else ())]
    progress("comparing", 0, len(methods))
    started = time.perf_counter()
    joint = calibrate(recording, options)
    judged = _Judges(joint, lollypop, truth)
    found = [_compared(JOINT, joint, judged, time.perf_counter() - started, _stated_sigmas(joint))]
    assert joint.solution is not None
    views = joint.solution.views
    left_out = _without_a_block_each(views)
    for done, method in enumerate(methods[1:], start=1):
        progress("comparing", done, len(methods))
        started = time.perf_counter()
        try:
            if method == PAPER:
                calibration = calibrate(recording, replace(options, mocap="exact"))
                duration_s, sigmas = time.perf_counter() - started, _stated_sigmas(calibration)
            else:
                estimate = _estimated(method, views, pose_pairs(views), measured_body_T_board)
                calibration, duration_s = as_calibration(method, estimate, joint), time.perf_counter() - started
                sigmas = _jackknifed(method, left_out, measured_body_T_board)
        except (GtcalError, np.linalg.LinAlgError) as error:
            found.append(_failed(method, str(error), time.perf_counter() - started))
            continue
        found.append(_compared(method, calibration, judged, duration_s, sigmas))
    progress("comparing", len(methods), len(methods))
    return Comparison(tuple(found))


@dataclass(frozen=True)
class _Judges:
    """What all methods are judged by."""

    joint: Calibration
    lollypop: LollypopRecording | None
    truth: GroundTruth | None


def _failed(method: str, why: str, duration_s: float) -> Compared:
    nan = float("nan")
    return Compared(method, None, nan, None, nan, nan, duration_s, why)


def compare_markers(
    path: Path,
    recording: Recording,
    joint: Calibration,
    lollypop: LollypopRecording | None,
    *,
    truth: GroundTruth | None = None,
    seed: int = 0,
) -> Compared:
    """Direct calibration on the markers of a file; X is the joint solution's, which the method does not find.

    Raises GtcalError where the file is wrong."""
    sightings, _ = read_marker_sightings(path, recording)
    started = time.perf_counter()
    try:
        missing = [name for name in recording.cameras if name not in sightings]
        if missing:
            raise GtcalError(f"no markers seen by camera {missing[0]!r}")
        found = {name: calibrate_on_markers(seen, seed=seed).camera_T_ref for name, seen in sightings.items()}
    except GtcalError as error:
        return _failed(MARKERS, str(error), time.perf_counter() - started)
    estimate = replace(joint.estimate, camera_T_ref=found)
    calibration = as_calibration(MARKERS, estimate, joint)
    judged = _Judges(joint, lollypop, truth)
    return _compared(MARKERS, calibration, judged, time.perf_counter() - started, (None, None))


def _estimated(
    method: str,
    views: Mapping[str, Views],
    pairs: Mapping[str, PosePairs],
    measured_body_T_board: FloatArray | None,
) -> Estimate:
    """By one of the baselines."""
    if method in STURM:
        assert measured_body_T_board is not None
        return sturm(views, pairs, measured_body_T_board, huber=STURM[method])
    body_T_board, cameras = CLOSED_FORMS[method](pairs)
    return Estimate(body_T_board, cameras, {name: of_camera.camera.theta for name, of_camera in views.items()})


_Sigmas = tuple[float | None, float | None]
_LeftOut = list[tuple[dict[str, Views], dict[str, PosePairs]]]


def _stated_sigmas(calibration: Calibration) -> _Sigmas:
    """The largest, in mm and deg, of the calibration's covariance."""
    poses = [camera.camera_T_ref for camera in calibration.cameras.values()]
    mm, deg = ([getattr(p, of) for p in poses] for of in ("position_of_a_in_b_sigma_mm", "rotation_sigma_deg"))
    known = all(sigma is not None for sigma in (*mm, *deg))
    return (float(np.max(mm)), float(np.max(deg))) if known else (None, None)


def _without_a_block_each(views: Mapping[str, Views]) -> _LeftOut:
    """The views without each of the blocks of time in turn; none where too few are left."""
    frames = np.unique(np.concatenate([of_camera.frame_index for of_camera in views.values()]))
    left_out = []
    for block in np.array_split(frames, _BLOCKS):
        rest = {
            name: select_views(of_camera, np.flatnonzero(~np.isin(of_camera.frame_index, block)))
            for name, of_camera in views.items()
        }
        try:
            left_out.append((rest, pose_pairs(rest)))
        except GtcalError:
            return []
    return left_out


def _jackknifed(method: str, left_out: _LeftOut, measured_body_T_board: FloatArray | None) -> _Sigmas:
    """The largest 1-sigma of a camera, in mm and deg, by the scatter of what the method finds with a block left out."""
    try:
        found = [_estimated(method, *rest, measured_body_T_board).camera_T_ref for rest in left_out]
    except (GtcalError, np.linalg.LinAlgError):
        return None, None
    if not found:
        return None, None
    by_camera = [inverse(np.stack([of_block[name] for of_block in found])) for name in found[0]]
    places_mm = [1e3 * ref_T_camera[:, :3, 3] for ref_T_camera in by_camera]
    turns = [Rotation.from_matrix(ref_T_camera[:, :3, :3]) for ref_T_camera in by_camera]
    turns_deg = [np.rad2deg((of_camera.mean().inv() * of_camera).as_rotvec()) for of_camera in turns]
    scale = (len(found) - 1) / np.sqrt(len(found))
    mm, deg = (float(scale * np.max([values.std(axis=0) for values in of])) for of in (places_mm, turns_deg))
    return mm, deg


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


def _compared(method: str, calibration: Calibration, judged: _Judges, duration_s: float, sigmas: _Sigmas) -> Compared:
    assert judged.joint.solution is not None
    views = judged.joint.solution.views.values()
    lengths = np.concatenate([norms(chain_residuals_px(of_camera, calibration.estimate)) for of_camera in views])
    finite = lengths[np.isfinite(lengths)]
    difference_mm, difference_deg = _farthest(calibration.estimate.camera_T_ref, judged.joint.estimate.camera_T_ref)
    truth_mm, truth_deg = (
        (None, None)
        if judged.truth is None
        else _farthest(calibration.estimate.camera_T_ref, judged.truth.camera_T_ref)
    )
    return Compared(
        method,
        calibration,
        float(np.sqrt((finite**2).mean())),
        None if judged.lollypop is None else lollypop_rmse_px(judged.lollypop, calibration),
        difference_mm,
        difference_deg,
        duration_s,
        "",
        *sigmas,
        truth_mm,
        truth_deg,
    )


def _farthest(found: Mapping[str, FloatArray], others: Mapping[str, FloatArray]) -> tuple[float, float]:
    """The largest difference of a camera's pose, in mm and deg."""
    differences = [pose_difference(inverse(pose), inverse(others[name])) for name, pose in found.items()]
    return max(mm for mm, _ in differences), max(deg for _, deg in differences)


def lollypop_rmse_px(lollypop: LollypopRecording, calibration: Calibration) -> float:
    """The verification's RMSE pooled over the sightings of all cameras."""
    found = [camera.px for camera in verify(lollypop, calibration).cameras.values() if camera.px.count]
    counts, rmses = np.array([px.count for px in found]), np.array([px.rmse for px in found])
    return float(np.sqrt((counts * rmses**2).sum() / counts.sum()))
