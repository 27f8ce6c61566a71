"""What an earlier calibration of the same rig knows: its poses, intrinsics and board with their joint covariance, less
sure by the day."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import gtsam
import numpy as np

from factors import JointPriorFactor
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.graph import BOARD_SHAPE, BODY_T_BOARD, camera_T_ref_key, theta_key
from gtcal.estimation.lens_sigmas import FACTORY_FOCAL, FACTORY_PX, sigmas_of

if TYPE_CHECKING:
    from gtcal.results.calibration import Calibration
    from gtcal.results.covariance import JointCovariance

_OPEN_RAD, _OPEN_M = 0.1, 0.1
"""1-sigma of where ref is, where it was defined anew: nothing is known of it beside the cameras themselves."""

_LEAST_DAYS = 1.0


@dataclass(frozen=True)
class Growth:
    """By how much less is known of a rig after a day, 1-sigma, as a random walk: so many times the root of the days.

    mm, deg: of each camera on its rig, and of the board on its body. lens: of the intrinsics, as a share of what a
    factory's values are off by. days: since the earlier calibration.

    Raises GtcalError for a number that is negative, or not finite."""

    mm: float = 0.1
    deg: float = 0.01
    lens: float = 0.1
    days: float = _LEAST_DAYS

    def __post_init__(self) -> None:
        for name in ("mm", "deg", "lens", "days"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise GtcalError(f"growth: {name} is {getattr(self, name)}, not zero or a positive number")

    @property
    def root_of_days(self) -> float:
        return float(np.sqrt(max(self.days, _LEAST_DAYS)))

    @property
    def of_pose(self) -> FloatArray:
        """(6, 6) what is added to the covariance of a pose, in the tangent of the frame that drifts."""
        sigmas = [np.deg2rad(self.deg)] * 3 + [1e-3 * self.mm] * 3
        return np.diag(np.square(sigmas)) * self.root_of_days**2


SAME_DAY = Growth(mm=0.0, deg=0.0, lens=0.0, days=0.0)
"""Of recordings that were taken one after the other."""


@dataclass(frozen=True)
class Earlier:
    """What is known of some unknowns together.

    body_T_board, board_shape: None where nothing is known of it. camera_T_ref, theta: of the cameras of which
    something is. covariance: (D, D), columns X, each Y_c, each theta_c, the board's shape, as far as they are there."""

    body_T_board: FloatArray | None
    camera_T_ref: Mapping[str, FloatArray]
    theta: Mapping[str, FloatArray]
    board_shape: FloatArray | None
    covariance: FloatArray = field(repr=False)

    @staticmethod
    def of(calibration: Calibration) -> Earlier:
        """All that a calibration knows; of the board's shape apart from the rest.

        Raises GtcalError where it has no covariance."""
        joint, cameras = _joint_of(calibration), calibration.cameras
        shape = calibration.board_shape
        n, n_shape = len(joint.matrix), 0 if shape is None else len(shape.shape)
        covariance = np.zeros((n + n_shape, n + n_shape))
        covariance[:n, :n] = joint.matrix
        if shape is not None:
            covariance[n:, n:] = shape.covariance
        return Earlier(
            calibration.body_T_board.a_T_b,
            {name: camera.camera_T_ref.a_T_b for name, camera in cameras.items()},
            {name: cameras[name].camera.theta for name, size in joint.theta_sizes.items() if size},
            None if shape is None else shape.shape,
            covariance,
        )

    @property
    def kept(self) -> tuple[str, ...]:
        """What something is known of, in words."""
        return tuple(what for what, _, _ in self._blocks())

    def only(self, keep: Callable[[str], bool]) -> Earlier:
        """What is known of the things that are to be kept, by their words: 'board', a camera's name, 'intrinsics of
        NAME', 'shape of the board'."""
        kept = [(what, columns) for what, columns, _ in self._blocks() if keep(what)]
        words = {what for what, _ in kept}
        rows = np.concatenate([np.arange(0), *(np.arange(columns.start, columns.stop) for _, columns in kept)])
        rows = rows.astype(np.int64)
        return Earlier(
            self.body_T_board if BOARD in words else None,
            {name: pose for name, pose in self.camera_T_ref.items() if name in words},
            {name: theta for name, theta in self.theta.items() if intrinsics_of(name) in words},
            self.board_shape if SHAPE in words else None,
            self.covariance[np.ix_(rows, rows)],
        )

    def in_another_ref(self, new_ref_T_ref: FloatArray) -> Earlier:
        """With the cameras in a ref that was defined anew, of whose place only they tell."""
        into = gtsam.Pose3(new_ref_T_ref).AdjointMap()
        J, opened = np.eye(len(self.covariance)), np.zeros((len(self.covariance), 6))
        for what, columns, _ in self._blocks():
            if what in self.camera_T_ref:
                J[columns, columns], opened[columns] = into, np.eye(6)
        of_ref = np.diag([_OPEN_RAD**2] * 3 + [_OPEN_M**2] * 3)
        return replace(
            self,
            camera_T_ref={name: pose @ inverse(new_ref_T_ref) for name, pose in self.camera_T_ref.items()},
            covariance=J @ self.covariance @ J.T + opened @ of_ref @ opened.T,
        )

    def theta_sigmas(self, camera: str) -> FloatArray:
        """(K,) Raises KeyError where nothing is known of its intrinsics."""
        (columns,) = (columns for what, columns, _ in self._blocks() if what == intrinsics_of(camera))
        return np.sqrt(np.diag(self.covariance)[columns])

    def factor(self, index: Mapping[str, int], weight: float = 1.0) -> gtsam.NonlinearFactor | None:
        """Of the cameras that the recording has, by their place in it; ``weight`` times the information. None where
        nothing is known of them."""
        here = self.only(lambda what: what.removeprefix(_INTRINSICS_OF) in {*index, BOARD, SHAPE})
        blocks = list(here._blocks())
        if not blocks:
            return None
        keys = [_key(what, index) for what, _, _ in blocks]
        return JointPriorFactor(keys, [mean for _, _, mean in blocks], here.covariance / weight)

    def _blocks(self) -> Iterator[tuple[str, slice, FloatArray]]:
        """Each unknown in words, its columns and its mean."""
        start = 0
        means = {
            **({} if self.body_T_board is None else {BOARD: self.body_T_board}),
            **self.camera_T_ref,
            **{intrinsics_of(name): theta for name, theta in self.theta.items()},
            **({} if self.board_shape is None else {SHAPE: self.board_shape}),
        }
        for what, mean in means.items():
            size = 6 if mean.ndim == 2 else len(mean)
            yield what, slice(start, start + size), mean
            start += size


BOARD, SHAPE, _INTRINSICS_OF = "board", "shape of the board", "intrinsics of "


def intrinsics_of(camera: str) -> str:
    """Of which intrinsics, in words."""
    return f"{_INTRINSICS_OF}{camera}"


def _key(what: str, index: Mapping[str, int]) -> int:
    if what in (BOARD, SHAPE):
        return BODY_T_BOARD if what == BOARD else BOARD_SHAPE
    camera = what.removeprefix(_INTRINSICS_OF)
    return camera_T_ref_key(index[camera]) if camera == what else theta_key(index[camera])


def grown(calibration: Calibration, growth: Growth) -> Calibration:
    """A calibration as sure as it is after some days. Raises GtcalError where it has no covariance."""
    joint = _joint_of(calibration)
    return calibration.with_covariance(replace(joint, matrix=joint.matrix + _added(calibration, joint, growth)))


def _joint_of(calibration: Calibration) -> JointCovariance:
    if calibration.covariance is None:
        raise GtcalError("the earlier calibration has no covariance, as without stage 3: there is nothing to take")
    return calibration.covariance


def _added(calibration: Calibration, joint: JointCovariance, growth: Growth) -> FloatArray:
    added = np.zeros_like(joint.matrix)
    added[joint.columns_of_body_T_board, joint.columns_of_body_T_board] = growth.of_pose
    for name, camera in calibration.cameras.items():
        of_pose, of_theta = joint.columns_of_camera_T_ref(name), joint.columns_of_theta(name)
        into = gtsam.Pose3(inverse(camera.camera_T_ref.a_T_b)).AdjointMap()  # the camera drifts in its own frame
        added[of_pose, of_pose] = into @ growth.of_pose @ into.T
        if joint.theta_sizes[name]:
            share = growth.lens * growth.root_of_days
            sigmas = sigmas_of(camera.camera, share * FACTORY_FOCAL, share * FACTORY_PX)
            added[of_theta, of_theta] = np.diag(sigmas**2)
    return added
