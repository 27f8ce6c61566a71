"""The centre of a printed face from its corners' bearings, by homography: no mocap, and no pose estimate.

A homography takes the face's plane to bearings as homogeneous coordinates: b ~ H (x, y, 1). It does not matter which
image plane they are thought in, so none is needed: where DESIGN's virtual camera is turned to the tag so that its
image plane meets all the bearings, here they are taken as they are, and nothing blows up at 80 degrees off the axis or
beyond. With four corners the solution is exact and closed; with more it is the least-squares one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtcal.camera import BoolArray, FloatArray
from gtcal.recordings.detections import IntArray


@dataclass(frozen=True)
class FaceCentres:
    """G faces, each in one image.

    centre_in_camera_m: (G, 3) by the face's stated size; its direction does not depend on that.
    normal_in_camera: (G, 3) unit, out of the print.
    ok: (G,) whether the corners are those of a flat face seen from its front; the rest is NaN elsewhere."""

    centre_in_camera_m: FloatArray
    normal_in_camera: FloatArray
    ok: BoolArray

    @property
    def viewing_angle_rad(self) -> FloatArray:
        """(G,) between the normal and the line of sight back to the camera."""
        length = np.linalg.norm(self.centre_in_camera_m, axis=1)
        with np.errstate(invalid="ignore"):
            cosine = -(self.normal_in_camera * self.centre_in_camera_m).sum(axis=1) / length
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def face_centres(bearings: FloatArray, corners_in_face_m: FloatArray, start: IntArray) -> FaceCentres:
    """The centres of G faces; face g has rows ``start[g]:start[g + 1]`` of unit bearings (N, 3) and of corners in the
    face's frame (N, 3), four or more each, not all on a line."""
    counts = np.diff(start)
    columns = np.full((len(counts), 3, 3), np.nan)
    four = counts == 4
    if four.any():
        rows = start[:-1][four, None] + np.arange(4)
        columns[four] = _of_four(bearings[rows], corners_in_face_m[rows, :2])
    if not four.all():
        columns[~four] = _least_squares(bearings, corners_in_face_m[:, :2], start, ~four)
    return _metric(columns, bearings[start[:-1]])


def _of_four(b: FloatArray, corners_m: FloatArray) -> FloatArray:
    """(G, 3, 3) the homographies that carry four corners (G, 4, 2) to their bearings (G, 4, 3), up to scale."""
    plane = np.concatenate([corners_m, np.ones((*corners_m.shape[:2], 1))], axis=2)
    scales = _null_vector(b) / _null_vector(plane)
    scaled = b[:, :3] * scales[:, :3, None]
    return np.swapaxes(np.linalg.solve(plane[:, :3], scaled), 1, 2)


def _null_vector(v: FloatArray) -> FloatArray:
    """(G, 4) the coefficients with which four vectors (G, 4, 3) of space add up to zero (Cramer's rule)."""
    d = [_det(v[:, [j for j in range(4) if j != i]]) * (-1) ** i for i in range(4)]
    return np.stack(d, axis=1)


def _det(v: FloatArray) -> FloatArray:
    return np.einsum("gi,gi->g", v[:, 0], np.cross(v[:, 1], v[:, 2]))


def _least_squares(bearings: FloatArray, corners_m: FloatArray, start: IntArray, which: BoolArray) -> FloatArray:
    """(G, 3, 3) the homographies with the least sum of |b x H s|^2, for the faces ``which`` (F,)."""
    size = np.abs(corners_m).max()
    s = np.column_stack([corners_m / size, np.ones(len(corners_m))])
    off = np.eye(3) - bearings[:, :, None] * bearings[:, None, :]
    moments = (off[:, :, None, :, None] * (s[:, :, None] * s[:, None, :])[:, None, :, None, :]).reshape(-1, 9, 9)
    summed = np.add.reduceat(moments, start[:-1], axis=0)[which]
    _, vectors = np.linalg.eigh(summed)
    return vectors[:, :, 0].reshape(-1, 3, 3) / np.array([size, size, 1.0])


def _metric(columns: FloatArray, some_bearing: FloatArray) -> FaceCentres:
    """Scale the homographies (G, 3, 3) so that the face's axes have unit length on average; turn them to the front."""
    with np.errstate(invalid="ignore", divide="ignore"):
        lengths = np.linalg.norm(columns[:, :, :2], axis=1)
        ahead = np.sign((columns[:, :, 2] * some_bearing).sum(axis=1))
        scaled = columns * (ahead * 2.0 / lengths.sum(axis=1))[:, None, None]
        normal = np.cross(scaled[:, :, 0], scaled[:, :, 1])
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        centre = scaled[:, :, 2]
        ok = np.isfinite(scaled).all(axis=(1, 2)) & ((normal * centre).sum(axis=1) < 0.0)
    nan = np.where(ok, 1.0, np.nan)[:, None]
    return FaceCentres(centre * nan, normal * nan, ok)
