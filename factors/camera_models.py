"""Camera models: from a point in the camera frame to a pixel, with analytic Jacobians, and back.

Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centres.

Every model is one scalar kernel, ``project_point``; arrays, factors and ``unproject`` loop over it. The three
fisheye models are one formula with more or fewer terms. With a = atan2(hypot(x, y), z),
s = 1 + k0 a^2 + k1 a^4 + ..., (u, v) = a s (x, y) / hypot(x, y) and rho2 = u^2 + v^2:

    u' = u + p0 (rho2 + 2 u^2) + 2 p1 u v + s0 rho2 + s1 rho2^2        px = fx u' + cx
    v' = v + p1 (rho2 + 2 v^2) + 2 p0 u v + s2 rho2 + s3 rho2^2        py = fy v' + cy

- Kannala-Brandt 4: four radial terms, here k1..k4 as OpenCV's fisheye and Kalibr's equidistant name them.
- Fisheye62: six radial terms k0..k5 and p0, p1 (Project Aria, Meta Quest). p0 and p1 stand the other way round
  from OpenCV's p1 and p2.
- Fisheye624: Fisheye62 and the thin prism s0..s3.

Pinhole radial-tangential is OpenCV's five-coefficient model, in OpenCV's order k1 k2 p1 p2 k3.

A point has a pixel where the model is one-to-one: up to the angle at which the radial function stops being
monotonic, in front of the camera for the pinhole, and where the tangential part does not fold. Everything else
is masked, never clipped or folded back.

An optimiser passes points that have no pixel on its way to an estimate under which they have one. For it alone the
radial function goes on past the end of the field, growing with the angle, its slope and its derivative by the
parameters without a step (``_beyond``): ``project_point`` gives that continued pixel, and says that it is none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from factors.kernel import inlined, kernel

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_PINHOLE, _KB4, _F62, _F624 = 0, 1, 2, 3  # model ids, as the kernels know them
_FARTHEST_PINHOLE_RAD = math.radians(85.0)  # off the axis: twice what rectilinear lenses see
_GROWTH_PER_RAD = 10.0  # of the continued radial function's slope, until that is an equidistant lens's
_SMALLEST_SLOPE = 1e-9  # of the radial function at the field's end: less, and it is there that it turns
_LEAST_TURN = 0.1  # of the slope's fall at the field's end, for its derivative: less, and the end is hardly determined
_LIMIT_SAMPLES = 720  # a quarter of a degree: a polynomial of degree 12 does not turn twice within one
_NEWTON_STEPS = 50
_UNDISTORT_TOLERANCE = 1e-14  # relative; next to a fold the last steps are rounding, the image is not


@inlined
def _radial(model_id: int, theta: FloatArray, radius: float) -> float:
    """radius * s(radius), the distance from the principal point in units of the focal length."""
    w = radius * radius
    if model_id == _PINHOLE:
        return radius * (1.0 + w * (theta[4] + w * (theta[5] + w * theta[8])))
    high = 0.0 if model_id == _KB4 else w * (theta[8] + w * theta[9])
    return radius * (1.0 + w * (theta[4] + w * (theta[5] + w * (theta[6] + w * (theta[7] + high)))))


@inlined
def _radial_slope(model_id: int, theta: FloatArray, radius: float) -> float:
    """d(radius * s(radius)) / d radius: positive where the model is one-to-one along a ray."""
    w = radius * radius
    if model_id == _PINHOLE:
        return 1.0 + w * (3.0 * theta[4] + w * (5.0 * theta[5] + w * 7.0 * theta[8]))
    high = 0.0 if model_id == _KB4 else w * (11.0 * theta[8] + w * 13.0 * theta[9])
    return 1.0 + w * (3.0 * theta[4] + w * (5.0 * theta[5] + w * (7.0 * theta[6] + w * (9.0 * theta[7] + high))))


@inlined
def _radial_bend(model_id: int, theta: FloatArray, radius: float) -> float:
    """d slope / d radius: negative where the radial function stops being monotonic."""
    w = radius * radius
    if model_id == _PINHOLE:
        return radius * (6.0 * theta[4] + w * (20.0 * theta[5] + w * 42.0 * theta[8]))
    high = 0.0 if model_id == _KB4 else w * (110.0 * theta[8] + w * 156.0 * theta[9])
    return radius * (6.0 * theta[4] + w * (20.0 * theta[5] + w * (42.0 * theta[6] + w * (72.0 * theta[7] + high))))


@kernel
def field_limit(model_id: int, theta: FloatArray) -> float:
    """Where the radial function stops being monotonic: the angle off the axis in rad (fisheye; at most pi), or
    the normalised radius hypot(x, y) / z (pinhole; at most that of 85 degrees, past which its pixels run away)."""
    pinhole = model_id == _PINHOLE
    farthest_angle = _FARTHEST_PINHOLE_RAD if pinhole else math.pi
    below = 0.0
    for i in range(1, _LIMIT_SAMPLES + 1):
        angle = i * farthest_angle / _LIMIT_SAMPLES
        above = math.tan(angle) if pinhole else angle
        if not _radial_slope(model_id, theta, above) > 0.0:
            for _ in range(60):
                middle = 0.5 * (below + above)
                if _radial_slope(model_id, theta, middle) > 0.0:
                    below = middle
                else:
                    above = middle
            return below
        below = above
    return below


@inlined
def _beyond(model_id: int, theta: FloatArray, limit: float, angle: float) -> tuple[float, float, float, float]:
    """The radial function continued past the field's end at ``limit``, as a function of the angle off the axis.

    Returns its value, its slope by the angle, and two derivatives by the i-th radial coefficient, over
    (2 i + 3) limit^(2 i + 2): of the limit, and of the value less limit^(2 i + 3)."""
    pinhole = model_id == _PINHOLE
    over = angle - (math.atan(limit) if pinhole else limit)
    stretch = 1.0 + limit * limit if pinhole else 1.0  # d radius / d angle
    value, slope = _radial(model_id, theta, limit), stretch * _radial_slope(model_id, theta, limit)
    if slope > _SMALLEST_SLOPE:  # the field ends for want of angles
        return value + over * slope, slope, 0.0, over * stretch
    bend = min(_radial_bend(model_id, theta, limit), -_LEAST_TURN)
    slope = min(_GROWTH_PER_RAD * over, 1.0)
    value += slope * (over - 0.5 * slope / _GROWTH_PER_RAD)
    return value, slope, -1.0 / bend, slope / (bend * stretch)


@inlined
def _distort_fisheye(
    model_id: int, theta: FloatArray, u: float, v: float
) -> tuple[float, float, float, float, float, float]:
    """Tangential and thin-prism part: u', v' and du'/du, du'/dv, dv'/du, dv'/dv."""
    if model_id == _KB4:
        return u, v, 1.0, 0.0, 0.0, 1.0
    p0, p1 = theta[10], theta[11]
    rho2 = u * u + v * v
    ud = u + p0 * (rho2 + 2.0 * u * u) + 2.0 * p1 * u * v
    vd = v + p1 * (rho2 + 2.0 * v * v) + 2.0 * p0 * u * v
    cross = 2.0 * (p0 * v + p1 * u)
    uu, uv = 1.0 + 6.0 * p0 * u + 2.0 * p1 * v, cross
    vu, vv = cross, 1.0 + 6.0 * p1 * v + 2.0 * p0 * u
    if model_id == _F624:
        s0, s1, s2, s3 = theta[12], theta[13], theta[14], theta[15]
        ud += rho2 * (s0 + s1 * rho2)
        vd += rho2 * (s2 + s3 * rho2)
        du = 2.0 * s0 + 4.0 * s1 * rho2
        dv = 2.0 * s2 + 4.0 * s3 * rho2
        uu, uv, vu, vv = uu + du * u, uv + du * v, vu + dv * u, vv + dv * v
    return ud, vd, uu, uv, vu, vv


@inlined
def _distort_pinhole(theta: FloatArray, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """OpenCV's radial-tangential distortion of normalised coordinates, and its four derivatives."""
    k1, k2, p1, p2, k3 = theta[4], theta[5], theta[6], theta[7], theta[8]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial / d r2, times two
    ud = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    vd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    cross = x * y * slope + 2.0 * (p1 * x + p2 * y)
    return (
        ud,
        vd,
        radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@inlined
def _project_fisheye(
    model_id: int,
    theta: FloatArray,
    limit: float,
    x: float,
    y: float,
    z: float,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
) -> tuple[float, float, bool]:
    r2 = x * x + y * y
    r = math.sqrt(r2)
    angle = math.atan2(r, z)
    squared_norm = r2 + z * z
    if not 0.0 < squared_norm < math.inf or (r == 0.0 and z < 0.0):
        return math.nan, math.nan, False
    inside = angle < limit
    if inside:
        radial, slope, end, pull = _radial(model_id, theta, angle), _radial_slope(model_id, theta, angle), angle, 0.0
    else:
        end = limit
        radial, slope, _, pull = _beyond(model_id, theta, limit, angle)
    per_r = 1.0 / r if r > 0.0 else 0.0
    cos_azimuth, sin_azimuth = x * per_r, y * per_r
    scale = radial * per_r if r > 0.0 else 1.0 / z  # (u, v) = scale * (x, y)
    u, v = scale * x, scale * y
    ud, vd, uu, uv, vu, vv = _distort_fisheye(model_id, theta, u, v)
    valid = inside and uu * vv - uv * vu > 0.0
    fx, fy = theta[0], theta[1]

    # d(u, v) / d(x, y, z): r * d scale / d r = turn, and d scale / d z = fall
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
        power, w = 1.0, end * end
        for i in range(4 if model_id == _KB4 else 6):
            power *= w
            by_coefficient = power * (end + (2 * i + 3) * pull)
            J_theta[0, 4 + i], J_theta[1, 4 + i] = along_u * by_coefficient, along_v * by_coefficient
        if model_id != _KB4:
            rho2 = u * u + v * v
            J_theta[0, 10], J_theta[1, 10] = fx * (rho2 + 2.0 * u * u), fy * 2.0 * u * v
            J_theta[0, 11], J_theta[1, 11] = fx * 2.0 * u * v, fy * (rho2 + 2.0 * v * v)
            if model_id == _F624:
                J_theta[0, 12], J_theta[0, 13], J_theta[0, 14], J_theta[0, 15] = (
                    fx * rho2,
                    fx * rho2 * rho2,
                    0.0,
                    0.0,
                )
                J_theta[1, 12], J_theta[1, 13], J_theta[1, 14], J_theta[1, 15] = (
                    0.0,
                    0.0,
                    fy * rho2,
                    fy * rho2 * rho2,
                )
    return fx * ud + theta[2], fy * vd + theta[3], valid


@inlined
def _continue_pinhole(
    theta: FloatArray,
    limit: float,
    x: float,
    y: float,
    z: float,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
) -> tuple[float, float]:
    """The pixel of a point beyond the field: its radial part continued, its tangential part as at the field's end."""
    r2 = x * x + y * y
    r, squared_norm = math.sqrt(r2), r2 + z * z
    cos_azimuth, sin_azimuth = x / r, y / r
    radial, slope, limit_by, pull = _beyond(_PINHOLE, theta, limit, math.atan2(r, z))
    p1, p2 = theta[6], theta[7]
    xe, ye, e2 = limit * cos_azimuth, limit * sin_azimuth, limit * limit
    ud = radial * cos_azimuth + 2.0 * p1 * xe * ye + p2 * (e2 + 2.0 * xe * xe)
    vd = radial * sin_azimuth + p1 * (e2 + 2.0 * ye * ye) + 2.0 * p2 * xe * ye
    ux, uy = 2.0 * p1 * ye + 6.0 * p2 * xe, 2.0 * (p1 * xe + p2 * ye)  # of the tangential part alone
    vy = 6.0 * p1 * ye + 2.0 * p2 * xe
    u_turned = -radial * sin_azimuth - ux * ye + uy * xe  # d (u, v) / d azimuth
    v_turned = radial * cos_azimuth - uy * ye + vy * xe
    fx, fy = theta[0], theta[1]
    for i in range(3):
        turn = (-sin_azimuth / r, cos_azimuth / r, 0.0)[i]
        tilt = (z * cos_azimuth / squared_norm, z * sin_azimuth / squared_norm, -r / squared_norm)[i]
        J_point[0, i] = fx * (slope * cos_azimuth * tilt + u_turned * turn)
        J_point[1, i] = fy * (slope * sin_azimuth * tilt + v_turned * turn)
    if with_theta:
        J_theta[0, 0], J_theta[0, 1], J_theta[0, 2], J_theta[0, 3] = ud, 0.0, 1.0, 0.0
        J_theta[1, 0], J_theta[1, 1], J_theta[1, 2], J_theta[1, 3] = 0.0, vd, 0.0, 1.0
        power = 1.0
        for i in range(3):
            column = 4 + i if i < 2 else 8
            power *= e2
            along = power * (limit + (2 * i + 3) * pull)
            moved = power * (2 * i + 3) * limit_by
            J_theta[0, column] = fx * (along * cos_azimuth + moved * (ux * cos_azimuth + uy * sin_azimuth))
            J_theta[1, column] = fy * (along * sin_azimuth + moved * (uy * cos_azimuth + vy * sin_azimuth))
        J_theta[0, 6], J_theta[1, 6] = fx * 2.0 * xe * ye, fy * (e2 + 2.0 * ye * ye)
        J_theta[0, 7], J_theta[1, 7] = fx * (e2 + 2.0 * xe * xe), fy * 2.0 * xe * ye
    return fx * ud + theta[2], fy * vd + theta[3]


@inlined
def _project_pinhole(
    theta: FloatArray,
    limit: float,
    x: float,
    y: float,
    z: float,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
) -> tuple[float, float, bool]:
    r = math.hypot(x, y)
    if not (r < math.inf and abs(z) < math.inf) or (r == 0.0 and not z > 0.0):
        return math.nan, math.nan, False
    if not r < limit * z:
        px, py = _continue_pinhole(theta, limit, x, y, z, J_point, J_theta, with_theta)
        return px, py, False
    xn, yn = x / z, y / z
    r2 = xn * xn + yn * yn
    ud, vd, ux, uy, vx, vy = _distort_pinhole(theta, xn, yn)
    valid = ux * vy - uy * vx > 0.0
    fx, fy = theta[0], theta[1]
    J_point[0, 0], J_point[0, 1] = fx * ux / z, fx * uy / z
    J_point[1, 0], J_point[1, 1] = fy * vx / z, fy * vy / z
    J_point[0, 2] = -(J_point[0, 0] * xn + J_point[0, 1] * yn)
    J_point[1, 2] = -(J_point[1, 0] * xn + J_point[1, 1] * yn)
    if with_theta:
        J_theta[0, 0], J_theta[0, 1], J_theta[0, 2], J_theta[0, 3] = ud, 0.0, 1.0, 0.0
        J_theta[1, 0], J_theta[1, 1], J_theta[1, 2], J_theta[1, 3] = 0.0, vd, 0.0, 1.0
        J_theta[0, 4], J_theta[1, 4] = fx * xn * r2, fy * yn * r2
        J_theta[0, 5], J_theta[1, 5] = fx * xn * r2 * r2, fy * yn * r2 * r2
        J_theta[0, 6], J_theta[1, 6] = fx * 2.0 * xn * yn, fy * (r2 + 2.0 * yn * yn)
        J_theta[0, 7], J_theta[1, 7] = fx * (r2 + 2.0 * xn * xn), fy * 2.0 * xn * yn
        J_theta[0, 8], J_theta[1, 8] = fx * xn * r2 * r2 * r2, fy * yn * r2 * r2 * r2
    return fx * ud + theta[2], fy * vd + theta[3], valid


@inlined
def project_point(
    model_id: int,
    theta: FloatArray,
    limit: float,
    x: float,
    y: float,
    z: float,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_theta: bool,
) -> tuple[float, float, bool]:
    """Pixel of one point in the camera frame, and whether it has one; where not, the continued pixel that an optimiser
    may go by, NaN for what is no direction or straight behind the camera.

    ``limit`` is ``field_limit(model_id, theta)``. Writes d pixel / d point into J_point (2, 3) and, if
    ``with_theta``, d pixel / d theta into J_theta (2, K); both are left as they were where the pixel is NaN.
    """
    if model_id == _PINHOLE:
        return _project_pinhole(theta, limit, x, y, z, J_point, J_theta, with_theta)
    return _project_fisheye(model_id, theta, limit, x, y, z, J_point, J_theta, with_theta)


@kernel
def _invert_radial(model_id: int, theta: FloatArray, limit: float, target: float) -> float:
    """The radius (angle of a fisheye) below ``limit`` with radius * s(radius) = target; NaN where there is
    none. Newton's method, kept inside a bracket that each step narrows."""
    low, high = 0.0, limit
    if not target < _radial(model_id, theta, limit):
        return math.nan
    radius = min(target, 0.5 * (low + high))
    for _ in range(_NEWTON_STEPS):
        excess = _radial(model_id, theta, radius) - target
        if excess > 0.0:
            high = radius
        else:
            low = radius
        step = excess / _radial_slope(model_id, theta, radius)
        following = radius - step
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - radius) <= 1e-16 * radius:
            return following
        radius = following
    return radius


@kernel
def _undistort_fisheye(model_id: int, theta: FloatArray, ud: float, vd: float) -> tuple[float, float, bool]:
    """Newton's method on the tangential and thin-prism part, kept on the axis's side of the fold."""
    u, v, u_inside, v_inside = ud, vd, 0.0, 0.0
    miss, tolerance = math.inf, _UNDISTORT_TOLERANCE * (1.0 + abs(ud) + abs(vd))
    for _ in range(_NEWTON_STEPS):
        uf, vf, uu, uv, vu, vv = _distort_fisheye(model_id, theta, u, v)
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
            return u, v, True
    return u, v, miss < tolerance


@kernel
def _undistort_pinhole(theta: FloatArray, limit: float, ud: float, vd: float) -> tuple[float, float, bool]:
    """Newton's method on the whole distortion from the solution of its radial part, kept on the axis's side of
    the fold."""
    distance = math.hypot(ud, vd)
    if distance == 0.0:
        x, y = 0.0, 0.0
    else:
        radius = _invert_radial(_PINHOLE, theta, limit, distance)
        if math.isnan(radius):  # only the tangential part can bring it back inside
            radius = 0.95 * limit
        x, y = ud * radius / distance, vd * radius / distance
    x_inside, y_inside = 0.0, 0.0
    miss, tolerance = math.inf, _UNDISTORT_TOLERANCE * (1.0 + abs(ud) + abs(vd))
    for _ in range(_NEWTON_STEPS):
        uf, vf, ux, uy, vx, vy = _distort_pinhole(theta, x, y)
        det = ux * vy - uy * vx
        if not det > 0.0:
            x, y = 0.5 * (x + x_inside), 0.5 * (y + y_inside)
            continue
        x_inside, y_inside = x, y
        miss = abs(ud - uf) + abs(vd - vf)
        dx = (vy * (ud - uf) - uy * (vd - vf)) / det
        dy = (ux * (vd - vf) - vx * (ud - uf)) / det
        x, y = x + dx, y + dy
        if abs(dx) + abs(dy) <= 1e-15 * (abs(x) + abs(y)):
            break
    return x, y, miss < tolerance and x * x + y * y < limit * limit


@kernel
def unproject_point(
    model_id: int, theta: FloatArray, limit: float, px: float, py: float
) -> tuple[float, float, float, bool]:
    """Unit bearing of one pixel in the camera frame, and whether the model has one."""
    ud, vd = (px - theta[2]) / theta[0], (py - theta[3]) / theta[1]
    if not (math.isfinite(ud) and math.isfinite(vd)):
        return math.nan, math.nan, math.nan, False
    if model_id == _PINHOLE:
        x, y, valid = _undistort_pinhole(theta, limit, ud, vd)
        norm = math.sqrt(x * x + y * y + 1.0)
        if not valid:
            return math.nan, math.nan, math.nan, False
        return x / norm, y / norm, 1.0 / norm, True
    u, v, valid = _undistort_fisheye(model_id, theta, ud, vd)
    rho = math.hypot(u, v)
    angle = _invert_radial(model_id, theta, limit, rho) if valid else math.nan
    if math.isnan(angle):
        return math.nan, math.nan, math.nan, False
    if rho == 0.0:
        return 0.0, 0.0, 1.0, True
    sine = math.sin(angle) / rho
    return u * sine, v * sine, math.cos(angle), True


@kernel
def _project_points(
    model_id: int,
    theta: FloatArray,
    points_in_camera: FloatArray,
    pixels_px: FloatArray,
    valid: BoolArray,
    J_point: FloatArray,
    J_theta: FloatArray,
    with_jacobians: bool,
    continued: bool,
) -> None:
    limit = field_limit(model_id, theta)
    for i in range(len(points_in_camera)):
        row = i if with_jacobians else 0
        pixels_px[i, 0], pixels_px[i, 1], valid[i] = project_point(
            model_id,
            theta,
            limit,
            points_in_camera[i, 0],
            points_in_camera[i, 1],
            points_in_camera[i, 2],
            J_point[row],
            J_theta[row],
            with_jacobians,
        )
        if not (valid[i] or continued):
            pixels_px[i], J_point[row], J_theta[row] = math.nan, math.nan, math.nan


@kernel
def _radial_slopes(model_id: int, theta: FloatArray, radii: FloatArray, slopes: FloatArray) -> None:
    for i in range(len(radii)):
        slopes[i] = _radial_slope(model_id, theta, radii[i])


@kernel
def _unproject_pixels(
    model_id: int, theta: FloatArray, pixels_px: FloatArray, bearings: FloatArray, valid: BoolArray
) -> None:
    limit = field_limit(model_id, theta)
    for i in range(len(pixels_px)):
        bearings[i, 0], bearings[i, 1], bearings[i, 2], valid[i] = unproject_point(
            model_id, theta, limit, pixels_px[i, 0], pixels_px[i, 1]
        )


def _rows(array: npt.ArrayLike, columns: int, name: str) -> FloatArray:
    rows = np.ascontiguousarray(array, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise ValueError(f"{name}.shape={rows.shape}, expected (N, {columns})")
    return rows


@dataclass(frozen=True)
class CameraModel:
    """One of the camera models above. ``parameter_names`` gives the order of the parameter vector theta."""

    name: str
    model_id: int
    parameter_names: tuple[str, ...]

    @property
    def n_parameters(self) -> int:
        return len(self.parameter_names)

    def project(self, points_in_camera: npt.ArrayLike, theta: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
        """Pixels (N, 2) of points (N, 3) in the camera frame; a mask (N,) that is False, with the pixel NaN,
        where the point has no pixel. Scale does not matter: bearings will do for points.

        Raises ValueError for arrays of another shape."""
        points, parameters = _rows(points_in_camera, 3, "points_in_camera"), self.as_theta(theta)
        pixels, valid = np.empty((len(points), 2)), np.empty(len(points), dtype=np.bool_)
        scratch_point, scratch_theta = np.empty((1, 2, 3)), np.empty((1, 2, self.n_parameters))
        _project_points(self.model_id, parameters, points, pixels, valid, scratch_point, scratch_theta, False, False)
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
        _project_points(self.model_id, parameters, points, pixels, valid, J_point, J_theta, True, continued)
        return pixels, valid, J_point, J_theta

    def unproject(self, pixels_px: npt.ArrayLike, theta: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
        """Unit bearings (N, 3) in the camera frame of pixels (N, 2); a mask (N,) that is False, with the
        bearing NaN, where no point of the valid field has that pixel.

        Raises ValueError for arrays of another shape."""
        pixels, parameters = _rows(pixels_px, 2, "pixels_px"), self.as_theta(theta)
        bearings, valid = np.empty((len(pixels), 3)), np.empty(len(pixels), dtype=np.bool_)
        _unproject_pixels(self.model_id, parameters, pixels, bearings, valid)
        return bearings, valid

    def radial_slopes(self, bearings: npt.ArrayLike, theta: npt.ArrayLike) -> FloatArray:
        """(N,) slope of the radial function at bearings or points (N, 3) of the valid field: 1 on the axis, 0 at the
        field's end, where a pixel no longer tells the angle. NaN for a bearing that is.

        Raises ValueError for arrays of another shape."""
        points, parameters = _rows(bearings, 3, "bearings"), self.as_theta(theta)
        off_axis = np.hypot(points[:, 0], points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            radii = off_axis / points[:, 2] if self.model_id == _PINHOLE else np.arctan2(off_axis, points[:, 2])
        slopes = np.empty(len(points))
        _radial_slopes(self.model_id, parameters, radii, slopes)
        return slopes

    def max_angle_rad(self, theta: npt.ArrayLike) -> float:
        """Half angle of the valid field: no point further off the axis has a pixel."""
        limit = field_limit(self.model_id, self.as_theta(theta))
        return math.atan(limit) if self.model_id == _PINHOLE else limit

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


_FOCAL_AND_CENTRE = ("fx", "fy", "cx", "cy")
_RADIAL_6_TANGENTIAL_2 = ("k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1")

PINHOLE_RADTAN = CameraModel("pinhole_radtan", _PINHOLE, (*_FOCAL_AND_CENTRE, "k1", "k2", "p1", "p2", "k3"))
KANNALA_BRANDT4 = CameraModel("kannala_brandt4", _KB4, (*_FOCAL_AND_CENTRE, "k1", "k2", "k3", "k4"))
FISHEYE62 = CameraModel("fisheye62", _F62, (*_FOCAL_AND_CENTRE, *_RADIAL_6_TANGENTIAL_2))
FISHEYE624 = CameraModel("fisheye624", _F624, (*_FOCAL_AND_CENTRE, *_RADIAL_6_TANGENTIAL_2, "s0", "s1", "s2", "s3"))

CAMERA_MODELS: Mapping[str, CameraModel] = MappingProxyType(
    {model.name: model for model in (FISHEYE62, KANNALA_BRANDT4, PINHOLE_RADTAN, FISHEYE624)}
)
"""Every model by name. A model listed here gets all the tests of ``tests/test_camera_models.py``."""
