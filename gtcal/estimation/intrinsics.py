"""A plain intrinsic calibration from a camera's views, for recordings that come without intrinsics.

First a Kannala-Brandt lens for every camera: the equidistant one whose focal length lets PnP fit best, refined by
Levenberg-Marquardt on the pixels over theta and all board poses, robustly. It tells gross corners from good ones. From
the good ones another model goes on in the same way, beginning with its lens that is nearest. A pinhole is left to
OpenCV (Zhang's method, which a few wrong tags would ruin), and a rational one goes on from that. OpenCV's own fisheye
calibration starts from normalised coordinates and fails on views that reach 90 degrees off the axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import gtsam
import numpy as np
import numpy.typing as npt

from factors import (
    KANNALA_BRANDT4,
    PINHOLE_RADTAN,
    CameraModel,
    FusedReprojectionFactor,
    RobustKernel,
    weak_intrinsics_prior,
)
from gtcal.camera import Camera, FloatArray
from gtcal.camera_files.lenses import nearest_lens
from gtcal.errors import GtcalError
from gtcal.estimation.graph import minimise
from gtcal.estimation.observations import Views
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import corner_views, residual_norms_px, select_corners, select_views
from gtcal.estimation.screening import CORNER_GATE, FLOOR_PX

MAX_VIEWS = 80
"""More, spread over the recording, hardly say more about a lens."""

WIDE_RAD = np.deg2rad(45.0)
"""Half the diagonal field from which a pinhole lens counts as wide."""

CLEARLY_BETTER = 0.99
"""The share of the RMSE that a lens with one more parameter must come down to, to be believed."""

NO_FIT_PX = 3.0
"""Median distance of the corners to where the lens and a pose of their view's own put them, from which it is no fit."""

MISFIT = 5.0
"""How many times worse than a Kannala-Brandt lens the wanted model may fit."""

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
    """The camera with its intrinsics, and how well the views fit by themselves (each with its own board pose), gross
    corners left out."""

    camera: Camera
    rmse_px: float
    n_views: int


def calibrate_intrinsics(views: Views) -> IntrinsicCalibration:
    """Find the intrinsics of the views' camera; those that it has are not used.

    Raises GtcalError where there are too few views, they fit no lens, or not one of the wanted model."""
    chosen = _choose(views)
    simple = _Fit.of(replace(chosen, camera=_kannala_brandt(chosen)))
    if not simple.median_px < NO_FIT_PX:
        raise GtcalError(
            f"camera {views.camera.name!r}: its views fit no lens (corners {simple.median_px:.3g} px off, typically); "
            "does the board's description fit the board, and image_size_px the images?"
        )
    clean = _choose(simple.without_gross_corners())
    wanted = views.camera.model
    found = _Fit.of(_pinhole(clean, wanted) if wanted.perspective else _other(clean, wanted))
    if not found.median_px < max(MISFIT * simple.median_px, FLOOR_PX):
        raise GtcalError(
            f"camera {views.camera.name!r}: {wanted.name} fits its views to {found.median_px:.3g} px, typically, but "
            f"{KANNALA_BRANDT4.name} to {simple.median_px:.3g} px; state another model"
        )
    clean = found.without_gross_corners()
    rmse_px = float(np.sqrt(np.mean(_Fit.of(clean).lengths_px ** 2)))
    return IntrinsicCalibration(found.views.camera, rmse_px, clean.n_views)


@dataclass(frozen=True)
class _Fit:
    """The views that PnP solves under their camera, and the distance (N,) of each corner to its projection."""

    views: Views
    lengths_px: FloatArray

    @staticmethod
    def of(views: Views) -> _Fit:
        poses = solve_pnp(views, max_views=views.n_views)
        if len(poses.view_index) == 0:
            return _Fit(views, np.full(views.n_corners, np.inf))
        solved = select_views(views, poses.view_index)
        return _Fit(solved, residual_norms_px(solved, poses.camera_T_board[:, 0]))

    @property
    def median_px(self) -> float:
        return float(np.median(self.lengths_px))

    def without_gross_corners(self) -> Views:
        return select_corners(self.views, self.lengths_px <= max(CORNER_GATE * self.median_px, FLOOR_PX))


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


def _pinhole(views: Views, wanted: CameraModel) -> Views:
    """The views with the pinhole camera that OpenCV finds, and from it with the terms that a richer model adds."""
    camera = replace(views.camera, model=PINHOLE_RADTAN)
    corners_m = np.split(views.corners_m.astype(np.float32), views.view_start[1:-1])
    corners_px = np.split(views.corners_px.astype(np.float32), views.view_start[1:-1])
    try:
        theta = _pinhole_in_steps(corners_m, corners_px, (camera.image_width_px, camera.image_height_px))
    except cv2.error as error:
        raise GtcalError(
            f"camera {camera.name!r}: OpenCV finds no intrinsics from these views ({error.err}); record the board from "
            "different directions and over the whole image"
        ) from error
    found = replace(views, camera=replace(camera, parameters=theta))
    return found if wanted is PINHOLE_RADTAN else replace(views, camera=_settled(views, _started(found, wanted)))


def _pinhole_in_steps(
    corners_m: list[Float32Array], corners_px: list[Float32Array], size_px: tuple[int, int]
) -> FloatArray:
    """Pixels are square unless the views clearly say otherwise: few views leave the ratio to the errors of the print
    and of the detector. k3 is zero unless the lens is wide: a narrow field does not determine it, and it then bends
    the corners of the image."""
    fixed = cv2.CALIB_FIX_K3
    square_rmse_px, theta = _zhang(corners_m, corners_px, size_px, fixed | cv2.CALIB_FIX_ASPECT_RATIO)
    free_rmse_px, free_theta = _zhang(corners_m, corners_px, size_px, fixed)
    square = free_rmse_px > CLEARLY_BETTER * square_rmse_px
    theta = theta if square else free_theta
    half_diagonal_rad = np.arctan(np.hypot(size_px[0] / theta[0], size_px[1] / theta[1]) / 2)
    if half_diagonal_rad < WIDE_RAD:
        return theta
    return _zhang(corners_m, corners_px, size_px, cv2.CALIB_FIX_ASPECT_RATIO if square else 0)[1]


def _zhang(
    corners_m: list[Float32Array], corners_px: list[Float32Array], size_px: tuple[int, int], flags: int
) -> tuple[float, FloatArray]:
    """OpenCV's calibration: rmse and theta."""
    rmse_px, K, distortion, _, _ = cv2.calibrateCamera(corners_m, corners_px, size_px, np.eye(3), None, flags=flags)
    return rmse_px, np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(distortion)[:5]])


def _kannala_brandt(views: Views) -> Camera:
    few = select_views(views, np.linspace(0, views.n_views - 1, min(views.n_views, _START_VIEWS)).astype(np.int64))
    starts = equidistant_lenses(views.camera)
    fits = [_median_px(replace(few, camera=start)) for start in starts]
    if not np.isfinite(fits).any():
        raise GtcalError(
            f"camera {views.camera.name!r}: no lens gives its views a pose of the board; does the board's description "
            "fit the board?"
        )
    return _settled(views, starts[int(np.argmin(fits))])


def _other(views: Views, wanted: CameraModel) -> Views:
    """From the Kannala-Brandt camera of the views the wanted one: all at once from nothing, its higher terms would run
    away."""
    return replace(views, camera=_settled(views, _started(views, wanted)))


def _started(views: Views, wanted: CameraModel) -> Camera:
    """The lens of the wanted model that is nearest to the views' own where the corners are."""
    bearings, seen = views.camera.unproject(views.corners_px)
    lens = nearest_lens(views.camera, wanted, views.corners_px[seen], bearings[seen])
    if lens is None:
        raise GtcalError(
            f"camera {views.camera.name!r}: its views look further off the axis than a {wanted.name} can; state a "
            "fisheye model"
        )
    return lens


def _settled(views: Views, camera: Camera) -> Camera:
    """PnP and refinement in turns until the focal length settles: a view that took the wrong one of its two poses gets
    another choice."""
    for _ in range(_ROUNDS):
        before, camera = camera, _refined(replace(views, camera=camera))
        if abs(camera.theta[0] - before.theta[0]) < 1e-4 * before.theta[0]:
            break
    return camera


def equidistant_lenses(camera: Camera) -> list[Camera]:
    """The camera with equidistant lenses of usual fields of view, for a start."""
    simple = replace(camera, model=KANNALA_BRANDT4)
    return [_equidistant(simple, np.deg2rad(field_deg)) for field_deg in START_FIELDS_DEG]


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
