"""A rough lens for a camera without intrinsics, from one view of a plane: good enough to predict where the next
corners are, and for nothing else."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from factors import KANNALA_BRANDT4
from gtcal.camera import Camera, FloatArray

# Radius over the image's width = f (a + k a^3) at the angle a from the axis: fields of 230 to 57 degrees across, from
# nearly orthographic (k = -1/6) to nearly stereographic (1/12).
_FOCAL_WIDTHS = (0.25, 0.3, 0.36, 0.43, 0.52, 0.65, 1.0)
_CUBIC_TERMS = (-0.12, -0.05, 0.0, 0.05)
_NEWTON_STEPS = 8
_WIDEST_RAD = 1.6


def guess_lens(image_shape: tuple[int, int], board_m: FloatArray, seen_px: FloatArray) -> Camera | None:
    """The fisheye lens about the image's centre under which points (N, 2) of a plane and their pixels (N, 2) are
    closest to a homography, of a few usual ones; None where they are closest as they stand (a pinhole)."""
    height, width = image_shape
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    f, k = _lenses()
    offset_px = seen_px - centre
    fisheye = _bearings(offset_px / width, f, k)
    pinhole = np.column_stack([offset_px / width, np.ones(len(seen_px))])[None]
    rays = _homographies_applied(board_m, np.concatenate([fisheye, pinhole]))
    predicted = np.concatenate([_project(rays[:-1], f, k), rays[-1:, :, :2] / rays[-1:, :, 2:]])
    misfit = np.median(np.linalg.norm(width * predicted - offset_px, axis=2), axis=1)
    best = int(np.argmin(np.where(np.isfinite(misfit), misfit, np.inf)))
    if best == len(f):
        return None
    theta = np.array([f[best] * width, f[best] * width, *centre, k[best], 0, 0, 0])
    return Camera("guess", KANNALA_BRANDT4, theta, width, height)


@lru_cache(maxsize=1)
def _lenses() -> tuple[FloatArray, FloatArray]:
    """(L,) focal lengths and cubic terms of all lenses to try."""
    f, k = np.meshgrid(_FOCAL_WIDTHS, _CUBIC_TERMS)
    return f.ravel(), k.ravel()


def _bearings(offsets: FloatArray, f: FloatArray, k: FloatArray) -> FloatArray:
    """(L, N, 3) unit bearings of offsets (N, 2) from the centre, over the image's width, under each lens; NaN beyond
    the lens's field."""
    radius = np.linalg.norm(offsets, axis=1)
    wanted, cubic = radius / f[:, None], k[:, None]
    angle = wanted.copy()
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            angle -= (angle + cubic * angle**3 - wanted) / (1 + 3 * cubic * angle**2)
        lost = (np.abs(angle + cubic * angle**3 - wanted) > 1e-6) | (angle > _WIDEST_RAD) | (angle < 0)
    angle = np.where(lost, np.nan, angle)
    direction = offsets / np.maximum(radius, 1e-12)[:, None]
    return np.concatenate([np.sin(angle)[..., None] * direction, np.cos(angle)[..., None]], axis=2)


def _project(rays: FloatArray, f: FloatArray, k: FloatArray) -> FloatArray:
    """(L, N, 2) the offsets from the centre, over the image's width, of rays (L, N, 3)."""
    across = np.linalg.norm(rays[..., :2], axis=2)
    angle = np.arctan2(across, rays[..., 2])
    radius = f[:, None] * (angle + k[:, None] * angle**3)
    return rays[..., :2] * (radius / np.maximum(across, 1e-300))[..., None]


def _homographies_applied(board_m: FloatArray, bearings: FloatArray) -> FloatArray:
    """(L, N, 3) the rays that the homography closest to bearings (L, N, 3) gives the board points (N, 2)."""
    middle = board_m.mean(axis=0)
    scaled = (board_m - middle) / np.abs(board_m - middle).max()
    points = np.column_stack([scaled, np.ones(len(scaled))])
    x, y, z = (bearings[:, :, i, None] * points for i in range(3))
    none = np.zeros_like(x)
    # The cross product of the bearing and H times the point, its three rows linear in H's nine entries.
    rows = np.stack(
        [np.concatenate(r, axis=2) for r in ((none, -z, y), (z, none, -x), (-y, x, none))],
        axis=2,
    )
    rows = np.nan_to_num(rows).reshape(len(bearings), -1, 9)
    normal = rows.transpose(0, 2, 1) @ rows
    h = np.linalg.eigh(normal)[1][:, :, 0].reshape(-1, 3, 3)
    rays = np.einsum("lij,nj->lni", h, points)
    facing = np.sign(np.nansum(rays * bearings, axis=(1, 2)))
    return rays * facing[:, None, None] + 0 * bearings
