"""A change of the whole result, told of the board and of each camera in mm, deg and px."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.uncertainty.placement import UNIT_DEG, UNIT_MM, UNIT_PX, Placement


@dataclass(frozen=True)
class BoardMotion:
    """How the board moves in its body, along and about the body's axes.

    turn_deg: (3,). shift_mm: (3,) of the board's centre."""

    turn_deg: FloatArray
    shift_mm: FloatArray

    @property
    def size(self) -> float:
        """In comparable units."""
        return float(np.hypot(np.linalg.norm(self.turn_deg) / UNIT_DEG, np.linalg.norm(self.shift_mm) / UNIT_MM))


@dataclass(frozen=True)
class CameraMotion:
    """How a camera moves and its lens changes.

    turn_deg: (3,) about the camera's axes.
    shift_mm: (3,) of its position along the axes of ref, and shift_in_camera_mm: (3,) the same along its own.
    lens_px: rms shift of the pixels over the image by the change of the lens, and its parts focal_px, centre_px and
        distortion_px, which may cancel; 0 where the intrinsics were fixed."""

    turn_deg: FloatArray
    shift_mm: FloatArray
    shift_in_camera_mm: FloatArray
    lens_px: float
    focal_px: float
    centre_px: float
    distortion_px: float

    @property
    def size(self) -> float:
        """In comparable units."""
        return float(np.linalg.norm([self.turn_size, self.shift_size, self.lens_size]))

    @property
    def turn_size(self) -> float:
        return float(np.linalg.norm(self.turn_deg)) / UNIT_DEG

    @property
    def shift_size(self) -> float:
        return float(np.linalg.norm(self.shift_mm)) / UNIT_MM

    @property
    def lens_size(self) -> float:
        return self.lens_px / UNIT_PX


def motions(change: FloatArray, placement: Placement) -> tuple[BoardMotion, dict[str, CameraMotion]]:
    """Of the board and of each camera, from a change (P,) in the measures of ``placement``."""
    of_board, *of_cameras = (change[block] for block in placement.blocks)
    board = BoardMotion(UNIT_DEG * of_board[:3], UNIT_MM * of_board[3:])
    names = placement.cameras
    return board, {name: _of_camera(name, part, placement) for name, part in zip(names, of_cameras, strict=True)}


def _of_camera(name: str, part: FloatArray, placement: Placement) -> CameraMotion:
    shift_mm = UNIT_MM * part[3:6]
    lens = [0.0] * 4
    if placement.theta_sizes[name]:
        theta = np.linalg.solve(placement.lens_effect(name) / UNIT_PX, part[6:])
        J = placement.lens_jacobian(name)
        groups = (slice(None), slice(0, 2), slice(2, 4), slice(4, None))
        lens = [_rms_px(J[:, :, group] @ theta[group]) for group in groups]
    return CameraMotion(UNIT_DEG * part[:3], shift_mm, placement.camera_T_ref[name][:3, :3] @ shift_mm, *lens)


def _rms_px(shifts_px: FloatArray) -> float:
    return float(np.sqrt(np.mean((shifts_px**2).sum(axis=1))))
