"""A calibration's covariance where it matters: in px over each image, and in mm over the capture volume.

Two views of one covariance. A point that is known in ref has a pixel, which is as uncertain as Y_c and theta_c make it:
what a Lollypop, or ground truth drawn into the image, is off by. The other way round a pixel that is known exactly,
at a known distance, stands for a point in ref, which is as uncertain: what a measurement taken with the camera is off
by. Both are J Sigma J^T with the joint covariance of Y_c and theta_c, to first order; neither holds the noise of the
point or of the pixel itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.rigid import inverse
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.results.calibration import Calibration, CameraCalibration
from gtcal.results.covariance import JointCovariance

CELLS_ACROSS = 40
"""Of the grid over an image."""


@dataclass(frozen=True)
class PixelUncertainty:
    """Of the pixels of N points that are known in ref.

    pixels_px: (N, 2). covariances_px2: (N, 2, 2). Both NaN where the lens has no pixel for the point, ``valid`` (N,)
    False."""

    pixels_px: FloatArray
    covariances_px2: FloatArray
    valid: BoolArray

    @property
    def sigma_px(self) -> FloatArray:
        """(N,) 1-sigma along the least sure direction in the image."""
        return _largest_sigma(self.covariances_px2)

    @property
    def rms_px(self) -> FloatArray:
        """(N,) root mean square length of the error: what the RMSE of e_2D compares with."""
        return _rms(self.covariances_px2)


@dataclass(frozen=True)
class PlaceUncertainty:
    """Of the points in ref that N exactly known pixels, each at its known distance from the camera, stand for.

    points_in_ref_m: (N, 3). covariances_m2: (N, 3, 3) along the axes of ref, NaN where the lens has no pixel for the
    point. seen: (N,) whether the camera has the point in its image."""

    points_in_ref_m: FloatArray
    covariances_m2: FloatArray
    seen: BoolArray

    @property
    def sigma_mm(self) -> FloatArray:
        """(N,) 1-sigma along the least sure direction in space."""
        return 1e3 * _largest_sigma(self.covariances_m2)

    @property
    def rms_mm(self) -> FloatArray:
        """(N,) root mean square length of the error."""
        return 1e3 * _rms(self.covariances_m2)


@dataclass(frozen=True)
class ImageUncertainty:
    """Of the pixels of points at one distance from a camera, on a grid over its image. Row 0 is the image's top.

    x_px: (W,), y_px: (H,) middles of the cells.
    sigma_px, rms_px: (H, W) as in ``PixelUncertainty``. sigma_mm: (H, W) as in ``PlaceUncertainty``. NaN where no point
        has the pixel."""

    camera: str
    kind: str
    distance_m: float
    x_px: FloatArray
    y_px: FloatArray
    sigma_px: FloatArray
    rms_px: FloatArray
    sigma_mm: FloatArray


@dataclass(frozen=True)
class VolumeUncertainty:
    """Of points in ref, as each camera places them.

    cameras: C names. points_in_ref_m: (N, 3). sigma_mm: (C, N) as in ``PlaceUncertainty``, NaN where the camera does
    not have the point in its image."""

    kind: str
    cameras: tuple[str, ...]
    points_in_ref_m: FloatArray
    sigma_mm: FloatArray

    @property
    def n_cameras(self) -> FloatArray:
        """(N,) how many cameras have the point in their image."""
        return np.isfinite(self.sigma_mm).sum(axis=0).astype(np.float64)

    @property
    def worst_mm(self) -> FloatArray:
        """(N,) of the least sure camera that has the point; NaN where none has."""
        worst = np.max(np.where(np.isfinite(self.sigma_mm), self.sigma_mm, -np.inf), axis=0, initial=-np.inf)
        return np.where(np.isfinite(worst), worst, np.nan)


def joint_covariance_of(calibration: Calibration, kind: str | None = None) -> JointCovariance:
    """The covariance of this kind, or the one that the estimates carry.

    Raises GtcalError where the calibration has none, or not this one."""
    known = calibration.covariances
    if not known:
        raise GtcalError("the calibration has no covariance, as without stage 3: calibrate with all the stages")
    wanted = kind or calibration.covariance_kind
    if wanted not in known:
        raise GtcalError(f"the calibration has no {wanted!r} covariance; it has: {', '.join(known)}")
    return known[wanted]


def pixel_uncertainty(
    calibration: Calibration, camera: str, points_in_ref_m: FloatArray, *, kind: str | None = None
) -> PixelUncertainty:
    """How uncertain the calibration leaves the pixels of points (N, 3) that are known in ref.

    Raises GtcalError where the calibration has no such camera or covariance."""
    calibrated = _camera(calibration, camera)
    pixels_px, valid, J = pixel_jacobians(calibrated.camera, calibrated.camera_T_ref.a_T_b, points_in_ref_m)
    return PixelUncertainty(pixels_px, _carried(J, joint_covariance_of(calibration, kind), camera), valid)


def place_uncertainty(
    calibration: Calibration, camera: str, points_in_ref_m: FloatArray, *, kind: str | None = None
) -> PlaceUncertainty:
    """How uncertain the calibration leaves the points (N, 3) of ref that their pixels, at their distance, stand for.

    Raises GtcalError where the calibration has no such camera or covariance."""
    calibrated = _camera(calibration, camera)
    pixels_px, valid, J = place_jacobians(calibrated.camera, calibrated.camera_T_ref.a_T_b, points_in_ref_m)
    seen = valid & calibrated.camera.in_image(pixels_px)
    return PlaceUncertainty(points_in_ref_m, _carried(J, joint_covariance_of(calibration, kind), camera), seen)


def image_uncertainty(
    calibration: Calibration, camera: str, distance_m: float, *, across: int = CELLS_ACROSS, kind: str | None = None
) -> ImageUncertainty:
    """``pixel_uncertainty`` and ``place_uncertainty`` of points at one distance, on a grid over the camera's image.

    Raises GtcalError for a distance that is not positive, or where there is no such camera or covariance."""
    if not 0.0 < distance_m < np.inf:
        raise GtcalError(f"a distance of {distance_m} m: expected a positive number")
    calibrated = _camera(calibration, camera)
    x_px, y_px = image_grid(calibrated.camera, across)
    ahead_m, has_bearing = points_ahead(calibrated.camera, distance_m, across)
    ref_T_camera = inverse(calibrated.camera_T_ref.a_T_b)
    points_in_ref_m = ahead_m @ ref_T_camera[:3, :3].T + ref_T_camera[:3, 3]
    pixel = pixel_uncertainty(calibration, camera, points_in_ref_m, kind=kind)
    place = place_uncertainty(calibration, camera, points_in_ref_m, kind=kind)
    sigma_px, rms_px, sigma_mm = (
        np.where(has_bearing, values, np.nan).reshape(len(y_px), len(x_px))
        for values in (pixel.sigma_px, pixel.rms_px, place.sigma_mm)
    )
    used = joint_covariance_of(calibration, kind).kind
    return ImageUncertainty(camera, used, distance_m, x_px, y_px, sigma_px, rms_px, sigma_mm)


def volume_uncertainty(
    calibration: Calibration, points_in_ref_m: FloatArray, *, kind: str | None = None
) -> VolumeUncertainty:
    """How uncertain each camera is about points (N, 3) of the capture volume.

    Raises GtcalError where the calibration has no such covariance."""
    sigmas_mm = []
    for name in calibration.cameras:
        found = place_uncertainty(calibration, name, points_in_ref_m, kind=kind)
        sigmas_mm.append(np.where(found.seen, found.sigma_mm, np.nan))
    used = joint_covariance_of(calibration, kind).kind
    return VolumeUncertainty(used, tuple(calibration.cameras), points_in_ref_m, np.array(sigmas_mm))


def points_ahead(camera: Camera, distance_m: float, across: int) -> tuple[FloatArray, BoolArray]:
    """Points (N, 3) in the camera at one distance, one for each cell of ``image_grid``, row by row; and whether there
    is one that has this pixel (N,)."""
    pixels_px = np.stack([axis.ravel() for axis in np.meshgrid(*image_grid(camera, across))], axis=1)
    bearings, has_bearing = camera.unproject(pixels_px)
    return distance_m * np.where(has_bearing[:, None], bearings, [0.0, 0.0, 1.0]), has_bearing


def image_grid(camera: Camera, across: int, down: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Middles of cells over the image: x (W,) and y (H,) in px; nearly square ones unless ``down`` is given."""
    down = down or max(round(across * camera.image_height_px / camera.image_width_px), 1)
    x_px = (np.arange(across) + 0.5) * camera.image_width_px / across - 0.5
    y_px = (np.arange(down) + 0.5) * camera.image_height_px / down - 0.5
    return x_px, y_px


def pixel_jacobians(
    camera: Camera, camera_T_ref: FloatArray, points_in_ref_m: FloatArray
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Pixels (N, 2) of points (N, 3) in ref, whether they have one (N,), and the derivative (N, 2, 6 + K) of the pixel
    to xi in camera_T_ref * Exp(xi) and to theta; NaN where there is none."""
    R = camera_T_ref[:3, :3]
    in_camera = points_in_ref_m @ R.T + camera_T_ref[:3, 3]
    pixels_px, valid, J_point, J_theta = camera.model.project_with_jacobians(in_camera, camera.theta)
    J_ref = J_point @ R
    # Exp(xi) moves p by rotation x p + translation, and j . (w x p) = w . (p x j)
    J_rotation = np.cross(points_in_ref_m[:, None, :], J_ref)
    return pixels_px, valid, np.concatenate([J_rotation, J_ref, J_theta], axis=2)


def place_jacobians(
    camera: Camera, camera_T_ref: FloatArray, points_in_ref_m: FloatArray
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Pixels (N, 2) of points (N, 3) in ref, whether they have one (N,), and the derivative (N, 3, 6 + K) to xi and to
    theta of the point in ref that the pixel, at its distance, stands for; NaN where there is none."""
    R = camera_T_ref[:3, :3]
    in_camera = points_in_ref_m @ R.T + camera_T_ref[:3, 3]
    pixels_px, valid, J_point, J_theta = camera.model.project_with_jacobians(in_camera, camera.theta)
    # Another lens sees the fixed pixel elsewhere: 0 = J_point dp + J_theta dtheta. J_point is blind along the ray, so
    # the smallest such dp lies across it and keeps the distance.
    across = np.swapaxes(J_point, 1, 2) @ _inverse_2x2(J_point @ np.swapaxes(J_point, 1, 2))
    J_lens = -R.T @ across @ J_theta
    # ref_T_camera Exp-ed is Exp(-xi) * ref_T_camera: it moves p by p x rotation - translation.
    x, y, z = points_in_ref_m.T
    zero = np.zeros_like(x)
    J_rotation = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    J = np.concatenate([J_rotation, np.broadcast_to(-np.eye(3), J_rotation.shape), J_lens], axis=2)
    return pixels_px, valid, np.where(valid[:, None, None], J, np.nan)


def _camera(calibration: Calibration, name: str) -> CameraCalibration:
    if name not in calibration.cameras:
        raise GtcalError(f"the calibration has no camera {name!r}; its cameras: {', '.join(calibration.cameras)}")
    return calibration.cameras[name]


def _carried(J: FloatArray, joint: JointCovariance, camera: str) -> FloatArray:
    """J Sigma J^T, (N, M, M), with the columns of Y_c and theta_c; of Y_c alone where the intrinsics were fixed."""
    sigma = camera_covariance(joint, camera)
    J = J[:, :, : len(sigma)]
    return np.asarray(J @ sigma @ np.swapaxes(J, 1, 2))


def camera_covariance(joint: JointCovariance, camera: str) -> FloatArray:
    """Of Y_c and theta_c together (6 + K, 6 + K); of Y_c alone (6, 6) where the intrinsics were fixed."""
    columns = np.r_[joint.columns_of_camera_T_ref(camera), joint.columns_of_theta(camera)]
    return joint.matrix[np.ix_(columns, columns)]


def _inverse_2x2(matrices: FloatArray) -> FloatArray:
    (a, b), (c, d) = np.moveaxis(matrices, 0, -1)
    determinant = a * d - b * c
    adjugate = np.stack([d, -b, -c, a], axis=-1).reshape(-1, 2, 2)
    return np.asarray(adjugate / determinant[:, None, None])


def _largest_sigma(covariances: FloatArray) -> FloatArray:
    """(N,) root of the largest eigenvalue of (N, M, M), NaN where that is NaN."""
    known = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    largest = np.linalg.eigvalsh(np.where(known[:, None, None], covariances, 0.0))[:, -1]
    return np.where(known, np.sqrt(np.maximum(largest, 0.0)), np.nan)


def _rms(covariances: FloatArray) -> FloatArray:
    return np.sqrt(np.trace(covariances, axis1=1, axis2=2))
