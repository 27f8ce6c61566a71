"""Models that project a point onto spheres before a plane.

With s = sin a, c = cos a of the angle a off the axis:

- Extended unified (EUCM): m = s / (alpha d + (1 - alpha) c), d = sqrt(beta s^2 + c^2) (Khomutenko, Garcia and Martinet,
  RA-L 2016). With beta = 1 it is the unified model as Basalt's "ucm" writes it.
- Double sphere: m = s / (alpha d + (1 - alpha) (xi + c)), d = sqrt(s^2 + (xi + c)^2) (Usenko, Demmel and Cremers,
  3DV 2018).
- Mei's omnidirectional: m = s / (xi + c), then OpenCV's k1 k2 p1 p2 (Mei and Rives, ICRA 2007; OpenCV's omnidir without
  its skew, Kalibr's omni-radtan).

On the axis the scale in px per rad is fx and fy of the extended unified model, and these over 1 + xi of the two others.
"""

from __future__ import annotations

import math

from factors.camera_models.model import FOCAL_AND_CENTRE, CameraModel
from factors.camera_models.parts import FloatArray, Radial, Spread
from factors.camera_models.pinhole import OPENCV_TANGENTIAL
from factors.kernel import inlined

_FARTHEST = math.tan(math.radians(85.0))  # m, for a scale of 1 on the axis: as far as a perspective's field goes


@inlined
def _over(sine: float, cosine: float, below: float, below_slope: float) -> tuple[float, float]:
    """sine / below and its slope by the angle; no slope where nothing is left below."""
    if below <= 0.0:
        return 0.0, -1.0
    return sine / below, (cosine - sine * below_slope / below) / below


# Extended unified: alpha, beta


@inlined
def _extended(theta: FloatArray, angle: float) -> tuple[float, float]:
    alpha, beta = theta[4], theta[5]
    s, c = math.sin(angle), math.cos(angle)
    d = math.sqrt(beta * s * s + c * c)
    return _over(s, c, alpha * d + (1.0 - alpha) * c, alpha * (beta - 1.0) * s * c / d - (1.0 - alpha) * s)


@inlined
def _extended_by_theta(theta: FloatArray, angle: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    alpha, beta = theta[4], theta[5]
    s, c = math.sin(angle), math.cos(angle)
    d = math.sqrt(beta * s * s + c * c)
    below = alpha * d + (1.0 - alpha) * c
    fall = -s / (below * below)  # dm / d below
    by_alpha, by_beta = fall * (d - c), fall * alpha * s * s / (2.0 * d)
    J_theta[0, 4], J_theta[1, 4] = along_u * by_alpha, along_v * by_alpha
    J_theta[0, 5], J_theta[1, 5] = along_u * by_beta, along_v * by_beta


@inlined
def _extended_room(theta: FloatArray, angle: float) -> float:
    alpha, beta = theta[4], theta[5]
    s, c = math.sin(angle), math.cos(angle)
    return alpha * math.sqrt(beta * s * s + c * c) + (1.0 - alpha) * c - s / _FARTHEST


# Double sphere: xi, alpha


@inlined
def _double(theta: FloatArray, angle: float) -> tuple[float, float]:
    xi, alpha = theta[4], theta[5]
    s, c = math.sin(angle), math.cos(angle)
    q = xi + c
    d = math.sqrt(s * s + q * q)
    return _over(s, c, alpha * d + (1.0 - alpha) * q, -s * (alpha * xi / d + 1.0 - alpha))


@inlined
def _double_by_theta(theta: FloatArray, angle: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    xi, alpha = theta[4], theta[5]
    s, c = math.sin(angle), math.cos(angle)
    q = xi + c
    d = math.sqrt(s * s + q * q)
    below = alpha * d + (1.0 - alpha) * q
    fall = -s / (below * below)
    by_xi, by_alpha = fall * (alpha * q / d + 1.0 - alpha), fall * (d - q)
    J_theta[0, 4], J_theta[1, 4] = along_u * by_xi, along_v * by_xi
    J_theta[0, 5], J_theta[1, 5] = along_u * by_alpha, along_v * by_alpha


@inlined
def _double_room(theta: FloatArray, angle: float) -> float:
    xi, alpha = theta[4], theta[5]
    s, q = math.sin(angle), xi + math.cos(angle)
    return alpha * math.sqrt(s * s + q * q) + (1.0 - alpha) * q - (1.0 + xi) * s / _FARTHEST


# Mei: k1, k2, p1, p2, xi


@inlined
def _single(theta: FloatArray, angle: float) -> tuple[float, float]:
    s, c = math.sin(angle), math.cos(angle)
    return _over(s, c, theta[8] + c, -s)


@inlined
def _single_by_theta(theta: FloatArray, angle: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    below = theta[8] + math.cos(angle)
    by_xi = -math.sin(angle) / (below * below)
    J_theta[0, 8], J_theta[1, 8] = along_u * by_xi, along_v * by_xi


@inlined
def _single_room(theta: FloatArray, angle: float) -> float:
    return theta[8] + math.cos(angle) - (1.0 + theta[8]) * math.sin(angle) / _FARTHEST


@inlined
def _two_terms(theta: FloatArray, m2: float) -> tuple[float, float]:
    return 1.0 + m2 * (theta[4] + m2 * theta[5]), 2.0 * (theta[4] + m2 * 2.0 * theta[5])


@inlined
def _two_terms_by_theta(theta: FloatArray, m2: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    J_theta[0, 4], J_theta[1, 4] = along_u * m2, along_v * m2
    J_theta[0, 5], J_theta[1, 5] = along_u * m2 * m2, along_v * m2 * m2


EXTENDED_UNIFIED = CameraModel(
    "extended_unified",
    (*FOCAL_AND_CENTRE, "alpha", "beta"),
    spread=Spread(_extended, _extended_by_theta, _extended_room),
    usual=(560.0, 0.62, 1.08),
    start=(0.5, 1.0),
)
DOUBLE_SPHERE = CameraModel(
    "double_sphere",
    (*FOCAL_AND_CENTRE, "xi", "alpha"),
    spread=Spread(_double, _double_by_theta, _double_room),
    usual=(460.0, -0.18, 0.59),
    start=(0.0, 0.5),
)
MEI_OMNI = CameraModel(
    "mei_omni",
    (*FOCAL_AND_CENTRE, "k1", "k2", "p1", "p2", "xi"),
    spread=Spread(_single, _single_by_theta, _single_room),
    radial=Radial(_two_terms, _two_terms_by_theta),
    tangential=OPENCV_TANGENTIAL,
    usual=(1260.0, -0.05, 0.08, 0.0004, -0.0007, 1.2),
    start=(0.0, 0.0, 0.0, 0.0, 1.0),
)
