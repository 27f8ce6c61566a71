"""Two calibrations from two halves of a recording: do they differ by more than the covariance of the whole recording
says?

That covariance is what the user relies on, and half of a short recording may be too little to have a true one of its
own. The halves' covariances give the shape of what is expected, the whole one's gives the size: C_1 and C_2 combine to
M = (C_1^-1 + C_2^-1)^-1, and (C_1 + C_2) (det C / det M)^(1 / dof) is what the difference is held against."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy import special

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.linear import squared_distance
from gtcal.results.calibration import Calibration, pose_difference
from gtcal.results.covariance import JointCovariance

UNLIKELY = 0.01
"""Halves that differ by more than chance lets one recording in a hundred."""


@dataclass(frozen=True)
class Difference:
    """Between the halves, of a camera's pose (``camera``), its intrinsics, the board's pose, or all of it.

    distance2: squared, in units of what the covariance of the whole recording lets expect; dof: its degrees of freedom.
    position_mm, angle_deg: of a pose, else NaN."""

    what: str
    distance2: float
    dof: int
    position_mm: float = float("nan")
    angle_deg: float = float("nan")

    @property
    def probability(self) -> float:
        """Of a difference as large or larger, were the covariances true."""
        return float(special.chdtrc(self.dof, self.distance2))

    @property
    def per_dof(self) -> float:
        """1, where the covariances are true."""
        return self.distance2 / self.dof


@dataclass(frozen=True)
class SplitHalf:
    """overall: of all unknowns jointly. by_unknown: of each alone."""

    overall: Difference
    by_unknown: tuple[Difference, ...]

    @property
    def agrees(self) -> bool:
        return self.overall.probability >= UNLIKELY

    @property
    def statement(self) -> str:
        """The outcome in a sentence."""
        expected = "what the whole recording's covariance lets expect"
        found = f"the halves differ by {np.sqrt(self.overall.per_dof):.2f} of {expected}"
        if self.agrees:
            return f"{found}: they agree"
        worst = max(self.by_unknown, key=lambda difference: difference.per_dof)
        return (
            f"{found} (chance of that: {self.overall.probability:.1g}), {worst.what} most: something moved or drifted "
            "during the recording, or errs systematically, and the stated sigmas are too small"
        )


def split_half(first: Calibration, second: Calibration, whole: Calibration | None = None) -> SplitHalf:
    """Compare the calibrations of two halves of a recording by the covariance of all of it; by the sum of their own,
    where that is not given.

    Raises GtcalError where one has no covariance."""
    own_first, own_second = _covariance(first), _covariance(second)
    expected = own_first.matrix + own_second.matrix
    if whole is not None:
        expected = _sized(expected, own_first.matrix, own_second.matrix, _covariance(whole).matrix)
    unknowns = list(_deviations(first, second, own_first))
    by_unknown = tuple(_difference(what, xi, expected[own, own], first, second) for what, own, xi in unknowns)
    overall = _difference("all", np.concatenate([xi for *_, xi in unknowns]), expected, first, second)
    return SplitHalf(overall, by_unknown)


def _covariance(calibration: Calibration) -> JointCovariance:
    if calibration.covariance is None:
        raise GtcalError("half of the recording leaves a direction open: record longer")
    return calibration.covariance


def _sized(expected: FloatArray, first: FloatArray, second: FloatArray, whole: FloatArray) -> FloatArray:
    """(P, P) the expected covariance of the halves' difference, as large as the whole recording's covariance says."""
    scale = np.diag(1.0 / np.sqrt(np.diag(whole)))
    first, second, whole = (scale @ matrix @ scale for matrix in (first, second, whole))
    information = np.linalg.inv(first) + np.linalg.inv(second)
    size = np.exp((np.linalg.slogdet(whole)[1] + np.linalg.slogdet(information)[1]) / len(whole))
    return np.asarray(size * expected)


def _deviations(
    first: Calibration, second: Calibration, joint: JointCovariance
) -> Iterator[tuple[str, slice, FloatArray]]:
    """Each unknown, its columns in the joint covariance, and xi with first * Exp(xi) = second."""
    yield "board", joint.columns_of_body_T_board, _xi(first.body_T_board.a_T_b, second.body_T_board.a_T_b)
    for name, camera in first.cameras.items():
        other = second.cameras[name]
        xi = _xi(camera.camera_T_ref.a_T_b, other.camera_T_ref.a_T_b)
        yield name, joint.columns_of_camera_T_ref(name), xi
    for name, camera in first.cameras.items():
        if joint.theta_sizes[name]:
            theta = second.cameras[name].camera.theta - camera.camera.theta
            yield f"intrinsics of {name}", joint.columns_of_theta(name), theta


def _xi(first_T: FloatArray, second_T: FloatArray) -> FloatArray:
    return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(inverse(first_T) @ second_T)))


def _difference(
    what: str, xi: FloatArray, covariance: FloatArray, first: Calibration, second: Calibration
) -> Difference:
    distance2 = squared_distance(xi, covariance)
    if what == "board":
        return Difference(what, distance2, 6, *pose_difference(first.body_T_board.a_T_b, second.body_T_board.a_T_b))
    if what in first.cameras:
        poses = (inverse(found.cameras[what].camera_T_ref.a_T_b) for found in (first, second))
        return Difference(what, distance2, 6, *pose_difference(*poses))
    return Difference(what, distance2, len(xi))
