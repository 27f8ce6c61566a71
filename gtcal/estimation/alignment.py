"""Stages 1 and 2: from PnP poses to a chain that fits them in 3-D.

Views whose PnP pose and mocap pose contradict the others (a swap, a flipped board pose, a wrong tag) must not decide
the result, so stage 1 runs three times: on the views whose turns agree, then on those that the last result explains,
each with the one of its two PnP poses that fits better. Where that ends far off, it runs again from the views that
agree by consensus.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from factors.alignment import corner_moments, squared_distances
from factors.moments import chain
from factors.rigid import inverse
from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.alignment_descent import converged_sweep
from gtcal.estimation.board_turns import turns_in_common
from gtcal.estimation.consensus import ViewPoses, consensus, rotation_between, rotation_by_turns
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import AlignmentViews, Minimisation, alignment_graph, minimise, to_values, updated
from gtcal.estimation.observations import Views
from gtcal.estimation.options import SweepMode
from gtcal.estimation.pnp import PnpViews, solve_pnp
from gtcal.estimation.procrustes import N_STARTS, SweepResult, alignment_sums, sweep
from gtcal.estimation.residuals import select_views
from gtcal.recordings.detections import IntArray

_PASSES = 3
_GATE = 3.0
"""A view guides the next pass where its rms distance is at most three times the median one. Views lost to it for no
fault but distance do no harm: stage 3 takes them all."""

_TURN_FLOOR_RAD = np.deg2rad(1.0)
"""Turns that differ by less agree: PnP is no better than that on a distant board."""

_FEWEST_JUDGED = 6
"""Of fewer views of a camera none is left out: each of them is needed, and which of them is wrong is not to be told."""

_MAX_REFERENCES = 200
_MOST_TURNED = 30  # views, 435 pairs of which tell X's rotation to start from

_CLOSE = 0.01
"""A chain that fits has its median corner within this share of the board's distance: three times what PnP errs by on a
distant board. Where none is so close, consensus is sought, which good recordings do without."""


@dataclass(frozen=True)
class GuideViews:
    """The views of one camera that PnP solved. pnp_camera_T_board: (W, K, 4, 4) both poses, the better first; of a
    print that looks the same after some turns both by each turn, in the order of ``views.board_turns``.
    pnp_median_px: (W,) median distance of a view's corners to their projection under the better pose.
    first: (W,) the pose that counts before a chain is known."""

    views: Views
    pnp_camera_T_board: FloatArray
    pnp_median_px: FloatArray
    corner_moments: FloatArray
    first: IntArray | None = None

    @staticmethod
    def of(views: Views, pnp: PnpViews) -> GuideViews:
        chosen = select_views(views, pnp.view_index)
        moments = corner_moments(chosen.view_start, chosen.corners_m)
        poses = pnp.camera_T_board[:, None] @ inverse(chosen.board_turns)[:, None]
        return GuideViews(
            chosen, poses.reshape(len(poses), poses.shape[1] * poses.shape[2], 4, 4), pnp.median_px[:, 0], moments
        )

    @property
    def start(self) -> IntArray:
        """(W,) ``first``, or the better pose as it was seen."""
        return np.zeros(len(self.corner_moments), dtype=np.int64) if self.first is None else self.first

    @property
    def poses(self) -> ViewPoses:
        """With the PnP pose to start with."""
        rows = np.arange(len(self.corner_moments))
        chosen = self.pnp_camera_T_board[rows, self.start]
        return ViewPoses(self.views.ref_T_body, chosen, self._moments_of(self.start))

    def _moments_of(self, pose: IntArray) -> FloatArray:
        """(W, 4, 4) of the corners where they truly are if the PnP pose of index ``pose`` (W,) is the true one."""
        if len(self.views.board_turns) == 1:
            return self.corner_moments
        S = self.views.board_turns[pose // 2]
        return np.asarray(S @ self.corner_moments @ np.swapaxes(S, 1, 2))

    @property
    def distances_m(self) -> FloatArray:
        """(W,) of the middle of the corners from the camera, by PnP."""
        middle = self.corner_moments[:, :, 3] / self.corner_moments[:, 3:, 3]
        return np.asarray(np.linalg.norm(np.einsum("vij,vj->vi", self.pnp_camera_T_board[:, 0, :3], middle), axis=1))

    def rms_m(self, camera_T_ref: FloatArray, body_T_board: FloatArray) -> FloatArray:
        """Rms distance (W, K) between the corners placed by the chain and by each of the PnP poses."""
        expected = chain(camera_T_ref, self.views.ref_T_body, body_T_board)
        n_views, n_poses = self.pnp_camera_T_board.shape[:2]
        squared = [
            squared_distances(expected, self.pnp_camera_T_board[:, i], self._moments_of(np.full(n_views, i)))
            for i in range(n_poses)
        ]
        mean = np.stack(squared, axis=1) / self.corner_moments[:, 3, 3, None]
        return np.sqrt(np.maximum(mean, 0.0))

    def select(self, index: IntArray) -> GuideViews:
        """Those of these views."""
        first = None if self.first is None else self.first[index]
        views, poses = select_views(self.views, index), self.pnp_camera_T_board[index]
        return GuideViews(views, poses, self.pnp_median_px[index], self.corner_moments[index], first)

    def alignment_views(self, keep: BoolArray, pose: IntArray) -> AlignmentViews:
        """The views where ``keep`` (W,), each with its PnP pose of index ``pose`` (W,)."""
        chosen = self.pnp_camera_T_board[np.arange(len(pose)), pose]
        return AlignmentViews(self.views.ref_T_body[keep], chosen[keep], self._moments_of(pose)[keep])


@dataclass(frozen=True)
class Aligned:
    """What stage 1 found. views: those that fit, as stage 2 takes them."""

    estimate: Estimate
    views: dict[str, AlignmentViews]
    sweep: SweepResult
    n_outlying: int


def guides_of(views: Mapping[str, Views], max_views: int) -> dict[str, GuideViews]:
    """Of each camera at most so many views, solved by PnP."""
    return {
        name: GuideViews.of(of_camera, solve_pnp(of_camera, max_views=max_views)) for name, of_camera in views.items()
    }


def stage_1(
    guides: Mapping[str, GuideViews],
    rng: np.random.Generator,
    *,
    n_starts: int = N_STARTS,
    method: SweepMode = "converged",
    seek_consensus: bool = True,
    hopeless_share: float = np.inf,
) -> Aligned:
    """Procrustes sweep over all cameras, robust to gross views while they are a minority.

    seek_consensus: where no chain comes close to most views; who tries wrong readings of a recording does without.
    hopeless_share: and has no use for a chain whose first pass ends with its median corner off by more than this share
    of its distance; it is left at that."""
    guides = started_in_one_turn(guides)
    agreeing = {name: _agreeing_views(guide) for name, guide in guides.items()}
    aligned = _passes(guides, agreeing, rng, n_starts, method, hopeless_share)
    if method == "paper" or not seek_consensus or _share_of_distance(guides, aligned.estimate) < _CLOSE:
        return aligned
    found = consensus({name: guide.poses for name, guide in guides.items()}, rng)
    if found is None:
        return aligned
    agreed = Estimate(found[1], found[0], _stated_theta(guides))
    again = _passes(guides, fitting_views(guides, agreed), rng, n_starts, method)
    return min((aligned, again), key=lambda tried: _share_of_distance(guides, tried.estimate))


def _passes(
    guides: Mapping[str, GuideViews],
    chosen: dict[str, AlignmentViews],
    rng: np.random.Generator,
    n_starts: int,
    method: SweepMode,
    hopeless_share: float = np.inf,
) -> Aligned:
    """The sweep on the views ``chosen``, then on those that fit what it found."""
    for _ in range(_PASSES):
        result = _swept(chosen, rng, n_starts, method)
        estimate = _estimate(guides, result)
        chosen = fitting_views(guides, estimate)
        if _share_of_distance(guides, estimate) > hopeless_share:
            break
    n_outlying = sum(len(guides[name].corner_moments) - len(v.corner_moments) for name, v in chosen.items())
    return Aligned(estimate, chosen, result, n_outlying)


def _swept(
    chosen: Mapping[str, AlignmentViews], rng: np.random.Generator, n_starts: int, method: SweepMode
) -> SweepResult:
    """Round the middle of the bodies and of the corners, where long levers take no digits."""
    ref_T_middle, board_T_middle = np.eye(4), np.eye(4)
    ref_T_middle[:3, 3] = np.mean(np.concatenate([v.ref_T_body[:, :3, 3] for v in chosen.values()]), axis=0)
    moments = np.sum([v.corner_moments.sum(axis=0) for v in chosen.values()], axis=0)
    board_T_middle[:3, 3] = moments[:3, 3] / moments[3, 3]
    to_middle = inverse(board_T_middle)
    sums = [
        alignment_sums(
            inverse(ref_T_middle) @ v.ref_T_body,
            v.pnp_camera_T_board @ board_T_middle,
            to_middle @ v.corner_moments @ to_middle.T,
        )
        for v in chosen.values()
    ]
    if method == "paper":
        found = sweep(sums, rng, n_starts)
    else:
        found = converged_sweep(sums, rng, n_starts, more=_by_turns(chosen))
    return replace(
        found,
        camera_T_ref=found.camera_T_ref @ inverse(ref_T_middle),
        body_T_board=found.body_T_board @ to_middle,
    )


def _by_turns(chosen: Mapping[str, AlignmentViews]) -> tuple[FloatArray, FloatArray]:
    """Starts (k, C, 4, 4) and (k, 4, 4), one by the turns between the views of each camera: rotations only."""
    rotations = [_rotations(v.ref_T_body, v.pnp_camera_T_board) for v in chosen.values()]
    R_X = np.concatenate([rotation_by_turns(A, That) for A, That in rotations])
    X, Y = np.tile(np.eye(4), (len(R_X), 1, 1)), np.tile(np.eye(4), (len(R_X), len(rotations), 1, 1))
    X[:, :3, :3] = R_X
    for c, (A, That) in enumerate(rotations):
        Y[:, c, :3, :3] = rotation_between(A @ R_X[:, None], np.broadcast_to(That, (len(R_X), *That.shape[1:])))
    return Y, X


def _rotations(ref_T_body: FloatArray, camera_T_board: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(1, v, 3, 3) each, of some of the views, spread evenly."""
    n_views = len(ref_T_body)
    rows = np.linspace(0, n_views - 1, min(n_views, _MOST_TURNED)).round().astype(np.int64)
    return ref_T_body[None, rows, :3, :3], camera_T_board[None, rows, :3, :3]


def _share_of_distance(guides: Mapping[str, GuideViews], estimate: Estimate) -> float:
    """Median over the views of the corners' rms distance from the chain, as a share of the board's from the camera."""
    shares = [
        guide.rms_m(estimate.camera_T_ref[name], estimate.body_T_board).min(axis=1) / guide.distances_m
        for name, guide in guides.items()
    ]
    return float(np.median(np.concatenate(shares)))


def fitting_views(guides: Mapping[str, GuideViews], estimate: Estimate) -> dict[str, AlignmentViews]:
    """The views that the estimate explains, each with the PnP pose that fits it better."""
    rms = {name: guide.rms_m(estimate.camera_T_ref[name], estimate.body_T_board) for name, guide in guides.items()}
    median_m = float(np.median(np.concatenate([by_pose.min(axis=1) for by_pose in rms.values()])))
    return {
        name: guide.alignment_views(_fits(rms[name], median_m), rms[name].argmin(axis=1))
        for name, guide in guides.items()
    }


def _fits(rms_m: FloatArray, median_m: float) -> BoolArray:
    """Mask (W,) of the fitting views; a camera none of whose views fit keeps its better half, one of few views all."""
    best = rms_m.min(axis=1)
    fits = best <= _GATE * median_m
    if len(best) < _FEWEST_JUDGED:
        return np.ones(len(best), dtype=bool)
    return fits if fits.sum() >= 3 else best <= np.median(best)


def _agreeing_views(guide: GuideViews) -> AlignmentViews:
    """Views that have turned from most others by the same angle for PnP as for the mocap, as they must whatever X and
    Y are: That_i^-1 That_j = X^-1 (A_i^-1 A_j) X (screw congruence, Chen 1991). At least half of the views."""
    by_pnp, by_mocap = (turns_rad(poses) for poses in (guide.poses.pnp_camera_T_board, guide.views.ref_T_body))
    mismatch_rad = np.median(np.abs(by_pnp - by_mocap), axis=1)
    agree = mismatch_rad <= max(_GATE * float(np.median(mismatch_rad)), _TURN_FLOOR_RAD)
    agree |= len(agree) < _FEWEST_JUDGED
    return guide.alignment_views(agree, guide.start)


def started_in_one_turn(guides: Mapping[str, GuideViews]) -> dict[str, GuideViews]:
    """Where the print looks the same after some turns: the views with poses to start with that are of one and the same
    turn, all cameras alike."""
    found, R_X = dict(guides), None
    for name, guide in sorted(guides.items(), key=lambda item: -item[1].views.n_views):
        S, A, That = guide.views.board_turns, guide.views.ref_T_body, guide.pnp_camera_T_board[:, 0]
        if len(S) == 1:
            return dict(guides)
        turns = turns_in_common(That, A, S)
        own = rotation_by_turns(*_rotations(A, That @ inverse(S[turns])))[0]
        R_X = own if R_X is None else R_X
        likeness = np.einsum("ij,gij->g", R_X, own @ np.swapaxes(S[:, :3, :3], 1, 2))
        turns = (turns + int(likeness.argmax())) % len(S)
        found[name] = replace(guide, first=2 * turns)
    return found


def turns_rad(poses: FloatArray) -> FloatArray:
    """Angles (W, R) between the attitudes of poses (W, 4, 4) and of R of them, spread evenly."""
    flat = poses[:, :3, :3].reshape(-1, 9)
    chosen = np.linspace(0, len(flat) - 1, min(len(flat), _MAX_REFERENCES)).round().astype(np.int64)
    return np.asarray(np.arccos(np.clip(0.5 * (flat @ flat[chosen].T - 1.0), -1.0, 1.0)))


def _estimate(guides: Mapping[str, GuideViews], result: SweepResult) -> Estimate:
    camera_T_ref = {name: result.camera_T_ref[c] for c, name in enumerate(guides)}
    return Estimate(result.body_T_board, camera_T_ref, _stated_theta(guides))


def _stated_theta(guides: Mapping[str, GuideViews]) -> dict[str, FloatArray]:
    return {name: guide.views.camera.theta for name, guide in guides.items()}


def without_stage_1(guides: Mapping[str, GuideViews]) -> Estimate:
    """The ablation's start: X the identity, each camera from its first view."""
    camera_T_ref = {
        name: guide.pnp_camera_T_board[0, 0] @ inverse(guide.views.ref_T_body[0]) for name, guide in guides.items()
    }
    return Estimate(np.eye(4), camera_T_ref, _stated_theta(guides))


def stage_2(
    views: Mapping[str, AlignmentViews], start: Estimate, *, eps: float, max_iterations: int
) -> tuple[Estimate, Minimisation]:
    """Levenberg-Marquardt on E_3D."""
    values = to_values(start, with_theta=False)
    found = minimise(alignment_graph(views), values, eps=eps, max_iterations=max_iterations)
    return updated(start, found.values), found
