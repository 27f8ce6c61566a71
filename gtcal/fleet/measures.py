"""The numbers of a result that a rig's history follows: a value with its sigma, by camera and quantity."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from gtcal.camera import FloatArray
from gtcal.results.calibration import Calibration, PoseEstimate
from gtcal.verification.verification import CameraVerification, ErrorStatistics, Verification

RIG = ""
"""In place of a camera's name: of all of them together, or of the mocap."""

BOARD = "body/board"
"""In place of a camera's name (which no camera can have): of body_T_board, the board on its body."""


@dataclass(frozen=True)
class Measure:
    """camera: a name, or ``RIG``. quantity: its name, ending with its unit. sigma: 1-sigma, None where nobody knows."""

    camera: str
    quantity: str
    value: float
    sigma: float | None


@dataclass(frozen=True)
class Pose:
    """what: a camera's name, of which it is camera_T_ref, or ``BOARD``, of which it is body_T_board.

    matrix: (4, 4). covariance: (6, 6) as of ``PoseEstimate``, or None."""

    what: str
    matrix: FloatArray
    covariance: FloatArray | None


def measures_of_verification(found: Verification) -> tuple[Measure, ...]:
    """Of each camera its RMSE and bias, and of all together the RMSE."""
    z = _sigmas_at(found.options.confidence)
    pooled = [Measure(RIG, f"rmse_{part.unit}", part.rmse, _rmse_sigma(part, z)) for part in _pooled(found)]
    of_cameras = [measure for camera in found.cameras.values() for measure in _of_camera(camera, found)]
    return tuple(measure for measure in (*pooled, *of_cameras) if math.isfinite(measure.value))


def _pooled(found: Verification) -> tuple[ErrorStatistics, ErrorStatistics]:
    return found.pooled_px, found.pooled_mm


def _sigmas_at(confidence: float) -> tuple[float, float]:
    """How many sigmas a one-sided and a two-sided bound are away."""
    return float(ndtri(confidence)), float(ndtri(0.5 + 0.5 * confidence))


def _rmse_sigma(found: ErrorStatistics, z: tuple[float, float]) -> float | None:
    return _known((found.rmse_high - found.rmse_low) / (2.0 * z[0]))


def _known(sigma: float) -> float | None:
    return float(sigma) if math.isfinite(sigma) else None


def _of_camera(camera: CameraVerification, found: Verification) -> Iterator[Measure]:
    name, z, bias = camera.camera, _sigmas_at(found.options.confidence), camera.bias
    for part in (camera.px, camera.mm):
        yield Measure(name, f"rmse_{part.unit}", part.rmse, _rmse_sigma(part, z))
    for axis, value, half in zip("xy", bias.xy_px, bias.xy_half_width_px, strict=True):
        yield Measure(name, f"bias_{axis}_px", float(value), _known(half / z[1]))
    yield Measure(name, "bias_radial_px", float(bias.radial_px), _known(bias.radial_half_width_px / z[1]))
    yield Measure(name, "bias_tangential_px", float(bias.tangential_px), _known(bias.tangential_half_width_px / z[1]))


def measures_of_calibration(found: Calibration) -> tuple[Measure, ...]:
    """Of each camera its residual and intrinsics; of the rig the pixels' and the mocap's noise."""
    of_rig = [Measure(RIG, "rmse_px", found.rmse_px, None), Measure(RIG, "sigma_px", found.sigma_px, None)]
    if found.mocap_noise is not None:
        noise = found.mocap_noise
        of_rig += [Measure(RIG, f"mocap_{body}_mm", sigma, None) for body, sigma in noise.translation_sigma_mm.items()]
        of_rig += [Measure(RIG, f"mocap_{body}_deg", sigma, None) for body, sigma in noise.rotation_sigma_deg.items()]
    of_cameras = []
    for name, camera in found.cameras.items():
        sigmas = camera.camera_with_sigmas.theta_sigmas
        known: list[float | None] = [None] * len(camera.camera.theta) if sigmas is None else sigmas.tolist()
        of_cameras.append(Measure(name, "rmse_px", camera.residuals.rmse_px, None))
        of_cameras += [
            Measure(name, parameter, float(value), sigma)
            for parameter, value, sigma in zip(
                camera.camera.model.parameter_names, camera.camera.theta, known, strict=True
            )
        ]
    return tuple(measure for measure in (*of_rig, *of_cameras) if math.isfinite(measure.value))


def poses_of(found: Calibration) -> tuple[Pose, ...]:
    """Every camera's camera_T_ref, and body_T_board."""
    of_cameras = (_pose(name, camera.camera_T_ref) for name, camera in found.cameras.items())
    return (*of_cameras, _pose(BOARD, found.body_T_board))


def _pose(what: str, pose: PoseEstimate) -> Pose:
    return Pose(what, pose.a_T_b, pose.covariance)


def remarks_of_verification(found: Verification) -> tuple[str, ...]:
    """What the errors look like, why it is no pass, and what to mind."""
    faults = [fault.sentence + (f" ({fault.caveat})" if fault.caveat else "") for fault in found.faults]
    return (*faults, *found.reasons, *found.warnings)


def remarks_of_drift(document: dict[str, Any]) -> tuple[str, ...]:
    """The first recording that fails, of a drift.json."""
    first = document["first_failing"]
    return () if first is None else (f"the first to fail is {first}",)


def as_rows(pose: Pose) -> tuple[list[float], list[float] | None]:
    """A pose as lists of numbers, row by row."""
    covariance = None if pose.covariance is None else np.asarray(pose.covariance).ravel().tolist()
    return np.asarray(pose.matrix).ravel().tolist(), covariance


def as_pose(what: str, matrix: list[float], covariance: list[float] | None) -> Pose:
    """From what ``as_rows`` gives."""
    return Pose(
        what,
        np.array(matrix, dtype=np.float64).reshape(4, 4),
        None if covariance is None else np.array(covariance, dtype=np.float64).reshape(6, 6),
    )
