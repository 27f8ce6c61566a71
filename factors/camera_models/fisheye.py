"""Fisheyes whose m(a) is a polynomial of the angle: m = a (1 + k a^2 + k' a^4 + ...), one formula with more or fewer
terms.

- Kannala-Brandt 4: four terms, here k1..k4 as OpenCV's fisheye and Kalibr's equidistant name them (Kannala and Brandt,
  PAMI 2006).
- Fisheye62: six terms k0..k5 and the tangential p0, p1 (Project Aria, Meta Quest). p0 and p1 stand the other way round
  from OpenCV's p1 and p2.
- Fisheye624: Fisheye62 and the thin prism s0..s3: t_u + s0 rho^2 + s1 rho^4, t_v + s2 rho^2 + s3 rho^4.
"""

from __future__ import annotations

from factors.camera_models.model import FOCAL_AND_CENTRE, CameraModel
from factors.camera_models.parts import FloatArray, Spread, Tangential, decentering, decentering_by_theta
from factors.kernel import inlined


def _polynomial(n: int) -> Spread:
    """Of n terms, theta's first after the centre."""

    @inlined
    def value(theta: FloatArray, angle: float) -> tuple[float, float]:
        w = angle * angle
        sum_, slope = theta[3 + n], (2 * n + 1) * theta[3 + n]
        for i in range(n - 1, 0, -1):
            sum_ = sum_ * w + theta[3 + i]
            slope = slope * w + (2 * i + 1) * theta[3 + i]
        return angle * (1.0 + w * sum_), 1.0 + w * slope

    @inlined
    def by_theta(theta: FloatArray, angle: float, J_theta: FloatArray, along_u: float, along_v: float) -> None:
        power = angle
        for i in range(n):
            power *= angle * angle
            J_theta[0, 4 + i], J_theta[1, 4 + i] = along_u * power, along_v * power

    return Spread(value, by_theta)


@inlined
def _decentred(theta: FloatArray, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    return decentering(theta[10], theta[11], u, v)


@inlined
def _decentred_by_theta(
    theta: FloatArray, u: float, v: float, J_theta: FloatArray, along_u: float, along_v: float
) -> None:
    decentering_by_theta(10, 11, u, v, J_theta, along_u, along_v)


@inlined
def _thin_prism(theta: FloatArray, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    tu, tv, uu, uv, vu, vv = decentering(theta[10], theta[11], u, v)
    s0, s1, s2, s3 = theta[12], theta[13], theta[14], theta[15]
    rho2 = u * u + v * v
    du = 2.0 * s0 + 4.0 * s1 * rho2
    dv = 2.0 * s2 + 4.0 * s3 * rho2
    return (
        tu + rho2 * (s0 + s1 * rho2),
        tv + rho2 * (s2 + s3 * rho2),
        uu + du * u,
        uv + du * v,
        vu + dv * u,
        vv + dv * v,
    )


@inlined
def _thin_prism_by_theta(
    theta: FloatArray, u: float, v: float, J_theta: FloatArray, along_u: float, along_v: float
) -> None:
    decentering_by_theta(10, 11, u, v, J_theta, along_u, along_v)
    rho2 = u * u + v * v
    J_theta[0, 12], J_theta[0, 13], J_theta[0, 14], J_theta[0, 15] = along_u * rho2, along_u * rho2 * rho2, 0.0, 0.0
    J_theta[1, 12], J_theta[1, 13], J_theta[1, 14], J_theta[1, 15] = 0.0, 0.0, along_v * rho2, along_v * rho2 * rho2


_SIX_TERMS = (*FOCAL_AND_CENTRE, "k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1")
_USUAL = (0.031, -0.029, 0.011, -0.007, 0.0024, -0.00034, 0.0003, -0.0002)

KANNALA_BRANDT4 = CameraModel(
    "kannala_brandt4",
    (*FOCAL_AND_CENTRE, "k1", "k2", "k3", "k4"),
    spread=_polynomial(4),
    usual=(560.0, -0.012, 0.004, -0.003, 0.0004),
)
FISHEYE62 = CameraModel(
    "fisheye62",
    _SIX_TERMS,
    spread=_polynomial(6),
    tangential=Tangential(_decentred, _decentred_by_theta),
    usual=(560.0, *_USUAL),
    extends=KANNALA_BRANDT4,
)
FISHEYE624 = CameraModel(
    "fisheye624",
    (*_SIX_TERMS, "s0", "s1", "s2", "s3"),
    spread=_polynomial(6),
    tangential=Tangential(_thin_prism, _thin_prism_by_theta),
    usual=(560.0, *_USUAL, 0.0004, -0.0001, -0.0003, 0.0002),
    extends=FISHEYE62,
)
