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

from factors.kernel import kernel
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
_BITS = 30
# A thrown hand tool turns by some 2000 degrees a second, nothing that is held does.
_LEAST_JUMP_DEG, _FASTEST_TURN_DEG_PER_S = 45.0, 3000.0
_MOST_TURNED_OVER = 0.2
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
    seen = _all_finite(markers_m) & _all_finite(points_m)
    poses = np.full((len(markers_m), 4, 4), np.nan)
    rms_m = np.full(len(markers_m), np.nan)
    _register(np.ascontiguousarray(points_m), markers_m, seen, _determined(points_m, seen), poses, rms_m)
    return poses, rms_m


def _determined(points_m: FloatArray, seen: BoolArray) -> BoolArray:
    """(N,) whether the markers that are seen are three or more and not in a line."""
    patterns, which, _ = _patterns(seen)
    return np.array([_spans_a_plane(points_m[pattern]) for pattern in patterns], dtype=np.bool_)[which]


def _patterns(seen: BoolArray) -> tuple[BoolArray, IntArray, IntArray]:
    """The different rows of seen (N, n), which of them each row is, and how often each is there. Bits are packed into
    whole numbers, since NumPy compares rows a hundred times slower than numbers."""
    n = seen.shape[1]
    keys = np.zeros(len(seen), dtype=np.int64)
    for start in range(0, n, _BITS):
        bits = seen[:, start : start + _BITS]
        packed = bits @ (1 << np.arange(bits.shape[1], dtype=np.int64))
        # renumbered from 0, so that many markers' numbers still fit
        _, keys = np.unique(keys * (1 << bits.shape[1]) + packed, return_inverse=True)
    _, first, which, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    return seen[first], which.reshape(-1), counts


@kernel
def _register(
    points_m: FloatArray,
    markers_m: FloatArray,
    seen: BoolArray,
    determined: BoolArray,
    poses: FloatArray,
    rms_m: FloatArray,
) -> None:
    """Horn's closed form (1987): the rotation is the eigenvector, as a quaternion, of the largest eigenvalue of a
    symmetric 4 x 4 matrix of the markers' second moments. Writes poses (N, 4, 4) and rms_m (N,)."""
    n = len(points_m)
    moments = np.empty((3, 3))
    horn = np.empty((4, 4))
    vectors = np.empty((4, 4))
    for row in range(len(markers_m)):
        if not determined[row]:
            continue
        count = 0
        point_mean = np.zeros(3)
        marker_mean = np.zeros(3)
        for i in range(n):
            if seen[row, i]:
                count += 1
                for k in range(3):
                    point_mean[k] += points_m[i, k]
                    marker_mean[k] += markers_m[row, i, k]
        point_mean /= count
        marker_mean /= count
        moments[:] = 0.0
        for i in range(n):
            if seen[row, i]:
                for k in range(3):
                    for m in range(3):
                        moments[k, m] += (points_m[i, k] - point_mean[k]) * (markers_m[row, i, m] - marker_mean[m])
        _horn_matrix(moments, horn)
        _eigenvectors(horn, vectors)
        best = 0
        for k in range(1, 4):
            if horn[k, k] > horn[best, best]:
                best = k
        pose = poses[row]
        _rotation_of(vectors[0, best], vectors[1, best], vectors[2, best], vectors[3, best], pose)
        for k in range(3):
            turned = pose[k, 0] * point_mean[0] + pose[k, 1] * point_mean[1] + pose[k, 2] * point_mean[2]
            pose[k, 3] = marker_mean[k] - turned
            pose[3, k] = 0.0
        pose[3, 3] = 1.0
        total = 0.0
        for i in range(n):
            if seen[row, i]:
                for k in range(3):
                    at = pose[k, 3]
                    for m in range(3):
                        at += pose[k, m] * points_m[i, m]
                    total += (at - markers_m[row, i, k]) ** 2
        rms_m[row] = np.sqrt(total / count)


@kernel
def _horn_matrix(S: FloatArray, horn: FloatArray) -> None:
    """Horn's matrix of S = sum point marker^T, for quaternions wxyz."""
    horn[0, 0] = S[0, 0] + S[1, 1] + S[2, 2]
    horn[1, 1] = S[0, 0] - S[1, 1] - S[2, 2]
    horn[2, 2] = -S[0, 0] + S[1, 1] - S[2, 2]
    horn[3, 3] = -S[0, 0] - S[1, 1] + S[2, 2]
    horn[0, 1] = horn[1, 0] = S[1, 2] - S[2, 1]
    horn[0, 2] = horn[2, 0] = S[2, 0] - S[0, 2]
    horn[0, 3] = horn[3, 0] = S[0, 1] - S[1, 0]
    horn[1, 2] = horn[2, 1] = S[0, 1] + S[1, 0]
    horn[1, 3] = horn[3, 1] = S[2, 0] + S[0, 2]
    horn[2, 3] = horn[3, 2] = S[1, 2] + S[2, 1]


@kernel
def _eigenvectors(A: FloatArray, V: FloatArray) -> None:
    """Jacobi's method: turns the symmetric A (4, 4) diagonal, and the columns of V into its eigenvectors."""
    V[:] = 0.0
    scale = 0.0
    for k in range(4):
        V[k, k] = 1.0
        for m in range(4):
            scale = max(scale, abs(A[k, m]))
    for _ in range(30):
        off = 0.0
        for p in range(3):
            for q in range(p + 1, 4):
                off = max(off, abs(A[p, q]))
                if abs(A[p, q]) <= 1e-17 * scale:
                    continue
                theta = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
                t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1.0))
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(4):
                    a, b = A[k, p], A[k, q]
                    A[k, p], A[k, q] = c * a - s * b, s * a + c * b
                for k in range(4):
                    a, b = A[p, k], A[q, k]
                    A[p, k], A[q, k] = c * a - s * b, s * a + c * b
                for k in range(4):
                    a, b = V[k, p], V[k, q]
                    V[k, p], V[k, q] = c * a - s * b, s * a + c * b
        if off <= 1e-17 * scale:
            break


@kernel
def _rotation_of(w: float, x: float, y: float, z: float, pose: FloatArray) -> None:
    """Write the rotation of a quaternion into pose (4, 4), made unit."""
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    pose[0, 0], pose[0, 1], pose[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    pose[1, 0], pose[1, 1], pose[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    pose[2, 0], pose[2, 1], pose[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


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
    patterns, which, counts = _patterns(seen)
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


def exchangeable(shape: MarkerShape, limit_m: float) -> tuple[str, str] | None:
    """Two labels that can be swapped without a residual that tells, as the opposite corners of a square, or None."""
    for i, j in combinations(range(len(shape.labels)), 2):
        swapped = shape.points_m.copy()
        swapped[[i, j]] = swapped[[j, i]]
        if register(shape.points_m, swapped[None])[1][0] <= limit_m:
            return shape.labels[i], shape.labels[j]
    return None


def turned_over(world_T_body: FloatArray, stamps_ns: IntArray, pair: tuple[str, str], what: str) -> BoolArray:
    """(N,) frames in which a body with these two exchangeable labels turned faster than anything does, and will turn
    back: they were swapped. The frames on the rarer side of such turns are the wrong ones.

    Raises GtcalError where neither side is rare, or a turn remains."""
    rows = np.flatnonzero(np.isfinite(world_T_body[:, 0, 0]))
    sides = np.cumsum(np.concatenate([[False], _jumps(world_T_body[rows], stamps_ns[rows])])) % 2
    rarer = int(2 * sides.sum() <= len(sides))
    wrong = rows[sides == rarer]
    right = rows[sides != rarer]
    jumps = _jumps(world_T_body[right], stamps_ns[right])
    if len(wrong) > _MOST_TURNED_OVER * len(rows) or jumps.any():
        at_s = 1e-9 * stamps_ns[(right[1:][jumps] if jumps.any() else wrong)[0]]
        raise GtcalError(
            f"{what}: from one frame to the next the body turns over, as at {at_s:.3f} s; the markers are symmetric, "
            f"so that labels like {pair[0]!r} and {pair[1]!r} get swapped: correct them in the mocap software"
        )
    return _mask(len(world_T_body), wrong)


def _jumps(world_T_body: FloatArray, stamps_ns: IntArray) -> BoolArray:
    """(N - 1,) whether the body turns faster than anything does on the way to the next frame."""
    if len(world_T_body) < 2:
        return np.zeros(0, dtype=np.bool_)
    step = np.swapaxes(world_T_body[:-1, :3, :3], 1, 2) @ world_T_body[1:, :3, :3]
    cosine = (np.trace(step, axis1=1, axis2=2) - 1.0) / 2.0
    turn_deg = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
    per_s = turn_deg / (1e-9 * np.diff(stamps_ns))
    return np.asarray((turn_deg > _LEAST_JUMP_DEG) & (per_s > _FASTEST_TURN_DEG_PER_S))


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
