"""The reprojection error of board corners, in two grains of one measurement.

    residual = pi(camera_T_ref * ref_T_body * body_T_board * corner(shape); theta) - pixel

``CornerReprojectionFactor`` is one corner with GTSAM's own noise models: the reference, and the researcher's tool.
``FusedReprojectionFactor`` is all corners of a view, or of all the views of a camera, as one factor with the same
error, gradient, Hessian and optimum.

The board's shape (``factors.board_shape``) is that of a flat board as stated, or a variable.

What makes the fused one fast: one kernel sums w [J r]^T [J r] of each view in the tangent of its camera_T_board
(and theta, and the shape), 7 columns instead of 13; ``factors.moments`` carries the sums over to the variables.

A corner without a pixel under the current estimate (outside the model's valid field) has the error of its continued
pixel (``project_point``), so that no step across the field's end is a step of the error. Only what has no direction
either has GTSAM's cheirality error: twice the focal length on both axes, with zero Jacobian.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gtsam
import numpy as np

from factors.board_shape import FLAT, N_SHAPE
from factors.camera_models import CameraModel
from factors.cores import in_order, n_cores_here
from factors.moments import chain, transport, triangular_factor
from factors.reprojection_kernels import FloatArray, IntArray, view_kernels
from factors.rigid import pose_at
from factors.robust import GAUSSIAN, MEASURED, AnyKernel, CalledBackKernel

_NO_OUTLINE = np.array([0.0, 0.0, 1.0, 1.0])
_NOT_CALLED_BACK = np.empty((0, 2))
_CORNERS_PER_TASK = 8192  # below this a thread costs more than it saves


@dataclass(frozen=True)
class CornerViews:
    """The corners a camera saw. View v holds rows ``view_start[v]:view_start[v + 1]`` of the corner columns.

    view_start: (V + 1,) first row of each view, and the number of rows. A view may be empty: it says nothing.
    corners_m: (N, 3) corners in the board frame.
    corners_px: (N, 2) their measured pixels.
    sigma_px: standard deviation of a measured coordinate.
    outline_m: (4,) of the whole board, as of ``outline_of``: what a shape other than ``FLAT`` is relative to.

    Raises ValueError where the shapes do not fit."""

    view_start: IntArray
    corners_m: FloatArray
    corners_px: FloatArray
    sigma_px: float = 1.0
    outline_m: FloatArray = field(default_factory=_NO_OUTLINE.copy)

    def __post_init__(self) -> None:
        for name, dtype in (("view_start", np.int64), ("corners_m", np.float64), ("corners_px", np.float64)):
            # of one layout, for numba compiles the kernels anew for every other
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=dtype))
        n = len(self.corners_m)
        if self.corners_m.shape != (n, 3) or self.corners_px.shape != (n, 2):
            raise ValueError(
                f"{self.corners_m.shape=}, {self.corners_px.shape=}, expected (N, 3) and (N, 2) with one N"
            )
        start = self.view_start
        if len(start) < 2 or start[0] != 0 or start[-1] != n or (np.diff(start) < 0).any():
            raise ValueError(f"view_start must run from 0 to N={n} over at least one view, and never back")
        if not self.sigma_px > 0.0:
            raise ValueError(f"{self.sigma_px=}, expected a positive standard deviation")
        if self.outline_m.shape != (4,):
            raise ValueError(f"{self.outline_m.shape=}, expected (4,)")

    @property
    def n_views(self) -> int:
        return len(self.view_start) - 1


@dataclass(frozen=True)
class ViewMoments:
    """What the corners of each view say, in the tangent of its camera_T_board (right-handed perturbation).

    moments: (V, D, D) sum of w [J r]^T [J r], whitened, w the robust weight. Columns: tangent (6), theta (K or
    none), the board's shape (5 or none), residual (1).
    loss: (V,) sum of the robust losses; the factor's error.
    n_invalid: (V,) corners that have no pixel."""

    moments: FloatArray
    loss: FloatArray
    n_invalid: IntArray


def _tasks(view_start: IntArray) -> list[tuple[int, int]]:
    """Ranges of views with about as many corners each, no more than there are cores."""
    wanted = int(view_start[-1]) // _CORNERS_PER_TASK
    # asking for the number of cores takes longer than a view
    n_tasks = min(wanted, n_cores_here()) if wanted > 1 else 1
    if n_tasks == 1:
        return [(0, len(view_start) - 1)]
    bounds = np.searchsorted(view_start, np.linspace(0, view_start[-1], n_tasks + 1)[1:-1])
    edges = [0, *(int(b) for b in bounds), len(view_start) - 1]
    return list(itertools.pairwise(edges))


def _run_on_all_cores(run: Callable[[tuple[int, int]], None], view_start: IntArray) -> None:
    tasks = _tasks(view_start)
    if len(tasks) == 1:
        run(tasks[0])
    else:
        list(in_order(run, tasks))


def _poses_of(views: CornerViews, camera_T_board: FloatArray) -> FloatArray:
    if camera_T_board.shape != (views.n_views, 4, 4):
        raise ValueError(f"{camera_T_board.shape=}, expected ({views.n_views}, 4, 4)")
    return np.ascontiguousarray(camera_T_board)


def view_moments(
    views: CornerViews,
    camera_T_board: FloatArray,
    model: CameraModel,
    theta: FloatArray,
    shape: FloatArray = FLAT,
    *,
    robust: AnyKernel = GAUSSIAN,
    with_theta: bool = False,
    with_shape: bool = False,
    with_moments: bool = True,
) -> ViewMoments:
    """Sum the corners of every view at camera_T_board (V, 4, 4), on a board of this shape (5,), on all cores.

    The result does not depend on the number of cores. Without ``with_moments`` only losses and counts are there
    (moments has the shape (0, D, D)).

    Raises ValueError where the shapes do not fit."""
    theta, kernels = model.as_theta(theta), view_kernels(model)
    camera_T_board = _poses_of(views, camera_T_board)
    columns = 7 + model.n_parameters * with_theta + N_SHAPE * with_shape
    n_views = views.n_views
    moments = np.empty((n_views if with_moments else 0, columns, columns))
    loss, n_invalid = np.empty(n_views), np.empty(n_views, dtype=np.int64)
    called_back = np.empty((len(views.corners_m), 2)) if isinstance(robust, CalledBackKernel) else _NOT_CALLED_BACK

    def run(kernel_id: int, with_moments: bool, task: tuple[int, int]) -> None:
        kernels.sum_views(
            theta,
            camera_T_board,
            views.view_start,
            views.corners_m,
            views.corners_px,
            views.outline_m,
            shape,
            views.sigma_px,
            kernel_id,
            robust.parameter,
            with_theta,
            with_shape,
            with_moments,
            *task,
            called_back,
            moments,
            loss,
            n_invalid,
        )

    if isinstance(robust, CalledBackKernel):
        _run_on_all_cores(partial(run, MEASURED, False), views.view_start)
        called_back[:] = robust.losses_and_weights(called_back[:, 0])
    _run_on_all_cores(partial(run, robust.kernel_id, with_moments), views.view_start)
    return ViewMoments(moments, loss, n_invalid)


def residuals_px(
    views: CornerViews, camera_T_board: FloatArray, model: CameraModel, theta: FloatArray, shape: FloatArray = FLAT
) -> FloatArray:
    """Projection less measurement (N, 2) of every corner at camera_T_board (V, 4, 4), on a board of this shape (5,);
    NaN where a corner has no pixel.

    Raises ValueError where the shapes do not fit."""
    theta, kernels = model.as_theta(theta), view_kernels(model)
    camera_T_board = _poses_of(views, camera_T_board)
    out = np.empty_like(views.corners_px)

    def run(task: tuple[int, int]) -> None:
        columns = views.view_start, views.corners_m, views.corners_px, views.outline_m, shape
        kernels.residuals(theta, camera_T_board, *columns, *task, out)

    _run_on_all_cores(run, views.view_start)
    return out


Jacobians = Any  # GTSAM's JacobianVector, or None for a value-only call
Evaluate = Callable[[gtsam.CustomFactor, gtsam.Values, Jacobians], FloatArray]


@dataclass(frozen=True)
class _Variables:
    """Where the residual's five arguments come from: each a key, or a constant."""

    camera_T_ref_key: int
    body_T_board_key: int
    ref_T_body: int | FloatArray
    theta: int | FloatArray
    shape: int | FloatArray

    @property
    def free_body(self) -> bool:
        return isinstance(self.ref_T_body, int)

    @property
    def free_theta(self) -> bool:
        return isinstance(self.theta, int)

    @property
    def keys(self) -> list[int]:
        optional_body = [self.ref_T_body] if isinstance(self.ref_T_body, int) else []
        optional = [value for value in (self.theta, self.shape) if isinstance(value, int)]
        return [self.camera_T_ref_key, *optional_body, self.body_T_board_key, *optional]

    @property
    def free_shape(self) -> bool:
        return isinstance(self.shape, int)

    def at(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """camera_T_ref (4, 4), ref_T_body (V, 4, 4), body_T_board (4, 4), theta (K,), shape (5,)."""
        body, theta, shape = self.ref_T_body, self.theta, self.shape
        return (
            pose_at(values, self.camera_T_ref_key),
            pose_at(values, body)[None] if isinstance(body, int) else body,
            pose_at(values, self.body_T_board_key),
            values.atVector(theta) if isinstance(theta, int) else theta,
            values.atVector(shape) if isinstance(shape, int) else shape,
        )

    def split(self, jacobians: Jacobians, columns: FloatArray) -> None:
        """Hand GTSAM the columns of each variable, in the order of ``keys``."""
        sizes = [6] * (2 + self.free_body)
        rest = columns.shape[1] - 6 * len(sizes) - N_SHAPE * self.free_shape
        sizes += [rest] * self.free_theta + [N_SHAPE] * self.free_shape
        start = 0
        for i, size in enumerate(sizes):
            jacobians[i] = np.asfortranarray(columns[:, start : start + size])
            start += size


def _checked(model: CameraModel, theta: int | FloatArray) -> int | FloatArray:
    return theta if isinstance(theta, int) else model.as_theta(theta)


def reprojection_moments(
    views: CornerViews,
    camera_T_ref: FloatArray,
    ref_T_body: FloatArray,
    body_T_board: FloatArray,
    model: CameraModel,
    theta: FloatArray,
    shape: FloatArray = FLAT,
    *,
    robust: AnyKernel = GAUSSIAN,
    free_body: bool = False,
    free_theta: bool = False,
    free_shape: bool = False,
) -> tuple[FloatArray, float]:
    """Sum of w [J r]^T [J r] over all views, upper triangle, in the tangents of camera_T_ref, of ref_T_body where
    ``free_body`` (one view only), of body_T_board, of theta where ``free_theta`` and of the board's shape where
    ``free_shape``, the residual last; and the summed loss."""
    camera_T_board = chain(camera_T_ref, ref_T_body, body_T_board)
    by_view = view_moments(
        views, camera_T_board, model, theta, shape, robust=robust, with_theta=free_theta, with_shape=free_shape
    )
    moments = transport(by_view.moments, ref_T_body, body_T_board, free_body=free_body)
    return moments, float(by_view.loss.sum())


@dataclass(frozen=True)
class _Summed:
    """All corners at some arguments: the triangular factor of their [J r], and their loss."""

    at: tuple[FloatArray, ...]
    triangle: FloatArray
    loss: float

    def is_at(self, arguments: tuple[FloatArray, ...]) -> bool:
        return all(there is here or np.array_equal(there, here) for there, here in zip(self.at, arguments, strict=True))


class _FusedResidual:
    """The callback of the fused factor. It keeps what it summed last: where a step is tried, the next one begins."""

    def __init__(self, views: CornerViews, variables: _Variables, model: CameraModel, robust: AnyKernel) -> None:
        self._views, self._variables, self._model, self._robust = views, variables, model, robust
        self._last: _Summed | None = None

    def __call__(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
        summed = self._at(self._variables.at(values))
        if jacobians is None:
            return np.array([math.sqrt(2.0 * summed.loss)])
        self._variables.split(jacobians, summed.triangle[:, :-1])
        return summed.triangle[:, -1]

    def _at(self, arguments: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]) -> _Summed:
        if self._last is None or not self._last.is_at(arguments):
            moments, loss = reprojection_moments(
                self._views,
                *arguments[:3],
                self._model,
                *arguments[3:],
                robust=self._robust,
                free_body=self._variables.free_body,
                free_theta=self._variables.free_theta,
                free_shape=self._variables.free_shape,
            )
            self._last = _Summed(arguments, triangular_factor(moments), loss)
        return self._last


class FusedReprojectionFactor(gtsam.CustomFactor):
    """All corners of one camera's views as one factor.

    camera_T_ref_key, body_T_board_key: Pose3 variables Y_c and X.
    ref_T_body: (V, 4, 4) exact poses A_t; or, for a single view, the key of a Pose3 variable A_t.
    theta: (K,) fixed intrinsics; or the key of a vector variable.
    shape: (5,) of the board, as in ``factors.board_shape``; or the key of a vector variable.
    robust: acts on each corner's whitened norm, as ``gtsam.noiseModel.Robust`` would.

    Keys in order: Y_c, A_t if free, X, theta if free, shape if free. The Jacobian handed to GTSAM is the triangular
    factor of the corners' whitened [J r]; a value-only call returns one entry, the root of twice the summed loss.

    Raises ValueError where the shapes do not fit."""

    def __init__(
        self,
        camera_T_ref_key: int,
        body_T_board_key: int,
        *,
        views: CornerViews,
        model: CameraModel,
        ref_T_body: int | FloatArray,
        theta: int | FloatArray,
        shape: int | FloatArray = FLAT,
        robust: AnyKernel = GAUSSIAN,
    ) -> None:
        if isinstance(ref_T_body, int):
            if views.n_views != 1:
                raise ValueError(f"{views.n_views=}: a free ref_T_body needs a factor of one view")
        elif ref_T_body.shape != (views.n_views, 4, 4):
            raise ValueError(f"{ref_T_body.shape=}, expected ({views.n_views}, 4, 4)")
        variables = _Variables(camera_T_ref_key, body_T_board_key, ref_T_body, _checked(model, theta), shape)
        # no noise model: the rows come whitened, and a value-only call returns fewer of them
        super().__init__(None, variables.keys, _FusedResidual(views, variables, model, robust))  # type: ignore[call-overload]


@dataclass(frozen=True)
class _CornerResidual:
    """The callback of the per-corner factor."""

    corner_m: FloatArray
    corner_px: FloatArray
    outline_m: FloatArray
    variables: _Variables
    model: CameraModel

    def __call__(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
        camera_T_ref, ref_T_body, body_T_board, theta, shape = self.variables.at(values)
        rows = view_kernels(self.model).corner_rows(
            self.model.as_theta(theta),
            camera_T_ref,
            ref_T_body[0],
            body_T_board,
            self.corner_m,
            self.corner_px,
            self.outline_m,
            shape,
            self.variables.free_body,
            self.variables.free_theta,
            self.variables.free_shape,
        )
        if jacobians is not None:
            self.variables.split(jacobians, rows[:, :-1])
        return rows[:, -1]


class CornerReprojectionFactor(gtsam.CustomFactor):
    """One corner as a factor of two rows, in px; variables and their order as in ``FusedReprojectionFactor``.

    noise_model: any of GTSAM's, of dimension 2; ``RobustKernel.noise_model`` makes the one that the fused factor
    uses inside. shape, outline_m: of the board, as in ``FusedReprojectionFactor`` and ``CornerViews``.

    Raises ValueError where the shapes do not fit."""

    def __init__(
        self,
        camera_T_ref_key: int,
        body_T_board_key: int,
        *,
        corner_m: FloatArray,
        corner_px: FloatArray,
        model: CameraModel,
        ref_T_body: int | FloatArray,
        theta: int | FloatArray,
        noise_model: gtsam.noiseModel.Base,
        shape: int | FloatArray = FLAT,
        outline_m: FloatArray = _NO_OUTLINE,
    ) -> None:
        constant = ref_T_body if isinstance(ref_T_body, int) else np.asarray(ref_T_body).reshape(1, 4, 4)
        variables = _Variables(camera_T_ref_key, body_T_board_key, constant, _checked(model, theta), shape)
        residual = _CornerResidual(corner_m, corner_px, outline_m, variables, model)
        super().__init__(noise_model, variables.keys, residual)
