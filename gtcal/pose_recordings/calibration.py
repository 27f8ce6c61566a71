"""What is found from poses, and how: stages 1 to 3, marginals, and the closed forms beside them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from factors.rigid import inverse
from gtcal.baselines.closed_forms import CLOSED_FORMS
from gtcal.baselines.pose_pairs import PosePairs
from gtcal.blas import on_one_blas_thread
from gtcal.camera import FloatArray
from gtcal.effects.find import FoundEffects, effect_warnings
from gtcal.errors import GtcalError
from gtcal.estimation.linear import squared_distance
from gtcal.estimation.motion import check_turning, turning
from gtcal.estimation.observations import Dropped
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.pose_joint import (
    JointPoses,
    PoseChain,
    PoseViews,
    differences,
    stage_1_of_poses,
    stage_2_of_poses,
    stage_3_of_poses,
)
from gtcal.pose_recordings.clock import tested_pose_clock, with_pose_clock
from gtcal.pose_recordings.effects import find_pose_effects
from gtcal.pose_recordings.recording import PoseRecording
from gtcal.progress import Progress, silent
from gtcal.recordings.capture import Capture, RefMotion
from gtcal.results.calibration import Clock, PoseEstimate, Provenance, StageReport, pose_difference
from gtcal.results.effect_finding import EffectFinding
from gtcal.results.presented import Presented
from gtcal.results.provenance import provenance

GROSS_WEIGHT = 0.2
"""A view that counts less is called gross."""

OF_POSES = ("clock", "clock_drift", "effects", "seed", "eps", "max_iterations", "allow_degenerate")
"""The options that count where there are poses in place of corners."""

_EPS, _MOST_GROSS = 1e-6, 0.15


@dataclass(frozen=True)
class PoseStatistics:
    """Of residuals: the chain against the measured poses, all views. rotation_rms_deg, shift_rms_mm: roots of the mean
    squared norm. median, worst: of the norms."""

    n_views: int
    n_gross: int
    rotation_rms_deg: float
    rotation_median_deg: float
    rotation_worst_deg: float
    shift_rms_mm: float
    shift_median_mm: float
    shift_worst_mm: float

    @staticmethod
    def of(residuals: FloatArray, weights: FloatArray) -> PoseStatistics:
        """residuals: (V, 6), rad and m. weights: (V,)."""
        turn, shift = (np.linalg.norm(part, axis=1) for part in (np.rad2deg(residuals[:, :3]), 1e3 * residuals[:, 3:]))
        numbers = [
            f(part) for part in (turn, shift) for f in (lambda norms: np.sqrt(np.mean(norms**2)), np.median, np.max)
        ]
        return PoseStatistics(len(residuals), int((weights < GROSS_WEIGHT).sum()), *map(float, numbers))


@dataclass(frozen=True)
class PoseCamera:
    """One camera. noise_deg, noise_mm: (3,) 1-sigma of its poses about the board's axes, and along the camera's; in
    units of what was stated, where it was (stated). tail: degrees of freedom of Student's t, infinite of a Gaussian."""

    camera_T_ref: PoseEstimate
    statistics: PoseStatistics
    noise_deg: tuple[float, ...]
    noise_mm: tuple[float, ...]
    stated: bool
    tail: float


@dataclass(frozen=True)
class ClosedForm:
    """A method on the same poses. difference_mm, difference_deg: of the cameras from the joint estimate, the largest;
    sigmas: in units of the joint estimate's uncertainty, of all unknowns together (root of the mean square).
    failure: why there is none."""

    method: str
    difference_mm: float
    difference_deg: float
    board_mm: float
    board_deg: float
    sigmas: float
    failure: str = ""


@dataclass(frozen=True, repr=False)
class PoseCalibration(Presented):
    """The result of ``calibrate_pose_recording``.

    covariance: (6 + 6 C, 6 + 6 C) of body_T_board and each camera_T_ref together, in their right tangents.
    mocap_noise_deg, mocap_noise_mm: (3,) 1-sigma of what moves the board for all cameras of a frame, about and along
    its axes; None where no frames are shared.
    clock, effects: as of a ``Calibration``; an effect's hold-out error is in sigmas in place of px. numbered: as of a
    ``Recording``.
    views: the poses at the times that they were taken at; these and solution: None where it was read from a file."""

    capture: Capture
    cameras: dict[str, PoseCamera]
    body_T_board: PoseEstimate
    covariance: FloatArray
    mocap_noise_deg: tuple[float, ...] | None
    mocap_noise_mm: tuple[float, ...] | None
    closed_forms: tuple[ClosedForm, ...]
    stages: tuple[StageReport, ...]
    dropped: tuple[Dropped, ...]
    warnings: tuple[str, ...]
    provenance: Provenance
    clock: Clock | None = None
    effects: tuple[EffectFinding, ...] = ()
    numbered: bool = False
    views: Mapping[str, PoseViews] | None = field(default=None, compare=False, repr=False)
    solution: JointPoses | None = field(default=None, compare=False, repr=False)

    @property
    def chain(self) -> PoseChain:
        """The unknowns, as plain arrays."""
        cameras = {name: camera.camera_T_ref.a_T_b for name, camera in self.cameras.items()}
        return PoseChain(cameras, self.body_T_board.a_T_b)


@on_one_blas_thread
def calibrate_pose_recording(
    recording: PoseRecording, options: CalibrationOptions | None = None, *, progress: Progress = silent
) -> PoseCalibration:
    """Every camera's extrinsic and the board-to-body transform from poses alone. Of the options ``OF_POSES`` count.

    Raises GtcalError where the motion leaves a direction open, or for a clock where there is no time."""
    started, options = time.perf_counter(), options or CalibrationOptions()
    if recording.motion.numbered and (options.clock in ("estimate", "per_camera") or options.clock_drift):
        raise GtcalError("the recording goes by number (numbered: true), and has no time: leave --clock out")
    views, dropped, clock = recording.views, recording.dropped, None
    if options.clock in ("estimate", "per_camera"):
        views, clock, late = with_pose_clock(
            views,
            recording.motion,
            lambda some: _solved(some, options)[0].chain,
            per_camera=options.clock == "per_camera",
            drift=options.clock_drift,
            progress=progress,
        )
        dropped = (*dropped, *late)
    warnings = _motion_warnings(views, options)
    found, reports = _solved(views, options, progress)
    if options.clock == "test" and not recording.motion.numbered:
        clock, doubt = tested_pose_clock(
            views, recording.motion, found.chain, lambda some: _solved(some, options)[0].chain
        )
        warnings += (doubt,) if doubt else ()
    progress("effects", 0, 1)
    effects = _effects(views, recording.motion, found, options)
    progress("closed forms", 0, 1)
    forms = closed_forms(views, found)
    progress("closed forms", 1, 1)
    residuals = found.chain.residuals(views)
    covariance = found.covariance + effects.left_out.T @ effects.left_out if len(effects.left_out) else found.covariance
    return PoseCalibration(
        recording.capture,
        {
            name: _camera(name, index, v, found, covariance, residuals[name])
            for index, (name, v) in enumerate(views.items())
        },
        PoseEstimate(found.chain.body_T_board, covariance[:6, :6]),
        covariance,
        *_mocap_noise(found),
        forms,
        reports,
        dropped,
        (*warnings, *_gross_warnings(found), *effect_warnings(_advised(effects.effects))),
        provenance(options, recording.inputs, time.perf_counter() - started),
        clock,
        _advised(effects.effects),
        recording.motion.numbered,
        views,
        found,
    )


def _solved(
    views: Mapping[str, PoseViews], options: CalibrationOptions, progress: Progress = silent
) -> tuple[JointPoses, tuple[StageReport, ...]]:
    """The three stages."""
    progress("stage 1: Procrustes sweep", 0, 1)
    at, reports = time.perf_counter(), []
    chain = stage_1_of_poses(views, np.random.default_rng(options.seed))
    reports.append(_report(1, "Procrustes sweep", at, (), ""))
    progress("stage 2: 3-D alignment", 0, 1)
    at = time.perf_counter()
    chain, errors = stage_2_of_poses(views, chain, eps=options.eps, max_iterations=options.max_iterations)
    reports.append(_report(2, "3-D alignment", at, errors, "m^2/2"))
    progress("stage 3: poses", 0, 1)
    at = time.perf_counter()
    try:
        found = stage_3_of_poses(views, chain, eps=min(_EPS, options.eps), max_iterations=options.max_iterations)
    except np.linalg.LinAlgError:
        raise GtcalError("the poses leave a direction open: turn about two axes or more") from None
    reports.append(_report(3, "poses", at, found.errors, "whitened"))
    return found, tuple(reports)


def _advised(found: Sequence[EffectFinding]) -> tuple[EffectFinding, ...]:
    """What to do of poses: there are no stretches of them."""
    advice = "give what was taken before it and after it as two recordings; or record again with it fixed"
    return tuple(replace(finding, advice=advice) if finding.moment else finding for finding in found)


def _effects(
    views: Mapping[str, PoseViews], motion: RefMotion, found: JointPoses, options: CalibrationOptions
) -> FoundEffects:
    if not options.effects:
        return FoundEffects((), (), np.zeros((0, 0)))
    clock_free = options.clock in ("estimate", "per_camera")
    return find_pose_effects(views, motion, found.chain, clock_free=clock_free, drift_free=options.clock_drift)


def closed_forms(views: Mapping[str, PoseViews], joint: JointPoses) -> tuple[ClosedForm, ...]:
    """Each method on the same poses, against the joint estimate."""
    pairs = {name: PosePairs(v.ref_T_body, v.camera_T_board) for name, v in views.items()}
    found = []
    for name, method in CLOSED_FORMS.items():
        try:
            X, cameras = method(pairs)
        except (GtcalError, np.linalg.LinAlgError) as error:
            nan = float("nan")
            found.append(ClosedForm(name, nan, nan, nan, nan, nan, str(error)))
            continue
        off = [
            pose_difference(inverse(pose), inverse(joint.chain.camera_T_ref[camera]))
            for camera, pose in cameras.items()
        ]
        board_mm, board_deg = pose_difference(X, joint.chain.body_T_board)
        xi = differences(joint.chain, PoseChain(cameras, X))
        sigmas = float(np.sqrt(squared_distance(xi, joint.covariance) / len(xi)))
        found.append(
            ClosedForm(name, max(mm for mm, _ in off), max(deg for _, deg in off), board_mm, board_deg, sigmas)
        )
    return tuple(found)


def _motion_warnings(views: Mapping[str, PoseViews], options: CalibrationOptions) -> tuple[str, ...]:
    try:
        warning = check_turning(turning(v.ref_T_body for v in views.values()))
    except GtcalError as error:
        if not options.allow_degenerate:
            raise
        warning = str(error)
    return () if warning is None else (warning,)


def _gross_warnings(found: JointPoses) -> tuple[str, ...]:
    shares = {name: float(np.mean(weights < GROSS_WEIGHT)) for name, weights in found.weights.items()}
    return tuple(
        f"camera {name!r}: {share:.0%} of its poses contradict the chain and hardly count; a detector that flips "
        "a board, or a body that slips, looks like that"
        for name, share in shares.items()
        if share > _MOST_GROSS
    )


def _report(stage: int, name: str, started_s: float, errors: tuple[float, ...], unit: str) -> StageReport:
    before, after = (errors[0], errors[-1]) if errors else (float("nan"), float("nan"))
    seconds = time.perf_counter() - started_s
    return StageReport(stage, name, max(len(errors) - 1, 0), before, after, unit, float("nan"), seconds)


def _camera(
    name: str, index: int, views: PoseViews, found: JointPoses, covariance: FloatArray, residuals: FloatArray
) -> PoseCamera:
    columns, noise = slice(6 + 6 * index, 12 + 6 * index), found.noise[name]
    deg, mm = _sigmas(noise.covariance, stated=views.covariance is not None)
    return PoseCamera(
        PoseEstimate(found.chain.camera_T_ref[name], covariance[columns, columns]),
        PoseStatistics.of(residuals, found.weights[name]),
        deg,
        mm,
        views.covariance is not None,
        noise.tail,
    )


def _mocap_noise(found: JointPoses) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    return (None, None) if found.mocap_covariance is None else _sigmas(found.mocap_covariance, stated=False)


def _sigmas(covariance: FloatArray, *, stated: bool) -> tuple[tuple[float, ...], tuple[float, ...]]:
    sigmas = np.sqrt(np.diag(covariance))
    deg, mm = (sigmas[:3], sigmas[3:]) if stated else (np.rad2deg(sigmas[:3]), 1e3 * sigmas[3:])
    return tuple(deg.tolist()), tuple(mm.tolist())
