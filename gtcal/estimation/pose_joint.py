"""Stage 3 on SE(3): every Y_c and X from measured poses of the board, of all cameras jointly.

A measured camera_T_board differs from the chain Y_c * ref_T_body * X by a rotation about the board's axes and a shift
along the camera's. That is noise of the camera's own, of one covariance for all its views (or as stated, times one
factor), of heavier tails where the views want them; and noise of the mocap, which moves the board for all cameras that
see a frame: Exp(b) behind X, of one covariance too, where frames are shared by cameras. The mocap's is integrated out
frame by frame, and the covariances are found with the estimate by expectation and maximisation (Dempster, Laird and
Rubin 1977; of Student's t Lange, Little and Taylor 1989)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np

from factors.marginal import MarginalFactor
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.estimation.alignment_descent import converged_sweep
from gtcal.estimation.consensus import ViewPoses, consensus
from gtcal.estimation.graph import BODY_T_BOARD, AlignmentViews, alignment_graph, camera_T_ref_key, minimise
from gtcal.estimation.linear import scaled_inverse
from gtcal.estimation.pose_level import LEVER_M, AbsolutePoses
from gtcal.estimation.pose_noise import (
    SHRUNK_BY,
    TAILS,
    PoseNoise,
    minus_log_likelihood,
    robust_covariance,
    shrunk,
    weights_of,
)
from gtcal.estimation.procrustes import alignment_sums
from gtcal.recordings.detections import IntArray

_ROUNDS, _SETTLED = 30, 1e-2
_FREE_IN_COVARIANCE = 13.0
"""By so many views fewer an unknown (6, 6) covariance S makes the estimate less sure: seven, for E(S^-1) of a Wishart
matrix is too large by as much, and six, for an estimate that is weighed by S scatters more (Rao 1967, of growth curves;
confirmed by scripts/study_poses.py)."""

_SHARED = 1.2
"""Views per frame from which the mocap's noise is told from the cameras'."""

_FIRST_SHARE = 0.3
"""Of the scatter, taken for the mocap's to start with."""


@dataclass(frozen=True)
class PoseViews:
    """The measured poses of one camera. stamps_ns, frame_index: (V,), views of one frame share ref_T_body.
    ref_T_body, camera_T_board: (V, 4, 4). covariance: (V, 6, 6) of xi in camera_T_board * Exp(xi), None where nothing
    is stated."""

    stamps_ns: IntArray
    frame_index: IntArray
    ref_T_body: FloatArray
    camera_T_board: FloatArray
    covariance: FloatArray | None = None

    @property
    def n_views(self) -> int:
        return len(self.stamps_ns)

    @cached_property
    def to_stated_units(self) -> FloatArray | None:
        """(V, 6, 6) what takes a view's residual to units of its stated covariance."""
        if self.covariance is None:
            return None
        T = np.tile(np.eye(6), (self.n_views, 1, 1))
        T[:, 3:, 3:] = self.camera_T_board[:, :3, :3]  # the shift along the camera's axes
        return np.linalg.inv(np.linalg.cholesky(T @ self.covariance @ np.swapaxes(T, 1, 2)))

    def residuals(self, camera_T_ref: FloatArray, body_T_board: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(V, 6), and its derivatives (V, 6, 12) by xi in Y_c * Exp(xi) and X * Exp(xi); in rad and m, or in units of
        what is stated."""
        r, J = AbsolutePoses(self.ref_T_body, self.camera_T_board).residuals(camera_T_ref, body_T_board)
        W = self.to_stated_units
        return (r, J) if W is None else (np.einsum("vij,vj->vi", W, r), W @ J)


@dataclass(frozen=True)
class PoseChain:
    """camera_T_ref: by camera; body_T_board (4, 4)."""

    camera_T_ref: Mapping[str, FloatArray]
    body_T_board: FloatArray

    def is_same(self, other: PoseChain) -> bool:
        """To the last bit."""
        pairs = [(pose, other.camera_T_ref[name]) for name, pose in self.camera_T_ref.items()]
        return all(np.array_equal(a, b) for a, b in ((self.body_T_board, other.body_T_board), *pairs))

    def residuals(self, views: Mapping[str, PoseViews]) -> dict[str, FloatArray]:
        """(V, 6) by camera: a rotation about the board's axes, a shift along the camera's, in rad and m."""
        plain = {name: replace(of_camera, covariance=None) for name, of_camera in views.items()}
        return {name: v.residuals(self.camera_T_ref[name], self.body_T_board)[0] for name, v in plain.items()}


@dataclass(frozen=True)
class JointPoses:
    """chain: the estimate. covariance: (6 + 6 C, 6 + 6 C) of X and each Y_c, in their right tangents. noise: of each
    camera; of one with stated covariances in their units. mocap_covariance: (6, 6) of b in X * Exp(b), None where no
    frame is shared. weights: (V,) by camera, about 1, near 0 for gross views. errors: of the graph, at the start and
    after. minus_log_likelihood: but for a constant."""

    chain: PoseChain
    covariance: FloatArray
    noise: Mapping[str, PoseNoise]
    mocap_covariance: FloatArray | None
    weights: Mapping[str, FloatArray]
    errors: tuple[float, ...]
    minus_log_likelihood: float
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values


def lever_moments(n_views: int) -> FloatArray:
    """(V, 4, 4) of points that stand for a board's where poses are compared in 3-D."""
    return np.tile(np.diag([LEVER_M**2] * 3 + [1.0]), (n_views, 1, 1))


def stage_1_of_poses(views: Mapping[str, PoseViews], rng: np.random.Generator) -> PoseChain:
    """The better, by the median view, of the sweep over all views and of a consensus of some."""
    posed = {name: ViewPoses(v.ref_T_body, v.camera_T_board, lever_moments(v.n_views)) for name, v in views.items()}
    sums = [alignment_sums(v.ref_T_body, v.pnp_camera_T_board, v.moments) for v in posed.values()]
    swept = converged_sweep(sums, rng)
    tried = [PoseChain(dict(zip(views, swept.camera_T_ref, strict=True)), swept.body_T_board)]
    agreed = consensus(posed, rng)
    tried += [PoseChain(*agreed)] if agreed is not None else []

    def median_m(chain: PoseChain) -> float:
        rms = [v.rms_m(chain.camera_T_ref[name][None], chain.body_T_board[None])[0] for name, v in posed.items()]
        return float(np.median(np.concatenate(rms)))

    return min(tried, key=median_m)


def stage_2_of_poses(
    views: Mapping[str, PoseViews], start: PoseChain, *, eps: float, max_iterations: int
) -> tuple[PoseChain, tuple[float, ...]]:
    """Levenberg-Marquardt on E_3D, and its values."""
    aligned = {
        name: AlignmentViews(v.ref_T_body, v.camera_T_board, lever_moments(v.n_views)) for name, v in views.items()
    }
    found = minimise(alignment_graph(aligned), _values(start), eps=eps, max_iterations=max_iterations)
    return _chain(views, found.values), found.errors


def stage_3_of_poses(
    views: Mapping[str, PoseViews],
    start: PoseChain,
    *,
    eps: float,
    max_iterations: int,
    tails: Sequence[float] = TAILS,
) -> JointPoses:
    """By the one of these tails, increasing, that explains the views best.

    Raises numpy.linalg.LinAlgError where the poses leave a direction open."""
    best = _Expectation(views, tails[-1], eps, max_iterations).settled(start)
    for tail in reversed(tails[:-1]):  # each from the one before; heavier ones as long as they explain more
        found = _Expectation(views, tail, eps, max_iterations).settled(best.chain, best)
        if found.minus_log_likelihood >= best.minus_log_likelihood:
            break
        best = found
    return best


def _values(chain: PoseChain) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(BODY_T_BOARD, gtsam.Pose3(chain.body_T_board))
    for index, pose in enumerate(chain.camera_T_ref.values()):
        values.insert(camera_T_ref_key(index), gtsam.Pose3(pose))
    return values


def _chain(names: Mapping[str, object], values: gtsam.Values) -> PoseChain:
    cameras = {name: values.atPose3(camera_T_ref_key(index)).matrix() for index, name in enumerate(names)}
    return PoseChain(cameras, values.atPose3(BODY_T_BOARD).matrix())


@dataclass(frozen=True)
class _Noise:
    """covariances: (6, 6) by camera. mocap: (6, 6), None where it isn't told from the cameras'."""

    covariances: dict[str, FloatArray]
    mocap: FloatArray | None

    def differs_from(self, other: _Noise) -> bool:
        pairs = [(C, other.covariances[name]) for name, C in self.covariances.items()]
        if self.mocap is not None and other.mocap is not None:
            pairs.append((self.mocap, other.mocap))
        return any(np.abs(np.diag(a) / np.diag(b) - 1.0).max() > _SETTLED for a, b in pairs)


class _Expectation:
    """Estimate and noise in turns, for one tail of the cameras' noise."""

    def __init__(self, views: Mapping[str, PoseViews], tail: float, eps: float, max_iterations: int) -> None:
        self.views, self.tail, self.eps, self.max_iterations = views, tail, eps, max_iterations
        frames = np.unique(np.concatenate([v.frame_index for v in views.values()]))
        self.frame_of = {name: np.searchsorted(frames, v.frame_index) for name, v in views.items()}
        self.n_frames, self.n_views = len(frames), sum(v.n_views for v in views.values())
        self.size = 6 + 6 * len(views)
        self._last: tuple[PoseChain, dict[str, tuple[FloatArray, FloatArray]]] | None = None
        self.shares_frames = len(views) > 1 and self.n_views > _SHARED * self.n_frames

    def settled(self, start: PoseChain, other: JointPoses | None = None) -> JointPoses:
        """Until both stay. other: the outcome for another tail, to start from."""
        chain, noise = start, self._first_noise(start)
        if other is not None:
            noise = _Noise({name: found.covariance for name, found in other.noise.items()}, other.mocap_covariance)
        errors: tuple[float, ...] = ()
        for _ in range(_ROUNDS):
            weights = self._weights(chain, noise)
            graph = self._graph(noise, weights)
            found = minimise(graph, _values(chain), eps=self.eps, max_iterations=self.max_iterations)
            chain, errors = _chain(self.views, found.values), errors + found.errors[len(errors) > 0 :]
            before, noise = noise, self._noise(chain, noise, weights)
            if not noise.differs_from(before):
                break
        weights = self._weights(chain, noise)
        sums = self._sums(chain, noise, weights).moments
        return JointPoses(
            chain,
            self._less_sure * scaled_inverse(sums[:-1, :-1]),
            {name: PoseNoise(C, self.tail, drifts=False) for name, C in noise.covariances.items()},
            noise.mocap,
            weights,
            errors,
            self._minus_log_likelihood(chain, noise, weights),
            self._graph(noise, weights),
            _values(chain),
        )

    @property
    def _less_sure(self) -> float:
        """By how much the estimate's covariance is larger than if the noise's were known."""
        lost = [
            _FREE_IN_COVARIANCE / (v.n_views + SHRUNK_BY) if v.covariance is None else 0.0 for v in self.views.values()
        ]
        lost += [_FREE_IN_COVARIANCE / self.n_frames] if self.shares_frames else []
        return 1.0 / (1.0 - min(float(np.mean(lost)), 0.9))

    def _rows(self, chain: PoseChain) -> dict[str, tuple[FloatArray, FloatArray]]:
        """By camera the residuals and their derivatives, once for a chain."""
        if self._last is None or not self._last[0].is_same(chain):
            poses = chain.camera_T_ref
            self._last = chain, {name: v.residuals(poses[name], chain.body_T_board) for name, v in self.views.items()}
        return self._last[1]

    def _first_noise(self, chain: PoseChain) -> _Noise:
        scatter = {name: robust_covariance(r) for name, (r, _) in self._rows(chain).items()}
        if not self.shares_frames:
            return _Noise(scatter, None)
        unit = [C for name, C in scatter.items() if self.views[name].covariance is None]
        mocap = np.mean(unit, axis=0) if unit else np.diag(np.repeat([1e-3, 1e-3], 3) ** 2)
        return _Noise(
            {name: (1.0 - _FIRST_SHARE) * C for name, C in scatter.items()},
            np.asarray(_FIRST_SHARE * mocap),
        )

    def _graph(self, noise: _Noise, weights: Mapping[str, FloatArray]) -> gtsam.NonlinearFactorGraph:
        keys = [BODY_T_BOARD, *map(camera_T_ref_key, range(len(self.views)))]

        known: list[tuple[PoseChain, FloatArray]] = []  # at one place the error is asked for, then the derivatives

        def moments(values: gtsam.Values) -> FloatArray:
            chain = _chain(self.views, values)
            if not known or not known[0][0].is_same(chain):
                known[:] = [(chain, self._sums(chain, noise, weights).moments)]
            return known[0][1]

        graph = gtsam.NonlinearFactorGraph()
        graph.add(MarginalFactor(keys, [6] * len(keys), moments))
        return graph

    def _sums(self, chain: PoseChain, noise: _Noise, weights: Mapping[str, FloatArray]) -> _Sums:
        total = np.zeros((self.size + 1, self.size + 1))
        mixed = np.zeros((self.n_frames, self.size + 1, 6))
        for index, (name, (r, J)) in enumerate(self._rows(chain).items()):
            whiten = np.linalg.inv(np.linalg.cholesky(noise.covariances[name]))
            rows = np.sqrt(weights[name])[:, None, None] * (whiten @ np.concatenate([J, r[:, :, None]], axis=2))
            columns = np.array([*range(6 + 6 * index, 12 + 6 * index), *range(6), self.size])
            flat = rows.reshape(-1, 13)
            total[columns[:, None], columns] += flat.T @ flat
            if noise.mocap is not None:  # which acts as X does
                frame = self.frame_of[name]  # a camera has one view of a frame
                mixed[frame[:, None], columns] += np.swapaxes(rows, 1, 2) @ rows[:, :, 6:12]
        return _Sums(total, mixed, noise.mocap)

    def _weights(self, chain: PoseChain, noise: _Noise) -> dict[str, FloatArray]:
        """Of each view by what is left of it once the mocap's part is taken away."""
        left = self._left(chain, noise, {name: np.ones(v.n_views) for name, v in self.views.items()})
        return {name: weights_of(e, noise.covariances[name], self.tail) for name, e in left.items()}

    def _left(self, chain: PoseChain, noise: _Noise, weights: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """(V, 6) by camera the residuals less the mocap's part."""
        moved = self._sums(chain, noise, weights).moved
        return {
            name: r - np.einsum("vij,vj->vi", J[:, :, 6:], moved[self.frame_of[name]])
            for name, (r, J) in self._rows(chain).items()
        }

    def _noise(self, chain: PoseChain, noise: _Noise, weights: Mapping[str, FloatArray]) -> _Noise:
        """What the residuals say of it: the mocap's part by what is expected of it, and how unsure that is."""
        sums = self._sums(chain, noise, weights)
        left, enlarged = self._left(chain, noise, weights), self.n_views / max(self.n_views - len(self.views) - 1, 1)
        covariances = {}
        for name, v in self.views.items():
            J_X = self._rows(chain)[name][1][:, :, 6:]
            unsure = J_X @ sums.unsure[self.frame_of[name]] @ np.swapaxes(J_X, 1, 2)
            w, e = weights[name], left[name]
            scatter = enlarged * ((e.T * w) @ e + np.einsum("v,vij->ij", w, unsure)) / v.n_views
            stated = v.covariance is not None
            covariances[name] = np.eye(6) * np.trace(scatter) / 6.0 if stated else shrunk(scatter, v.n_views)
        if noise.mocap is None:
            return _Noise(covariances, None)
        outer = np.einsum("fi,fj->ij", sums.moved, sums.moved) + sums.unsure.sum(axis=0)
        return _Noise(covariances, np.asarray(outer / self.n_frames))

    def _minus_log_likelihood(self, chain: PoseChain, noise: _Noise, weights: Mapping[str, FloatArray]) -> float:
        """Of the cameras' noise given the mocap's part, which is alike for all tails."""
        left = self._left(chain, noise, weights)
        return sum(minus_log_likelihood(e, noise.covariances[name], self.tail) for name, e in left.items())


@dataclass(frozen=True)
class _Sums:
    """[J r K]^T [J r K], whitened by the cameras' noise: J by X and every Y_c, r the residual, K by the mocap's part b
    of a frame. total: (P + 1, P + 1) of J and r, all frames. mixed: (F, P + 1, 6) of J and r with K, whose first rows
    are those of K itself. mocap: (6, 6) covariance of b, None where it is nil."""

    total: FloatArray
    mixed: FloatArray
    mocap: FloatArray | None

    @cached_property
    def unsure(self) -> FloatArray:
        """(F, 6, 6) covariance of each frame's b, given its views."""
        if self.mocap is None:
            return np.zeros((len(self.mixed), 6, 6))
        return np.asarray(np.linalg.inv(self.mixed[:, :6] + scaled_inverse(self.mocap)))

    @property
    def moved(self) -> FloatArray:
        """(F, 6) what is expected of b."""
        return np.asarray(np.einsum("fij,fj->fi", self.unsure, self.mixed[:, -1]))

    @property
    def moments(self) -> FloatArray:
        """(P + 1, P + 1) of J and r, b integrated out."""
        if self.mocap is None:
            return self.total
        n = self.mixed.shape[1]
        known = np.swapaxes(self.mixed @ self.unsure, 1, 2).reshape(-1, n)
        return np.asarray(self.total - known.T @ np.swapaxes(self.mixed, 1, 2).reshape(-1, n))


def differences(one: PoseChain, other: PoseChain) -> FloatArray:
    """(6 + 6 C,) xi in one * Exp(xi) = other, of X and each Y_c."""
    pairs = [(one.body_T_board, other.body_T_board)]
    pairs += [(pose, other.camera_T_ref[name]) for name, pose in one.camera_T_ref.items()]
    parts = [gtsam.Pose3.Logmap(gtsam.Pose3(inverse(a) @ b)) for a, b in pairs]
    return np.asarray(np.concatenate(parts), dtype=np.float64)
