"""The board: its size against the mocap's lengths, and its shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.effects.effect import single
from gtcal.effects.frames import Frames
from gtcal.effects.shapes import SHAPES
from gtcal.results.effect_finding import Moment, Quantity


@dataclass(frozen=True)
class Scale:
    """The board is larger than stated by a share, or the mocap's lengths are smaller than true by it: views and mocap
    can't tell which, as each body's offset from what it carries is unknown. To a camera a larger board looks nearer by
    that share: each view's board moves along its own line of sight."""

    name: str = "scale"
    what: str = "the board is larger than stated, or the mocap's lengths smaller than true, by a share"
    advice: str = (
        "measure the printed board and state its true size; if it is right, calibrate the mocap's volume again"
    )
    moment: Moment | None = None

    def columns(self, frames: Frames) -> FloatArray:
        columns = np.zeros((len(frames.stamps_ns), frames.n_columns, 1))
        ref_T_board = frames.ref_T_body @ frames.estimate.body_T_board
        for name in frames.cameras:
            camera_T_ref = frames.estimate.camera_T_ref[name]
            in_camera_m = (camera_T_ref @ ref_T_board)[:, :3, 3]
            of_camera = frames.columns_of_camera(name)
            columns[:, of_camera.start + 3 : of_camera.stop, 0] = -in_camera_m @ camera_T_ref[:3, :3]
        return columns

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 100.0, "%")


@dataclass(frozen=True)
class BoardShape:
    """One of ``SHAPES``, by its place."""

    index: int
    advice: str = "measure the printed board, and mount it on something flat and stiff"
    moment: Moment | None = None

    @property
    def name(self) -> str:
        return SHAPES[self.index].name

    @property
    def what(self) -> str:
        return SHAPES[self.index].what

    def columns(self, frames: Frames) -> FloatArray:
        columns = np.zeros((len(frames.stamps_ns), frames.n_columns, 1))
        columns[:, frames.n_columns - len(SHAPES) + self.index] = 1.0
        return columns

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, SHAPES[self.index].scale, SHAPES[self.index].unit)
