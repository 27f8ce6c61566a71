"""Which of the lens models that other tools know a camera can be written as, and what is lost by the nearest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from factors.camera_models import KANNALA_BRANDT4, PINHOLE_RADTAN, CameraModel
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError

_GRID = 25


@dataclass(frozen=True)
class Expressed:
    """A camera in a model that a format knows.

    theta: (K,) in the order of ``model.parameter_names``, of which those beyond the format's are zero.
    rms_px, max_px: what it differs by from the camera it was made from, over the image; 0 where it is the same."""

    model: CameraModel
    theta: FloatArray
    rms_px: float
    max_px: float


def express(camera: Camera, *, format_name: str, radtan_coefficients: int, nearest: bool = False) -> Expressed:
    """The camera as pinhole with radial-tangential distortion of 4 or 5 coefficients, or as an equidistant fisheye.

    nearest: where neither holds it, take the nearest (least squares over the image) in place of refusing.

    Raises GtcalError for a camera without intrinsics, or one that neither model holds unless ``nearest``."""
    exact = _exact(camera, radtan_coefficients)
    if exact is not None:
        return exact
    found = _nearest(camera, radtan_coefficients)
    if not nearest:
        raise GtcalError(
            f"camera {camera.name!r}: {format_name} can't express {camera.model.name} with these parameters; the "
            f"nearest {found.model.name} that it can is off by {found.rms_px:.3g} px rms and {found.max_px:.3g} px at "
            "most over the image: give --nearest to write that, or take --to numpy, which loses nothing"
        )
    return found


def _exact(camera: Camera, radtan_coefficients: int) -> Expressed | None:
    theta = camera.theta
    if camera.model == PINHOLE_RADTAN:
        return Expressed(PINHOLE_RADTAN, theta, 0.0, 0.0) if _fits(theta, radtan_coefficients) else None
    if not theta[8:].any():
        return Expressed(KANNALA_BRANDT4, theta[:8].copy(), 0.0, 0.0)
    return None


def _fits(theta: FloatArray, radtan_coefficients: int) -> bool:
    return not theta[4 + radtan_coefficients :].any()


def _nearest(camera: Camera, radtan_coefficients: int) -> Expressed:
    pinhole = camera.model == PINHOLE_RADTAN
    model = PINHOLE_RADTAN if pinhole else KANNALA_BRANDT4
    n_free = 4 + (radtan_coefficients if pinhole else 4)
    pixels_px, bearings = _image_grid(camera)

    def padded(free: FloatArray) -> FloatArray:
        return np.concatenate([free, np.zeros(model.n_parameters - n_free)])

    def residuals(free: FloatArray) -> FloatArray:
        projected_px, valid = model.project(bearings, padded(free))
        return np.where(valid[:, None], projected_px - pixels_px, camera.image_width_px).ravel()

    start = np.concatenate([camera.theta[:4], np.zeros(n_free - 4)])
    free = least_squares(residuals, start, x_scale=np.r_[np.full(4, 100.0), np.full(n_free - 4, 0.01)]).x
    norms_px = np.linalg.norm(residuals(free).reshape(-1, 2), axis=1)
    return Expressed(model, padded(free), float(np.sqrt(np.mean(norms_px**2))), float(norms_px.max()))


def _image_grid(camera: Camera) -> tuple[FloatArray, FloatArray]:
    x = np.linspace(0.0, camera.image_width_px - 1.0, _GRID)
    y = np.linspace(0.0, camera.image_height_px - 1.0, _GRID)
    pixels_px = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    bearings, valid = camera.unproject(pixels_px)
    if not valid.any():
        raise GtcalError(
            f"camera {camera.name!r}: its lens has no bearing for any pixel of the image; check its parameters"
        )
    return pixels_px[valid], bearings[valid]
