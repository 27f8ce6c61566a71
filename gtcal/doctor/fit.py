"""How well a recording agrees with itself: each view alone (the lens and the board), and all of them with the mocap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from factors.board_shape import outline_of
from gtcal.board import Board
from gtcal.board_tolerance import BoardTolerance
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.estimation.alignment import GuideViews, stage_1, stage_2, turns_rad
from gtcal.estimation.board_turns import turn_mismatches_rad
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views, board_turns
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import residual_norms_px, select_views
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import CameraDetections

VIEWS_PER_CAMERA = 40
"""More, spread over the recording, hardly say more about what is wrong with it."""

MIN_VIEWS = 3
MIN_CORNERS = 4

_STARTS = 8
"""Each chain is polished, so that fewer starts do than a calibration takes."""

_EPS_M2, _POLISHING_STEPS = 1e-6, 6

_TYPICAL = 0.8
"""The quantile of the corners' distances that a view's fit is judged by: it sees the border of the image, where lenses
differ, and doesn't see one wrong corner in five."""


@dataclass(frozen=True)
class AloneFit:
    """The views of one camera, each with a board pose of its own.

    guide: the views that PnP solves. typical_px: what four fifths of their corners keep within; infinite where PnP
    solves less than half of the views. behind: share of the views that see the board's back."""

    guide: GuideViews | None
    typical_px: float
    behind: float


@dataclass(frozen=True)
class ChainFit:
    """The views of all cameras in one chain with the mocap.

    angle_rad: the views' median distance between the corners placed by the chain and by PnP, as seen from the camera;
    it is the same for a recording in other units. distance_m: the same as a length.
    n_views: views with a mocap pose, of ``n_asked``. by_camera_rad: the angle of each camera's own views.
    estimate: the chain, None where there is none."""

    angle_rad: float
    distance_m: float
    n_views: int
    n_asked: int
    by_camera_rad: Mapping[str, float]
    estimate: Estimate | None

    @property
    def misfit_mm(self) -> float:
        """``distance_m`` as people read it."""
        return 1e3 * self.distance_m


NO_CHAIN = ChainFit(np.inf, np.inf, 0, 0, {}, None)


def views_of(camera: Camera, board: Board, detections: CameraDetections, *, most: int = VIEWS_PER_CAMERA) -> Views:
    """At most so many of a camera's views, without the mocap (every ref_T_body the identity): those with most corners
    among neighbours in time."""
    counts = np.diff(detections.view_start)
    enough = np.flatnonzero(counts >= MIN_CORNERS)
    parts = np.array_split(enough, most) if len(enough) > most else np.array_split(enough, max(len(enough), 1))
    chosen = np.array([part[np.argmax(counts[part])] for part in parts if len(part)], dtype=np.int64)
    keep = np.zeros(len(counts), dtype=bool)
    keep[chosen] = True  # in the order of time
    picked = detections.select_views(keep)
    n = picked.n_views
    outline_m = outline_of(board.corners_m)
    return Views(
        camera=camera,
        stamps_ns=picked.stamps_ns,
        frame_index=np.arange(n),
        ref_T_body=np.tile(np.eye(4), (n, 1, 1)),
        view_start=picked.view_start,
        corner_ids=picked.corner_ids,
        corners_m=board.corners_m[picked.corner_ids],
        corners_px=picked.corners_px,
        outline_m=outline_m,
        shape_sigmas=BoardTolerance().shape_sigmas(outline_m),
        board_turns=board_turns(board),
    )


def fit_alone(views: Views) -> AloneFit:
    """PnP of these views."""
    if views.n_views < MIN_VIEWS:
        return AloneFit(None, np.inf, 0.0)
    pnp = solve_pnp(views, max_views=views.n_views)
    if len(pnp.view_index) < max(MIN_VIEWS, views.n_views // 2):
        return AloneFit(None, np.inf, 0.0)
    solved = select_views(views, pnp.view_index)
    lengths_px = residual_norms_px(solved, pnp.camera_T_board[:, 0])
    # the infinite ones, of corners without a pixel, have no quantile between them
    typical_px = float(np.sort(lengths_px)[int(_TYPICAL * (len(lengths_px) - 1))])
    poses = pnp.camera_T_board[:, 0]
    behind = float(np.mean(np.einsum("vi,vi->v", poses[:, :3, 2], poses[:, :3, 3]) > 0.0))
    return AloneFit(GuideViews.of(views, pnp), typical_px, behind)


def fit_chain(
    guides: Mapping[str, GuideViews],
    motion: RefMotion,
    *,
    shift_s: float = 0.0,
    board_scale: float = 1.0,
    seed: int = 0,
    hopeless_rad: float = np.inf,
) -> ChainFit:
    """Stage 1 over these views. shift_s: what the cameras' stamps are put later by. board_scale: what the board is made
    larger by. hopeless_rad: a chain that starts out with a larger angle is not brought to its end. A camera with fewer
    than three mocap poses is left out; without a camera the angle is infinite."""
    asked = sum(guide.views.n_views for guide in guides.values())
    posed = {name: _posed(guide, motion, shift_s, board_scale) for name, guide in guides.items()}
    posed = {name: guide for name, guide in posed.items() if guide.views.n_views >= MIN_VIEWS}
    if not posed:
        return replace(NO_CHAIN, n_asked=asked)
    rng = np.random.default_rng(seed)
    aligned = stage_1(posed, rng, n_starts=_STARTS, seek_consensus=False, hopeless_share=hopeless_rad)
    # stage 1 stops short of its optimum by an amount that depends on the start: too rough to compare readings by
    estimate, _ = stage_2(aligned.views, aligned.estimate, eps=_EPS_M2, max_iterations=_POLISHING_STEPS)
    by_camera_m = {
        name: guide.rms_m(estimate.camera_T_ref[name], estimate.body_T_board).min(axis=1)
        for name, guide in posed.items()
    }
    by_camera_rad = {
        name: distance_m / np.linalg.norm(posed[name].pnp_camera_T_board[:, 0, :3, 3], axis=1)
        for name, distance_m in by_camera_m.items()
    }
    distance_m, angle_rad = (np.concatenate(list(values.values())) for values in (by_camera_m, by_camera_rad))
    return ChainFit(
        float(np.median(angle_rad)),
        float(np.median(distance_m)),
        len(distance_m),
        asked,
        {name: float(np.median(of_camera)) for name, of_camera in by_camera_rad.items()},
        estimate,
    )


def turn_misfit_rad(guides: Mapping[str, GuideViews], motion: RefMotion) -> float:
    """By how much the board turned otherwise for PnP than for the mocap, between two views of one camera: the median.
    It depends on no calibration (screw congruence, Chen 1991), and on rotations only. Infinite without views."""
    differences = []
    for guide in guides.values():
        at = motion.at(guide.views.stamps_ns)
        differences.append(_turn_mismatches_rad(guide, at.ref_T_body, at.ok).ravel())
    found = np.concatenate(differences)
    return float(np.median(found)) if len(found) else np.inf


def _turn_mismatches_rad(guide: GuideViews, ref_T_body: FloatArray, ok: BoolArray) -> FloatArray:
    """Between views, of a print that looks the same after turns by the turn that fits best."""
    poses, turns = guide.pnp_camera_T_board[ok, 0], guide.views.board_turns
    if len(turns) > 1:
        return turn_mismatches_rad(poses, ref_T_body[ok], turns).min(axis=2)
    return np.abs(turns_rad(poses) - turns_rad(ref_T_body[ok]))


def _posed(guide: GuideViews, motion: RefMotion, shift_s: float, board_scale: float) -> GuideViews:
    stamps_ns = guide.views.stamps_ns + round(shift_s * 1e9)
    at = motion.at(stamps_ns)
    index = np.flatnonzero(at.ok)
    posed = guide.select(index)
    poses, turns = posed.pnp_camera_T_board.copy(), posed.views.board_turns.copy()
    poses[..., :3, 3] *= board_scale
    turns[:, :3, 3] *= board_scale
    views = replace(posed.views, ref_T_body=at.ref_T_body[index], board_turns=turns)
    moments = posed.corner_moments * _moment_scale(board_scale)
    return replace(posed, views=views, pnp_camera_T_board=poses, corner_moments=moments)


def _moment_scale(board_scale: float) -> FloatArray:
    """What sums of homogeneous p p^T are multiplied by where the board grows."""
    grown = np.array([board_scale, board_scale, board_scale, 1.0])
    return np.outer(grown, grown)
