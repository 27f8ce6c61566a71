"""Detected board corners of one camera, in columns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from gtcal.camera import FloatArray

IntArray = npt.NDArray[np.int64]


class Cornered(Protocol):
    """What detections are of: a board, or a device with several faces."""

    @property
    def corners_m(self) -> FloatArray:
        """(C, 3) the corners in the frame of the board or the device."""

    @property
    def n_corners(self) -> int:
        """Corner ids are 0 to this less 1."""

    def corner_name(self, corner_id: int) -> str:
        """What a person calls this corner, as 'tag 7 corner 2'."""

    def describe(self) -> str:
        """The board or device in one line."""


@dataclass(frozen=True)
class ViewRows:
    """Views of one camera. View v holds rows ``view_start[v]:view_start[v + 1]`` of the corner columns.

    stamps_ns: (V,) strictly increasing time stamps.
    view_start: (V + 1,) first row of each view, and the number of rows.
    corner_ids: (N,) index into ``board.corners_m``, unique within a view.
    corners_px: (N, 2) pixels, integer coordinates at pixel centres.
    """

    stamps_ns: IntArray
    view_start: IntArray
    corner_ids: IntArray
    corners_px: FloatArray

    @property
    def n_views(self) -> int:
        return len(self.stamps_ns)

    @property
    def n_corners(self) -> int:
        return len(self.corner_ids)

    @property
    def view_of_corner(self) -> IntArray:
        """(N,) the view each row belongs to."""
        return np.repeat(np.arange(self.n_views), np.diff(self.view_start))


@dataclass(frozen=True)
class CameraDetections(ViewRows):
    """All views of one camera, at times of the camera's clock."""

    @staticmethod
    def from_views(views: Iterable[tuple[int, IntArray, FloatArray]]) -> CameraDetections:
        """Join views, each (stamp_ns, corner_ids (n,), corners_px (n, 2)), given in order of time."""
        listed = list(views)
        counts = [len(ids) for _, ids, _ in listed]
        return CameraDetections(
            stamps_ns=np.array([stamp for stamp, _, _ in listed], dtype=np.int64),
            view_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            corner_ids=np.concatenate([ids for _, ids, _ in listed] or [np.empty(0, np.int64)]).astype(np.int64),
            corners_px=np.concatenate([px for _, _, px in listed] or [np.empty((0, 2))]).astype(np.float64),
        )

    def select_views(self, keep: npt.NDArray[np.bool_]) -> CameraDetections:
        """The views where ``keep`` (V,) is True."""
        rows = keep[self.view_of_corner]
        counts = np.diff(self.view_start)[keep]
        return CameraDetections(
            self.stamps_ns[keep],
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            self.corner_ids[rows],
            self.corners_px[rows],
        )
