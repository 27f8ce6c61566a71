"""The reprojection error of whole frames: one factor for all the corners that all cameras see at one moment.

    residual = pi(camera_T_ref * ref_T_body * body_T_board * corner(shape); theta) - pixel,  ref_T_body = A_f a variable

A frame's factor has the error, gradient and Hessian of all its corners. The frames of a recording are summed together,
on all cores, the first time that GTSAM asks one of them at new values; the others then find their sums ready.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from factors.board_shape import FLAT, N_SHAPE
from factors.camera_models import CameraModel
from factors.kernel import kernel
from factors.moments import chain, transport_view, triangular_factor
from factors.reprojection import CornerViews, Jacobians, view_moments
from factors.reprojection_kernels import FloatArray, IntArray
from factors.rigid import pose_at
from factors.robust import GAUSSIAN, AnyKernel


@dataclass(frozen=True)
class CameraFrames:
    """What one camera saw, and in which frames.

    views: V views. frame: (V,) the frame of each, increasing, one view a frame.
    camera_T_ref: key of Y_c. theta: (K,) fixed intrinsics, or the key of a vector variable.

    Raises ValueError where the shapes do not fit."""

    views: CornerViews
    frame: IntArray
    model: CameraModel
    camera_T_ref: int
    theta: int | FloatArray

    def __post_init__(self) -> None:
        if self.frame.shape != (self.views.n_views,) or (np.diff(self.frame) <= 0).any():
            raise ValueError(f"{self.frame.shape=}, expected ({self.views.n_views},) increasing frame numbers")

    @property
    def n_theta(self) -> int:
        """How many intrinsics are variables."""
        return self.model.n_parameters if isinstance(self.theta, int) else 0


@kernel
def _frame_triangle(
    by_view: FloatArray,
    ref_T_body: FloatArray,
    body_T_board: FloatArray,
    first_column: IntArray,
    n_theta: IntArray,
    n_shape: int,
    n_columns: int,
) -> FloatArray:
    """Triangular factor of the summed moments (v, d, d) of a frame's views, in the tangents of A_f, X, the Y_c and
    theta_c of the views' cameras, the board's shape (its ``n_shape`` numbers), and the residual. View i's Y_c starts at
    ``first_column[i]``, its theta behind it."""
    total = np.zeros((n_columns, n_columns))
    for i in range(len(by_view)):
        k = n_theta[i] + n_shape
        local = np.zeros((19 + k, 19 + k))
        transport_view(by_view[i, : 7 + k, : 7 + k], ref_T_body, body_T_board, True, local)
        column = np.empty(19 + k, dtype=np.int64)
        for j in range(6):
            column[j], column[6 + j], column[12 + j] = first_column[i] + j, j, 6 + j
        for j in range(n_theta[i]):
            column[18 + j] = first_column[i] + 6 + j
        for j in range(n_shape + 1):
            column[18 + n_theta[i] + j] = n_columns - 1 - n_shape + j
        for a in range(19 + k):
            for b in range(a, 19 + k):
                p, q = column[a], column[b]
                if p > q:
                    p, q = q, p
                total[p, q] += local[a, b]
    return triangular_factor(total)


@kernel
def add_views(
    by_view: FloatArray,
    row: IntArray,
    ref_T_body: FloatArray,
    body_T_board: FloatArray,
    first_pose_column: int,
    first_theta_column: int,
    n_shape: int,
    total: FloatArray,
) -> None:
    """Add the moments (V, d, d) of a camera's views to those of their frames, both triangles."""
    n_theta, last = by_view.shape[1] - 7 - n_shape, total.shape[1] - 1
    column = np.empty(19 + n_theta + n_shape, dtype=np.int64)
    for j in range(6):
        column[j], column[6 + j], column[12 + j] = first_pose_column + j, j, 6 + j
    for j in range(n_theta):
        column[18 + j] = first_theta_column + j
    for j in range(n_shape + 1):
        column[18 + n_theta + j] = last - n_shape + j
    local = np.empty((len(column), len(column)))
    for v in range(len(by_view)):
        local[:] = 0.0
        transport_view(by_view[v], ref_T_body[v], body_T_board, True, local)
        into = total[row[v]]
        for a in range(len(local)):
            into[column[a], column[a]] += local[a, a]
            for b in range(a + 1, len(local)):
                into[column[a], column[b]] += local[a, b]
                into[column[b], column[a]] += local[a, b]


@dataclass
class _Sums:
    """The moments of all views, and the loss of each frame, at one set of values."""

    poses: dict[int, gtsam.Pose3] = field(default_factory=dict)
    vectors: dict[int, FloatArray] = field(default_factory=dict)
    ref_T_body: FloatArray = field(default_factory=lambda: np.zeros((0, 4, 4)))
    body_T_board: FloatArray = field(default_factory=lambda: np.eye(4))
    by_view: list[FloatArray] = field(default_factory=list)
    loss: FloatArray = field(default_factory=lambda: np.zeros(0))

    def are_at(self, values: gtsam.Values, keys: Sequence[int]) -> bool:
        """Whether they stand for these values of the keys, to the last bit."""
        for key in keys:
            if key in self.poses:
                if not values.atPose3(key).equals(self.poses[key], 0.0):
                    return False
            elif key not in self.vectors or not np.array_equal(values.atVector(key), self.vectors[key]):
                return False
        return True

    def of_views(self, views: list[tuple[int, int]]) -> FloatArray:
        """(v, d, d) moments of these views, those of smaller ones in the upper left."""
        found = [self.by_view[c][view] for c, view in views]
        size = max(len(moments) for moments in found)
        if all(len(moments) == size for moments in found):
            return np.stack(found)
        padded = np.zeros((len(found), size, size))
        for into, moments in zip(padded, found, strict=True):
            into[: len(moments), : len(moments)] = moments
        return padded


class FramesReprojection:
    """The frames of a recording and their factors, ``self.factors``; they share their sums.

    ref_T_body: (F,) keys of the Pose3 variables A_f. body_T_board: key of X. shape: (5,) of the board, as in
    ``factors.board_shape``, or the key of a vector variable.
    Keys of a factor in order: A_f, X, then for each camera that sees the frame Y_c and, where it is free, theta_c; then
    the shape, where it is free.

    Raises ValueError where a frame is seen by no camera or a frame number has no key."""

    def __init__(
        self,
        cameras: Sequence[CameraFrames],
        *,
        ref_T_body: Sequence[int],
        body_T_board: int,
        shape: int | FloatArray = FLAT,
        robust: AnyKernel = GAUSSIAN,
    ) -> None:
        self.cameras = tuple(cameras)
        self.ref_T_body = tuple(ref_T_body)
        self.body_T_board = body_T_board
        self.shape = shape
        self.robust = robust
        self._vectors = {key for key in (shape, *(camera.theta for camera in self.cameras)) if isinstance(key, int)}
        self._sums = _Sums()
        seen: list[list[tuple[int, int]]] = [[] for _ in self.ref_T_body]
        for c, camera in enumerate(self.cameras):
            if len(camera.frame) and not 0 <= camera.frame[0] <= camera.frame[-1] < len(seen):
                raise ValueError(f"frame numbers {camera.frame[0]} to {camera.frame[-1]} for {len(seen)} frames")
            for view, frame in enumerate(camera.frame):
                seen[frame].append((c, view))
        if not all(seen):
            raise ValueError(f"frame {seen.index([])} is seen by no camera")
        self.factors = [FrameReprojectionFactor(self, frame, views) for frame, views in enumerate(seen)]

    def sums_at(self, values: gtsam.Values, keys: Sequence[int]) -> _Sums:
        """The sums at ``values``, made anew unless they stand for the same ``keys``' values."""
        if not self._sums.are_at(values, keys):
            self._sums = self._summed(values)
        return self._sums

    def _summed(self, values: gtsam.Values) -> _Sums:
        """With the moments even where only the error is asked for: a step that lowers it is linearised next."""
        keys = (*self.ref_T_body, self.body_T_board, *(camera.camera_T_ref for camera in self.cameras))
        poses = {key: values.atPose3(key) for key in keys}
        vectors = {key: values.atVector(key) for key in self._vectors}
        ref_T_body = np.stack([poses[key].matrix() for key in self.ref_T_body])
        body_T_board = pose_at(values, self.body_T_board)
        shape = vectors[self.shape] if isinstance(self.shape, int) else self.shape
        by_view, loss = [], np.zeros(len(self.ref_T_body))
        for camera in self.cameras:
            found = view_moments(
                camera.views,
                chain(pose_at(values, camera.camera_T_ref), ref_T_body[camera.frame], body_T_board),
                camera.model,
                vectors[camera.theta] if isinstance(camera.theta, int) else camera.theta,
                shape,
                robust=self.robust,
                with_theta=camera.n_theta > 0,
                with_shape=isinstance(self.shape, int),
            )
            by_view.append(found.moments)
            loss += np.bincount(camera.frame, found.loss, minlength=len(loss))
        return _Sums(poses, vectors, ref_T_body, body_T_board, by_view, loss)


class _FrameResidual:
    """The callback of one frame's factor. views: (camera, its view) of each view of the frame."""

    def __init__(self, frames: FramesReprojection, frame: int, views: list[tuple[int, int]]) -> None:
        cameras = [frames.cameras[c] for c, _ in views]
        sizes = np.array([6 + camera.n_theta for camera in cameras])
        self._frames, self._frame, self._views = frames, frame, views
        self._first_column = 12 + np.cumsum(sizes) - sizes
        self._n_theta = sizes - 6
        self._n_shape = N_SHAPE if isinstance(frames.shape, int) else 0
        self._n_columns = int(13 + sizes.sum()) + self._n_shape
        self.keys = [frames.ref_T_body[frame], frames.body_T_board]
        for camera in cameras:
            self.keys += [camera.camera_T_ref, *([camera.theta] if isinstance(camera.theta, int) else [])]
        blocks = [6, 6, *(size for n in self._n_theta for size in ((6, int(n)) if n else (6,)))]
        if isinstance(frames.shape, int):
            self.keys.append(frames.shape)
            blocks.append(self._n_shape)
        edges = np.concatenate([[0], np.cumsum(blocks)])
        self._blocks = list(itertools.pairwise(edges.tolist()))

    def __call__(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
        sums = self._frames.sums_at(values, self.keys)
        if jacobians is None:
            return np.array([math.sqrt(2.0 * sums.loss[self._frame])])
        triangle = _frame_triangle(
            sums.of_views(self._views),
            sums.ref_T_body[self._frame],
            sums.body_T_board,
            self._first_column,
            self._n_theta,
            self._n_shape,
            self._n_columns,
        )
        for i, (start, end) in enumerate(self._blocks):
            jacobians[i] = np.asfortranarray(triangle[:, start:end])
        return triangle[:, -1]


class FrameReprojectionFactor(gtsam.CustomFactor):
    """All the corners of one frame; made by ``FramesReprojection``, which tells the keys. The Jacobian handed to GTSAM
    is the triangular factor of the corners' whitened [J r]; a value-only call returns one entry, the root of twice the
    summed loss."""

    def __init__(self, frames: FramesReprojection, frame: int, views: list[tuple[int, int]]) -> None:
        residual = _FrameResidual(frames, frame, views)
        super().__init__(None, residual.keys, residual)  # type: ignore[call-overload]
