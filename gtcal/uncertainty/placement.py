"""What a joint covariance is of: where the board and the cameras are, and the measures that people take of a change.

A tangent's translation runs along the axes of a frame that has turned, about an origin that may be far away, and a
distortion coefficient means nothing by itself. So changes are taken where they are understood: of the board's centre
in its body in mm, of a camera's position in ref in mm, of attitudes in deg, and of the lens as what it does to the
image in px (root mean square over the image). Divided by ``UNIT_MM``, ``UNIT_DEG`` and ``UNIT_PX``, they compare.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.rigid import skew
from gtcal.board import board_from_manifest
from gtcal.camera import Camera, FloatArray
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration
from gtcal.uncertainty.projected import image_grid

UNIT_MM, UNIT_DEG, UNIT_PX = 2.0, 0.2, 1.0
"""What weighs the same. 0.2 deg are 2 mm at 0.6 m; a 1-sigma from there on is no ground truth."""

_CELLS_ACROSS = 40
_LEAST_EFFECT = 1e-9


@dataclass(frozen=True)
class Placement:
    """board_centre_m: (3,) in the board. body_T_board: (4, 4). cameras: with their intrinsics, by name.
    camera_T_ref: (4, 4) by name. theta_sizes: by name the number of intrinsics that were solved for, or 0."""

    capture: Capture
    board_centre_m: FloatArray
    body_T_board: FloatArray
    cameras: Mapping[str, Camera]
    camera_T_ref: Mapping[str, FloatArray]
    theta_sizes: Mapping[str, int]

    @staticmethod
    def of(calibration: Calibration) -> Placement:
        cameras = calibration.cameras
        joint = calibration.covariance
        return Placement(
            capture=calibration.capture,
            board_centre_m=board_from_manifest(calibration.board).corners_m.mean(axis=0),
            body_T_board=calibration.body_T_board.a_T_b,
            cameras={name: found.camera for name, found in cameras.items()},
            camera_T_ref={name: found.camera_T_ref.a_T_b for name, found in cameras.items()},
            theta_sizes=joint.theta_sizes if joint is not None else dict.fromkeys(cameras, 0),
        )

    @cached_property
    def measures(self) -> FloatArray:
        """(P, P) that takes a change in the tangents of a ``JointCovariance`` to the comparable measures: of the board
        its turn about and its centre's shift along the axes of the body, of each camera its turn about its own axes
        and its shift along the axes of ref, and of each lens numbers whose length is the rms shift of the pixels."""
        blocks = [self._of_board()]
        blocks += [_of_camera(self.camera_T_ref[name]) for name in self.cameras]
        blocks += [self.lens_effect(name) / UNIT_PX for name, size in self.theta_sizes.items() if size]
        total = np.zeros((sum(map(len, blocks)),) * 2)
        start = 0
        for block in blocks:
            end = start + len(block)
            total[start:end, start:end] = block
            start = end
        return total

    @property
    def blocks(self) -> list[IntArray]:
        """Columns of the board, then of each camera with its lens."""
        found = [np.arange(6)]
        start = 6 + 6 * len(self.cameras)
        for index, name in enumerate(self.cameras):
            lens = np.arange(start, start + self.theta_sizes[name])
            found.append(np.concatenate([6 + 6 * index + np.arange(6), lens]))
            start += len(lens)
        return found

    def lens_effect(self, camera: str) -> FloatArray:
        """(K, K) that takes a change of theta to numbers whose length is the rms shift of the image's pixels."""
        J = self.lens_jacobian(camera)
        # Of a parameter that moves no pixel nothing is asked, but the measures have to stay invertible.
        values, vectors = np.linalg.eigh(np.einsum("nik,nil->kl", J, J) / max(len(J), 1))
        return np.sqrt(np.maximum(values, _LEAST_EFFECT**2))[:, None] * vectors.T

    def lens_jacobian(self, camera: str) -> FloatArray:
        """(N, 2, K) of pixels all over the image, those that the lens has."""
        found = self.cameras[camera]
        x_px, y_px = image_grid(found, _CELLS_ACROSS)
        bearings, valid = found.unproject(np.stack([axis.ravel() for axis in np.meshgrid(x_px, y_px)], axis=1))
        _, valid, _, J_theta = found.model.project_with_jacobians(bearings[valid], found.theta)
        return J_theta[valid]

    def _of_board(self) -> FloatArray:
        """body_T_board * Exp(xi) turns by R rotation, and moves the centre c by R (rotation x c + translation)."""
        R = self.body_T_board[:3, :3]
        J = np.zeros((6, 6))
        J[:3, :3] = R * (np.rad2deg(1.0) / UNIT_DEG)
        J[3:, :3] = -R @ skew(self.board_centre_m) * (1e3 / UNIT_MM)
        J[3:, 3:] = R * (1e3 / UNIT_MM)
        return J


def _of_camera(camera_T_ref: FloatArray) -> FloatArray:
    """camera_T_ref * Exp(xi) turns by R rotation, and moves the camera's position p by p x rotation - translation."""
    R, t = camera_T_ref[:3, :3], camera_T_ref[:3, 3]
    J = np.zeros((6, 6))
    J[:3, :3] = R * (np.rad2deg(1.0) / UNIT_DEG)
    J[3:, :3] = skew(-R.T @ t) * (1e3 / UNIT_MM)
    J[3:, 3:] = -np.eye(3) * (1e3 / UNIT_MM)
    return J
