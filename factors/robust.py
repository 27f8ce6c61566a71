"""Robust kernels, with the names, parameters and formulas of ``gtsam.noiseModel.mEstimator``.

The loss rho(d) and the weight w(d) = rho'(d) / d act on the whitened norm d of one corner's residual. For a norm,
which is never negative, GTSAM's two asymmetric kernels are the symmetric ones of the same name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import gtsam

from factors.kernel import kernel

_NULL, _FAIR, _HUBER, _CAUCHY, _TUKEY, _WELSCH, _GEMAN, _DCS, _DEAD_ZONE, _TRUNCATED = range(10)

_KERNEL_IDS = {
    "Null": _NULL,
    "Fair": _FAIR,
    "Huber": _HUBER,
    "Cauchy": _CAUCHY,
    "Tukey": _TUKEY,
    "Welsch": _WELSCH,
    "GemanMcClure": _GEMAN,
    "DCS": _DCS,
    "L2WithDeadZone": _DEAD_ZONE,
    "TruncatedLeastSquares": _TRUNCATED,
    "AsymmetricCauchy": _CAUCHY,
    "AsymmetricTukey": _TUKEY,
}

ROBUST_KERNELS: Mapping[str, float] = MappingProxyType(
    {
        "Null": 0.0,
        "Fair": 1.3998,
        "Huber": 1.345,
        "Cauchy": 2.3849,
        "Tukey": 4.6851,
        "Welsch": 2.9846,
        "GemanMcClure": 3.0,
        "DCS": 9.0,
        "L2WithDeadZone": 1.0,
        "TruncatedLeastSquares": 3.0,
        "AsymmetricCauchy": 2.3849,
        "AsymmetricTukey": 4.6851,
    }
)
"""Every kernel by name, and its default parameter in whitened units. For Fair to Welsch it is the one of 95 %
efficiency on Gaussian noise (Holland and Welsch 1977; Zhang 1997, table 1); for the others the kernel lets go of
a residual at about three sigma."""


@kernel
def robust_loss_and_weight(kernel_id: int, k: float, distance: float) -> tuple[float, float]:
    """rho(distance) and rho'(distance) / distance, for distance >= 0."""
    d2 = distance * distance
    if kernel_id == _NULL:
        return 0.5 * d2, 1.0
    k2 = k * k
    if kernel_id == _FAIR:
        q = distance / k
        return k2 * (q - math.log1p(q)), 1.0 / (1.0 + q)
    if kernel_id == _HUBER:
        return (0.5 * d2, 1.0) if distance <= k else (k * (distance - 0.5 * k), k / distance)
    if kernel_id == _CAUCHY:
        return 0.5 * k2 * math.log1p(d2 / k2), k2 / (k2 + d2)
    if kernel_id == _TUKEY:
        inside = 1.0 - d2 / k2
        return (k2 * (1.0 - inside**3) / 6.0, inside * inside) if distance <= k else (k2 / 6.0, 0.0)
    if kernel_id == _WELSCH:
        weight = math.exp(-d2 / k2)
        return -0.5 * k2 * math.expm1(-d2 / k2), weight
    if kernel_id == _GEMAN:
        share = k2 / (k2 + d2)
        return 0.5 * d2 * share, share * share
    if kernel_id == _DCS:
        scale = 2.0 * k / (k + d2)
        return (0.5 * d2, 1.0) if d2 <= k else (scale * d2 - 0.5 * k, scale * scale)
    if kernel_id == _DEAD_ZONE:
        over = distance - k
        return (0.5 * over * over, over / distance) if over > 0.0 else (0.0, 0.0)
    return (0.5 * d2, 1.0) if distance <= k else (0.5 * k2, 0.0)


@dataclass(frozen=True)
class RobustKernel:
    """A kernel by its name in ``gtsam.noiseModel.mEstimator`` and its parameter in whitened units.

    Raises ValueError for an unknown name or a parameter that is not positive."""

    name: str = "Null"
    parameter: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in ROBUST_KERNELS:
            raise ValueError(f"unknown robust kernel {self.name!r}; choose from {', '.join(ROBUST_KERNELS)}")
        if self.name != "Null" and not self.parameter > 0.0:
            raise ValueError(f"robust kernel {self.name}: parameter={self.parameter}, expected a positive one")

    @staticmethod
    def named(name: str) -> RobustKernel:
        """The kernel of that name with its default parameter."""
        return RobustKernel(name, ROBUST_KERNELS.get(name, 0.0))

    @property
    def kernel_id(self) -> int:
        """How ``robust_loss_and_weight`` knows it."""
        return _KERNEL_IDS[self.name]

    def noise_model(self, sigma: float, dimension: int) -> gtsam.noiseModel.Base:
        """The same kernel round isotropic Gaussian noise, as GTSAM's own noise model."""
        gaussian = gtsam.noiseModel.Isotropic.Sigma(dimension, sigma)
        if self.name == "Null":
            return gaussian
        estimator = getattr(gtsam.noiseModel.mEstimator, self.name).Create(self.parameter)
        return gtsam.noiseModel.Robust.Create(estimator, gaussian)


GAUSSIAN = RobustKernel()
"""No robust kernel: plain least squares."""
