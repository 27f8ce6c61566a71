"""What a camera model is made of: three scalar functions, each with its derivative by theta.

A point at the angle a off the optical axis and the azimuth phi is projected in three steps:

    spread      (u, v) = m(a) (cos phi, sin phi)         m = tan a of a perspective model, which states no spread
    distortion  u' = u s(u^2 + v^2) + t_u(u, v)          s: radial, t: tangential and the like
                v' = v s(u^2 + v^2) + t_v(u, v)
    pixel       (fx u' + cx, fy v' + cy)

Everything else that a model needs (Jacobians by the point and by theta, the end of the field, the smooth continuation
past it, the way back from a pixel) follows from these, in ``factors.camera_models.projection``.

The functions are ``factors.kernel.inlined``; theta is (K,), fx fy cx cy first. A ``by_theta`` writes the derivatives by
its own parameters into its own columns of J_theta (2, K), times ``along_u`` in the first row and ``along_v`` in the
second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.kernel import inlined

FloatArray = npt.NDArray[np.float64]
Function = Callable[..., Any]


@inlined
def _nothing_by_theta(theta: FloatArray, of: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    pass


@inlined
def _as_it_is(theta: FloatArray, of: float) -> tuple[float, float]:
    return of, 1.0


@inlined
def _unscaled(theta: FloatArray, m2: float) -> tuple[float, float]:
    return 1.0, 0.0


@inlined
def _unlimited(theta: FloatArray, of: float) -> float:
    return 1.0


@inlined
def _no_shift(theta: FloatArray, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@inlined
def _no_shift_by_theta(
    theta: FloatArray, u: float, v: float, J_theta: FloatArray, along_u: float, along_v: float
) -> None:
    pass


@dataclass(frozen=True)
class Spread:
    """m, where it is not the perspective's tan a.

    value: (theta, angle) to m and dm / d angle; the slope is positive as far as the model is one-to-one.
    by_theta: (theta, angle, J_theta, along_u, along_v) writes along * dm / d theta.
    room: (theta, angle) to a number that turns negative where the field ends for another reason than that the slope
    does: pixels that run away. Continuous there."""

    value: Function
    by_theta: Function
    room: Function = _unlimited


@dataclass(frozen=True)
class Radial:
    """s.

    value: (theta, m2) to s(m2), m2 = m^2, and 2 ds / d m2.
    by_theta: (theta, m2, J_theta, along_u, along_v) writes along * ds / d theta.
    room: (theta, m2), as of a spread."""

    value: Function
    by_theta: Function
    room: Function = _unlimited


@dataclass(frozen=True)
class Tangential:
    """t, zero on the axis to first order.

    value: (theta, u, v) to t_u, t_v and dt_u/du, dt_u/dv, dt_v/du, dt_v/dv.
    by_theta: (theta, u, v, J_theta, along_u, along_v) writes along_u * dt_u / d theta and along_v * dt_v / d theta."""

    value: Function
    by_theta: Function


PERSPECTIVE = Spread(_as_it_is, _nothing_by_theta)
"""Of a perspective model: m is hypot(x, y) / z, by which its field is measured in place of the angle."""

UNBENT = Radial(_unscaled, _nothing_by_theta)
STRAIGHT = Tangential(_no_shift, _no_shift_by_theta)


@dataclass(frozen=True)
class Parts:
    """Of one model."""

    spread: Spread = PERSPECTIVE
    radial: Radial = UNBENT
    tangential: Tangential = STRAIGHT


@inlined
def decentering(pu: float, pv: float, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    """Brown's tangential distortion: t_u = pu (rho^2 + 2 u^2) + 2 pv u v, t_v = pv (rho^2 + 2 v^2) + 2 pu u v, and its
    four derivatives. OpenCV's p1, p2 are pv, pu; Project Aria's p0, p1 are pu, pv."""
    rho2 = u * u + v * v
    cross = 2.0 * (pu * v + pv * u)
    return (
        pu * (rho2 + 2.0 * u * u) + 2.0 * pv * u * v,
        pv * (rho2 + 2.0 * v * v) + 2.0 * pu * u * v,
        6.0 * pu * u + 2.0 * pv * v,
        cross,
        cross,
        6.0 * pv * v + 2.0 * pu * u,
    )


@inlined
def decentering_by_theta(
    column_u: int, column_v: int, u: float, v: float, J_theta: FloatArray, along_u: float, along_v: float
) -> None:
    """Of ``decentering``: by pu in the first of the columns, by pv in the second."""
    rho2, cross = u * u + v * v, 2.0 * u * v
    J_theta[0, column_u], J_theta[1, column_u] = along_u * (rho2 + 2.0 * u * u), along_v * cross
    J_theta[0, column_v], J_theta[1, column_v] = along_u * cross, along_v * (rho2 + 2.0 * v * v)
