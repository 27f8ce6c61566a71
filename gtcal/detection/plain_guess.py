"""Which board without tags images show: a chessboard's squares, or a grid's dots, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gtcal.camera import FloatArray
from gtcal.detection.plain_view import blobs, see_plain_board
from gtcal.plain_boards import Chessboard
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, Images, read_if_whole

_FEW_IMAGES, _ENOUGH = 24, 3
_WIDEST_PX = 900  # squares and dots are counted in smaller images as well, and much faster
_FEWEST_SQUARES, _FEWEST_DOTS, _MOST_DOTS = 5, 9, 400
_ALIKE = 1.6  # dots side by side differ in size by less, times
_NEIGHBOURS = 1.6  # and in the distance of their nearest
_FLAT = 0.2  # dots lie aside of a flat grid by less, in its spacings, through any lens


@dataclass(frozen=True)
class PlainGuess:
    """kind: 'chessboard' or 'dot_grid'. columns, rows: of squares, or of dots. asymmetric: of dots."""

    kind: str
    columns: int
    rows: int
    asymmetric: bool


def guess_plain_board(images: Images) -> PlainGuess | None:
    """From some images, evenly spread. None where none of them shows one.

    Raises GtcalError where an image is of another size."""
    shown = list(_whole(images))
    for count in (_chessboard, _dots):
        counted: Counter[_Counted] = Counter()
        for image in shown:
            if (found := count(image)) is not None:
                counted[found] += 1
            if counted and max(counted.values()) >= _ENOUGH:
                break
        if counted:
            return PlainGuess(*max(counted, key=lambda one: (counted[one], one[1] * one[2])))
    return None


_Counted = tuple[str, int, int, bool]


def _whole(images: Images) -> Iterator[GreyImage]:
    for index in np.unique(np.linspace(0, len(images) - 1, _FEW_IMAGES).astype(int)):
        image = read_if_whole(images, int(index))
        if not isinstance(image, Exception):
            scale = min(1.0, _WIDEST_PX / image.shape[1])
            yield image if scale == 1.0 else np.asarray(cv2.resize(image, None, fx=scale, fy=scale))


def _chessboard(image: GreyImage) -> _Counted | None:
    """OpenCV grows a small pattern to the whole of what it sees, which dots between dots may pass for too: its corners
    have to be such of squares. The longer side is taken for the columns."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    whole, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
    if not whole or meta is None:
        return None
    rows, columns = sorted(side + 1 for side in meta.shape[:2])
    if rows < _FEWEST_SQUARES or not len(see_plain_board(image, Chessboard(columns, rows, 1.0)).corner_ids):
        return None
    return "chessboard", columns, rows, False


def _dots(image: GreyImage) -> _Counted | None:
    """By the counts of columns and rows that the number of alike blobs side by side allows."""
    found = blobs(image).detect(image)
    if len(found) < _FEWEST_DOTS:
        return None
    centres_px = np.array([keypoint.pt for keypoint in found])
    group = _largest_group(centres_px, np.array([keypoint.size for keypoint in found]))
    n = len(group)
    if not _FEWEST_DOTS <= n <= _MOST_DOTS:
        return None
    alone = _drawn([found[i] for i in group], image.shape)
    tried = [
        (misfit, columns, rows, asymmetric)
        for rows in range(3, n // 3 + 1)
        for asymmetric in (False, True)
        for columns in (n // rows,)
        if columns * rows == n and (asymmetric or rows <= columns)
        if (misfit := _misfit(alone, columns, rows, asymmetric)) < _FLAT
    ]
    if not tried:
        return None
    _, columns, rows, asymmetric = min(tried)
    return "dot_grid", columns, rows, asymmetric


def _misfit(image: GreyImage, columns: int, rows: int, asymmetric: bool) -> float:
    """By what share of their distance dots lie aside of a flat grid of these counts; infinite where there is no such
    grid. OpenCV takes some grids whose rows are shifted for such whose rows are not."""
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    whole, centres_px = cv2.findCirclesGrid(image, (columns, rows), flags=kind, blobDetector=blobs(image))
    if not whole or centres_px is None:
        return float("inf")
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    across = 2 * column + row % 2 if asymmetric else column
    flat = np.stack([across.ravel(), row.ravel()], axis=1).astype(np.float64)
    H, _ = cv2.findHomography(centres_px.reshape(-1, 2), flat)
    if H is None:
        return float("inf")
    back = cv2.perspectiveTransform(centres_px.reshape(-1, 1, 2).astype(np.float64), H).reshape(-1, 2)
    return float(np.sqrt(((back - flat) ** 2).sum(axis=1).mean()))


def _drawn(dots: list[cv2.KeyPoint], shape: tuple[int, ...]) -> GreyImage:
    """An image of these dots and nothing else."""
    image = np.full(shape, 255, dtype=np.uint8)
    for dot in dots:
        centre_px = round(16.0 * dot.pt[0]), round(16.0 * dot.pt[1])
        cv2.circle(image, centre_px, max(round(8.0 * dot.size), 24), 0, -1, cv2.LINE_AA, 4)
    return image


def _largest_group(points_px: FloatArray, sizes_px: FloatArray) -> IntArray:
    """The blobs of the largest group in which each has a neighbour of about its size and no further than the dots of a
    board are."""
    apart = np.linalg.norm(points_px[:, None] - points_px, axis=2)
    ratio = sizes_px[:, None] / sizes_px
    alike = (ratio < _ALIKE) & (ratio > 1.0 / _ALIKE) & ~np.eye(len(apart), dtype=bool)
    nearest = np.where(alike, apart, np.inf).min(axis=1)
    reach = _NEIGHBOURS * np.minimum(nearest[:, None], nearest)
    count, group = connected_components(csr_matrix(alike & (apart < reach)), directed=False)
    return np.asarray(np.flatnonzero(group == np.bincount(group, minlength=count).argmax()), dtype=np.int64)
