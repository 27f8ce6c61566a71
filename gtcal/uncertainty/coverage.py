"""What a recording shows of each image, of turns about each axis and of distances, and what is missing, in words.

Where an image had no corners its lens is extrapolated; where the body hardly turned about a second axis, X stays weak;
at one distance a camera's depth and its focal length look alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.motion import WEAK_TURN_RAD, turning
from gtcal.estimation.observations import Views
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration
from gtcal.uncertainty.direction_words import BODIES, MOVERS, axis_in_words
from gtcal.uncertainty.projected import image_grid

CELLS_ACROSS = 20
"""Of the grid over an image."""

BARE = 0.1
"""A region of an image with corners in less than this share of its cells is called bare."""

LEAST_DISTANCE_RATIO = 1.5
"""Between the 95 % and the 5 % quantile of the distances; less is one distance."""

_BORDER = 0.15
"""Of the image's width and height, on each side."""


@dataclass(frozen=True)
class ImageCoverage:
    """Where a camera had corners, on a grid of nearly square cells over its image. Row 0 is the image's top.

    counts: (H, W) corners. visible: (H, W) the cells that the lens can see.
    missing: as "no detections in the lower left quarter of the image", a line each."""

    camera: str
    counts: IntArray
    visible: BoolArray
    missing: tuple[str, ...]

    @property
    def share(self) -> float:
        """Of the visible cells that hold corners."""
        return float(((self.counts > 0) & self.visible).sum() / max(int(self.visible.sum()), 1))


@dataclass(frozen=True)
class TurnCoverage:
    """How far the body turned in ref, views of one camera among each other.

    axes_in_body: (3, 3) unit rows, the axis of most turning first. rms_deg: (3,) about each.
    missing: a line for what is missing, or none."""

    axes_in_body: FloatArray
    rms_deg: FloatArray
    missing: tuple[str, ...]


@dataclass(frozen=True)
class DistanceCoverage:
    """From how far a camera saw the corners, in m: the smallest, the quantiles of 5, 50 and 95 %, the largest."""

    camera: str
    nearest_m: float
    near_m: float
    median_m: float
    far_m: float
    farthest_m: float

    @property
    def missing(self) -> tuple[str, ...]:
        if self.far_m > LEAST_DISTANCE_RATIO * self.near_m:
            return ()
        return (f"the board was always about {self.median_m:.2g} m away: show it from half and from twice that too",)


@dataclass(frozen=True)
class Coverage:
    """What a calibration's recording shows. images, distances: by camera."""

    images: Mapping[str, ImageCoverage]
    turns: TurnCoverage
    distances: Mapping[str, DistanceCoverage]

    @property
    def missing(self) -> tuple[str, ...]:
        """All that is missing, a line each; those of a camera with its name."""
        of_images = [f"camera {name!r}: {line}" for name, found in self.images.items() for line in found.missing]
        of_distances = [f"camera {name!r}: {line}" for name, found in self.distances.items() for line in found.missing]
        return (*self.turns.missing, *of_images, *of_distances)


def coverage(calibration: Calibration) -> Coverage:
    """Of the views and corners that a calibration rests on.

    Raises GtcalError where it was read from a file, which keeps no views: see ``coverage_of_views``."""
    if calibration.solution is None:
        raise GtcalError("a calibration that was read from a file keeps no views to take the coverage from")
    return coverage_of_views(calibration.solution.views, calibration.solution.estimate, calibration.capture)


def coverage_of_views(views: Mapping[str, Views], estimate: Estimate, capture: Capture) -> Coverage:
    """Of views by camera. ``estimate``: where the cameras and the board are, for the distances."""
    return Coverage(
        images={name: image_coverage(found.camera, found.corners_px) for name, found in views.items()},
        turns=turn_coverage((found.ref_T_body for found in views.values()), capture),
        distances={name: distance_coverage(found, estimate) for name, found in views.items()},
    )


def image_coverage(
    camera: Camera, corners_px: FloatArray, *, across: int = CELLS_ACROSS, down: int | None = None
) -> ImageCoverage:
    """Of corners (N, 2) in px; on ``across`` cells, and ``down``, or as many as make them nearly square."""
    counts = cell_counts(camera, corners_px, across, down)
    visible = visible_cells(camera, across, down)
    return ImageCoverage(camera.name, counts, visible, _missing_regions(counts > 0, visible))


def cell_counts(camera: Camera, points_px: FloatArray, across: int, down: int | None = None) -> IntArray:
    """(H, W) how many of the points (N, 2) each cell of the image holds; those beside it count for its border."""
    shape = _shape(camera, across, down)
    size = np.array([camera.image_width_px, camera.image_height_px])
    column, row = np.clip(((points_px + 0.5) / size * shape[::-1]).astype(np.int64), 0, np.array(shape[::-1]) - 1).T
    return np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)


def visible_cells(camera: Camera, across: int, down: int | None = None) -> BoolArray:
    """(H, W) the cells whose middle the lens can see; all of them where the lens is not known."""
    x_px, y_px = image_grid(camera, across, down)
    if camera.parameters is None:
        return np.ones((len(y_px), len(x_px)), dtype=bool)
    _, visible = camera.unproject(np.stack([axis.ravel() for axis in np.meshgrid(x_px, y_px)], axis=1))
    return visible.reshape(len(y_px), len(x_px))


def turn_coverage(ref_T_body_by_camera: Iterable[FloatArray], capture: Capture) -> TurnCoverage:
    """Of the poses (V, 4, 4) of each camera's views."""
    found = turning(ref_T_body_by_camera)
    rms_deg = np.rad2deg(found.rms_rad)
    mover = MOVERS[capture]
    missing: tuple[str, ...] = ()
    axis = axis_in_words(found.axes_in_body[0], BODIES[capture])
    if found.rms_rad[0] < WEAK_TURN_RAD:
        missing = (f"{mover} hardly turned ({rms_deg[0]:.1f} deg rms): turn it about two axes, by 20 deg or more",)
    elif found.rms_rad[1] < WEAK_TURN_RAD:
        other = axis_in_words(found.axes_in_body[1], BODIES[capture])
        missing = (
            f"{mover} turned about {axis} ({rms_deg[0]:.0f} deg rms) and hardly about any other "
            f"({rms_deg[1]:.1f} deg): turn it about {other} too, by 20 deg or more",
        )
    return TurnCoverage(found.axes_in_body, rms_deg, missing)


def distance_coverage(views: Views, estimate: Estimate) -> DistanceCoverage:
    """Of the board's corners from the camera of the views."""
    camera_T_board = estimate.camera_T_ref[views.camera.name] @ views.ref_T_body @ estimate.body_T_board
    T = camera_T_board[views.view_of_corner]
    in_camera = np.einsum("nij,nj->ni", T[:, :3, :3], views.corners_m) + T[:, :3, 3]
    distances_m = np.linalg.norm(in_camera, axis=1)
    return DistanceCoverage(views.camera.name, *map(float, np.quantile(distances_m, [0.0, 0.05, 0.5, 0.95, 1.0])))


def _shape(camera: Camera, across: int, down: int | None) -> tuple[int, int]:
    x_px, y_px = image_grid(camera, across, down)
    return len(y_px), len(x_px)


def _missing_regions(covered: BoolArray, visible: BoolArray) -> tuple[str, ...]:
    """The bare regions, the largest first; none that lies in one already named."""
    named = np.zeros_like(visible)
    lines = []
    if not (covered & visible).any():
        return ("no detections in the image",)
    for name, region in _regions(visible.shape).items():
        inside = region & visible
        if not inside.any() or named[inside].mean() > 0.5:
            continue
        share = float(covered[inside].mean())
        if share < BARE:
            lines.append(f"{'no' if share == 0.0 else 'hardly any'} detections in {name} of the image")
            named |= inside
    return tuple(lines)


def _regions(shape: tuple[int, ...]) -> dict[str, BoolArray]:
    """Parts of an image by name, the largest first."""
    y, x = np.meshgrid(*((np.arange(n) + 0.5) / n for n in shape), indexing="ij")
    upper, left = y < 0.5, x < 0.5
    halves = {"the upper half": upper, "the lower half": ~upper, "the left half": left, "the right half": ~left}
    quarters = {
        "the upper left quarter": upper & left,
        "the upper right quarter": upper & ~left,
        "the lower left quarter": ~upper & left,
        "the lower right quarter": ~upper & ~left,
    }
    top, bottom, first, last = y < _BORDER, y > 1 - _BORDER, x < _BORDER, x > 1 - _BORDER
    middle = (abs(x - 0.5) < 0.25) & (abs(y - 0.5) < 0.25)
    borders = {
        "the middle": middle,
        "the upper border": top,
        "the lower border": bottom,
        "the left border": first,
        "the right border": last,
    }
    corners = {
        "the upper left corner": top & first,
        "the upper right corner": top & last,
        "the lower left corner": bottom & first,
        "the lower right corner": bottom & last,
    }
    return halves | quarters | borders | corners
