"""How well a camera's stated intrinsics are known: as stated with them, else as factories know a lens.

A factory's values and a calibration of the same camera by its user (Kalibr, OpenCV) differ by some tenths of a percent
in focal length and by a few pixels in the principal point, for the lens warms, is focused and is glued in. A distortion
coefficient is taken to be off by what moves some pixel of the image by as much as the principal point is off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gtcal.camera import Camera, FloatArray

if TYPE_CHECKING:
    from gtcal.estimation.options import CalibrationOptions

FACTORY_FOCAL = 3e-3
"""1-sigma of a stated focal length, as a share of it."""

FACTORY_PX = 3.0
"""1-sigma of a stated principal point's coordinates, and of what a distortion coefficient moves at most."""

_GRID = 15  # points across and down the image, its edges among them


def lens_sigmas(camera: Camera, options: CalibrationOptions) -> FloatArray:
    """(K,) 1-sigma of each of the camera's stated parameters, in their units: those that the options give for all
    cameras, else those stated with the camera, else a factory's.

    Raises GtcalError where the camera has no intrinsics."""
    sigmas = sigmas_of(camera, FACTORY_FOCAL, FACTORY_PX)
    if camera.theta_sigmas is not None:
        sigmas = np.where(np.isnan(camera.theta_sigmas), sigmas, camera.theta_sigmas)
    given = (options.focal_sigma_px, options.centre_sigma_px, options.distortion_sigma)
    for sigma, columns in zip(given, (slice(0, 2), slice(2, 4), slice(4, None)), strict=True):
        if sigma is not None:
            sigmas[columns] = sigma
    return sigmas


def sigmas_of(camera: Camera, focal_share: float, px: float) -> FloatArray:
    """(K,) 1-sigma of each parameter where the focal length is known to a share of itself, the principal point to so
    many px, and a distortion coefficient to what moves some pixel of the image by these."""
    largest_px = np.linalg.norm(moves_px(camera), axis=1).max(axis=0, initial=1e-9)
    sigmas = px / largest_px
    sigmas[:2], sigmas[2:4] = focal_share * camera.theta[:2], px
    return sigmas


def moves_px(camera: Camera) -> FloatArray:
    """(N, 2, K) by how many pixels a unit of each parameter moves pixels spread over the image."""
    across = np.linspace(0.0, camera.image_width_px - 1.0, _GRID)
    down = np.linspace(0.0, camera.image_height_px - 1.0, _GRID)
    pixels_px = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    bearings, seen = camera.unproject(pixels_px)
    _, valid, _, by_theta = camera.model.project_with_jacobians(bearings[seen], camera.theta)
    return by_theta[valid]
