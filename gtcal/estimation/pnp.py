"""The pose of the board in each view, from the pixels alone: what guides stages 1 and 2.

A fisheye sees past 80 degrees off its axis, where normalised coordinates blow up. So each view is solved in a virtual
pinhole camera that looks along the view's mean bearing (OpenCV's IPPE, Collins and Bartoli 2014), turned back, and
refined on the pixels of the real one. A planar board leaves two poses; both are kept, the better one first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from factors import CornerViews, RobustKernel
from factors.reprojection import view_moments
from factors.rigid import inverse
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import corner_views, median_by_view, residual_norms_px, select_views
from gtcal.recordings.detections import IntArray

MAX_OFF_MEAN_RAD = np.deg2rad(75.0)
"""Corners further than this off the virtual camera's axis do not enter IPPE; the refinement takes them all."""

_REFINEMENT = RobustKernel("Cauchy", 2.0)  # px: a wrong tag must not turn its view's pose
_REFINEMENT_STEPS = 8
_ENOUGH, _FEW = 1e-3, 0.05  # done where fewer views than this share still gain more than this share of their loss
_THINNEST_M = 1e-9


@dataclass(frozen=True)
class PnpViews:
    """Views of one camera with the poses that PnP gives them.

    view_index: (W,) which of the camera's views.
    camera_T_board: (W, 2, 4, 4) the two poses, the one with the smaller loss first.
    median_px: (W, 2) median distance of the view's corners to their projection under each pose."""

    view_index: IntArray
    camera_T_board: FloatArray
    median_px: FloatArray


def solve_pnp(views: Views, *, max_views: int) -> PnpViews:
    """PnP of at most ``max_views`` views, spread evenly over those with the most to say (eight corners or more, where
    there are enough such views). A view that PnP cannot solve is left out.

    Solved in a frame of the board's own, so that the poses do not depend on where its origin and axes were put."""
    board_T_own = _own_frame(views)
    in_own = (views.corners_m - board_T_own[:3, 3]) @ board_T_own[:3, :3]
    found = _solved(replace(views, corners_m=in_own), max_views)
    return replace(found, camera_T_board=found.camera_T_board @ inverse(board_T_own))


def _own_frame(views: Views) -> FloatArray:
    """board_T_own (4, 4): the origin at the centroid of the corners seen, x from the first of them to the last, z
    normal to the plane of both and of the corner that lies farthest from their line."""
    _, rows = np.unique(views.corner_ids, return_index=True)
    corners_m = views.corners_m[rows]
    along = corners_m[-1] - corners_m[0]
    x = along / max(float(np.linalg.norm(along)), 1e-12)
    normals = np.cross(x, corners_m - corners_m[0])
    lengths = np.linalg.norm(normals, axis=1)
    board_T_own = np.eye(4)
    board_T_own[:3, 3] = corners_m.mean(axis=0)
    if lengths.max() > 1e-9:  # else all on a line: PnP will fail
        z = normals[lengths.argmax()] / lengths.max()
        board_T_own[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    return board_T_own


def _solved(views: Views, max_views: int) -> PnpViews:
    chosen = _choose(np.diff(views.view_start), max_views)
    subset = select_views(views, chosen)
    solved, poses = _ippe(subset)
    if not solved.any():
        return PnpViews(chosen[:0], np.empty((0, 2, 4, 4)), np.empty((0, 2)))
    subset, chosen = select_views(subset, np.flatnonzero(solved)), chosen[solved]
    corners = corner_views(subset)
    refined = [refine_poses(corners, subset.camera, poses[:, i]) for i in range(2)]
    loss = np.stack([by_pose.loss for by_pose in refined], axis=1)
    better = np.argsort(loss, axis=1, kind="stable")
    camera_T_board = np.stack([by_pose.camera_T_board for by_pose in refined], axis=1)
    camera_T_board = np.take_along_axis(camera_T_board, better[:, :, None, None], axis=1)
    median = np.stack(
        [median_by_view(subset, residual_norms_px(subset, camera_T_board[:, i])) for i in range(2)], axis=1
    )
    return PnpViews(chosen, camera_T_board, median)


def _choose(n_corners: IntArray, max_views: int) -> IntArray:
    rich = np.flatnonzero(n_corners >= 8)
    candidates = rich if len(rich) >= min(max_views, len(n_corners) // 2) else np.arange(len(n_corners))
    if len(candidates) <= max_views:
        return candidates
    return candidates[np.linspace(0, len(candidates) - 1, max_views).round().astype(np.int64)]


def _ippe(views: Views) -> tuple[BoolArray, FloatArray]:
    """Both IPPE poses (W, 2, 4, 4) of the views that have them, and the mask (V,) of those views."""
    bearings, valid = views.camera.unproject(views.corners_px)

    def one(v: int) -> FloatArray | None:
        rows = slice(views.view_start[v], views.view_start[v + 1])
        return _ippe_of_view(views.corners_m[rows][valid[rows]], bearings[rows][valid[rows]])

    poses = [one(v) for v in range(views.n_views)]  # in threads it takes longer: it is half Python
    solved = np.array([pose is not None for pose in poses], dtype=bool)
    found = [pose for pose in poses if pose is not None]
    return solved, np.stack(found) if found else np.empty((0, 2, 4, 4))


def _ippe_of_view(corners_m: FloatArray, bearings: FloatArray) -> FloatArray | None:
    if len(bearings) < 4:
        return None
    virtual_R_camera = _turn_to(bearings.mean(axis=0))
    turned = bearings @ virtual_R_camera.T
    usable = turned[:, 2] > np.cos(MAX_OFF_MEAN_RAD)
    if usable.sum() < 4 or _on_a_line(corners_m[usable]):
        return None
    normalised = turned[usable, :2] / turned[usable, 2:]
    try:
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            corners_m[usable], normalised, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:  # collinear corners
        return None
    poses = [
        _pose(virtual_R_camera, np.asarray(rotation, float), np.asarray(translation, float))
        for rotation, translation in zip(rotations, translations, strict=True)
        if np.isfinite(rotation).all() and np.isfinite(translation).all()
    ]
    if count == 0 or not poses:
        return None
    return np.stack([poses[0], poses[-1]])


def _on_a_line(corners_m: FloatArray) -> bool:
    """Or in a point."""
    _, across, _ = np.linalg.svd(corners_m - corners_m.mean(axis=0), compute_uv=False)
    return bool(across <= _THINNEST_M)


def _turn_to(direction: FloatArray) -> FloatArray:
    """Rotation of a virtual camera whose z axis is ``direction`` (3,), as virtual_R_camera (3, 3)."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _pose(virtual_R_camera: FloatArray, rotation: FloatArray, translation: FloatArray) -> FloatArray:
    camera_T_board = np.eye(4)
    camera_T_board[:3, :3] = virtual_R_camera.T @ cv2.Rodrigues(rotation)[0]
    camera_T_board[:3, 3] = virtual_R_camera.T @ np.ravel(translation)
    return camera_T_board


@dataclass(frozen=True)
class RefinedPoses:
    """Poses (V, 4, 4) that fit each view's pixels best, and the views' losses (V,)."""

    camera_T_board: FloatArray
    loss: FloatArray


def refine_poses(corners: CornerViews, camera: Camera, camera_T_board: FloatArray) -> RefinedPoses:
    """Levenberg-Marquardt on the pixels of each view by itself, all views at once."""
    damping = np.full(len(camera_T_board), 1e-4)
    now = view_moments(corners, camera_T_board, camera.model, camera.theta, robust=_REFINEMENT)
    for _ in range(_REFINEMENT_STEPS):
        tried_T = camera_T_board @ _exp(_damped_step(now.moments, damping))
        tried = view_moments(corners, tried_T, camera.model, camera.theta, robust=_REFINEMENT)
        better = tried.loss < now.loss
        gains = (now.loss - tried.loss)[better] / (1e-12 + now.loss[better])
        camera_T_board = np.where(better[:, None, None], tried_T, camera_T_board)
        now.moments[better], now.loss[better] = tried.moments[better], tried.loss[better]
        damping = np.where(better, 0.1 * damping, 10.0 * damping)
        if (gains > _ENOUGH).sum() < _FEW * len(better):
            break
    return RefinedPoses(camera_T_board, now.loss)


def _damped_step(moments: FloatArray, damping: FloatArray) -> FloatArray:
    hessian, gradient = moments[:, :6, :6].copy(), moments[:, :6, 6]
    diagonal = np.einsum("vii->vi", hessian)
    diagonal *= 1.0 + damping[:, None]
    diagonal += 1e-9
    return -np.asarray(np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0], dtype=np.float64)


def _exp(steps: FloatArray) -> FloatArray:
    """Rigid transforms (V, 4, 4) of small steps (V, 6), rotation first; exact to first order, and rigid."""
    T = np.zeros((len(steps), 4, 4))
    T[:, :3, :3] = Rotation.from_rotvec(steps[:, :3]).as_matrix()
    T[:, :3, 3], T[:, 3, 3] = steps[:, 3:], 1.0
    return T
