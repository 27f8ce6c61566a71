"""The reprojection error of all frames with the mocap's noise integrated out: one factor, whatever their number.

``factors.frames`` has a variable A_f per frame under a prior of the mocap's noise. Here A_f = M_f Exp(L_f z_f), M_f the
mocap's pose, and the z_f are eliminated inside (``factors.noise_chain``). The factor's error is the least over all z_f
of what those factors and priors sum to, so that its optimum, and its Hessian there, which is their Schur complement,
are those of the graph with a variable per frame (variable projection: Golub and Pereyra 1973).

The z_f that are best at new values are predicted from the last linearisation, to first order in the step, and refined
there by Gauss-Newton steps over them alone until these promise next to nothing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from factors.board_shape import FLAT, N_SHAPE
from factors.cores import in_order
from factors.frames import CameraFrames, add_views
from factors.moments import chain, triangular_factor
from factors.noise_chain import NoiseChain
from factors.reprojection import CornerViews, Jacobians, view_moments
from factors.reprojection_kernels import FloatArray, IntArray
from factors.rigid import exponential, pose_at, right_jacobian
from factors.robust import GAUSSIAN, AnyKernel

_AT_ONCE = 256  # frames: their moments take up to 60 kB each
_MOST_REFINEMENTS = 8  # one or two are enough for noise of millimetres
_PROMISE = 1e-9
"""The z_f are good where a step over them promises to lower the error by less than this share of (1 + error): the
promise itself is taken, and what is left is of the next order."""


@dataclass(frozen=True)
class _Point:
    """The sums at one set of values and z (F, 6), whitened noise.

    total: (K, K) [J r]^T [J r] of the unknowns and the residual, the noise integrated out. error: the loss with the
    noise's prior, less ``promise``, which the best step over z takes off it. chain: linear round this point."""

    poses: dict[int, gtsam.Pose3]
    vectors: dict[int, FloatArray]
    z: FloatArray
    total: FloatArray
    error: float
    promise: float
    chain: NoiseChain

    def is_at(self, values: gtsam.Values) -> bool:
        """Whether it is at these values, to the last bit."""
        return all(values.atPose3(key).equals(pose, 0.0) for key, pose in self.poses.items()) and all(
            np.array_equal(values.atVector(key), vector) for key, vector in self.vectors.items()
        )

    def noise_at(self, values: gtsam.Values, correlation: FloatArray) -> FloatArray:
        """(F, 6) the best z at values nearby, to first order."""
        steps = [pose.localCoordinates(values.atPose3(key)) for key, pose in self.poses.items()]
        steps += [values.atVector(key) - vector for key, vector in self.vectors.items()]
        return self.chain.noise_at(correlation, np.concatenate([*steps, np.ones(1)]))


class MarginalFramesFactor(gtsam.CustomFactor):
    """All corners of all frames under the mocap's noise.

    cameras: what each saw, frames counted from 0. measured_ref_T_body: (F, 4, 4) the mocap's poses M_f. noise:
    (F, 6, 6) lower triangular L_f, in the tangent of ref_T_body, rotation first. correlation: (F,) of a frame's noise
    with the next one's, 0 where the chain is cut and at the end. body_T_board: key of X. shape: (5,) of the board, or
    the key of a vector variable.
    Keys in order: X, every Y_c, every theta_c that is free, the shape where it is free. The Jacobian handed to GTSAM is
    the triangular factor of what is left of all corners; a value-only call returns one entry, the root of twice the
    error.

    Raises ValueError where the shapes do not fit."""

    def __init__(
        self,
        cameras: Sequence[CameraFrames],
        *,
        measured_ref_T_body: FloatArray,
        noise: FloatArray,
        correlation: FloatArray,
        body_T_board: int,
        shape: int | FloatArray = FLAT,
        robust: AnyKernel = GAUSSIAN,
    ) -> None:
        n = len(measured_ref_T_body)
        if measured_ref_T_body.shape != (n, 4, 4) or noise.shape != (n, 6, 6) or correlation.shape != (n,):
            raise ValueError(f"{measured_ref_T_body.shape=}, {noise.shape=}, {correlation.shape=} for {n} frames")
        for camera in cameras:
            if len(camera.frame) and not 0 <= camera.frame[0] <= camera.frame[-1] < n:
                raise ValueError(f"frame numbers {camera.frame[0]} to {camera.frame[-1]} for {n} frames")
        self._measured, self._noise, self._correlation = measured_ref_T_body, noise, correlation
        self._body_T_board, self._shape, self._robust = body_T_board, shape, robust
        self._cameras = tuple(cameras)
        self._parts = [_part(self._cameras, *edges) for edges in itertools.pairwise([*range(0, n, _AT_ONCE), n])]
        free = {camera.theta: camera.n_theta for camera in cameras if isinstance(camera.theta, int)}
        free |= {shape: N_SHAPE} if isinstance(shape, int) else {}
        self._pose_keys = [body_T_board, *(camera.camera_T_ref for camera in cameras)]
        self._vector_keys = list(free)
        self._blocks = list(
            itertools.pairwise(itertools.accumulate([6] * (1 + len(cameras)) + [*free.values()], initial=0))
        )
        self._base: _Point | None = None
        self._last: _Point | None = None
        # no noise model: the rows come whitened, and a value-only call returns fewer of them
        super().__init__(None, [*self._pose_keys, *self._vector_keys], self._residual)  # type: ignore[call-overload]

    def ref_T_body(self, values: gtsam.Values) -> FloatArray:
        """(F, 4, 4) the A_f that are best at these values."""
        point = self._at(values)
        return self._poses(self._twists(point.noise_at(values, self._correlation)))

    def _residual(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
        point = self._at(values)
        if jacobians is None:
            return np.array([math.sqrt(2.0 * max(point.error, 0.0))])
        self._base = point
        triangle = triangular_factor(point.total)
        for i, (start, end) in enumerate(self._blocks):
            jacobians[i] = np.asfortranarray(triangle[:, start:end])
        return triangle[:, -1]

    def _at(self, values: gtsam.Values) -> _Point:
        if self._last is None or not self._last.is_at(values):
            self._last = self._refined(values)
        return self._last

    def _refined(self, values: gtsam.Values) -> _Point:
        start = self._base
        z = np.zeros((len(self._measured), 6)) if start is None else start.noise_at(values, self._correlation)
        point = self._summed(values, z)
        for _ in range(_MOST_REFINEMENTS):
            if not point.promise > _PROMISE * (1.0 + point.error):
                break
            point = self._summed(values, point.noise_at(values, self._correlation))
        return point

    def _twists(self, z: FloatArray) -> FloatArray:
        return np.einsum("fij,fj->fi", self._noise, z)

    def _poses(self, xi: FloatArray) -> FloatArray:
        return self._measured @ exponential(xi)

    def _summed(self, values: gtsam.Values, z: FloatArray) -> _Point:
        poses = {key: values.atPose3(key) for key in self._pose_keys}
        vectors = {key: values.atVector(key) for key in self._vector_keys}
        xi = self._twists(z)
        ref_T_body, turned = self._poses(xi), right_jacobian(xi)
        size = self._blocks[-1][1] + 1
        noises = NoiseChain.starting(len(z), size)
        total, loss, square = np.zeros((size, size)), 0.0, 0.0
        found = in_order(lambda part: self._moments(part, values, ref_T_body[part.rows]), self._parts)
        for part, (moments, loss_of_part) in zip(self._parts, found, strict=True):
            rows = part.rows
            loss += loss_of_part
            square += float(moments[:, -1, -1].sum())
            _about_no_noise(moments, turned[rows], xi[rows])
            total += moments[:, 6:, 6:].sum(axis=0)
            noises.eliminate(moments, self._noise[rows], self._correlation[rows])
        total -= noises.known_square
        of_prior = self._prior(z)
        promise = 0.5 * (square - float(total[-1, -1])) + of_prior
        return _Point(poses, vectors, z, total, loss + of_prior - promise, promise, noises)

    def _prior(self, z: FloatArray) -> float:
        """Half the squares of what is new in each frame's noise."""
        rho = np.concatenate([[0.0], self._correlation[:-1]])[:, None]
        new = (z - rho * np.concatenate([z[:1], z[:-1]])) / np.sqrt(1.0 - rho * rho)
        return 0.5 * float(np.sum(new * new))

    def _moments(self, part: _Part, values: gtsam.Values, ref_T_body: FloatArray) -> tuple[FloatArray, float]:
        """(f, D, D) of the frames of a part, columns A_f and then those of the factor, and their loss."""
        n_columns = 6 + self._blocks[-1][1] + 1
        total, loss = np.zeros((len(ref_T_body), n_columns, n_columns)), 0.0
        body_T_board = pose_at(values, self._body_T_board)
        shape = values.atVector(self._shape) if isinstance(self._shape, int) else self._shape
        theta_column = 12 + 6 * len(self._cameras) + np.cumsum([0, *(camera.n_theta for camera in self._cameras)])
        for c, views, frame in part.seen:
            camera, of_views = self._cameras[c], ref_T_body[frame]
            found = view_moments(
                views,
                chain(pose_at(values, camera.camera_T_ref), of_views, body_T_board),
                camera.model,
                values.atVector(camera.theta) if isinstance(camera.theta, int) else camera.theta,
                shape,
                robust=self._robust,
                with_theta=camera.n_theta > 0,
                with_shape=isinstance(self._shape, int),
            )
            n_shape = N_SHAPE * isinstance(self._shape, int)
            add_views(found.moments, frame, of_views, body_T_board, 12 + 6 * c, int(theta_column[c]), n_shape, total)
            loss += float(found.loss.sum())
        return total, loss


@dataclass(frozen=True)
class _Part:
    """Some frames in a row. seen: of each camera that saw any of them its place among the cameras, its views, and the
    place of each view's frame among ``rows``."""

    rows: slice
    seen: list[tuple[int, CornerViews, IntArray]]


def _part(cameras: tuple[CameraFrames, ...], first: int, end: int) -> _Part:
    seen = []
    for c, camera in enumerate(cameras):
        a, b = (int(edge) for edge in np.searchsorted(camera.frame, (first, end)))
        if a < b:
            seen.append((c, _some_views(camera.views, a, b), camera.frame[a:b] - first))
    return _Part(slice(first, end), seen)


def _some_views(views: CornerViews, first: int, end: int) -> CornerViews:
    start = views.view_start[first : end + 1]
    rows = slice(start[0], start[-1])
    return CornerViews(start - start[0], views.corners_m[rows], views.corners_px[rows], views.sigma_px, views.outline_m)


def _about_no_noise(moments: FloatArray, turned: FloatArray, xi: FloatArray) -> None:
    """Moments (f, D, D) in the tangent of A_f = M_f Exp(xi) made those in xi itself, the residual where xi is zero.

    turned: (f, 6, 6) right Jacobian of Exp at xi (f, 6)."""
    moments[:, :6] = np.swapaxes(turned, 1, 2) @ moments[:, :6]
    moments[:, :, :6] = moments[:, :, :6] @ turned
    moments[:, :, -1] -= np.einsum("fij,fj->fi", moments[:, :, :6], xi)
    moments[:, -1] -= np.einsum("fi,fij->fj", xi, moments[:, :6])
