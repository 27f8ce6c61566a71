"""What a calibration found, how sure it is, and how it was found."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from scipy.spatial.transform import Rotation

from factors.board_shape import FLAT
from factors.rigid import inverse
from gtcal.camera import Camera, FloatArray
from gtcal.files import InputFile
from gtcal.observed.estimate import Estimate
from gtcal.observed.views import Dropped, Views
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import IntArray
from gtcal.results.board_shape import BoardShape
from gtcal.results.carried_over import CarriedOver
from gtcal.results.covariance import JointCovariance
from gtcal.results.effect_finding import EffectFinding
from gtcal.results.lens_move import LensMove
from gtcal.results.other_board import OtherBoard
from gtcal.results.presented import PresentedCalibration


@dataclass(frozen=True)
class PoseEstimate:
    """A rigid transform with its uncertainty.

    a_T_b: (4, 4).
    covariance: (6, 6) of xi in a_T_b * Exp(xi): rotation first, in rad and m, along the axes of frame b. None where
        no covariance was computed."""

    a_T_b: FloatArray
    covariance: FloatArray | None

    @property
    def rotation_sigma_deg(self) -> FloatArray | None:
        """(3,) 1-sigma of the attitude about the axes of b."""
        return None if self.covariance is None else np.rad2deg(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def position_of_a_in_b_m(self) -> FloatArray:
        """(3,) the origin of a in b: for camera_T_ref, where the camera is."""
        return inverse(self.a_T_b)[:3, 3]

    @property
    def position_of_a_in_b_covariance_m2(self) -> FloatArray | None:
        """(3, 3) of ``position_of_a_in_b_m``: Exp(-xi) b_T_a moves the origin p by p x rotation - translation."""
        if self.covariance is None:
            return None
        x, y, z = self.position_of_a_in_b_m
        J = np.hstack([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], -np.eye(3)])
        return J @ self.covariance @ J.T

    @property
    def position_of_a_in_b_sigma_mm(self) -> FloatArray | None:
        """(3,) 1-sigma of ``position_of_a_in_b_m`` along the axes of b."""
        covariance = self.position_of_a_in_b_covariance_m2
        return None if covariance is None else 1e3 * np.sqrt(np.diag(covariance))

    @property
    def position_of_b_in_a_sigma_mm(self) -> FloatArray | None:
        """(3,) 1-sigma of the origin of b along the axes of a: for body_T_board, of the board's origin in the body."""
        if self.covariance is None:
            return None
        R = self.a_T_b[:3, :3]
        return 1e3 * np.sqrt(np.diag(R @ self.covariance[3:, 3:] @ R.T))


def pose_moved(a_T_b: FloatArray, xi: FloatArray) -> tuple[float, float]:
    """How far, in mm and deg, a's position in b moves with a_T_b * Exp(xi), xi (6,) small."""
    position_m = PoseEstimate(a_T_b, None).position_of_a_in_b_m
    return float(1e3 * np.linalg.norm(np.cross(position_m, xi[:3]) - xi[3:])), float(np.rad2deg(np.linalg.norm(xi[:3])))


def pose_difference(found_a_T_b: FloatArray, true_a_T_b: FloatArray) -> tuple[float, float]:
    """Distance in mm between the origins of b in a, and angle in deg between the attitudes, of two transforms."""
    position_mm = 1e3 * float(np.linalg.norm(found_a_T_b[:3, 3] - true_a_T_b[:3, 3]))
    turn = Rotation.from_matrix(found_a_T_b[:3, :3].T @ true_a_T_b[:3, :3])
    return position_mm, float(np.rad2deg(turn.magnitude()))


@dataclass(frozen=True)
class ResidualStatistics:
    """Reprojection residuals of the corners that were used; norms in px.

    rmse_px is pooled per corner: the root of the mean squared norm. n_without_pixel: corners among them that the result
    places where the lens has no pixel; the other numbers leave them out."""

    rmse_px: float
    median_px: float
    p95_px: float
    worst_px: float
    n_views: int
    n_corners: int
    n_without_pixel: int

    @staticmethod
    def of(norms_px: FloatArray, n_views: int) -> ResidualStatistics:
        """Of the corners' residual norms (N,), infinite for those without a pixel."""
        finite = norms_px[np.isfinite(norms_px)]
        return ResidualStatistics(
            rmse_px=float(np.sqrt(np.mean(finite**2))),
            median_px=float(np.median(finite)),
            p95_px=float(np.quantile(finite, 0.95)),
            worst_px=float(finite.max()),
            n_views=n_views,
            n_corners=len(norms_px),
            n_without_pixel=len(norms_px) - len(finite),
        )


@dataclass(frozen=True)
class CameraCalibration:
    """One camera: with the intrinsics used or found, where it is, and how well its corners fit.

    theta_covariance: (K, K) of the intrinsics where they were solved for, else None.
    lens_moves: how far they then moved from what was known of them beforehand, where anything was."""

    camera: Camera
    camera_T_ref: PoseEstimate
    theta_covariance: FloatArray | None
    residuals: ResidualStatistics
    lens_moves: tuple[LensMove, ...] = ()

    @property
    def camera_with_sigmas(self) -> Camera:
        """The camera with the sigmas of its intrinsics, as far as they were solved for."""
        found = self.theta_covariance
        return self.camera if found is None else replace(self.camera, theta_sigmas=np.sqrt(np.diag(found)))


@dataclass(frozen=True)
class SmoothError:
    """1-sigma of errors of a tracked body that are no noise, along and about its axes: smooth ``over`` 'time' or
    'place', where the body is and how it is turned."""

    body: str
    over: str
    translation_mm: float
    rotation_deg: float


@dataclass(frozen=True)
class MocapNoise:
    """What the mocap's noise was taken to be, and whether modelling it (stage 4) earned its place.

    translation_sigma_mm, rotation_sigma_deg: 1-sigma along and about each axis, by tracked body. correlation_s: time
        over which the noise is correlated. jitter_s: 1-sigma of the mocap's time stamps.
    estimated: from the recording, else given.
    innovation_variance: of what the model does not foresee, whitened; 1 where the sigmas are right. lag_1: its
        correlation from frame to frame, 0 where nothing systematic is left; lag_1_sigma: of chance.
    hold_out_px: by stage, 3 and 4: RMSE of blocks of time that the estimate has not seen.
    stage: whose estimate was taken. reason: why, in words.
    smooth: what the mocap errs by beside noise, largest first; it is in the covariance."""

    translation_sigma_mm: dict[str, float]
    rotation_sigma_deg: dict[str, float]
    correlation_s: float
    jitter_s: float
    estimated: bool
    innovation_variance: float
    lag_1: float
    lag_1_sigma: float
    hold_out_px: dict[int, float]
    stage: int
    reason: str
    smooth: tuple[SmoothError, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """A line on what the mocap errs by beside noise."""
        if not self.smooth:
            return ()
        words = {"time": "over the recording", "place": "with where it is and how it is turned"}
        parts = ", ".join(
            f"those of {part.body!r} vary {words[part.over]} by {part.translation_mm:.2g} mm and "
            f"{part.rotation_deg:.1g} deg"
            for part in self.smooth
        )
        return (
            f"the mocap's errors are not noise alone: {parts} (1-sigma); the result and its sigmas allow for that; "
            "markers that creep, a volume that warms or an arm's joints err so",
        )


@dataclass(frozen=True)
class Clock:
    """The offset of the cameras' clock: stamp + offset_s is the mocap's time. 1-sigma beside it; all by camera.

    corrected: whether the calibration was computed at the corrected times; else the offset is what the data want though
        the recording was taken as synchronised.
    drift: by how much the offset grows per second about ``middle_ns``; 0 where it was not asked for.
    readout_s, readout_sigma_s: of the rolling shutters whose readout time was found; those that were stated are not
        here but with their cameras.
    """

    offset_s: dict[str, float]
    sigma_s: dict[str, float]
    corrected: bool
    drift: float = 0.0
    drift_sigma: float = 0.0
    middle_ns: int = 0
    readout_s: dict[str, float] = field(default_factory=dict)
    readout_sigma_s: dict[str, float] = field(default_factory=dict)

    def mocap_ns(self, camera: str, stamps_ns: IntArray) -> IntArray:
        """(N,) the mocap's time of images that this camera stamped so."""
        return moved_ns(stamps_ns, self.offset_s[camera], self.drift, self.middle_ns)

    @property
    def readout_statements(self) -> tuple[str, ...]:
        """For people, of each rolling shutter whose readout time was found."""
        return tuple(
            f"camera {name!r} reads its rows out in {1e3 * seconds:.2f} ms ± {1e3 * self.readout_sigma_s[name]:.2f}"
            for name, seconds in self.readout_s.items()
        )

    @property
    def statement(self) -> str:
        """For people; cameras that share an offset are not told apart."""
        by_offset: dict[tuple[float, float], list[str]] = {}
        for name, offset_s in self.offset_s.items():
            by_offset.setdefault((offset_s, self.sigma_s[name]), []).append(name)
        shared = len(by_offset) == 1
        parts = [
            f"{1e3 * offset:+.2f} ms ± {1e3 * sigma:.2f}" + ("" if shared else f" for {', '.join(names)}")
            for (offset, sigma), names in by_offset.items()
        ]
        drift = f", growing by {1e6 * self.drift:+.1f} us/s ± {1e6 * self.drift_sigma:.1f}" if self.drift_sigma else ""
        return "; ".join(parts) + drift


def moved_ns(stamps_ns: IntArray, offset_s: float, drift: float, middle_ns: int) -> IntArray:
    """(N,) stamps moved by an offset that grows by ``drift`` per second about ``middle_ns``."""
    grown_ns = np.rint(drift * (stamps_ns - middle_ns)).astype(np.int64)
    return stamps_ns + round(1e9 * offset_s) + grown_ns


@dataclass(frozen=True)
class StageReport:
    """One stage of the solution.

    error_before, error_after: of the stage's own objective, in ``error_unit``; of stage 1, that of its worst and its
        best start; of the intrinsics, what they leave when each view has a board pose of its own.
    median_px: median reprojection residual over all views after the stage; of PnP, with a pose of each view's own."""

    stage: int
    name: str
    iterations: int
    error_before: float
    error_after: float
    error_unit: str
    median_px: float
    duration_s: float


@dataclass(frozen=True)
class Provenance:
    """How a result was made."""

    created_utc: str
    command_line: tuple[str, ...]
    versions: dict[str, str]
    options: dict[str, object]
    inputs: tuple[InputFile, ...]
    duration_s: float


@dataclass(frozen=True)
class Solution:
    """The optimised problem, for those who want to go on from it: add a factor, solve again.

    graph, values: GTSAM's, keys as in ``gtcal.estimation.graph``. views: the views and corners that were used, by
    camera. covariance_factor: by how much the calibration's covariance is larger than the graph's (few frames).
    lens_weight: how many times their information the priors of stated intrinsics count in the graph."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    estimate: Estimate
    views: dict[str, Views]
    covariance_factor: float = 1.0
    lens_weight: float = 1.0


@dataclass(frozen=True)
class Segment:
    """A stretch of a recording during which something moved.

    start_s, end_s: in s from the first image. moved: what moved at its start ('platform', 'board_body' or a camera);
        empty for the first.
    body_T_board, camera_T_ref: as of a ``Calibration``, in the bodies' frames as their markers then were."""

    start_s: float
    end_s: float
    moved: str
    body_T_board: PoseEstimate
    camera_T_ref: dict[str, PoseEstimate]


@dataclass(frozen=True, repr=False)
class Calibration(PresentedCalibration):
    """The result of ``calibrate``. It prints as the command line's tables; ``plot_cameras`` and its like draw it.

    sigma_px: standard deviation of one pixel coordinate, estimated from the residuals or as given.
    covariances: of X, every Y_c and every theta_c together, by kind (``gtcal.results.covariance``); none without
        stage 3.
    covariance_kind: which of them the estimates carry.
    estimates: by stage, 3 and 4, as far as they were run; the cameras and body_T_board are those of one of them.
    mocap_noise: None where it was not modelled.
    clock: None where it was neither estimated nor tested, or the motion does not tell.
    warnings: what the operator should know, a line each.
    effects: what the model leaves out and the data were asked about: first those that are no chance, by how far they
        would move a camera.
    segments: where it was calibrated in stretches between changes, those, in order of time; cameras and body_T_board
        are those of the first.
    board_shape: None where the board was taken as flat and as stated.
    carried_over: what was taken from an earlier calibration; None where nothing was.
    other_boards: of a recording of several, those beside the one that all else here is of.
    solution: None where the calibration was read from a file."""

    capture: Capture
    cameras: dict[str, CameraCalibration]
    body_T_board: PoseEstimate
    board: dict[str, object]
    sigma_px: float
    covariance_kind: str
    covariances: dict[str, JointCovariance]
    estimates: dict[int, Estimate]
    mocap_noise: MocapNoise | None
    stages: tuple[StageReport, ...]
    dropped: tuple[Dropped, ...]
    warnings: tuple[str, ...]
    provenance: Provenance
    clock: Clock | None = None
    effects: tuple[EffectFinding, ...] = ()
    segments: tuple[Segment, ...] = ()
    board_shape: BoardShape | None = None
    carried_over: CarriedOver | None = None
    other_boards: tuple[OtherBoard, ...] = ()
    solution: Solution | None = field(default=None, compare=False, repr=False)

    @property
    def covariance(self) -> JointCovariance | None:
        """The one that the estimates carry."""
        return self.covariances.get(self.covariance_kind)

    def with_covariance(self, joint: JointCovariance) -> Calibration:
        """The same with ``joint`` as the covariance that the estimates carry."""
        cameras = {
            name: replace(
                camera,
                camera_T_ref=replace(camera.camera_T_ref, covariance=joint.camera_T_ref(name)),
                theta_covariance=joint.theta(name),
            )
            for name, camera in self.cameras.items()
        }
        return replace(
            self,
            cameras=cameras,
            body_T_board=replace(self.body_T_board, covariance=joint.body_T_board),
            covariances={**self.covariances, joint.kind: joint},
            covariance_kind=joint.kind,
        )

    @property
    def estimate(self) -> Estimate:
        """The unknowns, as plain arrays."""
        return Estimate(
            self.body_T_board.a_T_b,
            {name: camera.camera_T_ref.a_T_b for name, camera in self.cameras.items()},
            {name: camera.camera.theta for name, camera in self.cameras.items()},
            FLAT if self.board_shape is None else self.board_shape.shape,
        )

    @property
    def rmse_px(self) -> float:
        """Pooled over the corners of all cameras."""
        parts = [camera.residuals for camera in self.cameras.values()]
        counts = [part.n_corners - part.n_without_pixel for part in parts]
        squares = sum(part.rmse_px**2 * count for part, count in zip(parts, counts, strict=True))
        return float(np.sqrt(squares / sum(counts)))
