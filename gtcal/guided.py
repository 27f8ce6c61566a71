"""Detection that the mocap guides.

The board is searched for in some first views of each camera, evenly spread. A calibration from those and the mocap say
where the board is in every other image, to a pixel or so: there its corners are fitted, its tags' codes checked, and
what agrees is kept, so that the search, ten times as dear, is left to the images in which the prediction fails.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gtcal.detection.corner_search import PredictedBoard, SeenBoard
from gtcal.detection.detect import Guidance
from gtcal.detection.many_images import Looking, Seen, look_at
from gtcal.errors import GtcalError
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import Images
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration

GUIDED_FROM = 240
"""A camera with so many images is guided; with fewer, the first views are a large part of them."""

FIRST_IMAGES, MOST_FIRST_ROUNDS = 60, 3
"""So many images are searched first, and as many again as long as too few show the board."""

_FEWEST_VIEWS, _FEWEST_CORNERS = 30, 8
# The first calibration must hold of nearly all first views, to so many pixels, for its word to be taken on where no
# board is.
_HOLDS_OF, _HOLDS_PX = 0.8, 5.0

_log = logging.getLogger("gtcal")


@dataclass
class MocapGuide:
    """Where the board is in a recording's images, from a first calibration. What it takes to tell is done when a camera
    is first asked for.

    names: of the cameras to detect in. calibrate: a recording with detections for every camera."""

    recording: Recording
    names: tuple[str, ...]
    calibrate: Callable[[Recording], Calibration]
    progress: Progress = field(default=silent)

    @cached_property
    def rests_on(self) -> str:
        """A fingerprint of the mocap's poses."""
        digest = hashlib.sha256(self.recording.capture.value.encode())
        for name, trajectory in self.recording.motion.trajectories.items():
            digest.update(name.encode() + trajectory.stamps_ns.tobytes() + trajectory.world_T_body.tobytes())
        return digest.hexdigest()

    def __call__(self, camera_name: str) -> Guidance:
        """What the first views showed, and where the board is in the others; nothing of a camera with few images, or of
        which the first views tell too little."""
        return Guidance(self._seen.get(camera_name, {}), dict(self._predicted(camera_name)))

    @cached_property
    def _seen(self) -> dict[str, dict[int, Seen]]:
        """By camera that is guided, what was seen in its first images."""
        names = [name for name in self.names if can_be_guided(self.recording, name)]
        seen: dict[str, dict[int, Seen]] = {}
        for done, name in enumerate(names):
            self.progress("first views", done, len(names))
            seen[name] = _first_views(self.recording, name)
        self.progress("first views", len(names), len(names))
        return seen

    @cached_property
    def _first(self) -> Calibration | None:
        """From the first views; None where there is none that holds."""
        views = {name: _detections(self.recording.images[name], seen) for name, seen in self._seen.items()}
        shown = {name: of_camera for name, of_camera in views.items() if of_camera.n_views >= _FEWEST_VIEWS}
        if not shown:
            return None
        cameras = {name: self.recording.cameras[name] for name in shown}
        try:
            found = self.calibrate(replace(self.recording, cameras=cameras, detections=shown, images={}))
        except GtcalError as error:
            _log.warning("the mocap can't guide the detection, so every image is searched: %s", error)
            return None
        wrong = [name for name in shown if not _holds(found, name, shown[name].n_views)]
        if wrong:
            _log.warning(
                "a first calibration does not hold of most first views of %s, so every image is searched for the board",
                ", ".join(wrong),
            )
        return None if wrong else found

    def _predicted(self, name: str) -> Iterator[tuple[int, PredictedBoard]]:
        if name not in self._seen or self._first is None or name not in self._first.cameras:
            return
        of_camera, clock = self._first.cameras[name], self._first.clock
        stamps_ns = self.recording.images[name].stamps_ns
        poses = self.recording.motion.at(stamps_ns if clock is None else clock.mocap_ns(name, stamps_ns))
        camera_T_board = of_camera.camera_T_ref.a_T_b @ poses.ref_T_body @ self._first.body_T_board.a_T_b
        for index in np.flatnonzero(poses.ok).tolist():
            yield index, PredictedBoard(of_camera.camera, camera_T_board[index])


def can_be_guided(recording: Recording, name: str) -> bool:
    """Whether a camera has enough images for it. The rows of a rolling shutter each have their own time: not these."""
    return len(recording.images[name]) >= GUIDED_FROM and recording.cameras[name].rolling_shutter is None


def _first_views(recording: Recording, name: str) -> dict[int, Seen]:
    images, camera = recording.images[name], recording.cameras[name]
    images = images.expecting(camera.image_width_px, camera.image_height_px)
    seen: dict[int, Seen] = {}
    for rounds in range(1, MOST_FIRST_ROUNDS + 1):
        spread = np.linspace(0, len(images) - 1, rounds * FIRST_IMAGES).round().astype(np.int64)
        wanted = [index for index in np.unique(spread).tolist() if index not in seen]
        seen |= dict(look_at(images, wanted, Looking(recording.board, camera)))
        if sum(_shows_the_board(view) for view in seen.values()) >= _FEWEST_VIEWS:
            break
    return seen


def _shows_the_board(view: Seen) -> bool:
    return isinstance(view, SeenBoard) and len(view.corner_ids) >= _FEWEST_CORNERS


def _detections(images: Images, seen: Mapping[int, Seen]) -> CameraDetections:
    return CameraDetections.from_views(
        (int(images.stamps_ns[index]), view.corner_ids, view.corners_px)
        for index, view in sorted(seen.items(), key=lambda item: item[0])
        if isinstance(view, SeenBoard) and _shows_the_board(view)
    )


def _holds(found: Calibration, name: str, n_views: int) -> bool:
    of_camera = found.cameras[name].residuals
    return of_camera.n_views >= _HOLDS_OF * n_views and of_camera.p95_px < _HOLDS_PX
