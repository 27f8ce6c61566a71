"""Results as JSON, as models: what their files hold and what --json prints.

Most of a result is dataclasses, written field by field; their models are made of them (``model_of``), so that there is
one definition of each field. A number that nobody knows is null."""
# mypy: disable-error-code="valid-type, misc, arg-type"
# of models that are made when this is read

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from inspect import cleandoc
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import Field, create_model

from gtcal.board import Board
from gtcal.differences import difference
from gtcal.observed.views import Dropped
from gtcal.pose_recordings import calibration as poses
from gtcal.readers import mocap_summary
from gtcal.recordings.manifest import Entry
from gtcal.results import calibration
from gtcal.results.carried_over import CarriedOver as CarriedOverResult
from gtcal.results.effect_finding import EffectFinding
from gtcal.results.lens_move import LensMove
from gtcal.selfchecks.chain_and_pnp import ChainAndPnp
from gtcal.verification import drift, verification, verification_file

_Verdict = Literal["pass", "fail", "inconclusive"]
_Rows = list[list[float]]
_Numbers = list[float | None]


@cache
def model_of(kind: type, *left_out: str) -> type[Entry]:
    """The model of a dataclass as JSON has it, with its docstring, but for the fields ``left_out``."""
    hints = get_type_hints(kind, localns={"Lollypop": dict, "LollypopRecording": dict})
    given: dict[str, Any] = {
        field.name: (_as_json(hints[field.name]), ...) for field in fields(kind) if field.name not in left_out
    }
    return create_model(kind.__name__, __base__=Entry, __doc__=cleandoc(kind.__doc__ or ""), **given)


def _as_json(hint: Any) -> Any:
    """The type that JSON has for one of Python."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is np.ndarray:
        return list[Any]
    if origin in (Union, types.UnionType):
        return Union[tuple(_as_json(part) for part in parts)]  # noqa: UP007  # of a tuple
    if origin in (tuple, list):
        inner = tuple(dict.fromkeys(_as_json(part) for part in parts if part is not Ellipsis))
        return list[Union[inner]]  # noqa: UP007
    if origin in (dict, Mapping):
        return dict[str, _as_json(parts[1])]
    if is_dataclass(hint):
        return model_of(hint, *verification_file.NOT_WRITTEN.get(hint, ()))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return Literal[tuple(str(each) for each in hint)]
    return {float: float | None, Path: str, object: Any, dict: dict[str, Any], Board: dict[str, Any]}.get(hint, hint)


class Input(Entry):
    """A file, or a folder of files, that a result was computed from."""

    path: str
    sha256: str


class Provenance(Entry):
    """How a result was made."""

    created_utc: str
    command_line: list[str]
    versions: dict[str, str]
    options: dict[str, Any]
    inputs: list[Input]
    duration_s: float


class Pose(Entry):
    """a_T_b: takes coordinates in frame b to coordinates in frame a."""

    matrix: _Rows = Field(description="4 x 4, m.")
    quat_wxyz: list[float]
    t_m: list[float]
    rotation_sigma_deg: list[float] | None = Field(description="1-sigma of the attitude about the axes of b.")
    covariance: _Rows | None = Field(description="6 x 6 of xi in a_T_b * Exp(xi): rotation in rad, translation in m.")


class BoardPose(Pose):
    """body_T_board."""

    position_of_board_in_body_sigma_mm: list[float] | None


class CameraPose(Pose):
    """camera_T_ref."""

    position_of_camera_in_ref_m: list[float]
    position_of_camera_in_ref_sigma_mm: list[float] | None


class CalibratedCamera(Entry):
    """A camera of a calibration."""

    model: str
    image_size_px: list[int] = Field(description="Width and height.")
    parameters: dict[str, float]
    rolling_shutter: dict[str, Any] | None
    parameter_sigmas: dict[str, float] | None = Field(description="1-sigma, where they were solved for.")
    parameter_covariance: _Rows | None
    camera_T_ref: CameraPose
    residuals: model_of(calibration.ResidualStatistics)
    lens_moves: list[model_of(LensMove)]


class BoardShape(Entry):
    """The board's shape where it was solved for, in m and shares."""

    shape: dict[str, float]
    sigmas: dict[str, float]
    stated_sigmas: dict[str, float]
    covariance: _Rows


class JointCovariance(Entry):
    """Of body_T_board, each camera_T_ref, then each camera's intrinsics that were solved for."""

    theta_sizes: dict[str, int]
    matrix: _Rows
    board_shape: _Rows | None


class EstimatedCamera(Entry):
    """A camera in an estimate."""

    camera_T_ref: _Rows
    theta: list[float]


class Estimate(Entry):
    """The unknowns after a stage."""

    body_T_board: _Rows
    cameras: dict[str, EstimatedCamera]
    board_shape: list[float]


class Segment(Entry):
    """A stretch of a recording during which something moved."""

    start_s: float
    end_s: float
    moved: str
    body_T_board: BoardPose
    camera_T_ref: dict[str, Pose]


class Calibration(Entry):
    """calibration.json, and what 'gtcal calibrate --json' prints."""

    gtcal_calibration: Literal[1]
    conventions: str
    capture: str
    board: dict[str, Any]
    board_shape: BoardShape | None
    rmse_px: float = Field(description="Pooled over the corners of all cameras.")
    sigma_px: float
    covariance_kind: str = Field(description="Which of the covariances the poses carry.")
    warnings: list[str]
    cameras: dict[str, CalibratedCamera]
    body_T_board: BoardPose
    covariances: dict[str, JointCovariance]
    estimates: dict[str, Estimate] = Field(description="By stage.")
    mocap_noise: model_of(calibration.MocapNoise) | None
    clock: model_of(calibration.Clock) | None
    effects: list[model_of(EffectFinding)]
    carried_over: model_of(CarriedOverResult) | None
    segments: list[Segment]
    stages: list[model_of(calibration.StageReport)]
    dropped: list[model_of(Dropped)]
    provenance: Provenance


class PoseCalibratedCamera(Entry):
    """A camera of a calibration from poses."""

    camera_T_ref: Pose
    position_of_camera_in_ref_m: list[float]
    residuals: model_of(poses.PoseStatistics)
    noise_deg: list[float]
    noise_mm: list[float]
    noise_in_units_of_what_was_stated: bool
    students_t_degrees_of_freedom: float | None


class PoseCalibration(Entry):
    """What 'gtcal calibrate' writes and prints of a recording of poses."""

    gtcal_pose_calibration: Literal[1]
    conventions: str
    capture: str
    warnings: list[str]
    cameras: dict[str, PoseCalibratedCamera]
    body_T_board: Pose
    covariance: _Rows
    mocap_noise_deg: list[float] | None
    mocap_noise_mm: list[float] | None
    closed_forms: list[model_of(poses.ClosedForm)]
    stages: list[model_of(calibration.StageReport)]
    dropped: list[model_of(Dropped)]
    provenance: Provenance


class PoseComparison(Entry):
    """What 'gtcal compare --json' prints of a recording of poses."""

    gtcal_pose_comparison: Literal[1]
    closed_forms: list[model_of(poses.ClosedForm)]


class _Head(Entry):
    gtcal_verification: Literal[1]
    conventions: str


class Verification(
    _Head,
    model_of(verification.Verification, "provenance", *verification_file.NOT_WRITTEN[verification.Verification]),
):
    """verification.json, and what 'gtcal verify --json' prints."""

    provenance: Provenance


class RecordingOfDrift(Entry):
    """A recording of a series."""

    name: str
    verdict: _Verdict
    reasons: list[str]
    findings: list[str]
    cameras: dict[str, dict[Literal["px", "mm"], model_of(verification.ErrorStatistics)]]


class Drift(Entry):
    """drift.json, and what 'gtcal drift --json' prints."""

    gtcal_drift: Literal[1]
    verdict: _Verdict
    first_failing: str | None
    recordings: list[RecordingOfDrift]
    trends: list[model_of(drift.Trend)]
    options: model_of(verification.VerificationOptions)
    provenance: Provenance


class HalvesDifference(Entry):
    """Between the calibrations of two halves, of one unknown."""

    what: str
    per_dof: float
    dof: int
    probability: float
    position_mm: float | None = Field(None, description="Of a pose.")
    angle_deg: float | None = Field(None, description="Of a pose.")


class SplitHalf(Entry):
    """The first half of a recording against the second."""

    agrees: bool
    overall: HalvesDifference
    by_unknown: list[HalvesDifference]


class HoldOut(Entry):
    """Blocks of time, each predicted without having been seen."""

    estimate: str
    rmse_px: float
    rmse_by_camera_px: dict[str, float | None]
    rmse_by_block_px: dict[str, float | None]
    position_spread_mm: dict[str, float]


class CameraChain(model_of(ChainAndPnp)):
    """Where a camera's error is; RMS lengths."""

    mocap_px: float
    calibration_px: float


class SelfCheck(Entry):
    """What 'gtcal selfcheck' writes, and prints with --json."""

    gtcal_selfcheck: Literal[1]
    statements: list[str]
    notes: list[str]
    split_half: SplitHalf | None
    n_folds: int
    hold_out: list[HoldOut]
    chain_and_pnp: list[CameraChain]
    provenance: Provenance


class ComparedMethod(Entry):
    """A method on the same recording; lengths are those of the camera that is farthest off."""

    method: str
    failure: str = Field(description="Why it has no result; else empty.")
    board_rmse_px: float | None
    lollypop_rmse_px: float | None
    difference_mm: float | None = Field(description="From the joint solution.")
    difference_deg: float | None
    duration_s: float
    sigma_mm: float | None
    sigma_deg: float | None
    truth_mm: float | None
    truth_deg: float | None
    camera_T_ref: dict[str, _Rows] | None = None
    body_T_board: _Rows | None = None


class Comparison(Entry):
    """What 'gtcal compare' writes, and prints with --json."""

    gtcal_comparison: Literal[1]
    methods: list[ComparedMethod]
    provenance: Provenance


class ImageUncertainty(Entry):
    """1-sigma over a camera's image, of points at one distance."""

    camera: str
    distance_m: float
    median_px: float
    worst_px: float
    median_mm: float
    worst_mm: float


class WeakDirection(Entry):
    """A way in which all of it can move at once."""

    grade: str
    sentence: str


class Uncertainty(Entry):
    """What 'gtcal uncertainty' writes, and prints with --json."""

    gtcal_uncertainty: Literal[1]
    calibration: str
    covariance_kind: str
    largest_sigma: dict[str, dict[str, str]] = Field(description="By pose and kind of covariance, in words.")
    images: list[ImageUncertainty]
    least_sure: list[WeakDirection]


class ChangeOf(model_of(difference.Change)):
    """From the first calibration to the second, of one thing."""

    probability: float
    verdict: str


class Difference(Entry):
    """What 'gtcal diff' writes, and prints with --json."""

    gtcal_difference: Literal[1]
    verdict: str
    statements: list[str]
    notes: list[str]
    options: model_of(difference.DifferenceOptions)
    b_ref_T_a_ref: _Rows | None
    changes: list[ChangeOf]
    provenance: Provenance


class Found(Entry):
    """One thing that is wrong with a recording."""

    fault: str
    says: str
    manifest_lines: list[str]
    advice: list[str]
    evidence: str
    measure: str
    before: float | None
    after: float | None
    unit: str
    alternatives: list[str]


class Diagnosis(Entry):
    """What 'gtcal doctor' writes, and prints with --json."""

    gtcal_diagnosis: Literal[1]
    healthy: bool
    statement: str
    findings: list[Found]
    unexplained: str | None
    notes: list[str]
    misfit_mm: float | None
    misfit_deg: float | None


class Span(Entry):
    """When something was recorded, from the recording's first stamp on; by number, of its first and last."""

    rate_hz: float | None
    first: float
    last: float
    n_gaps: int
    longest_gap_s: float | None
    n_lost: int


class SummaryCamera(Entry):
    """A camera of a recording."""

    model: str
    image_size_px: list[int]
    intrinsics_stated: bool
    source: str
    n_images: int | None
    times: Span
    share_with_pose: float = Field(description="Of its images at which every tracked body has a pose.")
    n_views: int | None = Field(description="null where the board was not looked for yet.")
    n_corners: int | None
    covered: float | None = Field(description="Share of the image with corners.")


class SummaryBody(Entry):
    """A tracked body of a recording."""

    n_poses: int
    times: Span
    range_mm: list[float]
    largest_turn_deg: float


class Summary(Entry):
    """What 'gtcal info --json' prints of a recording."""

    gtcal_summary: Literal[1]
    what: str
    numbered: bool
    cameras: dict[str, SummaryCamera]
    bodies: dict[str, SummaryBody]
    remarks: list[str]


class _MocapHead(Entry):
    gtcal_mocap_file: Literal[1]


class MocapFile(_MocapHead, model_of(mocap_summary.MocapSummary)):
    """What 'gtcal info --json' prints of a file of mocap data."""


class Draft(Entry):
    """What 'gtcal init --json' prints."""

    gtcal_draft: Literal[1]
    manifest: str = Field(description="The file that was written.")
    questions: list[str] = Field(description="To be answered in it before it loads.")
    warnings: list[str] = Field(description="What doesn't fit together: clocks that have no time in common.")
    left_aside: list[str]


class DetectedCamera(Entry):
    """The board in a camera's images."""

    n_images: int | None
    n_views: int = Field(description="Images with the board.")
    n_corners: int
    median_corners_per_view: float


class Detection(Entry):
    """What 'gtcal detect --json' prints."""

    gtcal_detection: Literal[1]
    corners_of_board: int
    cameras: dict[str, DetectedCamera]


class ErrorFromTruth(Entry):
    """How far a camera, or the board, is from the truth."""

    what: str
    position_mm: float
    rotation_deg: float


class Demo(Entry):
    """What 'gtcal demo --json' prints; with --fleet it is 'history'."""

    gtcal_demo: Literal[1]
    folder: str
    calibration: Calibration
    errors: list[ErrorFromTruth]
    verification: Verification
