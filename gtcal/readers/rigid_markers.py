"""A rigid body from its labelled markers: their mean shape, and in every frame the pose that fits it best.

The shape is found by generalised Procrustes from the markers alone: frames are registered to it, it is the median over
the registered frames, and so on; markers that are never all seen at once join as frames connect them. A frame with
fewer than three markers, or with three in a line, has no pose. A frame whose markers don't fit the shape is tried with
two labels swapped and with one marker left out; where exactly one of these fits, it is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

_MIN_MARKERS = 3
# Markers in a line to within this share of their length leave the turn about it to chance.
_STRAIGHT = 0.03
# Optical markers are good to some tenths of a millimetre, and swapped labels or ghosts are off by many: below this no
# frame is suspect.
_SMALLEST_LIMIT_M = 1e-3
# By how much the residual of a frame exceeds the usual one before it is taken for a mistake.
_LIMIT_RATIO, _LIMIT_SIGMAS = 3.0, 6.0
# Markers that usually move by so much against each other are not on one rigid body.
_LEAST_RIGID_RMS_M = 5e-3
_SHAPE_FRAMES = 2000
_SHAPE_ROUNDS = 6
_CHUNK = 100_000
# A marker this near to the centroid, as a share of the body's size, gives no axis.
_TOO_CENTRAL = 0.05


@dataclass(frozen=True)
class MarkerShape:
    """Markers of a rigid body: labels, and points_m (n, 3) in the body's frame."""

    labels: tuple[str, ...]
    points_m: FloatArray


@dataclass(frozen=True)
class MarkerFit:
    """The pose of a shape in N frames.

    world_T_body: (N, 4, 4), NaN where there is none.
    rms_m: (N,) residual per marker, NaN where there is no pose.
    limit_m: what a frame's rms_m must not exceed.
    swapped, without_one: (N,) frames in which two labels were swapped back, or one marker was left out.
    contradicting: (N,) frames with enough markers that fit in no way that is clear: no pose.
    too_few: (N,) frames with fewer than three markers, or with those in a line: no pose.
    """

    world_T_body: FloatArray
    rms_m: FloatArray
    limit_m: float
    swapped: BoolArray
    without_one: BoolArray
    contradicting: BoolArray
    too_few: BoolArray

    @property
    def ok(self) -> BoolArray:
        """(N,) whether there is a pose."""
        return np.isfinite(self.rms_m)

    @property
    def median_rms_m(self) -> float:
        return float(np.median(self.rms_m[self.ok])) if self.ok.any() else np.nan


def register(points_m: FloatArray, markers_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rigid transforms (N, 4, 4) that take points_m (n, 3) closest to markers_m (N, n, 3), NaN where a marker is
    not seen, and their residuals (N,), rms per marker. Both are NaN where the markers do not determine a pose."""
    parts = [_register(points_m, markers_m[i : i + _CHUNK]) for i in range(0, len(markers_m), _CHUNK)]
    if not parts:
        return np.empty((0, 4, 4)), np.empty(0)
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _register(points_m: FloatArray, markers_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    seen = _all_finite(markers_m) & _all_finite(points_m)
    poses = np.full((len(markers_m), 4, 4), np.nan)
    rms_m = np.full(len(markers_m), np.nan)
    rows = np.flatnonzero(_determined(points_m, seen))
    if not len(rows):
        return poses, rms_m
    weights = seen[rows].astype(np.float64)
    counts = weights.sum(axis=1)
    known = np.where(np.isfinite(points_m), points_m, 0.0)
    measured = np.where(seen[rows, :, None], markers_m[rows], 0.0)
    point_means = (weights @ known) / counts[:, None]
    marker_means = measured.sum(axis=1) / counts[:, None]
    centred = (measured - marker_means[:, None]) * weights[:, :, None]
    U, _, Vt = np.linalg.svd(np.swapaxes(centred, 1, 2) @ known)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    turned = U @ Vt
    offset = marker_means - (turned @ point_means[:, :, None])[:, :, 0]
    off = (measured - known @ np.swapaxes(turned, 1, 2) - offset[:, None]) * weights[:, :, None]
    poses[rows] = np.eye(4)
    poses[rows, :3, :3], poses[rows, :3, 3] = turned, offset
    rms_m[rows] = np.sqrt((off**2).sum(axis=(1, 2)) / counts)
    return poses, rms_m


def _determined(points_m: FloatArray, seen: BoolArray) -> BoolArray:
    """(N,) whether the markers that are seen are three or more and not in a line."""
    patterns, which = np.unique(seen, axis=0, return_inverse=True)
    good = np.array([_spans_a_plane(points_m[pattern]) for pattern in patterns], dtype=np.bool_)
    return good[which.reshape(-1)]


def _spans_a_plane(points_m: FloatArray) -> bool:
    if len(points_m) < _MIN_MARKERS:
        return False
    spread = np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
    return bool(spread[1] > _STRAIGHT * spread[0])


def mean_shape(markers_m: FloatArray, labels: Sequence[str], what: str) -> FloatArray:
    """(n, 3) the markers' mean shape in the frame of one of the frames, from markers_m (N, n, 3) with NaN for unseen
    ones. ``what`` names the body in errors.

    Raises GtcalError where a marker is never seen, no frame connects it with the others, or the shape isn't rigid."""
    seen = _all_finite(markers_m)
    never = [label for i, label in enumerate(labels) if not seen[:, i].any()]
    if never:
        raise GtcalError(f"{what}: marker {never[0]!r} is never seen; leave it out of the body's markers")
    chosen = _frames_for_shape(markers_m, seen)
    reference = _reference_frame(chosen)
    points_m = chosen[reference]
    for _ in range(_SHAPE_ROUNDS + len(labels)):
        poses, rms_m = register(points_m, chosen)
        good = np.isfinite(rms_m) & (rms_m <= _limit_m(rms_m))
        if not good.any():
            raise GtcalError(
                f"{what}: no frame shows three or more of the markers {', '.join(labels)} that are not in a line"
            )
        registered = _to_body(poses[good], chosen[good])
        before, points_m = points_m, _median(registered)
        unknown = ~_all_finite(points_m)
        settled = np.array_equal(np.isnan(before), np.isnan(points_m))
        if settled and not unknown.any() and np.abs(points_m - before).max() < 1e-7:
            break
        if settled and unknown.any():
            missing = [label for label, gone in zip(labels, unknown.tolist(), strict=True) if gone]
            raise GtcalError(
                f"{what}: marker {missing[0]!r} is never seen together with three of the others; leave it out of the "
                "body's markers"
            )
    typical_m = float(np.nanmedian(register(points_m, chosen)[1]))
    if typical_m > _LEAST_RIGID_RMS_M:
        raise GtcalError(
            f"{what}: the markers {', '.join(labels)} move against each other by {1000 * typical_m:.3g} mm rms; are "
            "they the labels of one rigid body?"
        )
    return points_m


def _frames_for_shape(markers_m: FloatArray, seen: BoolArray) -> FloatArray:
    """Frames that show most, evenly over the take, but some for each pattern of seen markers."""
    patterns, which, counts = np.unique(seen, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    by_most_seen = np.argsort(-patterns.sum(axis=1), kind="stable")
    rows: list[np.ndarray] = []
    for pattern in by_most_seen[:50]:
        if patterns[pattern].sum() < _MIN_MARKERS:
            continue
        of_it = np.flatnonzero(which == pattern)
        share = max(20, round(_SHAPE_FRAMES * counts[pattern] / len(which)))
        rows.append(of_it[np.linspace(0, len(of_it) - 1, min(share, len(of_it))).astype(np.int64)])
    if not rows:
        return markers_m[:1]
    return markers_m[np.unique(np.concatenate(rows))]


def _reference_frame(markers_m: FloatArray) -> int:
    """The frame whose distances between markers are nearest to the medians, among those that show most."""
    first, second = np.triu_indices(markers_m.shape[1], k=1)
    distances = np.linalg.norm(markers_m[:, first] - markers_m[:, second], axis=2)
    off = np.abs(distances - _median(distances))
    n_seen = _all_finite(markers_m).sum(axis=1)
    most = n_seen == n_seen.max()
    worst = np.where(np.isfinite(off), off, 0.0).max(axis=1)
    return int(np.flatnonzero(most)[worst[most].argmin()])


def _all_finite(values: FloatArray) -> BoolArray:
    """Whether all of the last axis is there."""
    return np.asarray(np.isfinite(values).all(axis=-1))


def _median(values: FloatArray) -> FloatArray:
    """The median over the first axis without the NaN; NaN where there is nothing."""
    some = np.isfinite(values).any(axis=0)
    out = np.full(values.shape[1:], np.nan)
    out[some] = np.nanmedian(values[:, some], axis=0)
    return out


def _to_body(world_T_body: FloatArray, in_world: FloatArray) -> FloatArray:
    return (in_world - world_T_body[:, None, :3, 3]) @ world_T_body[:, :3, :3]


def _limit_m(rms_m: FloatArray) -> float:
    """The residual beyond which a frame doesn't fit, from the residuals of all of them."""
    known = rms_m[np.isfinite(rms_m)]
    if not len(known):
        return _SMALLEST_LIMIT_M
    middle = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - middle)))
    return max(_SMALLEST_LIMIT_M, _LIMIT_RATIO * middle, middle + _LIMIT_SIGMAS * spread)


def in_body_frame(points_m: FloatArray, labels: Sequence[str], what: str) -> FloatArray:
    """The shape (n, 3) in a frame that its markers define, the same in every take: origin at the centroid, x towards
    the first marker, the second marker (or the next that isn't in line with x) on the side of positive y in the plane
    of x and y.

    Raises GtcalError where the markers are in a line, or the first is at the centroid."""
    centred = points_m - points_m.mean(axis=0)
    size_m = float(np.linalg.norm(centred, axis=1).max())
    if not _spans_a_plane(points_m):
        raise GtcalError(f"{what}: the markers {', '.join(labels)} are in a line; a body needs one beside it")
    if np.linalg.norm(centred[0]) < _TOO_CENTRAL * size_m:
        raise GtcalError(
            f"{what}: marker {labels[0]!r} is at the centroid of the markers, and the body's x axis points to the "
            "first; list another one first"
        )
    x = centred[0] / np.linalg.norm(centred[0])
    across = centred - np.outer(centred @ x, x)
    off_line = np.linalg.norm(across, axis=1) > _TOO_CENTRAL * size_m
    y = across[int(np.flatnonzero(off_line)[0])]
    y /= np.linalg.norm(y)
    return np.asarray(centred @ np.stack([x, y, np.cross(x, y)], axis=1))


def fit(shape: MarkerShape, markers_m: FloatArray) -> MarkerFit:
    """The pose of the shape in every frame of markers_m (N, n, 3), NaN where unseen."""
    poses, rms_m = register(shape.points_m, markers_m)
    too_few = np.isnan(rms_m)
    limit_m = _limit_m(rms_m)
    bad = np.flatnonzero(rms_m > limit_m)
    mended, mended_rms_m, how = _mend(shape.points_m, markers_m[bad], limit_m)
    poses[bad], rms_m[bad] = mended, mended_rms_m
    swapped, without_one, contradicting = (_mask(len(poses), bad[how == which]) for which in ("swap", "drop", ""))
    return MarkerFit(poses, rms_m, limit_m, swapped, without_one, contradicting, too_few)


def _mask(n: int, rows: IntArray) -> BoolArray:
    mask = np.zeros(n, dtype=np.bool_)
    mask[rows] = True
    return mask


def _mend(points_m: FloatArray, markers_m: FloatArray, limit_m: float) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Frames that don't fit, with the one swap of two labels, or without the one marker, that makes them fit: poses,
    residuals and how. NaN and '' where there is no such one, or more than one."""
    n = markers_m.shape[1]
    best_poses = np.full((len(markers_m), 4, 4), np.nan)
    best_rms_m = np.full(len(markers_m), np.nan)
    how = np.full(len(markers_m), "", dtype="<U4")
    n_fitting = np.zeros(len(markers_m), dtype=np.int64)
    either_seen = _all_finite(markers_m)
    trials: list[tuple[str, tuple[int, ...]]] = [("swap", pair) for pair in combinations(range(n), 2)]
    trials += [("drop", (i,)) for i in range(n)]
    for meaning, markers in trials if len(markers_m) else ():
        rows = np.flatnonzero(either_seen[:, markers].any(axis=1))
        tried = markers_m[rows].copy()
        if meaning == "swap":
            tried[:, list(markers)] = tried[:, list(markers[::-1])]
        else:
            tried[:, markers[0]] = np.nan
        poses, rms_m = register(points_m, tried)
        fits = rms_m <= limit_m
        n_fitting[rows[fits]] += 1
        best_poses[rows[fits]], best_rms_m[rows[fits]], how[rows[fits]] = poses[fits], rms_m[fits], meaning
    unclear = n_fitting != 1
    best_poses[unclear], best_rms_m[unclear], how[unclear] = np.nan, np.nan, ""
    return best_poses, best_rms_m, how
