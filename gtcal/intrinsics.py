"""A plain intrinsic calibration from a camera's views, for recordings that come without intrinsics.

Pinhole cameras: OpenCV (Zhang's method). Fisheyes: the equidistant lens whose focal length lets PnP fit best, refined
by Levenberg-Marquardt on the pixels over theta and all board poses. OpenCV's own fisheye calibration starts from
normalised coordinates and fails on views that reach 90 degrees off the axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import gtsam
import numpy as np
import numpy.typing as npt

from factors import KANNALA_BRANDT4, PINHOLE_RADTAN, FusedReprojectionFactor, RobustKernel, weak_intrinsics_prior
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.graph import minimise
from gtcal.observations import Views
from gtcal.pnp import solve_pnp
from gtcal.residuals import corner_views, residual_norms_px, select_views

MAX_VIEWS = 80
"""More, spread over the recording, hardly say more about a lens."""

WIDE_RAD = np.deg2rad(45.0)
"""Half the diagonal field from which a pinhole lens counts as wide."""

START_FIELDS_DEG = (40, 60, 80, 100, 120, 140, 160, 180, 200, 220)
"""Fields of view over the longer side that a fisheye may start from."""

Float32Array = npt.NDArray[np.float32]

_START_VIEWS = 15
_ROUNDS = 10
_ROBUST = RobustKernel("Huber", 1.345)
_MIN_VIEWS = 6
_MIN_CORNERS = 12


@dataclass(frozen=True)
class IntrinsicCalibration:
    """The camera with its intrinsics, and how well the views fit by themselves (each with its own board pose)."""

    camera: Camera
    rmse_px: float
    n_views: int


def calibrate_intrinsics(views: Views) -> IntrinsicCalibration:
    """Find the intrinsics of the views' camera; those that it has are not used.

    Raises GtcalError where there are too few views, or OpenCV finds no solution."""
    chosen = _choose(views)
    pinhole = views.camera.model is PINHOLE_RADTAN
    camera = _pinhole_camera(chosen) if pinhole else _fisheye_camera(chosen)
    return _checked(replace(chosen, camera=camera))


def _choose(views: Views) -> Views:
    """The views with many corners, spread evenly over the recording."""
    index = np.flatnonzero(np.diff(views.view_start) >= _MIN_CORNERS)
    if len(index) < _MIN_VIEWS:
        raise GtcalError(
            f"camera {views.camera.name!r}: {len(index)} views with {_MIN_CORNERS} or more corners; at least "
            f"{_MIN_VIEWS} from different directions are needed to find intrinsics"
        )
    if len(index) > MAX_VIEWS:
        index = index[np.linspace(0, len(index) - 1, MAX_VIEWS).round().astype(np.int64)]
    return select_views(views, index)


def _pinhole_camera(views: Views) -> Camera:
    camera = views.camera
    corners_m = np.split(views.corners_m.astype(np.float32), views.view_start[1:-1])
    corners_px = np.split(views.corners_px.astype(np.float32), views.view_start[1:-1])
    try:
        theta = _pinhole(corners_m, corners_px, (camera.image_width_px, camera.image_height_px))
    except cv2.error as error:
        raise GtcalError(
            f"camera {camera.name!r}: OpenCV finds no intrinsics from these views ({error.err}); record the board from "
            "different directions and over the whole image"
        ) from error
    return replace(camera, parameters=theta)


def _pinhole(corners_m: list[Float32Array], corners_px: list[Float32Array], size_px: tuple[int, int]) -> FloatArray:
    """k3 is left at zero unless the lens is wide: a narrow field does not determine it, and it then bends the corners
    of the image."""
    narrow = _zhang(corners_m, corners_px, size_px, cv2.CALIB_FIX_K3)
    half_diagonal_rad = np.arctan(np.hypot(size_px[0] / narrow[0], size_px[1] / narrow[1]) / 2)
    return narrow if half_diagonal_rad < WIDE_RAD else _zhang(corners_m, corners_px, size_px, 0)


def _zhang(
    corners_m: list[Float32Array], corners_px: list[Float32Array], size_px: tuple[int, int], flags: int
) -> FloatArray:
    _, K, distortion, _, _ = cv2.calibrateCamera(corners_m, corners_px, size_px, None, None, flags=flags)
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(distortion)[:5]])


def _fisheye_camera(views: Views) -> Camera:
    """Kannala-Brandt first, then the terms that a richer model adds to it: all at once, the higher ones run away."""
    few = select_views(views, np.linspace(0, views.n_views - 1, min(views.n_views, _START_VIEWS)).astype(np.int64))
    simple = replace(views.camera, model=KANNALA_BRANDT4)
    starts = [_equidistant(simple, np.deg2rad(field_deg)) for field_deg in START_FIELDS_DEG]
    fits = [_median_px(replace(few, camera=start)) for start in starts]
    camera = _settled(views, starts[int(np.argmin(fits))])
    wanted = views.camera.model
    if wanted is KANNALA_BRANDT4:
        return camera
    extended = np.pad(camera.theta, (0, wanted.n_parameters - KANNALA_BRANDT4.n_parameters))
    return _settled(views, replace(camera, model=wanted, parameters=extended))


def _settled(views: Views, camera: Camera) -> Camera:
    """PnP and refinement in turns until the focal length settles: a view that took the wrong one of its two poses gets
    another choice."""
    for _ in range(_ROUNDS):
        before, camera = camera, _refined(replace(views, camera=camera))
        if abs(camera.theta[0] - before.theta[0]) < 1e-4 * before.theta[0]:
            break
    return camera


def _equidistant(camera: Camera, field_rad: float) -> Camera:
    """Without distortion, with this field over the longer side of the image."""
    width_px, height_px = camera.image_width_px, camera.image_height_px
    focal_px = max(width_px, height_px) / field_rad
    theta = np.zeros(camera.model.n_parameters)
    theta[:4] = focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2
    return replace(camera, parameters=theta)


def _median_px(views: Views) -> float:
    """How well PnP fits the views; infinite where it solves fewer than half of them."""
    poses = solve_pnp(views, max_views=views.n_views)
    return float(np.median(poses.median_px[:, 0])) if 2 * len(poses.view_index) > views.n_views else np.inf


def _refined(views: Views) -> Camera:
    """Theta and all board poses, from the start that the views' camera has."""
    camera = views.camera
    poses = solve_pnp(views, max_views=views.n_views)
    views = select_views(views, poses.view_index)
    theta_key, eye_key = gtsam.symbol("k", 0), gtsam.symbol("y", 0)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for index in range(views.n_views):
        view_key = gtsam.symbol("x", index)
        graph.add(
            FusedReprojectionFactor(
                eye_key,
                view_key,
                views=corner_views(select_views(views, np.array([index]))),
                model=camera.model,
                ref_T_body=np.eye(4)[None],
                theta=theta_key,
                robust=_ROBUST,
            )
        )
        values.insert(view_key, gtsam.Pose3(poses.camera_T_board[index, 0]))
    graph.add(gtsam.PriorFactorPose3(eye_key, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    graph.add(weak_intrinsics_prior(theta_key, camera.model, camera.image_width_px, camera.image_height_px))
    values.insert(eye_key, gtsam.Pose3())
    values.insert(theta_key, camera.theta)
    found = minimise(graph, values, eps=1e-8, max_iterations=100)
    return replace(camera, parameters=found.values.atVector(theta_key))


def _checked(views: Views) -> IntrinsicCalibration:
    """The fit of each view by itself. Raises GtcalError where the solution is no camera."""
    camera = views.camera
    fx, fy = camera.theta[:2]
    if not (np.isfinite(camera.theta).all() and fx > 0.0 and fy > 0.0):
        raise GtcalError(
            f"camera {camera.name!r}: the intrinsics found make no sense (fx = {fx:.6g}, fy = {fy:.6g}); record the "
            "board from different directions and over the whole image, or state another model"
        )
    poses = solve_pnp(views, max_views=views.n_views)
    used = select_views(views, poses.view_index)
    lengths = residual_norms_px(used, poses.camera_T_board[:, 0])
    return IntrinsicCalibration(camera, float(np.sqrt(np.mean(lengths**2))), used.n_views)
