"""The Lollypop as a print to scale: each face with its tags, and where the retroreflective discs go."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.drawing import Sheet, Text, check_figure, lay_out, write_sheet
from gtcal.verification.lollypop import Face, Lollypop

_MM = 1e-3
_BETWEEN_FACES_M = 20 * _MM
_IN_PLANE_M = 2 * _MM  # a disc this near to a face's plane is on it
_DOT_M, _DOTS, _CROSS_M, _LINE_M = 0.3 * _MM, 60, 3 * _MM, 0.15 * _MM
_TEXT_M = 2.8 * _MM


def draw_lollypop(device: Lollypop, path: Path, *, page: str | None = None, dpi: int = 300) -> Sheet:
    """Draw a device to scale into a .pdf, .svg or .png file as ``draw_board`` draws a board: its faces side by side,
    each disc as a dotted circle of its size around a cross, numbered as in ``markers_m``. Markers off the faces, balls
    on sticks, are not drawn.

    Returns what was drawn. Raises GtcalError as ``draw_board`` does."""
    check_figure(path, dpi)
    sheet = lollypop_sheet(device, page)
    write_sheet(sheet, path, dpi=dpi)
    return sheet


def lollypop_sheet(device: Lollypop, page: str | None = None) -> Sheet:
    """Lay a device out on a page; ``board_origin_m`` is the middle of its first face.

    Raises GtcalError where the page is unknown or too small."""
    rectangles, texts, right_m = [], [], 0.0
    bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])
    for index, face in enumerate(device.faces):
        discs = _discs_on(device, face)
        x_min, y_min, x_max, y_max = _bounds(face, [middle for _, middle in discs], device.marker_diameter_m)
        at = np.array([0.0 if index == 0 else right_m + _BETWEEN_FACES_M - x_min, 0.0])
        rectangles.append(_pattern(face) + np.tile(at, 2))
        for number, middle in discs:
            rectangles.append(_disc(middle + at, device.marker_diameter_m))
            x, y = (middle + at + np.array([0.6 * device.marker_diameter_m, -0.3 * _TEXT_M])).tolist()
            texts.append(Text(x, y, _TEXT_M, str(number)))
        bounds[:2] = np.minimum(bounds[:2], at + np.array([x_min, y_min]))
        bounds[2:] = np.maximum(bounds[2:], at + np.array([x_max, y_max]))
        right_m = float(at[0]) + x_max
    x0, y0, x1, y1 = bounds.tolist()
    return lay_out(np.concatenate(rectangles), texts, (x0, y0, x1, y1), device.describe(), page)


def _discs_on(device: Lollypop, face: Face) -> list[tuple[int, FloatArray]]:
    """The number, from 1, and the middle (2,) in the face's frame of each disc that is on it."""
    face_T_body = inverse(face.body_T_face)
    in_face = device.markers_in_body_m @ face_T_body[:3, :3].T + face_T_body[:3, 3]
    return [(i, point[:2]) for i, point in enumerate(in_face, start=1) if abs(point[2]) < _IN_PLANE_M]


def _pattern(face: Face) -> FloatArray:
    """(R, 4) the black of the tags about the middle of the face."""
    to_middle = face.corners_in_face_m[0, :2] - face.board.corners_m[0, :2]
    return np.asarray(face.board.black_rectangles_m + np.tile(to_middle, 2))


def _bounds(face: Face, middles: list[FloatArray], diameter_m: float) -> tuple[float, float, float, float]:
    """Of the tags with a white module around them, and of the discs with their numbers."""
    reach = face.corners_in_face_m[:, :2].max(axis=0) + face.board.module_m
    points = np.array([-reach, reach, *(m - diameter_m for m in middles), *(m + diameter_m for m in middles)])
    (x_min, y_min), (x_max, y_max) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x_min, y_min, x_max, y_max


def _disc(middle_m: FloatArray, diameter_m: float) -> FloatArray:
    """(R, 4) a dotted circle and a cross."""
    angles = np.arange(_DOTS) * 2 * np.pi / _DOTS
    rim = middle_m + 0.5 * diameter_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    half = np.array([(0.5 * _CROSS_M, 0.5 * _LINE_M), (0.5 * _LINE_M, 0.5 * _CROSS_M)])
    low = np.concatenate([rim - 0.5 * _DOT_M, middle_m - half])
    high = np.concatenate([rim + 0.5 * _DOT_M, middle_m + half])
    return np.concatenate([low, high], axis=1)
