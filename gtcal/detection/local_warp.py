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
    for m in range(len(centres_m)):
        for k in range(len(board_m)):
            distance[k] = math.hypot(board_m[k, 0] - centres_m[m, 0], board_m[k, 1] - centres_m[m, 1])
        if left_out[m] >= 0:
            distance[left_out[m]] = np.inf
        near = np.argsort(distance)[:_NEIGHBOURS]
        _fit_one(board_m, plane, centres_m[m], spread_m, near, distance, terms[m])


@kernel
def _fit_one(board_m, plane, centre_m, spread_m, near, distance, terms):  # type: ignore[no-untyped-def]
    """Weighted linear least squares in  t + A b - x (g . b) = x,  with x centred and scaled to the neighbours."""
    first = distance[near[0]]
    origin_x, origin_y = plane[near[0], 0], plane[near[0], 1]
    size = 1e-300
    for k in near:
        if math.isfinite(distance[k]):
            size = max(size, math.hypot(plane[k, 0] - origin_x, plane[k, 1] - origin_y))
    normal, right, row = np.zeros((8, 8)), np.zeros(8), np.zeros(8)
    n = 0
    for k in near:
        if not math.isfinite(distance[k]):
            continue
        n += 1
        weight = math.exp(-0.5 * (distance[k] / (spread_m + first)) ** 2)
        bx, by = (board_m[k, 0] - centre_m[0]) / spread_m, (board_m[k, 1] - centre_m[1]) / spread_m
        x, y = (plane[k, 0] - origin_x) / size, (plane[k, 1] - origin_y) / size
        row[:] = (1.0, 0.0, bx, by, 0.0, 0.0, -x * bx, -x * by)
        _add(row, x, weight, normal, right)
        row[:] = (0.0, 1.0, 0.0, 0.0, bx, by, -y * bx, -y * by)
        _add(row, y, weight, normal, right)
    if n < _FEWEST or not _spans_a_plane(normal):
        return
    for i in range(8):
        normal[i, i] += 1e-9
    normal[6, 6] += _RIDGE
    normal[7, 7] += _RIDGE
    found = np.linalg.solve(normal, right)
    # Back from centred coordinates: x -> origin + size x leaves g as it is.
    terms[0], terms[1] = origin_x + size * found[0], origin_y + size * found[1]
    terms[2], terms[3] = origin_x * found[6] + size * found[2], origin_x * found[7] + size * found[3]
    terms[4], terms[5] = origin_y * found[6] + size * found[4], origin_y * found[7] + size * found[5]
    terms[6], terms[7] = found[6], found[7]


@kernel
def _spans_a_plane(normal):  # type: ignore[no-untyped-def]
    """Whether the neighbours, whose weighted moments the normal matrix holds, don't all lie near one line."""
    weight, x, y = normal[0, 0], normal[0, 2], normal[0, 3]
    xx, xy, yy = normal[2, 2] - x * x / weight, normal[2, 3] - x * y / weight, normal[3, 3] - y * y / weight
    trace, area = (xx + yy) / weight, (xx * yy - xy * xy) / weight**2
    return area > _LEAST_SPREAD**2 * trace


@kernel
def _add(row, value, weight, normal, right):  # type: ignore[no-untyped-def]
    for i in range(8):
        if row[i] != 0.0:
            right[i] += weight * row[i] * value
            for j in range(8):
                normal[i, j] += weight * row[i] * row[j]
