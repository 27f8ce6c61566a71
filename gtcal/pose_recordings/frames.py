"""The moments that effects and the clock are looked for in, of poses: what ``gtcal.effects.frames`` has of corners.

A pose says of A_f, X and Y_c what its residual's derivatives say; those by A_f are those by X, carried over by the
adjoint. The noise that moves the board for all cameras of a frame is integrated out, as the mocap's is there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import adjoint, inverse
from gtcal.camera import FloatArray
from gtcal.effects.frames import Frames, clusters
from gtcal.effects.isolated import isolated
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.frame_statistics import FrameMoments
from gtcal.estimation.mocap_noise import MocapNoiseModel
from gtcal.estimation.pose_joint import JointPoses, PoseChain, PoseViews, stage_3_of_poses
from gtcal.estimation.pose_noise import squared_distances
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

_FEWEST_STRETCHES = 10
_NEVER_GROSS = 6.0
"""Sigmas: a pose that is off by less needs no other explanation than noise with a tail."""

_LARGEST_LAG = 0.5
_EPS, _MOST_STEPS = 1e-6, 30


@dataclass(frozen=True)
class PoseFrames(Frames):
    """The frames' moments at a chain. of_views: the poses that they are of, isolated gross ones left out."""

    of_views: Mapping[str, PoseViews]
    chain: PoseChain

    def shifted_noise(self, shift: FloatArray) -> Frames | None:
        """The same with the noise that the poses show once their frames' tangents are shifted by (n, D - 1)."""
        moved = {name: self.moved(name, shift) for name in self.of_views}
        return _frames(self.of_views, self.motion, self.chain, _noise_of(moved, self.chain))

    def moved(self, name: str, shift: FloatArray) -> PoseViews:
        """A camera's poses, put where their residuals are those at tangents shifted by (n, D - 1)."""
        v = self.of_views[name]
        r, J = _rows(v, self.chain, name, self)
        rows = np.searchsorted(self.of_frames.frame_index, v.frame_index)
        left = r + np.einsum("vij,vj->vi", J, shift[rows])
        expected = self.chain.camera_T_ref[name] @ v.ref_T_body @ self.chain.body_T_board
        seen = expected.copy()
        seen[:, :3, :3] = expected[:, :3, :3] @ Rotation.from_rotvec(-left[:, :3]).as_matrix()
        seen[:, :3, 3] -= left[:, 3:]
        return replace(v, camera_T_board=seen)


def pose_frames(views: Mapping[str, PoseViews], motion: RefMotion, chain: PoseChain) -> PoseFrames | None:
    """Of all poses but isolated gross ones; None where these leave too few frames.

    Raises numpy.linalg.LinAlgError where the poses leave a direction open."""
    first = _noise_of(views, chain)
    kept = {name: _without_isolated(v, chain, name, first) for name, v in views.items()}
    return _frames(kept, motion, chain, _noise_of(kept, chain))


def _noise_of(views: Mapping[str, PoseViews], chain: PoseChain) -> JointPoses:
    """As Gaussian: what lasts, as effects do, is no tail."""
    return stage_3_of_poses(views, chain, eps=_EPS, max_iterations=_MOST_STEPS, tails=(np.inf,))


def _without_isolated(v: PoseViews, chain: PoseChain, name: str, noise: JointPoses) -> PoseViews:
    r = v.residuals(chain.camera_T_ref[name], chain.body_T_board)[0]
    lengths = np.sqrt(squared_distances(r, noise.noise[name].covariance))
    keep = ~isolated(lengths, _NEVER_GROSS)
    covariance = None if v.covariance is None else v.covariance[keep]
    return PoseViews(v.stamps_ns[keep], v.frame_index[keep], v.ref_T_body[keep], v.camera_T_board[keep], covariance)


def _frames(
    views: Mapping[str, PoseViews], motion: RefMotion, chain: PoseChain, noise: JointPoses
) -> PoseFrames | None:
    index, first = np.unique(np.concatenate([v.frame_index for v in views.values()]), return_index=True)
    stamps_ns = np.concatenate([v.stamps_ns for v in views.values()])[first]
    cluster = clusters(len(index))
    if cluster[-1] < _FEWEST_STRETCHES - 1:
        return None
    raw = _moments(views, chain, noise, index, stamps_ns)
    size = raw.n_unknowns
    return PoseFrames(
        views={},
        theta_sizes=dict.fromkeys(views, 0),
        motion=motion,
        estimate=Estimate(chain.body_T_board, chain.camera_T_ref, {}),
        stamps_ns=stamps_ns,
        start_ns=int(stamps_ns[0]),
        moments=raw.moments,
        marginal=_marginal(raw, chain, noise),
        sigma_px=1.0,
        n_corners=6 * sum(v.n_views for v in views.values()),
        free=np.arange(6, 6 + size),
        information=np.zeros((size + 1, size + 1)),
        seen={name: np.isin(index, v.frame_index) for name, v in views.items()},
        cluster=cluster,
        noise=MocapNoiseModel({}),
        of_frames=raw,
        of_views=views,
        chain=chain,
    )


def _rows(v: PoseViews, chain: PoseChain, name: str, of: Frames) -> tuple[FloatArray, FloatArray]:
    """(V, 6) residuals, and (V, 6, D - 1) their derivatives, in rad and m."""
    plain = replace(v, covariance=None)
    r, J = plain.residuals(chain.camera_T_ref[name], chain.body_T_board)
    return r, _spread(J, chain, of.columns_of_camera(name), of.n_columns)


def _spread(J: FloatArray, chain: PoseChain, of_camera: slice, n_columns: int) -> FloatArray:
    """Derivatives (V, 6, 12) by Y_c and X, put in their columns; and those by A_f."""
    columns = np.zeros((len(J), 6, n_columns))
    columns[:, :, :6] = J[:, :, 6:] @ adjoint(inverse(chain.body_T_board)[None])
    columns[:, :, 6:12], columns[:, :, of_camera] = J[:, :, 6:], J[:, :, :6]
    return columns


def _moments(
    views: Mapping[str, PoseViews], chain: PoseChain, noise: JointPoses, index: IntArray, stamps_ns: IntArray
) -> FrameMoments:
    n_columns = 12 + 6 * len(views)
    total = np.zeros((len(index), n_columns + 1, n_columns + 1))
    lags, correlated, n_numbers = 0.0, 0.0, 0
    for c, (name, v) in enumerate(views.items()):
        r, J = v.residuals(chain.camera_T_ref[name], chain.body_T_board)
        whiten = np.linalg.inv(np.linalg.cholesky(noise.noise[name].covariance))
        white = whiten @ r[:, :, None]
        rows = np.concatenate([whiten @ _spread(J, chain, slice(12 + 6 * c, 18 + 6 * c), n_columns), white], axis=2)
        total[np.searchsorted(index, v.frame_index)] += np.swapaxes(rows, 1, 2) @ rows
        lags += float(np.sum(white[1:] * white[:-1]))
        correlated += float(np.sum(white**2))
        n_numbers += white[1:].size
    rho = np.clip(lags / max(correlated, 1e-300) + max(n_numbers, 1) ** -0.5, 0.0, _LARGEST_LAG)
    return FrameMoments(index, stamps_ns, (1.0 - rho) / (1.0 + rho) * total, 1.0, correlated, n_numbers)


def _marginal(raw: FrameMoments, chain: PoseChain, noise: JointPoses) -> FloatArray:
    """(n, D, D) with the mocap's noise integrated out of each frame, where it was told from the cameras'."""
    if noise.mocap_covariance is None:
        return raw.moments
    carry = gtsam.Pose3(chain.body_T_board).AdjointMap()
    information = np.linalg.inv(carry @ noise.mocap_covariance @ carry.T)
    M = raw.moments
    return np.asarray(M - np.swapaxes(M[:, :6], 1, 2) @ np.linalg.solve(M[:, :6, :6] + information, M[:, :6]))
