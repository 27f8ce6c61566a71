"""What is known beforehand: of X, of a camera's place, of two cameras' relative place, of intrinsics.

A pose is stated as a person states it: where b is in a, and how sure that is along and about the axes of b.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import gtsam
import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

from factors import PoseMeasurementFactor, factory_intrinsics_prior
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.earlier import Earlier
from gtcal.estimation.graph import BODY_T_BOARD, camera_T_ref_key, theta_key

UNLIKELY = 1e-3
"""A prior whose residual exceeds what chance lets one in a thousand is said to contradict the data."""


@dataclass(frozen=True)
class PosePrior:
    """Where b is in a: the position of b's origin in a and the rotation a_R_b.

    sigma_m, sigma_rad: (3,) 1-sigma along and about the axes of b; None where nothing is known of a component.

    Raises GtcalError for a sigma that is not positive or a quaternion of another length than one."""

    position_m: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]
    sigma_m: tuple[float | None, float | None, float | None]
    sigma_rad: tuple[float | None, float | None, float | None]

    def __post_init__(self) -> None:
        for name in ("sigma_m", "sigma_rad"):
            if not all(sigma is None or sigma > 0.0 for sigma in getattr(self, name)):
                raise GtcalError(f"{name}: {getattr(self, name)} holds what is no positive number")
        if abs(np.linalg.norm(self.quat_wxyz) - 1.0) > 1e-3:
            raise GtcalError(f"quat_wxyz: {self.quat_wxyz} is not of length 1")

    @property
    def a_T_b(self) -> FloatArray:
        """(4, 4)."""
        w, x, y, z = self.quat_wxyz
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), self.position_m
        return matrix

    @property
    def weights(self) -> FloatArray:
        """(6,) 1/sigma, rotation first; 0 where nothing is known."""
        return np.array([0.0 if sigma is None else 1.0 / sigma for sigma in (*self.sigma_rad, *self.sigma_m)])


@dataclass(frozen=True)
class Priors:
    """All that is known beforehand.

    body_T_board: X. ref_T_camera: by camera. camera_a_T_camera_b: by (a, b).
    intrinsics: by camera, by parameter: (value, sigma), in the parameter's unit.
    earlier: what an earlier calibration knows of all of it together."""

    body_T_board: PosePrior | None = None
    ref_T_camera: Mapping[str, PosePrior] = field(default_factory=dict)
    camera_a_T_camera_b: Mapping[tuple[str, str], PosePrior] = field(default_factory=dict)
    intrinsics: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    earlier: Earlier | None = None

    @property
    def of_poses(self) -> bool:
        """Whether anything is known of a pose."""
        earlier = self.earlier is not None and (self.earlier.body_T_board is not None or self.earlier.camera_T_ref)
        return bool(self.body_T_board or self.ref_T_camera or self.camera_a_T_camera_b or earlier)

    def __bool__(self) -> bool:
        return self.of_poses or bool(self.intrinsics) or self.earlier is not None

    def document(self) -> dict[str, object]:
        """As JSON knows it."""
        between = {f"{a} {b}": vars(prior) for (a, b), prior in self.camera_a_T_camera_b.items()}
        return {
            "body_T_board": vars(self.body_T_board) if self.body_T_board else None,
            "ref_T_camera": {name: vars(prior) for name, prior in self.ref_T_camera.items()},
            "camera_a_T_camera_b": between,
            "intrinsics": {name: dict(known) for name, known in self.intrinsics.items()},
            "earlier": None if self.earlier is None else list(self.earlier.kept),
        }


def prior_factors(
    priors: Priors, cameras: Mapping[str, Camera], *, free_theta: bool, weight: float = 1.0
) -> Iterator[tuple[str, gtsam.NonlinearFactor]]:
    """A factor for each prior, with what it is of, in words. cameras: in the order of the recording. weight: how many
    times its information what an earlier calibration knows counts.

    Raises GtcalError for a camera or a parameter that is not there, or intrinsics that are fixed."""
    index = {name: i for i, name in enumerate(cameras)}
    for name in [*priors.ref_T_camera, *priors.intrinsics, *(n for pair in priors.camera_a_T_camera_b for n in pair)]:
        if name not in cameras:
            raise GtcalError(f"a prior is of camera {name!r}, which is not there; cameras: {', '.join(cameras)}")
    if priors.body_T_board:
        prior = priors.body_T_board
        yield "the board's pose", PoseMeasurementFactor([(BODY_T_BOARD, False)], prior.a_T_b, prior.weights)
    for name, prior in priors.ref_T_camera.items():
        chain = [(camera_T_ref_key(index[name]), True)]
        yield f"the pose of {name}", PoseMeasurementFactor(chain, prior.a_T_b, prior.weights)
    for (a, b), prior in priors.camera_a_T_camera_b.items():
        chain = [(camera_T_ref_key(index[a]), False), (camera_T_ref_key(index[b]), True)]
        yield f"the pose of {b} in {a}", PoseMeasurementFactor(chain, prior.a_T_b, prior.weights)
    for name, known in priors.intrinsics.items():
        if not free_theta:
            raise GtcalError(f"a prior is of the intrinsics of {name!r}, but they are fixed: refine them")
        yield f"the intrinsics of {name}", _intrinsics_factor(theta_key(index[name]), cameras[name], known)
    if priors.earlier is not None:
        factor = priors.earlier.factor(index, weight)
        if factor is not None:
            yield "what an earlier calibration knows", factor


def _intrinsics_factor(key: int, camera: Camera, known: Mapping[str, tuple[float, float]]) -> gtsam.NonlinearFactor:
    names = camera.model.parameter_names
    values, sigmas = camera.theta.copy(), np.full(len(names), np.inf)
    for parameter, (value, sigma) in known.items():
        if parameter not in names:
            raise GtcalError(
                f"a prior is of {parameter!r} of camera {camera.name!r}; {camera.model.name} has {', '.join(names)}"
            )
        if not sigma > 0.0:
            raise GtcalError(f"the prior's sigma of {parameter!r} of camera {camera.name!r} is {sigma}, not positive")
        values[names.index(parameter)], sigmas[names.index(parameter)] = value, sigma
    return factory_intrinsics_prior(key, values, sigmas)


def contradictions(
    priors: Priors, cameras: Mapping[str, Camera], values: gtsam.Values, *, free_theta: bool
) -> tuple[str, ...]:
    """A warning for each prior that the data pull away from by more than its sigmas allow."""
    found = []
    for what, factor in prior_factors(priors, cameras, free_theta=free_theta):
        distance = float(np.sqrt(2.0 * factor.error(values)))
        if distance > np.sqrt(special.chdtri(_n_known(factor, values), UNLIKELY)):
            found.append(f"the prior on {what} and the data contradict each other: it ends {distance:.1f} sigma off")
    return tuple(found)


def _n_known(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> int:
    """The components that a prior says something of."""
    jacobian, _ = factor.linearize(values).jacobian()
    return int(np.any(jacobian != 0.0, axis=1).sum())
