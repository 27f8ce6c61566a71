"""Sub-pixel corners: the blurred crossing of two edges, fitted to the grey values around it.

Two edges cross at the corner. Each is a step smoothed by a Gaussian, S(d) = erf(d / (sqrt(2) sigma))
of the distance d from it in pixels, and the grey value is

    saddle (black across from black):  p0 + p3 S T
    any other corner:                  p0 + p1 S + p2 T + p3 S T

with the corner, the two directions, the two blurs and the levels p free. Where the lens bends the edges, they are
parabolas of the curvature that the prediction gives them: taken as straight, corners far from the image's centre come
out several hundredths of a pixel too near to it. On rendered views this is three to ten times closer to the truth than
gradient methods (cornerSubPix), and unbiased also where a corner is no saddle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from factors.kernel import kernel, reordered
from gtcal.camera import BoolArray, FloatArray
from gtcal.detection.cholesky import solve_in_place
from gtcal.detection.sight import BoardImage
from gtcal.recordings.images import GreyImage

# Parameters of one corner: x, y, the normals' angles, the logarithms of the blurs, p0, p3, p1, p2; then, never free,
# the edges' curvatures in 1/px towards their normals. A saddle frees the first eight: with p1 and p2 free it follows
# the light across the window instead of the corner.
_N_SADDLE, _N_ALL = 8, 10
N_PARAMETERS = _N_ALL + 2
_N_FOUND = 6 + N_PARAMETERS
_ROUNDS, _STEPS = 3, 12
# How far the corner may end from the middle of its window: at first, and at last.
_ABOUT_THERE_PX, _THERE_PX = 0.3, 0.02
# The last step is so short and promises so little, as a part of the squared residuals, that it needn't be looked at.
_SETTLED_PX, _SETTLED_GAIN = 2e-3, 0.01
# A fit that leaves residuals as large as the step itself has found nothing.
_HOPELESS = 1.0
# A window narrower than this has too few pixels for the fit, one wider gains nothing and feels the lens.
_MIN_RADIUS_PX, MAX_RADIUS_PX = 2.0, 10.0
_MAX_PIXELS = (2 * int(MAX_RADIUS_PX) + 3) ** 2
_START_BLUR_PX = 0.8
_MIN_LOG_BLUR, _MAX_LOG_BLUR = math.log(0.25), math.log(6.0)
# The smoothed step and its slope are looked up, so close that reading on a straight line is off by 2e-6.
_TABLE_END, _PER_UNIT = 6.0, 256


def _step_table() -> FloatArray:
    """(N, 2) erf(u / sqrt(2)) and its slope."""
    u = np.arange(2 * _TABLE_END * _PER_UNIT + 2) / _PER_UNIT - _TABLE_END  # one more, for reading between
    steps = [math.erf(math.sqrt(0.5) * x) for x in u.tolist()]
    return np.column_stack([steps, math.sqrt(2.0 / math.pi) * np.exp(-0.5 * u**2)])


_STEP_TABLE = _step_table()


@dataclass(frozen=True)
class RefinedCorners:
    """What the fit found at each of N corners.

    corners_px: (N, 2) the crossing of the two edges; NaN where the fit failed.
    step: (N,) half the grey-level step between black and white along a saddle's edges: negative where the
        print is black towards (+x +y), positive where it is white.
    misfit: (N,) rms of the residuals over |step|; NaN where the fit failed.
    blur_px: (N,) the larger of the two edges' Gaussian blurs.
    turned_rad: (N,) the larger of the angles by which the two edges turned away from the predicted ones.
    parameters: (N, 12) of the fits, to go on from.
    """

    corners_px: FloatArray
    step: FloatArray
    misfit: FloatArray
    blur_px: FloatArray
    turned_rad: FloatArray
    parameters: FloatArray


def refine_corners(
    image: GreyImage,
    guess: BoardImage,
    *,
    saddle: BoolArray,
    clear_band_m: float,
    clear_reach_m: float,
    going_on_from: FloatArray | None = None,
) -> RefinedCorners:
    """Fit the corners of a board near predicted places.

    image: uint8 (H, W). guess: the N predicted places. saddle: (N,) whether black lies across from black.
    clear_band_m, clear_reach_m: how far the print around a corner is as assumed (see ``Board``): the window is
        that part of the print.
    going_on_from: (N, 12) parameters of earlier fits, of which only the print's scale and the lens's bend are taken
        from the guess. The window then ends where the corner does; without, only about there.
    """
    found = np.full((len(guess.pixels_px), _N_FOUND), np.nan)
    _refine_all(
        image,
        np.ascontiguousarray(guess.pixels_px, dtype=np.float64),
        np.ascontiguousarray(guess.px_per_m, dtype=np.float64),
        np.ascontiguousarray(guess.px_per_m2, dtype=np.float64),
        np.ascontiguousarray(saddle),
        clear_band_m,
        clear_reach_m,
        np.empty((0, N_PARAMETERS)) if going_on_from is None else going_on_from,
        found,
    )
    return RefinedCorners(found[:, :2], found[:, 2], found[:, 3], found[:, 4], found[:, 5], found[:, 6:])


@kernel
def _refine_all(  # type: ignore[no-untyped-def]
    image, guess_px, px_per_m, px_per_m2, saddle, band_m, reach_m, going_on_from, found
):
    window, rows = np.empty((3, _MAX_PIXELS)), np.empty((_N_ALL + 1, _MAX_PIXELS))
    q, m_per_px = np.empty(N_PARAMETERS), np.empty(2)
    for i in range(len(guess_px)):
        n_free = _N_SADDLE if saddle[i] else _N_ALL
        if not _start(guess_px[i], px_per_m[i], px_per_m2[i], q, m_per_px):
            continue
        angle_x, angle_y = q[2], q[3]
        moved_px = _ABOUT_THERE_PX
        if len(going_on_from):
            q[:_N_ALL] = going_on_from[i, :_N_ALL]
            moved_px = _THERE_PX
        misfit = _fit_in_moving_window(image, m_per_px, band_m, reach_m, n_free, moved_px, window, rows, q)
        if math.isnan(misfit):
            continue
        found[i, 0], found[i, 1], found[i, 2] = q[0], q[1], q[7]
        found[i, 3] = misfit / max(abs(q[7]), 1e-9)
        found[i, 4] = math.exp(max(q[4], q[5]))
        found[i, 5] = max(_apart(q[2], angle_x), _apart(q[3], angle_y))
        found[i, 6:] = q


@kernel
def _apart(angle, other):  # type: ignore[no-untyped-def]
    return abs(math.atan2(math.sin(angle - other), math.cos(angle - other)))


@kernel
def _start(guess_px, px_per_m, px_per_m2, q, m_per_px):  # type: ignore[no-untyped-def]
    """The parameters before the fit: the place and the directions as predicted, levels still unknown; and how many
    metres of print a pixel's distance from either edge is."""
    a, b, c, d = px_per_m[0, 0], px_per_m[0, 1], px_per_m[1, 0], px_per_m[1, 1]
    area = a * d - b * c
    if not abs(area) > 1e-12:
        return False
    q[0], q[1] = guess_px[0], guess_px[1]
    # The normals of the board lines x = const and y = const are the rows of the inverse.
    q[2], q[3] = math.atan2(-b / area, d / area), math.atan2(a / area, -c / area)
    m_per_px[0], m_per_px[1] = math.hypot(b, d) / abs(area), math.hypot(a, c) / abs(area)
    q[4] = q[5] = math.log(_START_BLUR_PX)
    q[6:] = 0.0
    # The line x = const runs along y, and the other way round: its curvature is how far the second derivative along
    # it leaves its direction, per square of the first.
    q[10] = (math.cos(q[2]) * px_per_m2[0, 1] + math.sin(q[2]) * px_per_m2[1, 1]) / (b * b + d * d)
    q[11] = (math.cos(q[3]) * px_per_m2[0, 0] + math.sin(q[3]) * px_per_m2[1, 0]) / (a * a + c * c)
    return True


@kernel
def _fit_in_moving_window(image, m_per_px, band_m, reach_m, n_free, moved_px, window, rows, q):  # type: ignore[no-untyped-def]
    """Fit, lay the window where the corner and its edges were found, and fit again. Returns the rms residual, NaN on
    failure."""
    misfit = np.nan
    for _ in range(_ROUNDS):
        x, y = q[0], q[1]
        n = _collect(image, q, m_per_px, band_m, reach_m, window)
        if n < 2 * n_free:
            return np.nan
        if math.isnan(misfit) and q[7] == 0.0:
            q[6] = window[2, :n].mean()
        misfit = _fit(window, n, n_free, rows, q)
        if not misfit < _HOPELESS * abs(q[7]) or not math.hypot(q[0] - x, q[1] - y) < MAX_RADIUS_PX:
            return np.nan
        if math.hypot(q[0] - x, q[1] - y) < moved_px:
            break
    return misfit


@kernel
def _collect(image, q, m_per_px, band_m, reach_m, window):  # type: ignore[no-untyped-def]
    """Write (x, y, grey) of the pixels on the uniform quadrants and the edges between them."""
    # Keep clear of the neighbouring edges by as much as they are blurred.
    keep_off_px = min(max(1.4 * math.exp(max(q[4], q[5])), 0.7), 1.5)
    band_x, band_y = _radius(band_m / m_per_px[0], keep_off_px), _radius(band_m / m_per_px[1], keep_off_px)
    reach_x, reach_y = _radius(reach_m / m_per_px[0], keep_off_px), _radius(reach_m / m_per_px[1], keep_off_px)
    cos_x, sin_x, cos_y, sin_y = math.cos(q[2]), math.sin(q[2]), math.cos(q[3]), math.sin(q[3])
    height, width = image.shape
    r = MAX_RADIUS_PX
    n = 0
    for y in range(max(math.ceil(q[1] - r), 0), min(math.floor(q[1] + r), height - 1) + 1):
        for x in range(max(math.ceil(q[0] - r), 0), min(math.floor(q[0] + r), width - 1) + 1):
            dx, dy = x - q[0], y - q[1]
            u, v = abs(cos_x * dx + sin_x * dy), abs(cos_y * dx + sin_y * dy)
            inside = u <= reach_x and v <= reach_y and (u <= band_x or v <= band_y)
            if inside and dx * dx + dy * dy <= r * r:
                window[0, n], window[1, n], window[2, n] = x, y, image[y, x]
                n += 1
    return n


@kernel
def _radius(clear_px, keep_off_px):  # type: ignore[no-untyped-def]
    return max(clear_px - keep_off_px, _MIN_RADIUS_PX)


@kernel
def _fit(window, n, n_free, rows, q):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt on the first ``n_free`` parameters in place. Returns the rms residual, or NaN."""
    hessian, gradient = np.empty((n_free, n_free)), np.empty(n_free)
    new_hessian, new_gradient = np.empty((n_free, n_free)), np.empty(n_free)
    damped, step, trial = np.empty((n_free, n_free)), np.empty(n_free), q.copy()
    damping = 1e-3
    cost = _normal_equations(window, n, n_free, q, rows, hessian, gradient)
    for _ in range(_STEPS):
        damped[:] = hessian
        step[:] = gradient
        for i in range(n_free):
            damped[i, i] = hessian[i, i] * (1.0 + damping) + 1e-9
        new_cost = np.inf
        if solve_in_place(damped, step):
            trial[:n_free] = q[:n_free] + step
            trial[4] = min(max(trial[4], _MIN_LOG_BLUR), _MAX_LOG_BLUR)
            trial[5] = min(max(trial[5], _MIN_LOG_BLUR), _MAX_LOG_BLUR)
            gain = 0.0
            for i in range(n_free):
                gain += gradient[i] * step[i]
            if math.hypot(step[0], step[1]) < _SETTLED_PX and gain < _SETTLED_GAIN * cost:
                q[:] = trial
                break
            new_cost = _normal_equations(window, n, n_free, trial, rows, new_hessian, new_gradient)
        if not new_cost <= cost:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        q[:] = trial
        hessian[:] = new_hessian
        gradient[:] = new_gradient
        cost = new_cost
        damping = max(0.1 * damping, 1e-7)
    return math.sqrt(cost / n)


@kernel
def _normal_equations(window, n, n_free, q, rows, hessian, gradient):  # type: ignore[no-untyped-def]
    _fill_rows(window, n, q, rows)
    for i in range(n_free):
        gradient[i] = _dot(rows, i, _N_ALL, n)
        for j in range(i + 1):
            hessian[i, j] = _dot(rows, i, j, n)
    return _dot(rows, _N_ALL, _N_ALL, n)


@reordered
def _dot(rows, i, j, n):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(n):
        total += rows[i, k] * rows[j, k]
    return total


@kernel
def _fill_rows(window, n, q, rows):  # type: ignore[no-untyped-def]
    """Write the model's derivatives by its parameters at each pixel (x, y, grey), and below them what is left of the
    grey value. In three passes, of which the processor's vectors do the first and the last."""
    cos_x, sin_x, per_x = math.cos(q[2]), math.sin(q[2]), math.exp(-q[4])
    cos_y, sin_y, per_y = math.cos(q[3]), math.sin(q[3]), math.exp(-q[5])
    x0, y0, p0, p3, p1, p2, bent_x, bent_y = q[0], q[1], q[6], q[7], q[8], q[9], q[10], q[11]
    for k in range(n):
        dx, dy = window[0, k] - x0, window[1, k] - y0
        along_x, along_y = cos_x * dy - sin_x * dx, cos_y * dy - sin_y * dx
        across_x, across_y = cos_x * dx + sin_x * dy, cos_y * dx + sin_y * dy
        rows[4, k] = per_x * (across_x - 0.5 * bent_x * along_x * along_x)
        rows[5, k] = per_y * (across_y - 0.5 * bent_y * along_y * along_y)
    for k in range(n):
        rows[8, k], rows[6, k] = _smooth_step(rows[4, k])
        rows[9, k], rows[7, k] = _smooth_step(rows[5, k])
    for k in range(n):
        dx, dy = window[0, k] - x0, window[1, k] - y0
        along_x, along_y = cos_x * dy - sin_x * dx, cos_y * dy - sin_y * dx
        across_x, across_y = cos_x * dx + sin_x * dy, cos_y * dx + sin_y * dy
        bend_x, bend_y = bent_x * along_x, bent_y * along_y
        s, t = rows[8, k], rows[9, k]
        by_u, by_v = per_x * (p1 + p3 * t) * rows[6, k], per_y * (p2 + p3 * s) * rows[7, k]
        rows[0, k] = -by_u * (cos_x + bend_x * sin_x) - by_v * (cos_y + bend_y * sin_y)
        rows[1, k] = -by_u * (sin_x - bend_x * cos_x) - by_v * (sin_y - bend_y * cos_y)
        rows[2, k] = by_u * along_x * (1.0 + bent_x * across_x)
        rows[3, k] = by_v * along_y * (1.0 + bent_y * across_y)
        rows[4, k] *= -by_u / per_x
        rows[5, k] *= -by_v / per_y
        rows[6, k] = 1.0
        rows[7, k] = s * t
        rows[10, k] = window[2, k] - (p0 + p3 * s * t + p1 * s + p2 * t)


@kernel
def _smooth_step(u):  # type: ignore[no-untyped-def]
    """erf(u / sqrt(2)) and its slope."""
    at = (min(max(u, -_TABLE_END), _TABLE_END) + _TABLE_END) * _PER_UNIT
    i = int(at)
    part = at - i
    s, slope = _STEP_TABLE[i, 0], _STEP_TABLE[i, 1]
    return s + part * (_STEP_TABLE[i + 1, 0] - s), slope + part * (_STEP_TABLE[i + 1, 1] - slope)
