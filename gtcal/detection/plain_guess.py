"""Which board without tags images show: a chessboard's squares, or a grid's dots, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from gtcal.detection.plain_view import blobs
from gtcal.recordings.images import GreyImage, Images, read_if_whole

_FEW_IMAGES, _ENOUGH = 8, 3
_WIDEST_PX = 900  # squares and dots are counted in smaller images as well, and much faster
_FEWEST_SQUARES, _FEWEST_DOTS, _MOST_DOTS = 5, 9, 400
_ALIKE = 2.5  # dots of one board differ in size by less, times


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
    """OpenCV grows a small pattern to the whole of what it sees. The longer side is taken for the columns."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    whole, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
    if not whole or meta is None:
        return None
    rows, columns = sorted(side + 1 for side in meta.shape[:2])
    return ("chessboard", columns, rows, False) if rows >= _FEWEST_SQUARES else None


def _dots(image: GreyImage) -> _Counted | None:
    """By the counts of columns and rows that the number of blobs allows."""
    found = blobs(image).detect(image)
    sizes = np.array([keypoint.size for keypoint in found])
    if not _FEWEST_DOTS <= len(sizes) <= _MOST_DOTS or sizes.max() > _ALIKE * sizes.min():
        return None
    n = len(sizes)
    for rows in (r for r in range(3, n // 3 + 1) if n % r == 0):
        for kind, asymmetric in ((cv2.CALIB_CB_SYMMETRIC_GRID, False), (cv2.CALIB_CB_ASYMMETRIC_GRID, True)):
            columns = n // rows
            if not asymmetric and rows > columns:
                continue
            if cv2.findCirclesGrid(image, (columns, rows), flags=kind, blobDetector=blobs(image))[0]:
                return "dot_grid", columns, rows, asymmetric
    return None
