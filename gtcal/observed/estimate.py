"""The unknowns of a calibration, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from factors.board_shape import FLAT
from gtcal.camera import FloatArray


@dataclass(frozen=True)
class Estimate:
    """X, every Y_c and every theta_c; cameras by name, in the order of the recording.

    body_T_board: (4, 4). camera_T_ref: (4, 4) each. theta: (K,) each. board_shape: (5,) as in ``factors.board_shape``.
    """

    body_T_board: FloatArray
    camera_T_ref: Mapping[str, FloatArray]
    theta: Mapping[str, FloatArray]
    board_shape: FloatArray = field(default_factory=FLAT.copy)
