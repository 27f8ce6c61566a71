"""The corners of a Lollypop's tags in one image.

A tag alone has no neighbours to be predicted from or vouched for by. So each tag that OpenCV reads is taken by itself:
its four corners are fitted to the grey values (``gtcal.detection.refinement``), starting from the homography of the
tag, and it counts only where all four look like the print's and its code is read once more between them.
"""

from __future__ import annotations

import cv2
import numpy as np

from gtcal.board import ArucoGrid
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.detection.corner_search import PredictedBoard, SeenBoard
from gtcal.detection.refinement import RefinedCorners, refine_corners
from gtcal.detection.sight import board_image, sight_of
from gtcal.detection.tags import FoundTags, module_centres_m, read_codes, read_tags
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage
from gtcal.verification.lollypop import Lollypop

# Threshold in grey levels and enlargement of each try; a small or blurred tag needs the later ones.
_PASSES = ((25, 1), (7, 1), (15, 2))
_ROUNDS = 2
_MARGIN_PX = 3.0
_MOVED_PART, _MOVED_PX = 0.15, 1.5  # of the tag's side: how far a fit may end from its start
_MISFIT, _FAINTEST_STEP, _TURNED_RAD = 0.3, 4.0, 0.35
_AROUND_PART, _AROUND_PX = 0.75, 48.0  # of its size, and at least: how far from where it should be it is looked for
_LEAST_CORRELATION = 0.7  # with the tag's code: on rendered tags 0.75 or more where OpenCV reads them at all


def see_lollypop(
    image: GreyImage, device: Lollypop, camera: Camera | None = None, predicted: PredictedBoard | None = None
) -> SeenBoard:
    """The corners of the device's tags in one image, uint8 (H, W): ids increasing; a tag with all four or none.

    camera: used where it has parameters, to tell how the lens bends a tag's edges. predicted: where the device's body
    should be; its tags are then looked for near there only."""
    n_tags = 0
    rows, columns = (slice(None), slice(None)) if predicted is None else _near(image, device, predicted)
    for threshold, scale in _PASSES:
        tags = read_tags(np.ascontiguousarray(image[rows, columns]), device, threshold=threshold, scale=scale)
        tags = tags.shifted(columns.start or 0, rows.start or 0)
        n_tags = max(n_tags, len(tags))
        if len(tags):
            ids, corners_px = _fitted(image, device, camera, _distinct(tags))
            if len(ids):
                return SeenBoard(ids, corners_px, n_tags)
    return SeenBoard(np.empty(0, dtype=np.int64), np.empty((0, 2)), n_tags)


def _near(image: GreyImage, device: Lollypop, predicted: PredictedBoard) -> tuple[slice, slice]:
    """The rows and columns of an image about the device; all of them where it has no pixel."""
    points = device.corners_m @ predicted.camera_T_board[:3, :3].T + predicted.camera_T_board[:3, 3]
    pixels, valid = predicted.camera.project(points)
    if not valid.any():
        return slice(None), slice(None)
    low, high = pixels[valid].min(axis=0), pixels[valid].max(axis=0)
    around = max(_AROUND_PART * float((high - low).max()), _AROUND_PX)
    height, width = image.shape
    first = np.clip(np.floor(low - around), 0, [width - 1, height - 1]).astype(int)
    last = np.clip(np.ceil(high + around), 1, [width, height]).astype(int)
    return slice(first[1], max(last[1], first[1] + 1)), slice(first[0], max(last[0], first[0] + 1))


def _distinct(tags: FoundTags) -> FoundTags:
    """Without the tags that are seen twice: which one is the device's can't be told."""
    _, inverse, counts = np.unique(tags.tags, return_inverse=True, return_counts=True)
    return tags.take(counts[inverse] == 1)


def _fitted(image: GreyImage, device: Lollypop, camera: Camera | None, tags: FoundTags) -> tuple[IntArray, FloatArray]:
    ids, corners_px = [], []
    start = 0
    for face, first_id in zip(device.faces, device.face_start[:-1].tolist(), strict=True):
        n_tags = face.board.n_tags
        for index, quad_px in zip(tags.tags, tags.corners_px, strict=True):
            tag = int(index) - start
            if 0 <= tag < n_tags and (fitted := _fit_tag(image, face.board, camera, tag, quad_px)) is not None:
                ids.append(first_id + 4 * tag + np.array(face.board.opencv_corners))
                corners_px.append(fitted)
        start += n_tags
    if not ids:
        return np.empty(0, dtype=np.int64), np.empty((0, 2))
    all_ids, all_px = np.concatenate(ids), np.concatenate(corners_px)
    order = np.argsort(all_ids)
    return all_ids[order], all_px[order]


def _fit_tag(
    image: GreyImage, board: ArucoGrid, camera: Camera | None, tag: int, quad_px: FloatArray
) -> FloatArray | None:
    """(4, 2) the tag's corners, in the order of ``board.tag_corners_m``; None where they don't look like the print."""
    square_m = board.tag_corners_m[tag, :, :2]
    side_px = float(np.linalg.norm(quad_px - np.roll(quad_px, 1, axis=0), axis=1).min())
    first_px = quad_px
    for _ in range(_ROUNDS):
        sight = sight_of(camera, image.shape[:2], square_m, quad_px)
        H = _homography(square_m, sight.to_plane(quad_px))
        refined = refine_corners(
            image,
            board_image(sight, _mapped(H, square_m), _derivatives(H, square_m), 0.05 * board.tag_side_m),
            saddle=np.zeros(4, dtype=bool),
            clear_band_m=board.clear_band_m,
            clear_reach_m=board.clear_reach_m,
        )
        if not _good(image, refined, first_px, max(_MOVED_PART * side_px, _MOVED_PX)).all():
            return None
        quad_px = refined.corners_px
    return quad_px if _is_the_tag(image, board, camera, tag, quad_px) else None


def _good(image: GreyImage, refined: RefinedCorners, first_px: FloatArray, limit_px: float) -> BoolArray:
    height, width = image.shape
    x, y = refined.corners_px.T
    inside = (x >= _MARGIN_PX) & (x <= width - 1 - _MARGIN_PX) & (y >= _MARGIN_PX) & (y <= height - 1 - _MARGIN_PX)
    near = np.linalg.norm(refined.corners_px - first_px, axis=1) < limit_px
    looks = (refined.misfit < _MISFIT) & (np.abs(refined.step) > _FAINTEST_STEP) & (refined.turned_rad < _TURNED_RAD)
    return inside & near & looks


def _is_the_tag(image: GreyImage, board: ArucoGrid, camera: Camera | None, tag: int, quad_px: FloatArray) -> bool:
    square_m = board.tag_corners_m[tag, :, :2]
    sight = sight_of(camera, image.shape[:2], square_m, quad_px)
    H = _homography(square_m, sight.to_plane(quad_px))
    modules = _mapped(H, module_centres_m(board, np.array([tag]))[0])
    centres_px = sight.to_pixels(modules)[None]
    return bool(read_codes(image, board, np.array([tag]), centres_px)[0] >= _LEAST_CORRELATION)


def _homography(square_m: FloatArray, quad: FloatArray) -> FloatArray:
    """(3, 3) that maps the tag's square (4, 2) to its image (4, 2)."""
    H = cv2.getPerspectiveTransform(square_m.astype(np.float32), quad.astype(np.float32))
    return np.asarray(H, dtype=np.float64)


def _mapped(H: FloatArray, points: FloatArray) -> FloatArray:
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ H.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def _derivatives(H: FloatArray, points: FloatArray) -> FloatArray:
    """(N, 2, 2) derivative of the homography at points (N, 2)."""
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ H.T
    mapped = homogeneous[:, :2] / homogeneous[:, 2:]
    return (H[None, :2, :2] - mapped[:, :, None] * H[None, 2:, :2]) / homogeneous[:, 2, None, None]
