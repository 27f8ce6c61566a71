"""What a verification with the Lollypop found: errors, statistics, verdict and findings.

A *sighting* is one face of the device in one image, at a moment at which the mocap has its pose. Its image centre is
measured in the image alone, its mocap centre comes from the mocap through the calibration; the calibration is as good
as they agree. All arrays over sightings have S rows, in order of time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import numpy.typing as npt

from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration, Provenance
from gtcal.results.presented import PresentedVerification
from gtcal.verification.error_types import ERROR_CLASS_LIMITS_PX as ERROR_CLASS_LIMITS_PX
from gtcal.verification.error_types import Bias as Bias
from gtcal.verification.error_types import ErrorClass as ErrorClass
from gtcal.verification.error_types import ErrorCurve as ErrorCurve
from gtcal.verification.error_types import ErrorStatistics as ErrorStatistics
from gtcal.verification.error_types import HeatMap as HeatMap
from gtcal.verification.error_types import error_classes as error_classes
from gtcal.verification.fault import MAIN_CAUSE as MAIN_CAUSE
from gtcal.verification.fault import Fault as Fault
from gtcal.verification.fault import FaultKind as FaultKind

if TYPE_CHECKING:
    from gtcal.verification.lollypop import Lollypop
    from gtcal.verification.lollypop_recording import LollypopRecording


class Verdict(StrEnum):
    """PASS and FAIL hold with the stated confidence; INCONCLUSIVE is what the recording cannot decide."""

    PASS = "pass"
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"

    @property
    def exit_code(self) -> int:
        """Of the command line."""
        return {Verdict.PASS: 0, Verdict.FAIL: 3, Verdict.INCONCLUSIVE: 4}[self]


ClockSource = Literal["calibration", "estimate", "trust"]
ImagesLookedAt = Literal["all", "expected"]


@dataclass(frozen=True)
class VerificationOptions:
    """Tolerances and limits of ``gtcal.verify``.

    clock: calibration: where the calibration found an offset between the clocks, it is applied. estimate: what is left
        of one in this recording is found from the sightings, and applied too. trust: the stamps are taken as they are.
    images: of cameras that come as images. all: every image is searched for the device. expected: some ten a second,
        where calibration and mocap say that it is seen, and near there (``gtcal.verification.lollypop_guide``).
    max_rmse_px: e_2D RMSE that passes. 0.5 px: where the paper's green ends, and above all of its table (0.22 to
        0.44 px on a real headset, detection and mocap noise included).
    max_rmse_mm: e_3D RMSE that passes. 1 mm: what 0.5 px are at 1 m through a focal length of 500 px.
    confidence: of the bounds on the RMSE that decide (one-sided) and of the intervals of the bias (two-sided).
    max_viewing_angle_deg: sightings more oblique than this, from the face's normal, are left out. At 60 deg the tape
        that holds the discs, 0.12 mm proud, shifts the centre by 0.1 mm.
    min_sightings, min_blocks: a camera with fewer sightings, or with fewer independent stretches of time, is
        inconclusive.
    min_coverage: share of the image's cells (``coverage_columns`` x ``coverage_rows``, those the lens can see) with a
        sighting; a camera with less is inconclusive.
    min_parallax_deg: least angle between two cameras' rays for a triangulation.
    heat_map_columns, heat_map_rows: bins of the heat map, by default two by two to a cell of the coverage.
    false_alarm_rate: of the fault finding, over all its tests of one recording together.
    least_fault_px: a finding must move the image centre by this, RMS over the sightings it concerns; less is of no
        consequence even where it is real.

    Raises GtcalError for a value that makes no sense."""

    clock: ClockSource = "calibration"
    images: ImagesLookedAt = "all"
    max_rmse_px: float = 0.5
    max_rmse_mm: float = 1.0
    confidence: float = 0.95
    max_viewing_angle_deg: float = 60.0
    min_sightings: int = 50
    min_blocks: int = 8
    min_coverage: float = 0.2
    coverage_columns: int = 8
    coverage_rows: int = 6
    min_parallax_deg: float = 3.0
    heat_map_columns: int = 16
    heat_map_rows: int = 12
    false_alarm_rate: float = 0.002
    least_fault_px: float = 0.1

    def __post_init__(self) -> None:
        if self.clock not in get_args(ClockSource):
            raise GtcalError(f"clock: {self.clock!r} is none of {', '.join(get_args(ClockSource))}")
        if self.images not in get_args(ImagesLookedAt):
            raise GtcalError(f"images: {self.images!r} is none of {', '.join(get_args(ImagesLookedAt))}")
        for name in ("max_rmse_px", "max_rmse_mm", "least_fault_px"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise GtcalError(f"{name}: {getattr(self, name)} is not a positive number")
        for name, low, high in (
            ("confidence", 0.5, 1.0),
            ("false_alarm_rate", 0.0, 0.5),
            ("max_viewing_angle_deg", 0.0, 90.0),
            ("min_parallax_deg", 0.0, 90.0),
        ):
            if not low < getattr(self, name) < high:
                raise GtcalError(
                    f"{name}: {getattr(self, name)} is out of range; expected between {low:g} and {high:g}"
                )
        if not 0.0 <= self.min_coverage <= 1.0:
            raise GtcalError(f"min_coverage: {self.min_coverage} is out of range; expected a share from 0 to 1")
        for name, least in (
            ("min_sightings", 2),
            ("min_blocks", 2),
            ("coverage_columns", 1),
            ("coverage_rows", 1),
            ("heat_map_columns", 1),
            ("heat_map_rows", 1),
        ):
            if getattr(self, name) < least:
                raise GtcalError(f"{name}: {getattr(self, name)} is out of range; expected {least} or more")


@dataclass(frozen=True)
class Sightings:
    """The sightings of one camera and their errors.

    camera: with the calibration's intrinsics. camera_T_ref: (4, 4) the calibration's.
    stamps_ns: (S,) increasing; two faces seen in one image share a stamp.
    frame_index: (S,) the stamp's place among the distinct stamps of all cameras.
    face_index: (S,) the face of the device.
    ref_T_body: (S, 4, 4) the device's body by the mocap.
    image_centre_px: (S, 2) the face's centre as the image has it. image_bearings: (S, 3) its unit bearing.
    mocap_centre_px: (S, 2) the face's centre by mocap and calibration. mocap_centre_in_camera_m: (S, 3), and how it
        moves: mocap_velocity_in_camera_m_s: (S, 3).
    tag_centre_in_camera_m: (S, 3) the face's centre by the image and the face's stated size: its depth is coarse.
    viewing_angle_rad: (S,) between the face's normal and the line of sight, as the image has it.
    """

    camera: Camera
    camera_T_ref: FloatArray
    stamps_ns: IntArray
    frame_index: IntArray
    face_index: IntArray
    ref_T_body: FloatArray
    image_centre_px: FloatArray
    image_bearings: FloatArray
    mocap_centre_px: FloatArray
    mocap_centre_in_camera_m: FloatArray
    mocap_velocity_in_camera_m_s: FloatArray
    tag_centre_in_camera_m: FloatArray
    viewing_angle_rad: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def errors_px(self) -> FloatArray:
        """(S, 2) image centre less mocap centre."""
        return self.image_centre_px - self.mocap_centre_px

    @property
    def e_2d_px(self) -> FloatArray:
        """(S,) the paper's e_2D: distance of the two centres in the image."""
        return np.linalg.norm(self.errors_px, axis=1)

    @property
    def errors_in_camera_m(self) -> FloatArray:
        """(S, 3) the image centre, back-projected to the depth of the mocap centre, less the mocap centre. Depth is z
        where the bearing has 10 deg or more to the image plane, and the distance beyond, where z tends to zero."""
        z, range_m = self.mocap_centre_in_camera_m[:, 2], self.distance_m
        ahead = np.minimum(z / range_m, self.image_bearings[:, 2]) > np.sin(np.deg2rad(10.0))
        scale = np.where(ahead, z / np.where(ahead, self.image_bearings[:, 2], 1.0), range_m)
        return self.image_bearings * scale[:, None] - self.mocap_centre_in_camera_m

    @property
    def e_3d_mm(self) -> FloatArray:
        """(S,) the paper's e_3D: length of ``errors_in_camera_m``. Blind along the ray."""
        return 1e3 * np.linalg.norm(self.errors_in_camera_m, axis=1)

    @property
    def distance_m(self) -> FloatArray:
        """(S,) from the camera to the mocap centre."""
        return np.linalg.norm(self.mocap_centre_in_camera_m, axis=1)

    @property
    def field_angle_rad(self) -> FloatArray:
        """(S,) between the optical axis and the image centre's bearing."""
        across = np.linalg.norm(self.image_bearings[:, :2], axis=1)
        return np.arctan2(across, self.image_bearings[:, 2])

    @property
    def radial_tangential_px(self) -> FloatArray:
        """(S, 2) the error outwards from the principal point, and around it (from x towards y)."""
        outwards = self.image_centre_px - self.camera.theta[2:4]
        outwards = outwards / np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
        around = np.stack([-outwards[:, 1], outwards[:, 0]], axis=1)
        errors = self.errors_px
        return np.stack([(errors * outwards).sum(axis=1), (errors * around).sum(axis=1)], axis=1)


@dataclass(frozen=True)
class LeftOut:
    """Frames of one camera (or of one face in them) that were not used, and why."""

    camera: str
    reason: str
    count: int


@dataclass(frozen=True)
class ExpectedError:
    """A camera's systematic error against what the calibration's covariance lets expect.

    predicted_px: RMS over the sightings of what the covariance says of their pixels.
    observed_px, observed_sigma_px: RMS of the error that a small motion of the camera explains, and how sure that is.
    normalised: its distance from none, in units of both covariances per degree of freedom; about 1 where they hold.
    p_value: of one as large or larger, were the covariance true. agrees: that is 1 % or more."""

    predicted_px: float
    observed_px: float
    observed_sigma_px: float
    normalised: float
    p_value: float
    agrees: bool

    @property
    def statement(self) -> str:
        """For people."""
        found = (
            f"systematic error {self.observed_px:.2g} px (known to {self.observed_sigma_px:.2g}), "
            f"{self.predicted_px:.2g} px expected of its covariance"
        )
        if self.agrees:
            return f"{found}: agrees"
        return f"{found}: larger than its covariance explains (drift, or an error of the model)"


@dataclass(frozen=True)
class CameraVerification:
    """One camera's errors and its verdict.

    reasons: why it is not a pass, one line each; empty for a pass.
    n_frames: images of the camera, or where it has none the distinct stamps of all cameras.
    coverage: share of the image's cells that the lens can see that hold a sighting.
    expected: None for a calibration without a covariance, or with too little data."""

    camera: str
    verdict: Verdict
    reasons: tuple[str, ...]
    n_frames: int
    n_sightings: int
    px: ErrorStatistics
    mm: ErrorStatistics
    bias: Bias
    coverage: float
    curves: tuple[ErrorCurve, ...]
    heat_map: HeatMap
    expected: ExpectedError | None = None


@dataclass(frozen=True)
class TriangulationCheck:
    """Where two or more cameras see a face at the same stamp: the point nearest to their rays against the mocap's.
    Depth included, unlike e_3D.

    cameras: names, in the order of the columns of ``seen_by``.
    stamps_ns: (T,). seen_by: (T, C) which cameras. parallax_deg: (T,) largest angle between two of the rays.
    errors_in_ref_mm: (T, 3) triangulated less mocap centre, in the frame ref.
    depth_mm, across_mm: (T,) its part along the mean line of sight (positive: farther), and the length of the rest.
    statistics: of the errors' lengths, None where T is 0. depth_rmse_mm, depth_bias_mm, across_rmse_mm: NaN there.
    The arrays have no rows where the verification was read from a file."""

    cameras: tuple[str, ...]
    stamps_ns: IntArray
    seen_by: npt.NDArray[np.bool_]
    parallax_deg: FloatArray
    errors_in_ref_mm: FloatArray
    depth_mm: FloatArray
    across_mm: FloatArray
    statistics: ErrorStatistics | None
    depth_rmse_mm: float
    depth_bias_mm: float
    across_rmse_mm: float


@dataclass(frozen=True)
class PoseCheck:
    """For a device with several faces: its pose from the image alone against the mocap's, per image with two faces or
    more. Depth included.

    stamps_ns: (P,). errors: (P, 6) xi in found_camera_T_body = calibrated_camera_T_body * Exp(xi): rotation first, in
    rad and m, along the body's axes.
    depth_mm, across_mm: (P,) the position's error along the line of sight (positive: farther), and the length of the
        rest. rotation_deg: (P,) angle.
    count: P; the RMSEs of the last three are NaN where it is 0. The arrays have no rows where the verification was read
        from a file."""

    camera: str
    stamps_ns: IntArray
    errors: FloatArray
    depth_mm: FloatArray
    across_mm: FloatArray
    rotation_deg: FloatArray
    count: int
    depth_rmse_mm: float
    across_rmse_mm: float
    rotation_rmse_deg: float


@dataclass(frozen=True, repr=False)
class Verification(PresentedVerification):
    """The result of ``verify``. It prints as the command line's tables; ``plot_heat_maps`` and its like draw it.

    reasons: why it is not a pass, one line each.
    pooled_px, pooled_mm: over the sightings of all cameras.
    pose_checks: empty for a device with one face.
    faults: the findings, the one that explains most first; empty where the errors look like noise.
    clock_offset_s: what the sightings want added to the cameras' stamps, with its 1-sigma, where it was asked for and
        applied; beyond what the calibration found, where that is applied too.
    sightings: by camera, empty where the verification was read from a file.
    calibration, recording: what was compared; None where the verification was read from a file."""

    verdict: Verdict
    reasons: tuple[str, ...]
    cameras: dict[str, CameraVerification]
    pooled_px: ErrorStatistics
    pooled_mm: ErrorStatistics
    triangulation: TriangulationCheck
    pose_checks: tuple[PoseCheck, ...]
    faults: tuple[Fault, ...]
    left_out: tuple[LeftOut, ...]
    warnings: tuple[str, ...]
    clock_offset_s: tuple[float, float] | None
    device: Lollypop
    options: VerificationOptions
    provenance: Provenance
    first_stamp_ns: int
    last_stamp_ns: int
    sightings: dict[str, Sightings] = field(default_factory=dict, compare=False, repr=False)
    calibration: Calibration | None = field(default=None, compare=False, repr=False)
    recording: LollypopRecording | None = field(default=None, compare=False, repr=False)

    @property
    def clock_lines(self) -> tuple[str, ...]:
        """What was added to the stamps, for people; empty where they were taken as the calibration has them."""
        if self.clock_offset_s is None:
            return ()
        offset_ms, sigma_ms = (1e3 * seconds for seconds in self.clock_offset_s)
        return (
            f"clock: {offset_ms:+.2f} ms ± {sigma_ms:.2f} added to the cameras' stamps, as the sightings want; an "
            "error along the device's motion is partly hidden by that",
        )

    @property
    def duration_s(self) -> float:
        return (self.last_stamp_ns - self.first_stamp_ns) * 1e-9
