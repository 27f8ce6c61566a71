"""Robust kernels, with the names, parameters and formulas of ``gtsam.noiseModel.mEstimator``; and any other estimator
of GTSAM's, one's own ``mEstimator.Custom`` too, called back from Python.

The loss rho(d) and the weight w(d) = rho'(d) / d act on the whitened norm d of one corner's residual. For a norm,
which is never negative, GTSAM's two asymmetric kernels are the symmetric ones of the same name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from factors.kernel import kernel

_NULL, _FAIR, _HUBER, _CAUCHY, _TUKEY, _WELSCH, _GEMAN, _DCS, _DEAD_ZONE, _TRUNCATED = range(10)
CALLED_BACK, MEASURED = 10, 11
"""In place of a compiled kernel: loss and weight of each corner are given; only its distance is asked for."""

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

_PROBED = np.concatenate([np.geomspace(0.05, 50.0, 40), [0.77, 1.83]])
_SLOPE_STEP, _SAME_SLOPE, _KINKS = 1e-4, 1e-3, 0.25
"""Where a kernel's slope is looked at, how near weight times distance must be to it, and at what share of the distances
it need not be: kernels have kinks."""


@dataclass(frozen=True)
class CalledBackKernel:
    """Any estimator of ``gtsam.noiseModel.mEstimator``, one's own too. Its Python or C++ functions are called back for
    every corner at every evaluation: a calibration takes about twice as long as with a ``RobustKernel``, which is
    compiled.

    Raises ValueError where it weighs each coordinate by itself, or its loss and weight can't be of one kernel."""

    estimator: Any  # an mEstimator.Base, whose stub lacks loss and weight

    def __post_init__(self) -> None:
        _check_acts_on_the_norm(self.estimator)
        _check_slope(self.estimator)

    @property
    def name(self) -> str:
        """As GTSAM calls it."""
        return type(self.estimator).__name__

    @property
    def kernel_id(self) -> int:
        return CALLED_BACK

    @property
    def parameter(self) -> float:
        """None that is known."""
        return math.nan

    def document(self) -> dict[str, object]:
        """What a file can hold of it."""
        return {"name": self.name, "called_back": True}

    def losses_and_weights(self, distances: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """(N, 2) rho and rho' / distance at distances (N,). Raises ValueError where one is not a finite number."""
        loss, weight = self.estimator.loss, self.estimator.weight
        pairs = np.array([(loss(d), weight(d)) for d in distances.tolist()]).reshape(-1, 2)
        if not np.isfinite(pairs).all():
            at = distances[np.argmin(np.isfinite(pairs).all(axis=1))]
            raise ValueError(f"robust kernel {self.name}: loss or weight at {at:g} sigmas is not a finite number")
        return pairs

    def noise_model(self, sigma: float, dimension: int) -> gtsam.noiseModel.Base:
        """As ``RobustKernel.noise_model``."""
        return gtsam.noiseModel.Robust.Create(self.estimator, gtsam.noiseModel.Isotropic.Sigma(dimension, sigma))


AnyKernel = RobustKernel | CalledBackKernel


def kernel_of(given: object) -> AnyKernel:
    """The kernel that a name, a kernel or an estimator of ``gtsam.noiseModel.mEstimator`` stands for: compiled where
    there is a compiled one with the same loss and weight, else called back.

    Raises ValueError for anything else, in one line."""
    if isinstance(given, AnyKernel):
        return given
    if isinstance(given, str):
        return RobustKernel.named(given)
    if not isinstance(given, gtsam.noiseModel.mEstimator.Base):
        raise ValueError(
            f"robust kernel {' '.join(repr(given).split())}: expected a name ({', '.join(ROBUST_KERNELS)}), a "
            "factors.RobustKernel, or an estimator of gtsam.noiseModel.mEstimator"
        )
    called_back = CalledBackKernel(given)
    return _compiled(called_back) or called_back


def _compiled(called_back: CalledBackKernel) -> RobustKernel | None:
    """The compiled kernel of the same name that gives the same loss and weight."""
    if called_back.name not in ROBUST_KERNELS:
        return None
    if called_back.name == "Null":
        return GAUSSIAN
    _, _, _, _, parameter, *_ = called_back.estimator.serialize().splitlines()[1].split()
    found = RobustKernel(called_back.name, float(parameter))
    ours = [robust_loss_and_weight(found.kernel_id, found.parameter, d) for d in _PROBED.tolist()]
    same = np.allclose(ours, called_back.losses_and_weights(_PROBED), rtol=1e-9, atol=1e-12)
    return found if same else None


def _check_acts_on_the_norm(estimator: Any) -> None:
    model = gtsam.noiseModel.Robust.Create(estimator, gtsam.noiseModel.Unit.Create(2))
    residuals = _PROBED[:, None] * (0.6, 0.8)
    scales = np.array([model.whiten(residual) for residual in residuals]) / residuals
    if not np.allclose(scales[:, 0], scales[:, 1], rtol=1e-9, equal_nan=True):
        raise ValueError(
            f"robust kernel {type(estimator).__name__}: weighs each coordinate by itself; a corner is weighed by its "
            "residual's length: create it with ReweightScheme.Block"
        )


def _check_slope(estimator: Any) -> None:
    """weight(d) d is the slope of loss(d), or there is no minimum to find."""
    name = type(estimator).__name__
    above, below, here = (
        np.array([(estimator.loss(d), estimator.weight(d)) for d in (_PROBED * scale).tolist()])
        for scale in (1.0 + _SLOPE_STEP, 1.0 - _SLOPE_STEP, 1.0)
    )
    if not np.isfinite([above, below, here]).all() or (here < 0.0).any():
        raise ValueError(f"robust kernel {name}: its loss and weight are not finite numbers from 0 on at all distances")
    slope, stated = (above[:, 0] - below[:, 0]) / (2.0 * _SLOPE_STEP * _PROBED), _PROBED * here[:, 1]
    off = np.abs(slope - stated) > _SAME_SLOPE * np.maximum(np.abs(slope), 1e-3)
    if off.mean() > _KINKS:
        at = int(np.argmax(off))
        raise ValueError(
            f"robust kernel {name}: at {_PROBED[at]:.3g} sigmas its weight times the distance is {stated[at]:.4g}, but "
            f"its loss has the slope {slope[at]:.4g}; expected weight = loss' / distance"
        )
