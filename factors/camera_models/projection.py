"""From the parts of a camera model to its kernels: projection with Jacobians, continuation past the field, and back.

A point has a pixel where the model is one-to-one: up to the end of its field, where the radial function
R = m s(m^2) stops being monotonic or its pixels run away (85 degrees off the axis of a perspective model), and where
the tangential part does not fold. Everything else is masked, never clipped or folded back.

An optimiser passes points that have no pixel on its way to an estimate under which they have one. For it alone the
radial function goes on past the end of the field, growing with the angle, its slope and its derivative by the
parameters without a step: ``project_point`` gives that continued pixel, and says that it is none. Where the distortion
bends (s is other than 1) the tangential part stays as at the field's end.

The functions below are templates: ``kernels_of`` binds the global names ``perspective``, ``bends``, ``spread``, ... to
a model's, so that each model has machine code of its own. ``t`` is how far off the axis a point is: hypot(x, y) / z of
a perspective model, else the angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.camera_models.parts import PERSPECTIVE, UNBENT, FloatArray, Function, Parts
from factors.kernel import inlined_with, kernel_with, unbound

BoolArray = npt.NDArray[np.bool_]

FARTHEST_PERSPECTIVE_RAD = math.radians(85.0)
"""Off the axis, where the field of a perspective model ends at the latest: twice what rectilinear lenses see."""

_GROWTH_PER_RAD = 10.0  # of the continued radial function's slope, until that is an equidistant lens's
_SMALLEST_SLOPE = 1e-9  # of the radial function at the field's end: less, and it is there that it turns
_LEAST_TURN = 0.1  # of the slope's fall at the field's end, of that on the axis: less, and the end is hardly determined
_LIMIT_SAMPLES = 720  # a quarter of a degree: a polynomial of degree 12 does not turn twice within one
_DIFFERENCE = 1e-6  # step of the central differences at the field's end
_NEWTON_STEPS = 50
_UNDISTORT_TOLERANCE = 1e-14  # relative; next to a fold the last steps are rounding, the image is not

# What ``field_end`` gives, end[0]: the limit in t, its angle off the axis, R there, its slope by the angle (0 where
# that is what ends the field), and m there.
_LIMIT, _ANGLE, _VALUE, _SLOPE, _M = range(5)
# end[1:], by theta: R at that place; the limit's angle; the slope at the limit; m at the limit.
_VALUE_BY, _ANGLE_BY, _SLOPE_BY, _M_BY = range(1, 5)

# Names that ``kernels_of`` binds: a model's parts, and what is made of them below
perspective = bends = False
farthest_angle = math.pi
spread: Function = unbound
spread_by_theta: Function = unbound
spread_room: Function = unbound
radial: Function = unbound
radial_by_theta: Function = unbound
radial_room: Function = unbound
tangential: Function = unbound
tangential_by_theta: Function = unbound
radius: Function = unbound
room: Function = unbound
fill_by_theta: Function = unbound
field_end: Function = unbound
beyond: Function = unbound
beyond_by_theta: Function = unbound
distort: Function = unbound
project_beyond_a_bend: Function = unbound
project_point: Function = unbound
invert: Function = unbound
undistort: Function = unbound
unproject_point: Function = unbound


def _radius(theta: FloatArray, t: float) -> tuple[float, float]:
    """R, and dR/dt: positive where the model is one-to-one along a ray."""
    m, slope = spread(theta, t)
    scale, bend = radial(theta, m * m)
    return m * scale, slope * (scale + m * m * bend)


def _room(theta: FloatArray, t: float) -> float:
    """Positive within the field."""
    m, _ = spread(theta, t)
    return min(radius(theta, t)[1], spread_room(theta, t), radial_room(theta, m * m))


def _fill_by_theta(theta: FloatArray, end: FloatArray) -> None:
    """end[1:] at the limit."""
    limit, stretch = end[0, _LIMIT], 1.0  # d t / d angle
    if perspective:
        stretch += limit * limit
    m, m_slope = spread(theta, limit)
    scale, bend = radial(theta, m * m)
    along = np.zeros((2, end.shape[1]))
    spread_by_theta(theta, limit, along, scale + m * m * bend, 1.0)
    by_scale = np.zeros((2, end.shape[1]))
    radial_by_theta(theta, m * m, by_scale, m, 1.0)
    ends = end[0, _ANGLE] < farthest_angle
    fall = (room(theta, limit + _DIFFERENCE) - room(theta, limit - _DIFFERENCE)) / (2.0 * _DIFFERENCE)
    fall = min(fall, -_LEAST_TURN * radius(theta, 0.0)[1])
    bent = (radius(theta, limit + _DIFFERENCE)[1] - radius(theta, limit - _DIFFERENCE)[1]) / (2.0 * _DIFFERENCE)
    other = theta.copy()
    for i in range(4, len(theta)):
        other[i] = theta[i] + _DIFFERENCE
        above, slope_above = room(other, limit), radius(other, limit)[1]
        other[i] = theta[i] - _DIFFERENCE
        below, slope_below = room(other, limit), radius(other, limit)[1]
        other[i] = theta[i]
        moved = -(above - below) / (2.0 * _DIFFERENCE) / fall if ends else 0.0
        end[_VALUE_BY, i] = along[0, i] + by_scale[0, i]
        end[_ANGLE_BY, i] = moved / stretch
        end[_SLOPE_BY, i] = stretch * ((slope_above - slope_below) / (2.0 * _DIFFERENCE) + bent * moved)
        if perspective:
            end[_SLOPE_BY, i] += 2.0 * limit * moved * radius(theta, limit)[1]
        end[_M_BY, i] = along[1, i] + m_slope * moved


def _field_end(theta: FloatArray, with_theta: bool) -> FloatArray:
    """The end of the field; ``with_theta``, its derivatives too."""
    end = np.zeros((5, max(5, len(theta))))
    below, step = 0.0, farthest_angle / _LIMIT_SAMPLES
    for i in range(1, _LIMIT_SAMPLES + 1):
        above = math.tan(i * step) if perspective else i * step
        if not room(theta, above) > 0.0:
            for _ in range(60):
                middle = 0.5 * (below + above)
                if room(theta, middle) > 0.0:
                    below = middle
                else:
                    above = middle
            end[0, _ANGLE] = math.atan(below) if perspective else below
            break
        below = above
        end[0, _ANGLE] = farthest_angle
    value, slope = radius(theta, below)
    if perspective:
        slope *= 1.0 + below * below
    end[0, _LIMIT], end[0, _VALUE] = below, value
    end[0, _SLOPE] = slope if slope > _SMALLEST_SLOPE else 0.0
    end[0, _M] = spread(theta, below)[0]
    if with_theta:
        fill_by_theta(theta, end)
    return end


def _beyond(end: FloatArray, over: float) -> tuple[float, float]:
    """R continued by the angle ``over`` past the field's end, and its slope by the angle."""
    value, slope = end[0, _VALUE], end[0, _SLOPE]
    if slope > 0.0:
        return value + over * slope, slope
    slope = min(_GROWTH_PER_RAD * over, 1.0)
    return value + slope * (over - 0.5 * slope / _GROWTH_PER_RAD), slope


def _beyond_by_theta(end: FloatArray, over: float, slope: float, i: int) -> float:
    """Of ``beyond``, by theta[i]."""
    if end[0, _SLOPE] > 0.0:
        return end[_VALUE_BY, i] + over * end[_SLOPE_BY, i]
    return end[_VALUE_BY, i] - slope * end[_ANGLE_BY, i]


def _distort(theta: FloatArray, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    """u', v' and du'/du, du'/dv, dv'/du, dv'/dv."""
    scale, bend = radial(theta, u * u + v * v)
    tu, tv, uu, uv, vu, vv = tangential(theta, u, v)
    cross = u * v * bend
    return u * scale + tu, v * scale + tv, scale + u * u * bend + uu, cross + uv, cross + vu, scale + v * v * bend + vv


def _project_beyond_a_bend(
    theta: FloatArray,
    end: FloatArray,
    x: float,
    y: float,
    z: float,
    r: float,
    over: float,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
) -> tuple[float, float]:
    """The continued pixel of a model that bends."""
    squared_norm = r * r + z * z
    cos_azimuth, sin_azimuth = x / r, y / r
    value, slope = beyond(end, over)
    m = end[0, _M]
    ue, ve = m * cos_azimuth, m * sin_azimuth
    tu, tv, uu, uv, vu, vv = tangential(theta, ue, ve)
    ud, vd = value * cos_azimuth + tu, value * sin_azimuth + tv
    u_turned = -value * sin_azimuth - uu * ve + uv * ue  # d (u', v') / d azimuth
    v_turned = value * cos_azimuth - vu * ve + vv * ue
    fx, fy = theta[0], theta[1]
    for i in range(3):
        turn = (-sin_azimuth / r, cos_azimuth / r, 0.0)[i]
        tilt = (z * cos_azimuth / squared_norm, z * sin_azimuth / squared_norm, -r / squared_norm)[i]
        J_point[0, i] = fx * (slope * cos_azimuth * tilt + u_turned * turn)
        J_point[1, i] = fy * (slope * sin_azimuth * tilt + v_turned * turn)
    if with_theta:
        for i in range(4, len(theta)):
            J_theta[0, i] = J_theta[1, i] = 0.0
        tangential_by_theta(theta, ue, ve, J_theta, fx, fy)
        for i in range(4, len(theta)):
            along, moved = beyond_by_theta(end, over, slope, i), end[_M_BY, i]
            J_theta[0, i] += fx * (along * cos_azimuth + moved * (uu * cos_azimuth + uv * sin_azimuth))
            J_theta[1, i] += fy * (along * sin_azimuth + moved * (vu * cos_azimuth + vv * sin_azimuth))
        J_theta[0, 0], J_theta[0, 1], J_theta[0, 2], J_theta[0, 3] = ud, 0.0, 1.0, 0.0
        J_theta[1, 0], J_theta[1, 1], J_theta[1, 2], J_theta[1, 3] = 0.0, vd, 0.0, 1.0
    return fx * ud + theta[2], fy * vd + theta[3]


def _project_point(
    theta: FloatArray,
    end: FloatArray,
    x: float,
    y: float,
    z: float,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
) -> tuple[float, float, bool]:
    """Pixel of one point in the camera frame, and whether it has one; where not, the continued pixel that an optimiser
    may go by, NaN for what is no direction or straight behind the camera.

    ``end`` is ``field_end(theta, with_theta)``. Writes d pixel / d point into J_point (2, 3) and, if ``with_theta``,
    d pixel / d theta into J_theta (2, K); both are left as they were where the pixel is NaN."""
    r = math.sqrt(x * x + y * y)
    squared_norm = x * x + y * y + z * z
    if not 0.0 < squared_norm < math.inf or (r == 0.0 and not z > 0.0):
        return math.nan, math.nan, False
    if perspective:
        inside, t = r < end[0, _LIMIT] * z, 0.0
    else:
        t = math.atan2(r, z)
        inside = t < end[0, _LIMIT]
    if bends and not inside:
        angle = math.atan2(r, z) if perspective else t
        px, py = project_beyond_a_bend(theta, end, x, y, z, r, angle - end[0, _ANGLE], J_point, J_theta, with_theta)
        return px, py, False
    over, slope = 0.0, 1.0
    if perspective:
        per_z = 1.0 / z
        u, v = x * per_z, y * per_z
        cos_azimuth, sin_azimuth = 1.0, 0.0
    else:
        per_r = 1.0 / r if r > 0.0 else 0.0
        cos_azimuth, sin_azimuth = x * per_r, y * per_r
        if inside:
            m, slope = spread(theta, t)
        else:
            over = t - end[0, _ANGLE]
            m, slope = beyond(end, over)
        scale = m * per_r if r > 0.0 else slope / z
        u, v = scale * x, scale * y
    ud, vd, uu, uv, vu, vv = distort(theta, u, v)
    valid = inside and uu * vv - uv * vu > 0.0
    fx, fy = theta[0], theta[1]

    if perspective:
        J_point[0, 0], J_point[0, 1] = fx * uu * per_z, fx * uv * per_z
        J_point[1, 0], J_point[1, 1] = fy * vu * per_z, fy * vv * per_z
        J_point[0, 2] = -(J_point[0, 0] * u + J_point[0, 1] * v)
        J_point[1, 2] = -(J_point[1, 0] * u + J_point[1, 1] * v)
    else:  # d(u, v) / d(x, y, z): r * d scale / d r = turn, and d scale / d z = fall
        fall = -slope / squared_norm
        turn = -fall * z - scale
        u_x = scale + cos_azimuth * cos_azimuth * turn
        u_y = cos_azimuth * sin_azimuth * turn
        v_y = scale + sin_azimuth * sin_azimuth * turn
        J_point[0, 0], J_point[0, 1] = fx * (uu * u_x + uv * u_y), fx * (uu * u_y + uv * v_y)
        J_point[1, 0], J_point[1, 1] = fy * (vu * u_x + vv * u_y), fy * (vu * u_y + vv * v_y)
        J_point[0, 2], J_point[1, 2] = fx * fall * (uu * x + uv * y), fy * fall * (vu * x + vv * y)

    if with_theta:
        J_theta[0, 0], J_theta[0, 1], J_theta[0, 2], J_theta[0, 3] = ud, 0.0, 1.0, 0.0
        J_theta[1, 0], J_theta[1, 1], J_theta[1, 2], J_theta[1, 3] = 0.0, vd, 0.0, 1.0
        along_u = fx * (uu * cos_azimuth + uv * sin_azimuth)
        along_v = fy * (vu * cos_azimuth + vv * sin_azimuth)
        if inside:
            spread_by_theta(theta, t, J_theta, along_u, along_v)
        else:
            for i in range(4, len(theta)):
                by_theta = beyond_by_theta(end, over, slope, i)
                J_theta[0, i], J_theta[1, i] = along_u * by_theta, along_v * by_theta
        radial_by_theta(theta, u * u + v * v, J_theta, fx * u, fy * v)
        tangential_by_theta(theta, u, v, J_theta, fx, fy)
    return fx * ud + theta[2], fy * vd + theta[3], valid


def _invert(theta: FloatArray, limit: float, target: float, whole: bool) -> float:
    """t below ``limit`` at which R (``whole``), or m, is the target; NaN where there is none. Newton's method, kept
    inside a bracket that each step narrows."""
    low, high = 0.0, limit
    at_limit = radius(theta, limit)[0] if whole else spread(theta, limit)[0]
    if not target < at_limit:
        return math.nan
    t = min(target, 0.5 * (low + high))
    for _ in range(_NEWTON_STEPS):
        value, slope = radius(theta, t) if whole else spread(theta, t)
        excess = value - target
        if excess > 0.0:
            high = t
        else:
            low = t
        following = t - excess / slope
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - t) <= 1e-16 * t:
            return following
        t = following
    return t


def _undistort(theta: FloatArray, end: FloatArray, ud: float, vd: float) -> tuple[float, float, bool]:
    """(u, v) of (u', v'): Newton's method on the whole distortion from the solution of its radial part, kept on the
    axis's side of the fold."""
    u, v = ud, vd
    if bends:
        distance = math.hypot(ud, vd)
        if distance > 0.0:
            t = invert(theta, end[0, _LIMIT], distance, True)
            m = spread(theta, t)[0] if t == t else 0.95 * end[0, _M]  # only the tangential part can bring it back in
            u, v = ud * m / distance, vd * m / distance
    u_inside, v_inside = 0.0, 0.0
    miss, tolerance = math.inf, _UNDISTORT_TOLERANCE * (1.0 + abs(ud) + abs(vd))
    for _ in range(_NEWTON_STEPS):
        uf, vf, uu, uv, vu, vv = distort(theta, u, v)
        det = uu * vv - uv * vu
        if not det > 0.0:
            u, v = 0.5 * (u + u_inside), 0.5 * (v + v_inside)
            continue
        u_inside, v_inside = u, v
        miss = abs(ud - uf) + abs(vd - vf)
        du = (vv * (ud - uf) - uv * (vd - vf)) / det
        dv = (uu * (vd - vf) - vu * (ud - uf)) / det
        u, v = u + du, v + dv
        if abs(du) + abs(dv) <= 1e-15 * (abs(u) + abs(v)):
            break
    return u, v, miss < tolerance


def _unproject_point(theta: FloatArray, end: FloatArray, px: float, py: float) -> tuple[float, float, float, bool]:
    """Unit bearing of one pixel in the camera frame, and whether the model has one."""
    ud, vd = (px - theta[2]) / theta[0], (py - theta[3]) / theta[1]
    if not (math.isfinite(ud) and math.isfinite(vd)):
        return math.nan, math.nan, math.nan, False
    u, v, valid = undistort(theta, end, ud, vd)
    if perspective:
        if not (valid and u * u + v * v < end[0, _LIMIT] * end[0, _LIMIT]):
            return math.nan, math.nan, math.nan, False
        norm = math.sqrt(u * u + v * v + 1.0)
        return u / norm, v / norm, 1.0 / norm, True
    m = math.hypot(u, v)
    angle = invert(theta, end[0, _LIMIT], m, False) if valid else math.nan
    if math.isnan(angle):
        return math.nan, math.nan, math.nan, False
    if m == 0.0:
        return 0.0, 0.0, 1.0, True
    sine = math.sin(angle) / m
    return u * sine, v * sine, math.cos(angle), True


def _project_points(
    theta: FloatArray,
    points_in_camera: FloatArray,
    pixels_px: FloatArray,
    valid: BoolArray,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_jacobians: bool,
    continued: bool,
) -> None:
    end = field_end(theta, with_jacobians)
    for i in range(len(points_in_camera)):
        row = i if with_jacobians else 0
        pixels_px[i, 0], pixels_px[i, 1], valid[i] = project_point(
            theta,
            end,
            points_in_camera[i, 0],
            points_in_camera[i, 1],
            points_in_camera[i, 2],
            J_point[row],
            J_theta[row],
            with_jacobians,
        )
        if not (valid[i] or continued):
            pixels_px[i], J_point[row], J_theta[row] = math.nan, math.nan, math.nan


def _unproject_pixels(theta: FloatArray, pixels_px: FloatArray, bearings: FloatArray, valid: BoolArray) -> None:
    end = field_end(theta, False)
    for i in range(len(pixels_px)):
        bearings[i, 0], bearings[i, 1], bearings[i, 2], valid[i] = unproject_point(
            theta, end, pixels_px[i, 0], pixels_px[i, 1]
        )


def _radial_slopes(theta: FloatArray, ts: FloatArray, slopes: FloatArray) -> None:
    for i in range(len(ts)):
        slopes[i] = radius(theta, ts[i])[1]


_FIRST: tuple[Function, ...] = (_radius, _room)
_INLINED: tuple[Function, ...] = (_beyond, _beyond_by_theta, _distort)
_CALLED: tuple[Function, ...] = (_fill_by_theta, _field_end, _invert, _undistort, _unproject_point)


@dataclass(frozen=True)
class Kernels:
    """Of one model, compiled when first called.

    bound: what a template of another module may name, ``project_point`` and ``field_end`` among it. cached: whether
    they are kept on disk, as those of gtcal's own models."""

    bound: Mapping[str, Any]
    cached: bool
    field_end: Function
    project_points: Function
    unproject_pixels: Function
    radial_slopes: Function


@cache
def kernels_of(name: str, parts: Parts) -> Kernels:
    """The kernels of a model of this name with these parts."""
    functions = [
        function for part in (parts.spread, parts.radial, parts.tangential) for function in vars(part).values()
    ]
    cached = all(function.__module__.startswith(f"{__package__}.") for function in functions)
    bound = _names_of(parts)

    def called(template: Function) -> Function:
        return kernel_with(template, name, bound, cache=cached)

    for template in _FIRST:
        bound[template.__name__[1:]] = called(template)
    for template in _INLINED:
        bound[template.__name__[1:]] = inlined_with(template, name, bound)
    bound["project_beyond_a_bend"] = called(_project_beyond_a_bend)
    bound["project_point"] = inlined_with(_project_point, name, bound)
    for template in _CALLED:
        bound[template.__name__[1:]] = called(template)
    return Kernels(
        bound, cached, bound["field_end"], called(_project_points), called(_unproject_pixels), called(_radial_slopes)
    )


def _names_of(parts: Parts) -> dict[str, Any]:
    perspective = parts.spread is PERSPECTIVE
    return {
        "perspective": perspective,
        "bends": parts.radial is not UNBENT,
        "farthest_angle": FARTHEST_PERSPECTIVE_RAD if perspective else math.pi,
        "spread": parts.spread.value,
        "spread_by_theta": parts.spread.by_theta,
        "spread_room": parts.spread.room,
        "radial": parts.radial.value,
        "radial_by_theta": parts.radial.by_theta,
        "radial_room": parts.radial.room,
        "tangential": parts.tangential.value,
        "tangential_by_theta": parts.tangential.by_theta,
    }
