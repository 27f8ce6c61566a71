"""Boards without tags in one image: chessboards and grids of dots, which OpenCV finds where it sees the whole of them.

OpenCV's order of the corners may be mirrored or turned. Mirrored it can't be, and of the turns those drop out under
which black squares would lie on white ones; of what is left (``Board.turns``) the chain with the mocap chooses later.
Then the corners of a chessboard are fitted as those of any board, the dots by their light (``dots``)."""

from __future__ import annotations

import cv2
import numpy as np

from gtcal.board import Board
from gtcal.board_base import quarter_turns
from gtcal.camera import Camera, FloatArray
from gtcal.detection.corner_search import CornerSearch, SeenBoard
from gtcal.detection.dots import refined_dots
from gtcal.plain_boards import Chessboard, DotGrid
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage

_NOTHING = SeenBoard(np.empty(0, dtype=np.int64), np.empty((0, 2)), 0)
# Less of a chessboard's corners confirmed by the fit, and it was something else.
_CONFIRMED = 0.8
# findCirclesGrid's blobs: dots of a board at the far end of its use, and at the near one; their roundness at a slant.
_SMALLEST_DOT_PX2, _LARGEST_DOT_SHARE = 9.0, 0.05


def see_plain_board(image: GreyImage, board: Board, camera: Camera | None = None) -> SeenBoard:
    """What one image, uint8 (H, W), shows of a board without tags."""
    if isinstance(board, DotGrid):
        return _see_dots(image, board, camera)
    if isinstance(board, Chessboard):
        return _see_chessboard(image, board, camera)
    raise TypeError(f"{type(board).__name__} is no board without tags")


def _see_chessboard(image: GreyImage, board: Chessboard, camera: Camera | None) -> SeenBoard:
    size = (board.square_columns - 1, board.square_rows - 1)
    whole, found = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY)
    if not whole:
        return _NOTHING
    best = _NOTHING
    for corners_px in _right_handed(board, found.reshape(-1, 2).astype(np.float64)):
        search = CornerSearch(image, board, camera)
        search.anchors_m, search.anchors_px = search.corners_m, corners_px
        search.extend(search.corners_m, corners_px, np.arange(board.n_corners))
        ids = np.flatnonzero(search.found)
        if len(ids) > max(_CONFIRMED * board.n_corners, len(best.corner_ids)) and not search.is_warped:
            best = SeenBoard(ids, search.corners_px[ids], 0)
    return best


def _see_dots(image: GreyImage, board: DotGrid, camera: Camera | None) -> SeenBoard:
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    size = (board.dot_columns, board.dot_rows)
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        whole, found = cv2.findCirclesGrid(image, size, flags=flags, blobDetector=blobs(image))
        if whole:
            break
    else:
        return _NOTHING
    for corners_px in _right_handed(board, found.reshape(-1, 2).astype(np.float64)):
        refined_px, ids = refined_dots(image, board, camera, corners_px)
        return SeenBoard(ids, refined_px[ids], 0) if len(ids) > _CONFIRMED * board.n_corners else _NOTHING
    return _NOTHING


def blobs(image: GreyImage) -> cv2.SimpleBlobDetector:
    """What finds dark blobs that may be dots."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.filterByArea, parameters.minArea = True, _SMALLEST_DOT_PX2
    parameters.maxArea = _LARGEST_DOT_SHARE * image.size
    parameters.filterByCircularity = False
    parameters.filterByInertia, parameters.minInertiaRatio = True, 0.05
    parameters.filterByConvexity, parameters.minConvexity = True, 0.8
    parameters.minDistBetweenBlobs = 3.0
    return cv2.SimpleBlobDetector.create(parameters)


def _right_handed(board: Board, found_px: FloatArray) -> list[FloatArray]:
    """The corners (C, 2) in the orders, of those that the grid's own symmetry allows, in which the print is not
    mirrored."""
    xy = board.corners_m[:, :2]
    turns = list(quarter_turns(board.corners_m, board.pitch_m).values())
    mirrored = _mirror(xy, board.pitch_m)
    orders = turns if mirrored is None else [*turns, *(mirrored[turn] for turn in turns)]
    return [found_px[order] for order in orders if _is_seen_from_front(xy, found_px[order])]


def _mirror(xy: FloatArray, pitch_m: float) -> IntArray | None:
    """(C,) the corner that each comes to lie on where left and right are exchanged, or where that is none, up and
    down."""
    middle = 0.5 * (xy.min(axis=0) + xy.max(axis=0))
    for sign in ((-1.0, 1.0), (1.0, -1.0)):
        apart = np.linalg.norm(((xy - middle) * sign)[:, None] - (xy - middle)[None], axis=2)
        if (apart.min(axis=1) < 1e-6 * pitch_m).all():
            return np.asarray(apart.argmin(axis=1), dtype=np.int64)
    return None


def _is_seen_from_front(xy: FloatArray, pixels_px: FloatArray) -> bool:
    """Pixels count y downwards, so that what is seen from the front has a derivative of negative determinant."""
    about, pixels = xy - xy.mean(axis=0), pixels_px - pixels_px.mean(axis=0)
    return bool(np.linalg.det(about.T @ pixels) < 0.0)
