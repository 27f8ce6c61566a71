"""A board beside the one that a calibration is mainly of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gtcal.recordings.capture import Capture

if TYPE_CHECKING:
    from gtcal.results.calibration import PoseEstimate, ResidualStatistics


@dataclass(frozen=True)
class OtherBoard:
    """Where another board of the same recording sits in its body, found with the same cameras.

    board: as in a manifest. capture: of this board, by what is tracked. residuals: by camera that saw it."""

    name: str
    board: dict[str, object]
    capture: Capture
    body_T_board: PoseEstimate
    residuals: dict[str, ResidualStatistics]
