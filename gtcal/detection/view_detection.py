"""The board's corners in one image.

Of a board of tags OpenCV reads what tags it can, and the search goes outwards from there (``CornerSearch``): a corner
counts where it belongs to a tag whose code is read. Boards without tags are found as a whole (``plain_view``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gtcal.board import Board, TaggedBoard
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.detection.corner_search import FEWEST_CORNERS, CornerSearch, PredictedBoard, SeenBoard, least_stretch
from gtcal.detection.local_warp import fit_local_warps
from gtcal.detection.plain_view import see_plain_board
from gtcal.detection.sight import BoardImage
from gtcal.detection.tags import (
    ABSENT_CORRELATION,
    READ_CORRELATION,
    READABLE_MODULE_PX,
    FoundTags,
    find_tags,
    module_centres_m,
    read_codes,
)
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage

_FEWEST_TAGS = 2


def detect_view(image: GreyImage, board: Board, camera: Camera | None = None) -> tuple[IntArray, FloatArray]:
    """Find the board's corners in one image, uint8 (H, W).

    camera: used where it has parameters, only to predict where corners are.

    Returns the corner ids (n,), increasing, and the corners (n, 2) in pixels; both empty where the image doesn't
    show at least two tags of the board (or the only one) that lie to each other as on the board."""
    seen = see_board(image, board, camera)
    return seen.corner_ids, seen.corners_px


def see_board(
    image: GreyImage, board: Board, camera: Camera | None = None, predicted: PredictedBoard | None = None
) -> SeenBoard:
    """As ``detect_view``, and how many tags were read where the board isn't recognised.

    predicted: where the board must be, to a few pixels; a board without tags has no use for it. Its corners are then
    looked for there first, and the board is searched for only where most that should be seen aren't there; where it
    should be outside the image, not at all (``unsearched``). What is found is checked in the same way, and doesn't
    depend on the prediction."""
    if not isinstance(board, TaggedBoard):
        return see_plain_board(image, board, camera)
    if predicted is None:
        return _searched(image, board, camera)
    looked = _looked_for(image, board, predicted)
    if looked.n_expected == 0:
        return replace(looked.seen, unsearched=True)
    if 2 * len(looked.seen.corner_ids) > looked.n_expected:
        return looked.seen
    return max(looked.seen, _searched(image, board, camera), key=lambda seen: len(seen.corner_ids))


def _searched(image: GreyImage, board: TaggedBoard, camera: Camera | None) -> SeenBoard:
    found, n_tags = find_tags(image, board)
    search = _TagSearch(image, board, camera)
    if len(found):
        search.begin(found)
        search.go_on()
    return search.seen(n_tags)


@dataclass(frozen=True)
class _Looked:
    """What is seen where the board should be, and how many corners should be."""

    seen: SeenBoard
    n_expected: int


def _looked_for(image: GreyImage, board: TaggedBoard, predicted: PredictedBoard) -> _Looked:
    search = _TagSearch(image, board, predicted.camera)
    n_expected = search.begin_at(predicted)
    if search.found.any():
        search.go_on()
    return _Looked(search.seen(int((search.tag_read == 1).sum())), n_expected)


@lru_cache(maxsize=8)
def _corners_of_tags(board: TaggedBoard) -> BoolArray:
    """(T, C) the corners next to each tag."""
    beside = np.zeros((len(board.tag_ids), board.n_corners), dtype=np.bool_)
    beside[board.corner_tags, np.arange(board.n_corners)[:, None]] = True
    return beside


class _TagSearch(CornerSearch):
    """The search on a board of tags: corners count as long as the codes of their tags are not found to be others.

    tag_read: (T,) 1 where a tag's code was read, -1 where the image shows something else, 0 where it wasn't or can't
    be looked at."""

    def __init__(self, image: GreyImage, board: TaggedBoard, camera: Camera | None) -> None:
        super().__init__(image, board, camera)
        self.tagged = board
        self.tag_corners = _corners_of_tags(board)
        self.tag_read = np.zeros(len(board.tag_ids), dtype=np.int64)
        self.first_tags = np.zeros(len(board.tag_ids), dtype=np.bool_)

    def begin(self, tags: FoundTags) -> None:
        """Look for the corners next to the tags of the first pass."""
        self.first_tags[tags.tags] = True
        self.anchors_m = self.tagged.tag_corners_m[tags.tags, :, :2].reshape(-1, 2)
        self.anchors_px = tags.corners_px.reshape(-1, 2)
        self.extend(self.anchors_m, self.anchors_px, self.corners_of(tags.tags))

    def corners_of(self, tags: IntArray) -> IntArray:
        return np.flatnonzero(self.tag_corners[tags].any(axis=0))

    def reachable(self) -> IntArray:
        """... and of no tag found to be absent."""
        candidates = super().reachable()
        return candidates[~self._absent()[candidates]]

    def seen(self, n_tags: int) -> SeenBoard:
        """What was found, if it is the board."""
        if not self.is_the_board():
            return SeenBoard(np.empty(0, dtype=np.int64), np.empty((0, 2)), n_tags)
        self.polish()
        ids = np.flatnonzero(self.found)
        return SeenBoard(ids, self.corners_px[ids], n_tags)

    def _look(self, candidates: IntArray, guess: BoardImage) -> None:
        """As for any board, then the tags are read."""
        super()._look(candidates, guess)
        self._read_tags()

    def is_the_board(self) -> bool:
        """Whether what was found is this board: enough tags are read, more than are found to be something else, and
        the corners lie as on the board."""
        if self.found.sum() < FEWEST_CORNERS:
            return False
        seen = np.any(self.tag_corners[:, self.found], axis=1)
        n_read = (seen & ((self.tag_read == 1) | (self.first_tags & (self.tag_read == 0)))).sum()
        if n_read < min(_FEWEST_TAGS, len(self.tag_read)) or n_read <= (self.tag_read == -1).sum():
            return False
        return not self.is_warped

    def _absent(self) -> BoolArray:
        """(C,) the corners all of whose tags were looked at and aren't there."""
        present = self.tag_read != -1
        return ~self.tag_corners[present].any(axis=0)

    def _read_tags(self) -> None:
        """Read the tags next to newly found corners; drop the corners whose tags turn out to be something else."""
        tags = np.flatnonzero(self.tag_corners[:, self.found].any(axis=1) & (self.tag_read == 0))
        if not len(tags) or self.found.sum() < FEWEST_CORNERS:
            return
        known_m, known_px = self.known()
        plane = self.sight.to_plane(known_px)
        middle_m = self.tagged.tag_corners_m[tags, :, :2].mean(axis=1)
        warps = fit_local_warps(known_m, plane, middle_m, spread_m=self.tagged.pitch_m)
        modules = warps.apply(module_centres_m(self.tagged, tags))
        modules_px = self.sight.to_pixels(modules.reshape(-1, 2)).reshape(modules.shape)
        module_px = self.tagged.module_m * least_stretch(self._to_pixels(warps).px_per_m)
        correlation = read_codes(self.image, self.tagged, tags, modules_px)
        readable = np.isfinite(correlation) & (module_px >= READABLE_MODULE_PX)
        self.tag_read[tags[readable & (correlation >= READ_CORRELATION)]] = 1
        self.tag_read[tags[readable & (correlation < ABSENT_CORRELATION)]] = -1
        self.corners_px[self._absent()] = np.nan
