"""A camera model: its name, its parameters, its parts, and what is asked of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.camera_models.parts import (
    PERSPECTIVE,
    STRAIGHT,
    UNBENT,
    FloatArray,
    Parts,
    Radial,
    Spread,
    Tangential,
)
from factors.camera_models.projection import BoolArray, Kernels, kernels_of

FOCAL_AND_CENTRE = ("fx", "fy", "cx", "cy")
"""What every model's parameters begin with."""

CAMERA_MODELS: dict[str, CameraModel] = {}
"""Every model by name. A model listed here gets all the tests of ``tests/test_camera_models.py``."""


def register_camera_model(model: CameraModel) -> CameraModel:
    """Make a model known by its name, to manifests and files too. Returns it.

    Raises ValueError where another has the name, or its parameters do not begin with fx fy cx cy."""
    if CAMERA_MODELS.get(model.name, model) != model:
        raise ValueError(f"there is a camera model {model.name!r} already")
    if model.parameter_names[:4] != FOCAL_AND_CENTRE:
        raise ValueError(f"{model.parameter_names=}, expected {' '.join(FOCAL_AND_CENTRE)} first")
    CAMERA_MODELS[model.name] = model
    return model


@dataclass(frozen=True)
class CameraModel:
    """A camera model. ``parameter_names`` gives the order of the parameter vector theta: fx fy cx cy, then the lens's.

    spread, radial, tangential: its parts (``factors.camera_models.parts``); by default it is a pinhole.
    usual: a lens of this model over an image of 1280 x 1024, by which simulation and tests know it: fx, and the
        parameters after the centre. In px per rad on the axis 560 to 710: 84 to 130 degrees across.
    start: the parameters after the centre of a lens that bends nothing, from which others are found; () for zeros.
    extends: the model that this one is where the parameters that it has more are zero."""

    name: str
    parameter_names: tuple[str, ...]
    spread: Spread = PERSPECTIVE
    radial: Radial = UNBENT
    tangential: Tangential = STRAIGHT
    usual: tuple[float, ...] = ()
    start: tuple[float, ...] = ()
    extends: CameraModel | None = None

    def __reduce__(self) -> tuple[object, ...]:
        """Its compiled parts stay where they are: a process that is handed a model takes its own of that name."""
        return _registered, (self.name,)

    @property
    def n_parameters(self) -> int:
        return len(self.parameter_names)

    @property
    def perspective(self) -> bool:
        """Whether it projects onto a plane before it distorts, so that nothing has a pixel from 85 degrees on."""
        return self.spread is PERSPECTIVE

    @property
    def kernels(self) -> Kernels:
        return kernels_of(self.name, Parts(self.spread, self.radial, self.tangential))

    @property
    def undistorted(self) -> FloatArray:
        """(K - 4,) the parameters after the centre of ``start``."""
        return np.array(self.start or np.zeros(self.n_parameters - 4), dtype=np.float64)

    def project(self, points_in_camera: npt.ArrayLike, theta: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
        """Pixels (N, 2) of points (N, 3) in the camera frame; a mask (N,) that is False, with the pixel NaN,
        where the point has no pixel. Scale does not matter: bearings will do for points.

        Raises ValueError for arrays of another shape."""
        points, parameters = _rows(points_in_camera, 3, "points_in_camera"), self.as_theta(theta)
        pixels, valid = np.empty((len(points), 2)), np.empty(len(points), dtype=np.bool_)
        scratch_point, scratch_theta = np.empty((1, 2, 3)), np.empty((1, 2, self.n_parameters))
        self.kernels.project_points(parameters, points, pixels, valid, scratch_point, scratch_theta, False, False)
        return pixels, valid

    def project_with_jacobians(
        self, points_in_camera: npt.ArrayLike, theta: npt.ArrayLike, *, continued: bool = False
    ) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
        """``project``, and d pixel / d point (N, 2, 3) and d pixel / d theta (N, 2, K), NaN where masked.

        continued: give what is masked the pixels and derivatives that an optimiser goes by, past the field's end.

        Raises ValueError for arrays of another shape."""
        points, parameters = _rows(points_in_camera, 3, "points_in_camera"), self.as_theta(theta)
        pixels, valid = np.empty((len(points), 2)), np.empty(len(points), dtype=np.bool_)
        J_point = np.full((len(points), 2, 3), np.nan)
        J_theta = np.full((len(points), 2, self.n_parameters), np.nan)
        self.kernels.project_points(parameters, points, pixels, valid, J_point, J_theta, True, continued)
        return pixels, valid, J_point, J_theta

    def unproject(self, pixels_px: npt.ArrayLike, theta: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
        """Unit bearings (N, 3) in the camera frame of pixels (N, 2); a mask (N,) that is False, with the
        bearing NaN, where no point of the valid field has that pixel.

        Raises ValueError for arrays of another shape."""
        pixels, parameters = _rows(pixels_px, 2, "pixels_px"), self.as_theta(theta)
        bearings, valid = np.empty((len(pixels), 3)), np.empty(len(pixels), dtype=np.bool_)
        self.kernels.unproject_pixels(parameters, pixels, bearings, valid)
        return bearings, valid

    def radial_slopes(self, bearings: npt.ArrayLike, theta: npt.ArrayLike) -> FloatArray:
        """(N,) slope of the radial function at bearings or points (N, 3) of the valid field, over that on the axis: 1
        on the axis, 0 at the field's end, where a pixel no longer tells the angle. NaN for a bearing that is.

        Raises ValueError for arrays of another shape."""
        points, parameters = _rows(bearings, 3, "bearings"), self.as_theta(theta)
        off_axis = np.hypot(points[:, 0], points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            ts = off_axis / points[:, 2] if self.perspective else np.arctan2(off_axis, points[:, 2])
        slopes = np.empty(len(points))
        self.kernels.radial_slopes(parameters, ts, slopes)
        return slopes / self.slope_on_axis(parameters)

    def slope_on_axis(self, theta: npt.ArrayLike) -> float:
        """Pixels per rad on the axis, over the focal length: 1 of most models."""
        slope = np.empty(1)
        self.kernels.radial_slopes(self.as_theta(theta), np.zeros(1), slope)
        return float(slope[0])

    def max_angle_rad(self, theta: npt.ArrayLike) -> float:
        """Half angle of the valid field: no point further off the axis has a pixel."""
        return float(self.kernels.field_end(self.as_theta(theta), False)[0, 1])

    def as_theta(self, theta: npt.ArrayLike) -> FloatArray:
        """theta as a float64 array (K,). The compiled kernels trust its length.

        Raises ValueError for another shape."""
        parameters = np.ascontiguousarray(theta, dtype=np.float64)
        if parameters.shape != (self.n_parameters,):
            raise ValueError(
                f"theta.shape={parameters.shape}, expected ({self.n_parameters},) for {self.name}: "
                + " ".join(self.parameter_names)
            )
        return parameters


def _registered(name: str) -> CameraModel:
    return CAMERA_MODELS[name]


def _rows(array: npt.ArrayLike, columns: int, name: str) -> FloatArray:
    rows = np.ascontiguousarray(array, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise ValueError(f"{name}.shape={rows.shape}, expected (N, {columns})")
    return rows
