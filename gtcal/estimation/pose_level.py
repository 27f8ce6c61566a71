"""Hand-eye calibration from poses alone: where there are no corners, only what a detector or a tracker made of them.

Each view has the mocap's (or an arm's) ref_T_body and a measured camera_T_board, which the chain Y_c * ref_T_body * X
should be. What it is off by, a rotation about the board's axes and a shift along the camera's, is Gaussian with one
covariance for all views, of heavier tails where the views want them (a Student t), found with the estimate itself by
expectation and maximisation (Lange, Little and Taylor 1989). Where the board's poses drift, as those of a visual
odometry, it is the steps from view to view that are measured, and Y_c alone is found from these; which of the two it is
is chosen by the smaller noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.spatial.transform import Rotation

from factors.marginal import MarginalFactor
from factors.moments import chain
from factors.rigid import inverse, skew
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.alignment_descent import converged_sweep
from gtcal.estimation.consensus import ViewPoses, consensus
from gtcal.estimation.graph import BODY_T_BOARD, camera_T_ref_key, minimise
from gtcal.estimation.linear import scaled_inverse
from gtcal.estimation.pose_noise import (
    TAILS,
    PoseNoise,
    minus_log_likelihood,
    robust_covariance,
    shrunk,
    weights_of,
)
from gtcal.estimation.procrustes import alignment_sums
from gtcal.results.calibration import PoseEstimate
from gtcal.results.presented import Presented

FEWEST_VIEWS = 3

_ROUNDS, _SETTLED = 30, 1e-4
_RIGID = 1e-3
"""What rotations that were written with few digits are off by."""

LEVER_M = 0.2
"""How far from its origin the board's points are taken to be where poses are aligned in 3-D, to start with."""


@dataclass(frozen=True, repr=False)
class PoseLevel(Presented):
    """The result of ``calibrate_poses``.

    camera_T_ref, body_T_board: (4, 4). covariance: (12, 12) of both, in that order, in their right tangents.
    weights: (V,) of the views, about 1, and near 0 for those that are gross. minus_log_likelihood: of the measured
    poses, but for a constant; it also tells which of two readings of the same poses is the likelier."""

    camera_T_ref: FloatArray
    body_T_board: FloatArray
    covariance: FloatArray
    noise: PoseNoise
    weights: FloatArray
    minus_log_likelihood: float

    @property
    def poses(self) -> tuple[PoseEstimate, PoseEstimate]:
        """camera_T_ref and body_T_board with their covariances."""
        return (
            PoseEstimate(self.camera_T_ref, self.covariance[:6, :6]),
            PoseEstimate(self.body_T_board, self.covariance[6:, 6:]),
        )


def calibrate_poses(
    ref_T_body: FloatArray, camera_T_board: FloatArray, rng: np.random.Generator | None = None
) -> PoseLevel:
    """Hand-eye calibration from poses alone: one camera's extrinsic and the board's place on its body.

        found = gtcal.calibrate_poses(ref_T_body, camera_T_board)
        found                # where the camera and the board are, with 1-sigma
        found.camera_T_ref   # (4, 4)

    ref_T_body: (V, 4, 4) of V >= 3 views in order of time, the poses of the board's body by a mocap or an arm, in m.
    camera_T_board: (V, 4, 4), the board's poses in the camera at the same times, as a detector measured them.
    rng: of the consensus of some views that is sought besides the alignment of all.

    Raises GtcalError for fewer pairs, a pose that is none, or where they leave a direction open."""
    if len(ref_T_body) < FEWEST_VIEWS or ref_T_body.shape != camera_T_board.shape:
        raise GtcalError(f"{len(ref_T_body)} and {len(camera_T_board)} poses: 3 or more of each are needed, in pairs")
    for what, poses in (("ref_T_body", ref_T_body), ("camera_T_board", camera_T_board)):
        _check_rigid(what, poses)
    start = _start(ref_T_body, camera_T_board, rng or np.random.default_rng(0))
    still = AbsolutePoses(ref_T_body, camera_T_board)
    try:
        found = _settled(still, start)
        if len(ref_T_body) > 2 * FEWEST_VIEWS:
            steps = _settled(PoseSteps(ref_T_body, camera_T_board), (found.camera_T_ref, found.body_T_board))
            if steps.noise.log_determinant < found.noise.log_determinant:
                return _with_board(steps, still)
    except np.linalg.LinAlgError:
        raise GtcalError("the poses leave a direction open: turn about two axes or more") from None
    return found


def _check_rigid(what: str, poses: FloatArray) -> None:
    R = np.nan_to_num(poses[:, :3, :3])
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = ~(np.isfinite(poses).all(axis=(1, 2)) & (off < _RIGID) & (np.linalg.det(R) > 0.0))
    if wrong.any():
        raise GtcalError(f"{what}: pose {int(np.argmax(wrong))} is no rotation and translation, or has NaN in it")


def _start(
    ref_T_body: FloatArray, camera_T_board: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """The better, by the median view, of the alignment of all views and of a consensus of some."""
    moments = np.tile(np.diag([LEVER_M**2] * 3 + [1.0]), (len(ref_T_body), 1, 1))
    views = ViewPoses(ref_T_body, camera_T_board, moments)
    swept = converged_sweep([alignment_sums(ref_T_body, camera_T_board, moments)], rng)
    starts = [(swept.camera_T_ref[0], swept.body_T_board)]
    agreed = consensus({"": views}, rng)
    starts += [(agreed[0][""], agreed[1])] if agreed is not None else []
    return min(starts, key=lambda start: float(np.median(views.rms_m(start[0][None], start[1][None]))))


@dataclass(frozen=True)
class AbsolutePoses:
    """The chain against each measured pose."""

    ref_T_body: FloatArray
    camera_T_board: FloatArray
    drifts: bool = False
    keys: tuple[int, ...] = (camera_T_ref_key(0), BODY_T_BOARD)

    def residuals(self, camera_T_ref: FloatArray, body_T_board: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(V, 6), and its derivatives (V, 6, 12) by xi in Y_c * Exp(xi) and X * Exp(xi)."""
        placed = self.ref_T_body @ body_T_board
        expected = camera_T_ref @ placed
        turned = Rotation.from_matrix(np.swapaxes(self.camera_T_board[:, :3, :3], 1, 2) @ expected[:, :3, :3])
        phi = turned.as_rotvec()
        J = np.zeros((len(phi), 6, 12))
        into = _inverse_right_jacobians(phi)
        R_Y = camera_T_ref[:3, :3]
        J[:, :3, :3], J[:, :3, 6:9] = into @ np.swapaxes(placed[:, :3, :3], 1, 2), into
        J[:, 3:, :3], J[:, 3:, 3:6] = -R_Y @ skew(placed[:, :3, 3]), R_Y
        J[:, 3:, 9:] = expected[:, :3, :3]
        return np.hstack([phi, expected[:, :3, 3] - self.camera_T_board[:, :3, 3]]), J


@dataclass(frozen=True)
class PoseSteps:
    """The camera's steps from view to view, by the chain Y_c * A_i * A_(i+1)^-1 * Y_c^-1, against the measured ones."""

    ref_T_body: FloatArray
    camera_T_board: FloatArray
    drifts: bool = True
    keys: tuple[int, ...] = (camera_T_ref_key(0),)

    def residuals(self, camera_T_ref: FloatArray, body_T_board: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(V - 1, 6), and its derivatives (V - 1, 6, 12); those by X are zero."""
        steps = self.ref_T_body[:-1] @ inverse(self.ref_T_body[1:])
        measured = self.camera_T_board[:-1] @ inverse(self.camera_T_board[1:])
        expected = camera_T_ref @ steps @ inverse(camera_T_ref)
        phi = Rotation.from_matrix(np.swapaxes(measured[:, :3, :3], 1, 2) @ expected[:, :3, :3]).as_rotvec()
        into, R_Y, R_step = _inverse_right_jacobians(phi), camera_T_ref[:3, :3], steps[:, :3, :3]
        J = np.zeros((len(phi), 6, 12))
        # Y Exp(xi) S Exp(-xi) Y^-1: its rotation turns, in its own frame, by R_Y (R_S^T - I) w
        J[:, :3, :3] = into @ R_Y @ (np.swapaxes(R_step, 1, 2) - np.eye(3))
        at = -np.asarray(R_Y.T @ camera_T_ref[:3, 3])  # Y's camera in ref: what Y^-1 takes zero to
        moved = R_step @ at + steps[:, :3, 3]
        J[:, 3:, :3] = R_Y @ (R_step @ skew(at) - skew(moved))
        J[:, 3:, 3:6] = R_Y @ (np.eye(3) - R_step)
        return np.hstack([phi, expected[:, :3, 3] - measured[:, :3, 3]]), J


_Model = AbsolutePoses | PoseSteps


def _settled(model: _Model, start: tuple[FloatArray, FloatArray]) -> PoseLevel:
    """By the tail that explains the views best."""
    return min((_with_tail(model, start, tail) for tail in TAILS), key=lambda found: found.minus_log_likelihood)


def _with_tail(model: _Model, start: tuple[FloatArray, FloatArray], tail: float) -> PoseLevel:
    """Estimate and noise in turns, until both stay."""
    (Y, X), r = start, model.residuals(*start)[0]
    covariance = robust_covariance(r)
    for _ in range(_ROUNDS):
        weights = weights_of(r, covariance, tail)
        Y, X = _minimised(model, (Y, X), covariance, weights)
        r, J = model.residuals(Y, X)
        before = covariance
        covariance = shrunk((r.T * weights) @ r / max(len(r) - len(model.keys), 1), len(r))
        if np.abs(np.diag(covariance) / np.diag(before) - 1.0).max() < _SETTLED:
            break
    weights = weights_of(r, covariance, tail)
    J = J[:, :, : 6 * len(model.keys)]
    information = np.einsum("via,ij,vjb->ab", J * weights[:, None, None], np.linalg.inv(covariance), J)
    noise, likelihood = PoseNoise(covariance, tail, model.drifts), minus_log_likelihood(r, covariance, tail)
    return PoseLevel(Y, X, scaled_inverse(information), noise, weights, likelihood)


def _minimised(
    model: _Model, at: tuple[FloatArray, FloatArray], covariance: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    root, size = np.sqrt(weights)[:, None], 6 * len(model.keys)

    def moments(values: gtsam.Values) -> FloatArray:
        Y = values.atPose3(model.keys[0]).matrix()
        X = values.atPose3(model.keys[1]).matrix() if len(model.keys) > 1 else at[1]
        r, J = model.residuals(Y, X)
        columns = np.concatenate([J[:, :, :size], r[:, :, None]], axis=2)
        white = (root[:, :, None] * (whiten @ columns)).reshape(-1, size + 1)
        return np.asarray(white.T @ white)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(MarginalFactor(model.keys, [6] * len(model.keys), moments))
    for key, pose in zip(model.keys, at, strict=False):
        values.insert(key, gtsam.Pose3(pose))
    found = minimise(graph, values, eps=1e-9, max_iterations=30).values
    return found.atPose3(model.keys[0]).matrix(), (
        found.atPose3(model.keys[1]).matrix() if len(model.keys) > 1 else at[1]
    )


def _with_board(steps: PoseLevel, still: AbsolutePoses) -> PoseLevel:
    """X where all views, drifted as they are, want it by their median; as unsure as they scatter."""
    wanted = inverse(chain(steps.camera_T_ref, still.ref_T_body, np.eye(4))) @ still.camera_T_board
    X = np.eye(4)
    X[:3, :3] = Rotation.from_matrix(wanted[:, :3, :3]).mean().as_matrix()
    X[:3, 3] = np.median(wanted[:, :3, 3], axis=0)
    turned = Rotation.from_matrix(X[:3, :3].T @ wanted[:, :3, :3]).as_rotvec()
    scatter = np.hstack([turned, (wanted[:, :3, 3] - X[:3, 3]) @ X[:3, :3]])
    covariance = np.zeros((12, 12))
    covariance[:6, :6], covariance[6:, 6:] = steps.covariance, scatter.T @ scatter / len(scatter)
    return replace(steps, body_T_board=X, covariance=covariance, weights=np.append(steps.weights, 1.0))


def _inverse_right_jacobians(phi: FloatArray) -> FloatArray:
    """(V, 3, 3) of Log(R Exp(w)) by w at w = 0, with R = Exp(phi) (Sola et al. 2018, eq. 144)."""
    angle = np.linalg.norm(phi, axis=1)
    safe = np.maximum(angle, 1e-4)
    of_square = np.where(angle < 1e-4, 1.0 / 12.0, 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe)))
    K = skew(phi)
    return np.asarray(np.eye(3) + 0.5 * K + of_square[:, None, None] * (K @ K))
