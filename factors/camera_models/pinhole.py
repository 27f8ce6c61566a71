"""OpenCV's perspective models, their coefficients in OpenCV's order.

- Radial-tangential: s = 1 + k1 r^2 + k2 r^4 + k3 r^6, and p1, p2.
- Rational: s = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), and p1, p2 (OpenCV's
  CALIB_RATIONAL_MODEL, ROS's rational_polynomial, COLMAP's FULL_OPENCV, the Brown-Conrady lenses of Azure Kinect and
  RealSense).
"""

from __future__ import annotations

from factors.camera_models.model import FOCAL_AND_CENTRE, CameraModel
from factors.camera_models.parts import FloatArray, Radial, Tangential, decentering, decentering_by_theta
from factors.kernel import inlined

_LARGEST_SCALE = 100.0  # s, on the way to a pole


@inlined
def _polynomial(theta: FloatArray, m2: float) -> tuple[float, float]:
    k1, k2, k3 = theta[4], theta[5], theta[8]
    return 1.0 + m2 * (k1 + m2 * (k2 + m2 * k3)), 2.0 * (k1 + m2 * (2.0 * k2 + m2 * 3.0 * k3))


@inlined
def _polynomial_by_theta(theta: FloatArray, m2: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    J_theta[0, 4], J_theta[1, 4] = along_u * m2, along_v * m2
    J_theta[0, 5], J_theta[1, 5] = along_u * m2 * m2, along_v * m2 * m2
    J_theta[0, 8], J_theta[1, 8] = along_u * m2 * m2 * m2, along_v * m2 * m2 * m2


@inlined
def _rational(theta: FloatArray, m2: float) -> tuple[float, float]:
    k4, k5, k6 = theta[9], theta[10], theta[11]
    above, above_slope = _polynomial(theta, m2)
    below = 1.0 + m2 * (k4 + m2 * (k5 + m2 * k6))
    if below <= 0.0:  # past a pole the image comes back from infinity
        return 0.0, -1.0
    below_slope = 2.0 * (k4 + m2 * (2.0 * k5 + m2 * 3.0 * k6))
    scale = above / below
    return scale, (above_slope - scale * below_slope) / below


@inlined
def _rational_by_theta(theta: FloatArray, m2: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
    above, _ = _polynomial(theta, m2)
    below = 1.0 + m2 * (theta[9] + m2 * (theta[10] + m2 * theta[11]))
    _polynomial_by_theta(theta, m2, J_theta, along_u / below, along_v / below)
    power = -above / (below * below)
    for i in range(9, 12):
        power *= m2
        J_theta[0, i], J_theta[1, i] = along_u * power, along_v * power


@inlined
def _rational_room(theta: FloatArray, m2: float) -> float:
    above, _ = _polynomial(theta, m2)
    return 1.0 + m2 * (theta[9] + m2 * (theta[10] + m2 * theta[11])) - above / _LARGEST_SCALE


@inlined
def _decentred(theta: FloatArray, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    return decentering(theta[7], theta[6], u, v)


@inlined
def _decentred_by_theta(
    theta: FloatArray, u: float, v: float, J_theta: FloatArray, along_u: float, along_v: float
) -> None:
    decentering_by_theta(7, 6, u, v, J_theta, along_u, along_v)


OPENCV_TANGENTIAL = Tangential(_decentred, _decentred_by_theta)
"""p1 and p2 in the columns 6 and 7."""

_FIVE = (*FOCAL_AND_CENTRE, "k1", "k2", "p1", "p2", "k3")

PINHOLE_RADTAN = CameraModel(
    "pinhole_radtan",
    _FIVE,
    radial=Radial(_polynomial, _polynomial_by_theta),
    tangential=OPENCV_TANGENTIAL,
    usual=(710.0, -0.11, 0.07, 0.0004, -0.0007, -0.012),
)
PINHOLE_RATIONAL = CameraModel(
    "pinhole_rational",
    (*_FIVE, "k4", "k5", "k6"),
    radial=Radial(_rational, _rational_by_theta, _rational_room),
    tangential=OPENCV_TANGENTIAL,
    usual=(710.0, 0.52, -0.41, 0.0004, -0.0007, 0.13, 0.63, -0.36, 0.06),
    extends=PINHOLE_RADTAN,
)
