"""The board's image near a point: a homography fitted to the known points around it.

A lens bends the whole board's image, but hardly the part of it next to a few known corners. So a place on the board
is predicted from its neighbours alone, and no camera model is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from factors.kernel import kernel
from gtcal.camera import FloatArray
from gtcal.detection.cholesky import solve_in_place
from gtcal.recordings.detections import IntArray

# The nearest known points that take part, and how many of them a homography needs at least.
_NEIGHBOURS, _FEWEST = 24, 4
# Pulls the perspective terms towards none. Far below what four points a tag apart say, it only steadies the
# extrapolation from one small tag.
_RIDGE = 3e-3
# Neighbours closer than this to one line, rms and in units of the spread, say nothing across it.
_LEAST_SPREAD = 0.1


@dataclass(frozen=True)
class LocalWarps:
    """M homographies from the board to a plane: ((t + A b) / (1 + g . b)), with b = (board point - centre) / spread.

    centres_m: (M, 2). spread_m: one length. terms: (M, 8) tx ty Axx Axy Ayx Ayy gx gy; NaN where there were too few
    known points, or all on a line.
    """

    centres_m: FloatArray
    spread_m: float
    terms: FloatArray

    def at_centres(self) -> tuple[FloatArray, FloatArray]:
        """(M, 2) the image in the plane of each centre, and (M, 2, 2) its derivative to the board point in metres."""
        t, a, g = self.terms[:, :2], self.terms[:, 2:6].reshape(-1, 2, 2), self.terms[:, 6:]
        return t, (a - t[:, :, None] * g[:, None, :]) / self.spread_m

    def apply(self, points_m: FloatArray) -> FloatArray:
        """(M, K, 2) the images of points (M, K, 2), each row by its own warp."""
        b = (points_m - self.centres_m[:, None]) / self.spread_m
        t, a, g = self.terms[:, :2], self.terms[:, 2:6].reshape(-1, 2, 2), self.terms[:, 6:]
        scale = 1.0 + np.einsum("mki,mi->mk", b, g)
        return (t[:, None] + np.einsum("mij,mkj->mki", a, b)) / scale[:, :, None]


def fit_local_warps(
    board_m: FloatArray,
    plane: FloatArray,
    centres_m: FloatArray,
    *,
    spread_m: float,
    leave_out: IntArray | None = None,
) -> LocalWarps:
    """Fit a homography around each centre, the nearer a known point the more it counts.

    board_m, plane: (K, 2) the known points on the board and in the plane. centres_m: (M, 2). spread_m: the distance
    on the board within which points count. leave_out: (M,) a known point that a centre must not use, or -1.
    """
    terms = np.full((len(centres_m), 8), np.nan)
    left_out = np.full(len(centres_m), -1) if leave_out is None else leave_out
    if len(board_m) >= _FEWEST:
        _fit_all(np.ascontiguousarray(board_m), np.ascontiguousarray(plane), centres_m, spread_m, left_out, terms)
    return LocalWarps(centres_m, spread_m, terms)


@kernel
def _fit_all(board_m, plane, centres_m, spread_m, left_out, terms):  # type: ignore[no-untyped-def]
    distance = np.empty(len(board_m))
    normal, right, sums = np.empty((8, 8)), np.empty(8), np.empty((4, 6))
    for m in range(len(centres_m)):
        for k in range(len(board_m)):
            distance[k] = math.hypot(board_m[k, 0] - centres_m[m, 0], board_m[k, 1] - centres_m[m, 1])
        if left_out[m] >= 0:
            distance[left_out[m]] = np.inf
        near = _nearest(distance)
        _fit_one(board_m, plane, centres_m[m], spread_m, near, distance, sums, normal, right, terms[m])


@kernel
def _nearest(distance):  # type: ignore[no-untyped-def]
    """The nearest points, the very nearest of them first; all that are as far as the last."""
    n = len(distance)
    last = np.partition(distance, _NEIGHBOURS - 1)[_NEIGHBOURS - 1] if n > _NEIGHBOURS else np.inf
    near = np.flatnonzero((distance <= last) & np.isfinite(distance))
    for i in range(1, len(near)):
        if distance[near[i]] < distance[near[0]]:
            near[0], near[i] = near[i], near[0]
    return near


@kernel
def _fit_one(  # type: ignore[no-untyped-def]
    board_m, plane, centre_m, spread_m, near, distance, sums, normal, right, terms
):
    """Weighted linear least squares in  t + A b - x (g . b) = x,  with x centred and scaled to the neighbours."""
    if len(near) < _FEWEST:
        return
    origin_x, origin_y = plane[near[0], 0], plane[near[0], 1]
    size = 1e-300
    for k in near:
        size = max(size, math.hypot(plane[k, 0] - origin_x, plane[k, 1] - origin_y))
    sums[:] = 0.0
    for k in near:
        weight = math.exp(-0.5 * (distance[k] / (spread_m + distance[near[0]])) ** 2)
        bx, by = (board_m[k, 0] - centre_m[0]) / spread_m, (board_m[k, 1] - centre_m[1]) / spread_m
        x, y = (plane[k, 0] - origin_x) / size, (plane[k, 1] - origin_y) / size
        _add(sums[0], weight, bx, by)
        _add(sums[1], weight * x, bx, by)
        _add(sums[2], weight * y, bx, by)
        _add(sums[3], weight * (x * x + y * y), bx, by)
    _fill(sums, normal, right)
    if not _spans_a_plane(normal):
        return
    for i in range(8):
        normal[i, i] += 1e-9
    normal[6, 6] += _RIDGE
    normal[7, 7] += _RIDGE
    if not solve_in_place(normal, right):
        return
    # Back from centred coordinates: x -> origin + size x leaves g as it is.
    terms[0], terms[1] = origin_x + size * right[0], origin_y + size * right[1]
    terms[2], terms[3] = origin_x * right[6] + size * right[2], origin_x * right[7] + size * right[3]
    terms[4], terms[5] = origin_y * right[6] + size * right[4], origin_y * right[7] + size * right[5]
    terms[6], terms[7] = right[6], right[7]


@kernel
def _add(sums, weight, bx, by):  # type: ignore[no-untyped-def]
    """A neighbour to the sums of 1, bx, by, bx^2, bx by and by^2."""
    sums[0] += weight
    sums[1] += weight * bx
    sums[2] += weight * by
    sums[3] += weight * bx * bx
    sums[4] += weight * bx * by
    sums[5] += weight * by * by


@kernel
def _fill(sums, normal, right):  # type: ignore[no-untyped-def]
    """The normal equations from the sums weighted by 1, x, y and x^2 + y^2."""
    normal[:] = 0.0
    for axis, t, a in ((0, 0, 2), (1, 1, 4)):
        plain, by_x = sums[0], sums[1 + axis]
        normal[t, t] = plain[0]
        right[t] = by_x[0]
        for i in range(2):
            normal[t, a + i] = normal[a + i, t] = plain[1 + i]
            normal[t, 6 + i] = normal[6 + i, t] = -by_x[1 + i]
            right[a + i] = by_x[1 + i]
            for j in range(2):
                normal[a + i, a + j] = plain[3 + i + j]
                normal[a + i, 6 + j] = normal[6 + j, a + i] = -by_x[3 + i + j]
    for i in range(2):
        right[6 + i] = -sums[3, 1 + i]
        for j in range(2):
            normal[6 + i, 6 + j] = sums[3, 3 + i + j]


@kernel
def _spans_a_plane(normal):  # type: ignore[no-untyped-def]
    """Whether the neighbours, whose weighted moments the normal matrix holds, don't all lie near one line."""
    weight, x, y = normal[0, 0], normal[0, 2], normal[0, 3]
    xx, xy, yy = normal[2, 2] - x * x / weight, normal[2, 3] - x * y / weight, normal[3, 3] - y * y / weight
    trace, area = (xx + yy) / weight, (xx * yy - xy * xy) / weight**2
    return area > _LEAST_SPREAD**2 * trace
