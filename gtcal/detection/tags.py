"""The first pass over an image: tags that OpenCV reads, as far as they agree with one another, and reading a tag
where the board says that it must be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from gtcal.board import TaggedBoard, aruco_dictionary, tag_codes
from gtcal.camera import BoolArray, FloatArray
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage

# Thresholds in grey levels of each try, in order; on most views the first one reads enough tags. Then those of the
# tries around what was read, enlarged: where nothing is read at all, enlargement shows nothing either (measured).
_THRESHOLDS, _ENLARGED_THRESHOLDS, _ENLARGEMENT = (25, 7, 3), (15, 3), 2
_ENOUGH_TAGS = 4
# Two tags disagree when one lies further from where the other says than this part of their distance.
_TOLERANCE = 0.2
_SMALLEST_SIDE_PX = 4.0
# From this width of a module on a code can be looked at. On rendered and real views the right code correlates with
# 0.55 or more (0.9 and more where it is sharp), another one with 0.5 or less in 99 of 100 cases.
READABLE_MODULE_PX = 1.4
READ_CORRELATION, ABSENT_CORRELATION = 0.6, 0.45


class Tagged(Protocol):
    """What the tags are read for: a board, or a device with several faces."""

    @property
    def dictionary(self) -> str: ...
    @property
    def border_modules(self) -> int: ...
    @property
    def tag_ids(self) -> IntArray: ...


@dataclass(frozen=True)
class FoundTags:
    """F tags found in an image.

    tags: (F,) which of the board's tags each is (index, not id).
    corners_px: (F, 4, 2) the corners in the order of ``board.tag_corners_m``.
    """

    tags: IntArray
    corners_px: FloatArray

    def __len__(self) -> int:
        return len(self.tags)

    def take(self, rows: BoolArray | IntArray) -> FoundTags:
        return FoundTags(self.tags[rows], self.corners_px[rows])

    def shifted(self, x_px: int, y_px: int) -> FoundTags:
        """As in the image of which this one was a part that begins there."""
        return FoundTags(self.tags, self.corners_px + np.array([x_px, y_px]))


def find_tags(image: GreyImage, board: TaggedBoard) -> tuple[FoundTags, int]:
    """The tags of the board that OpenCV reads in an image and that agree with one another (``agreeing_tags``), and
    how many it reads at most, agreeing or not.

    Thresholding ties a tag to its neighbours where the print is faint, blurred or small, so the image is tried with
    several thresholds, and enlarged where some tags were read, until enough are."""
    best, most = FoundTags(np.empty(0, dtype=np.int64), np.empty((0, 4, 2))), 0
    for found in _tries(image, board):
        best, most = max(best, agreeing_tags(found, board), key=len), max(most, len(found))
        if len(best) >= min(_ENOUGH_TAGS, len(board.tag_ids)):
            break
    return best, most


def _tries(image: GreyImage, board: TaggedBoard) -> Iterator[FoundTags]:
    richest = FoundTags(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))
    for threshold in _THRESHOLDS:
        found = read_tags(image, board, threshold=threshold, scale=1)
        richest = max(richest, found, key=len)
        yield found
    if not len(richest):
        return
    columns, rows = _reach(richest, board, image.shape)
    for threshold in _ENLARGED_THRESHOLDS:
        found = read_tags(image[rows, columns], board, threshold=threshold, scale=_ENLARGEMENT)
        yield FoundTags(found.tags, found.corners_px + np.array([columns.start, rows.start]))


def _reach(found: FoundTags, board: TaggedBoard, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The columns and rows of an image in which the board lies that these tags are of, if any of them is."""
    x_min, y_min, x_max, y_max = board.bounds_m
    tag_m = np.linalg.norm(np.diff(board.tag_corners_m[found.tags, :2, :2], axis=1), axis=2).min()
    sides_px = np.linalg.norm(found.corners_px - np.roll(found.corners_px, 1, axis=1), axis=2)
    board_px = sides_px.max() * np.hypot(x_max - x_min, y_max - y_min) / tag_m
    corners_px = found.corners_px.reshape(-1, 2)
    size_px = np.array([shape[1], shape[0]])
    first = np.clip(np.floor(corners_px.min(axis=0) - board_px), 0, size_px).astype(int)
    last = np.clip(np.ceil(corners_px.max(axis=0) + board_px), 0, size_px).astype(int)
    return slice(int(first[0]), int(last[0])), slice(int(first[1]), int(last[1]))


def read_tags(image: GreyImage, board: Tagged, *, threshold: int, scale: int) -> FoundTags:
    """All tags of the board that OpenCV reads in an image, right or wrong: ids that aren't on the board, mirrored,
    concave and tiny quadrilaterals are left out.

    threshold: grey levels by which black must be darker than its surroundings. scale: factor of enlargement."""
    enlarged = image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale)
    quads, ids, _ = _detector(board, threshold).detectMarkers(enlarged)
    if ids is None or not len(ids):
        return FoundTags(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))
    index_of = {int(tag_id): index for index, tag_id in enumerate(board.tag_ids)}
    tags = np.array([index_of.get(int(i), -1) for i in ids.ravel()], dtype=np.int64)
    corners_px = (np.concatenate(quads).astype(np.float64) + 0.5) / scale - 0.5
    return FoundTags(tags, corners_px).take((tags >= 0) & _plausible(corners_px))


def _detector(board: Tagged, threshold: int) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = board.border_modules
    parameters.adaptiveThreshConstant = threshold
    # All the errors that the dictionary can correct: what is read must agree with its neighbours anyway.
    parameters.errorCorrectionRate = 1.0
    parameters.perspectiveRemovePixelPerCell = 8
    return cv2.aruco.ArucoDetector(aruco_dictionary(board.dictionary), parameters)


def _plausible(corners_px: FloatArray) -> BoolArray:
    """(F,) whether each quadrilateral (F, 4, 2) is convex, turns clockwise in the image and is large enough."""
    edges = np.roll(corners_px, -1, axis=1) - corners_px
    after = np.roll(edges, -1, axis=1)
    turns = edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0]
    return (turns > 0).all(axis=1) & (np.linalg.norm(edges, axis=2) > _SMALLEST_SIDE_PX).all(axis=1)


def agreeing_tags(found: FoundTags, board: TaggedBoard) -> FoundTags:
    """The tags that lie to one another as on the board; none where these are not the majority (another board).

    Each tag's sides give the derivative of the image to the board. The mean of two tags' derivatives carries the
    board vector between their centres into the image up to third order, so neither perspective nor a fisheye lens
    upsets the comparison."""
    disagree = _disagreements(found, board)
    kept = np.ones(len(found), dtype=bool)
    while disagree[np.ix_(kept, kept)].any():
        kept[np.argmax(np.where(kept, disagree[:, kept].sum(axis=1), -1))] = False
    return found.take(kept if 2 * kept.sum() > len(found) else np.zeros(len(found), dtype=bool))


def _disagreements(found: FoundTags, board: TaggedBoard) -> BoolArray:
    """(F, F) which pairs of tags contradict each other."""
    board_m = board.tag_corners_m[found.tags, :, :2]
    derivative = _affine_parts(board_m, found.corners_px)
    between_m = _differences(board_m.mean(axis=1))
    between_px = _differences(found.corners_px.mean(axis=1))
    mean = (derivative[:, None] + derivative[None]) / 2
    off_px = np.linalg.norm(between_px - np.einsum("abij,abj->abi", mean, between_m), axis=2)
    disagree = off_px > _TOLERANCE * np.linalg.norm(between_px, axis=2)
    same = found.tags[:, None] == found.tags[None]
    np.fill_diagonal(same, False)
    np.fill_diagonal(disagree, False)
    return disagree | same


def _differences(points: FloatArray) -> FloatArray:
    return points[None] - points[:, None]


def _affine_parts(board_m: FloatArray, corners_px: FloatArray) -> FloatArray:
    """(F, 2, 2) the derivative of the pixel to the board point at the middle of each tag, in pixels per metre."""
    b = board_m - board_m.mean(axis=1, keepdims=True)
    p = corners_px - corners_px.mean(axis=1, keepdims=True)
    return np.einsum("fki,fkj->fij", p, b) @ np.linalg.inv(np.einsum("fki,fkj->fij", b, b))


def module_centres_m(board: TaggedBoard, tags: IntArray) -> FloatArray:
    """(F, B, 2) the centres of the data modules (border left out) of tags, row by row in OpenCV's drawing."""
    n = tag_codes(board.dictionary, (int(board.tag_ids[0]),), board.border_modules).shape[1]
    middle = (np.arange(board.border_modules, n - board.border_modules) + 0.5) / n
    right, down = (grid.ravel()[None, :, None] for grid in np.meshgrid(middle, middle))
    upper_left, upper_right, _, lower_left = np.moveaxis(board.tag_corners_m[tags, :, :2], 1, 0)
    return upper_left[:, None] + right * (upper_right - upper_left)[:, None] + down * (lower_left - upper_left)[:, None]


def read_codes(image: GreyImage, board: TaggedBoard, tags: IntArray, centres_px: FloatArray) -> FloatArray:
    """(F,) how well the image shows the codes of the tags at their module centres (F, B, 2): the correlation of
    the grey values with the code, 1 at best, 0 for chance; NaN where a module centre is outside the image."""
    border = board.border_modules
    ids = tuple(int(i) for i in board.tag_ids)
    codes = tag_codes(board.dictionary, ids, border)[tags, border:-border, border:-border]
    height, width = image.shape
    inside = np.all((centres_px >= 0) & (centres_px <= np.array([width - 1, height - 1])), axis=(1, 2))
    at = np.where(inside[:, None, None], centres_px, 0.0).astype(np.float32)
    grey = cv2.remap(image, at, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    correlation = _correlations(grey, codes.reshape(len(tags), -1))
    return np.where(inside, correlation, np.nan)


def _correlations(grey: FloatArray, codes: BoolArray) -> FloatArray:
    a = grey - grey.mean(axis=1, keepdims=True, dtype=np.float64)
    b = codes - codes.mean(axis=1, keepdims=True)
    scale = np.sqrt((a * a).sum(axis=1) * (b * b).sum(axis=1))
    return (a * b).sum(axis=1) / np.maximum(scale, 1e-9)
