"""Which lens a file can hold: exactly, or by the nearest one that it can and what is lost by that, in pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from factors.camera_models import (
    DOUBLE_SPHERE,
    EXTENDED_UNIFIED,
    FISHEYE62,
    FISHEYE624,
    KANNALA_BRANDT4,
    MEI_OMNI,
    PINHOLE_RADTAN,
    PINHOLE_RATIONAL,
    CameraModel,
)
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.errors import GtcalError

_GRID = 25
# A polar grid of bearings for lenses that only project: half a degree outwards, ten degrees around.
_AZIMUTHS, _STEPS, _WIDEST_RAD = 36, 240, np.deg2rad(120.0)
_NEWTON_STEPS, _STEP, _FOUND_PX = 8, 1e-6, 1e-6
# Past 85 degrees off its axis a pinhole's image is eleven focal lengths from the middle, and no sensor reaches there.
_PINHOLE_LIMIT = np.cos(np.deg2rad(85.0))


@dataclass(frozen=True)
class Form:
    """A lens as a format writes it: a camera model whose first ``n_free`` parameters are written, the rest being zero.

    one_focal_length: fx and fy are one number there."""

    model: CameraModel
    n_free: int
    one_focal_length: bool = False

    def holds(self, theta: FloatArray) -> bool:
        """Whether these parameters of ``model`` are of this form."""
        return not theta[self.n_free :].any() and (not self.one_focal_length or bool(theta[0] == theta[1]))


PINHOLE = Form(PINHOLE_RADTAN, 4)
RADTAN4 = Form(PINHOLE_RADTAN, 8)
RADTAN5 = Form(PINHOLE_RADTAN, 9)
KB4 = Form(KANNALA_BRANDT4, 8)
RATIONAL = Form(PINHOLE_RATIONAL, 12)
F62 = Form(FISHEYE62, 12)
F624 = Form(FISHEYE624, 16)
DS = Form(DOUBLE_SPHERE, 6)
EUCM = Form(EXTENDED_UNIFIED, 6)
OMNI = Form(MEI_OMNI, 9)
F624_ONE_FOCAL_LENGTH = Form(FISHEYE624, 16, one_focal_length=True)
OPENCV_FORMS = (RADTAN5, KB4, RATIONAL)
"""What cv2.projectPoints and cv2.fisheye project, by their coefficients alone."""


@dataclass(frozen=True)
class Expressed:
    """A camera in a form that a format knows.

    theta: (K,) in the order of ``form.model.parameter_names``.
    rms_px, max_px: what it differs by from the camera it was made from, over the image; 0 where it is the same."""

    form: Form
    theta: FloatArray
    rms_px: float = 0.0
    max_px: float = 0.0

    @property
    def model(self) -> CameraModel:
        return self.form.model

    def said(self, camera: Camera) -> str:
        """For a comment beside a lens: how far it is off, and whether the image looks past what OpenCV and COLMAP
        project."""
        off = f"lens off by {self.max_px:.3g} px at most over the image"
        bearings = np.zeros((1, 3)) if self.model.perspective else _image_grid(camera)[1]
        if bearings[:, 2].min() >= 0:
            return off
        widest_deg = np.rad2deg(np.arccos(bearings[:, 2].min()))
        return f"{off}, which looks up to {widest_deg:.0f} deg off the axis; OpenCV and COLMAP project up to 90"

    def camera(self, name: str, image_size_px: tuple[int, int]) -> Camera:
        """A camera with this lens."""
        return Camera(name, self.model, self.theta, *image_size_px)


@dataclass(frozen=True)
class ForeignLens:
    """A lens that gtcal has no model of: it projects bearings (N, 3) to pixels (N, 2), integers at pixel centres.

    name: as its format calls it. form: of the model of gtcal's that is nearest in kind. theta: where to start from."""

    name: str
    form: Form
    theta: FloatArray
    project: Callable[[FloatArray], FloatArray]


def express(camera: Camera, *, format_name: str, forms: Sequence[Form], nearest: bool = False) -> Expressed:
    """The camera in the first of the forms that holds it exactly.

    nearest: where none does, take the nearest (least squares over the image) in place of refusing.

    Raises GtcalError for a camera without intrinsics, or one that no form holds unless ``nearest``."""
    for form in forms:
        theta = as_model(camera.model, camera.theta, form.model)
        if theta is not None and form.holds(theta):
            return Expressed(form, theta)
    found = _nearest(camera, _usual(camera, forms), format_name)
    if not nearest:
        raise GtcalError(
            f"camera {camera.name!r}: {format_name} can't express {camera.model.name} with these parameters; the "
            f"nearest {_named(found.form)} that it can is off by {found.rms_px:.3g} px rms and {found.max_px:.3g} px "
            "at most over the image: give --nearest to write that, or take --to numpy, which loses nothing"
        )
    return found


def _usual(camera: Camera, forms: Sequence[Form]) -> Sequence[Form]:
    """Those that most tools read: a sphere only in place of another."""
    usual = [form for form in forms if not form.model.start]
    return forms if camera.model.start or not usual else usual


def as_model(model: CameraModel, theta: FloatArray, other: CameraModel) -> FloatArray | None:
    """The same lens as parameters of another model, None where it isn't one."""
    n = other.n_parameters
    if not _related(model, other) or theta[n:].any():
        return None
    return np.concatenate([theta, np.zeros(max(0, n - len(theta)))])[:n]


def _related(model: CameraModel, other: CameraModel) -> bool:
    """Whether they are one formula with more or fewer terms."""
    return model in _ancestry(other) or other in _ancestry(model)


def _ancestry(model: CameraModel | None) -> list[CameraModel]:
    return [] if model is None else [model, *_ancestry(model.extends)]


def fit_foreign(lens: ForeignLens, image_size_px: tuple[int, int]) -> Expressed | None:
    """The nearest to a lens that gtcal has no model of; None where it has no bearing within its image."""
    azimuths, angles = np.linspace(0, 2 * np.pi, _AZIMUTHS, endpoint=False), np.linspace(0, _WIDEST_RAD, _STEPS + 1)[1:]
    if lens.form.model.perspective:
        angles = angles[np.cos(angles) > _PINHOLE_LIMIT]
    azimuth, angle = np.meshgrid(azimuths, angles, indexing="ij")
    bearings = np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1
    ).reshape(-1, 3)
    pixels_px = lens.project(bearings)
    seen = _before_the_fold(pixels_px.reshape(_AZIMUTHS, -1, 2), lens.theta[2:4]).ravel()
    seen &= (pixels_px > -0.5).all(axis=1) & (pixels_px < np.array(image_size_px) - 0.5).all(axis=1)
    if np.count_nonzero(seen) < len(lens.theta):
        return None
    rough = _fitted(lens.form, lens.theta, pixels_px[seen], bearings[seen], image_size_px)
    if rough is None:
        return None
    grid_px, start = _image_grid(rough.camera(lens.name, image_size_px))
    bearings, found = _unprojected(lens, grid_px, start)
    return _fitted(lens.form, rough.theta, grid_px[found], bearings[found], image_size_px)


def _unprojected(lens: ForeignLens, pixels_px: FloatArray, bearings: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Bearings (N, 3) of pixels (N, 2) from bearings near them, and whether they were found: Newton's method."""
    for _ in range(_NEWTON_STEPS):
        across = np.cross(bearings, np.eye(3)[np.argmin(np.abs(bearings), axis=1)])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        tangents = np.stack([across, np.cross(bearings, across)])
        here_px = lens.project(bearings)
        J = np.stack([(lens.project(bearings + _STEP * t) - here_px) / _STEP for t in tangents], axis=-1)
        steps = (np.linalg.pinv(J) @ (pixels_px - here_px)[..., None])[..., 0]
        bearings = bearings + np.einsum("knc,nk->nc", tangents, steps)
        bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    return bearings, np.linalg.norm(lens.project(bearings) - pixels_px, axis=1) < _FOUND_PX


def _before_the_fold(pixels_px: FloatArray, centre_px: FloatArray) -> BoolArray:
    """(A, S) whether each pixel of (A, S, 2), outwards along each azimuth, is further out than all before it."""
    radius_px = np.linalg.norm(np.nan_to_num(pixels_px, nan=0.0, posinf=0.0, neginf=0.0) - centre_px, axis=-1)
    return np.logical_and.accumulate(np.diff(radius_px, axis=1, prepend=-1.0) > 0, axis=1)


def _nearest(camera: Camera, forms: Sequence[Form], format_name: str) -> Expressed:
    pixels_px, bearings = _image_grid(camera)
    size_px = camera.image_width_px, camera.image_height_px
    fitted = [_fitted(form, _start(camera, form), pixels_px, bearings, size_px) for form in forms]
    found = [fit for fit in fitted if fit is not None]
    if not found:
        widest_deg = np.rad2deg(np.arccos(np.clip(bearings[:, 2].min(), -1.0, 1.0)))
        raise GtcalError(
            f"camera {camera.name!r}: {format_name} can't express {camera.model.name} with these parameters, and no "
            f"lens that it can has a bearing for every pixel of the image, which reaches {widest_deg:.0f} deg off the "
            "axis: take --to numpy, which loses nothing"
        )
    return min(found, key=lambda fit: fit.rms_px)


def _start(camera: Camera, form: Form) -> FloatArray:
    """What the two models share; else the same scale on the axis, without distortion."""
    theta = np.concatenate([camera.theta[:4], form.model.undistorted])
    if _related(camera.model, form.model):
        shared = min(len(theta), camera.model.n_parameters)
        theta[:shared] = camera.theta[:shared]
        return theta
    theta[:2] *= camera.model.slope_on_axis(camera.theta) / form.model.slope_on_axis(theta)
    return theta


def _fitted(
    form: Form, start: FloatArray, pixels_px: FloatArray, bearings: FloatArray, size_px: tuple[int, int]
) -> Expressed | None:
    """The form's parameters that project the bearings nearest to the pixels; None where it has no pixel for some."""
    from scipy.optimize import least_squares  # slow to import, and seldom needed

    model = form.model
    if model.perspective and bearings[:, 2].min() < _PINHOLE_LIMIT:
        return None
    spread = np.eye(model.n_parameters)[:, : form.n_free]  # free parameters to theta
    if form.one_focal_length:
        spread = np.delete(spread, 1, axis=1)
        spread[1, 0] = 1.0
    free = np.linalg.lstsq(spread, start, rcond=None)[0]
    if not model.project(bearings, spread @ free)[1].all():  # the start folds within the image: begin undistorted
        free = np.linalg.lstsq(spread, np.r_[start[:4], model.undistorted], rcond=None)[0]

    def residuals(free: FloatArray) -> FloatArray:
        projected_px, valid = model.project(bearings, spread @ free)
        return np.where(valid[:, None], projected_px - pixels_px, max(size_px)).ravel()

    def jacobian(free: FloatArray) -> FloatArray:
        J_theta = model.project_with_jacobians(bearings, spread @ free)[3]
        return np.nan_to_num(J_theta.reshape(-1, model.n_parameters)) @ spread

    solved = least_squares(residuals, free, jacobian, x_scale="jac", xtol=1e-10, ftol=1e-10, gtol=None, max_nfev=100)
    theta = spread @ solved.x
    if not model.project(bearings, theta)[1].all():
        return None
    norms_px = np.linalg.norm(residuals(solved.x).reshape(-1, 2), axis=1)
    return Expressed(form, theta, float(np.sqrt(np.mean(norms_px**2))), float(norms_px.max()))


def nearest_lens(camera: Camera, model: CameraModel, pixels_px: FloatArray, bearings: FloatArray) -> Camera | None:
    """The camera with the lens of another model that projects its bearings (N, 3) nearest to its pixels (N, 2); None
    where that has no pixel for some."""
    form = Form(model, model.n_parameters)
    size_px = camera.image_width_px, camera.image_height_px
    found = _fitted(form, _start(camera, form), pixels_px, bearings, size_px)
    return None if found is None else replace(camera, model=model, parameters=found.theta)


def difference_px(camera: Camera, other: Camera) -> tuple[float, float]:
    """By how much the second camera's pixels differ from the first's over its image: rms and at most; infinite where
    the second has none."""
    pixels_px, bearings = _image_grid(camera)
    projected_px, valid = other.project(bearings)
    if not valid.all():
        return np.inf, np.inf
    norms_px = np.linalg.norm(projected_px - pixels_px, axis=1)
    return float(np.sqrt(np.mean(norms_px**2))), float(norms_px.max())


def _image_grid(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Pixels over the image, borders included, and their bearings, as far as the lens has any."""
    x = np.linspace(0.0, camera.image_width_px - 1.0, _GRID)
    y = np.linspace(0.0, camera.image_height_px - 1.0, _GRID)
    pixels_px = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    bearings, valid = camera.unproject(pixels_px)
    if not valid.any():
        raise GtcalError(
            f"camera {camera.name!r}: its lens has no bearing for any pixel of the image; check its parameters"
        )
    return pixels_px[valid], bearings[valid]


def _named(form: Form) -> str:
    missing = " and ".join(form.model.parameter_names[form.n_free :]) if form.n_free > 4 else "distortion"
    without = f" without {missing}" if form.n_free < form.model.n_parameters else ""
    return form.model.name + without + (" with one focal length" if form.one_focal_length else "")
