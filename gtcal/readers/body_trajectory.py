"""From a mocap take to the trajectory of one of its bodies: as the file has it, from its markers, or both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.readers.mocap_take import METRES_PER_UNIT, BodyColumns, MocapTake, frame_stamps_ns, rotations
from gtcal.readers.poses import PoseConventions, check_distance, check_rate, farthest_row
from gtcal.readers.rigid_markers import (
    MarkerFit,
    MarkerShape,
    exchangeable,
    fit,
    in_body_frame,
    mean_shape,
    register,
    turned_over,
)
from gtcal.readers.selection import BodySelection, refuse_unused, shifted
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory

_SHOWN_NAMES = 12
_JUDGED_FRAMES = 2000
# Filters lag by some degrees, mirrored axes turn the other way. Where the software says where its own pose puts the
# markers, there is no lag.
_LARGEST_DISAGREEMENT_DEG = 10.0
_LARGEST_DISAGREEMENT_M = 0.01
_TRIMMED = 0.95
# A hundredth of a millimetre is no reason to prefer anything.
_WORTH_M = 1e-5


@dataclass(frozen=True)
class Solved:
    """A body's poses (N, 4, 4), NaN where there is none, and what was done to get them."""

    world_T_body: FloatArray
    notes: tuple[str, ...]


def trajectory_of(
    take: MocapTake, body: str, declared: PoseConventions, selection: BodySelection, used: set[str]
) -> Trajectory:
    """The trajectory of ``body`` from a take. ``used``: the fields of ``selection`` that this format has a use for.

    Raises GtcalError naming the file and what is wrong, or which field of the manifest is missing."""
    refuse_unused(take.path, body, selection, used | {"stamp_offset_ns"}, take.format)
    scale = _metres_per_unit(take, body, declared)
    name, labels = _chosen(take, body, selection)
    _check_declared(take, body, declared, name)
    stamps_ns = _stamps_ns(take, body, selection)
    check_rate(take.path, stamps_ns, body, "s")
    markers_m = scale * np.stack([take.markers[label] for label in labels], axis=1) if labels else None
    if name is None:
        assert markers_m is not None  # _chosen's own check
        solved = from_markers(markers_m, stamps_ns, labels, f"{take.path}: {body}", body)
    else:
        poses = poses_of(take, body, name, selection, scale)
        solved = (
            Solved(poses, ())
            if markers_m is None
            else from_both(poses, markers_m, labels, f"{take.path}: {name!r}", body)
        )
    seen = np.isfinite(solved.world_T_body).all(axis=(1, 2))
    if not seen.any():
        raise GtcalError(f"{take.path}: {body}: not seen in any of the {take.n_frames} frames")
    poses = solved.world_T_body[seen]
    check_distance(take.path, poses[:, :3, 3], body, "mm" if scale == METRES_PER_UNIT["mm"] else "m")
    if (row := farthest_row(poses[:, :3, 3])) is not None:
        distance_m = float(np.linalg.norm(poses[row, :3, 3]))
        frame = int(take.frames[seen][row])
        raise GtcalError(f"{take.path}: {body}: in frame {frame} it is {distance_m:.6g} m from the mocap origin")
    notes = (*(f"{body}: {note}" for note in take.notes), *solved.notes)
    return shifted(Trajectory(body, stamps_ns[seen], poses, notes), selection.stamp_offset_ns)


def poses_of(take: MocapTake, body: str, name: str, selection: BodySelection, scale: float) -> FloatArray:
    """(N, 4, 4) world_T_body as the file has it, metres, NaN where it was not seen."""
    columns = take.bodies[name]
    kind = columns.rotation or selection.rotation
    if kind is None:
        raise GtcalError(
            f"{take.path}: the file doesn't state how it writes rotations, and gtcal doesn't guess it; add "
            f"{body}.rotation to the manifest: {_kinds_for(columns)}"
        )
    if selection.rotation is not None and selection.rotation != kind:
        raise GtcalError(
            f"{take.path}: the file says {kind} rotations, but the manifest says {body}.rotation: "
            f"{selection.rotation}; correct the one that is wrong"
        )
    expected = {"quaternion_xyzw": 4, "matrix_by_columns": 9, "matrix_by_rows": 9}.get(kind, 3)
    if columns.rotations.shape[1] != expected:
        raise GtcalError(
            f"{take.path}: {body}.rotation: {kind} takes {expected} numbers, but the file has "
            f"{columns.rotations.shape[1]}; choose {_kinds_for(columns)}"
        )
    seen = columns.seen()
    poses = np.full((take.n_frames, 4, 4), np.nan)
    poses[seen] = np.eye(4)
    where = f"{take.path}: {name!r}"
    poses[seen, :3, :3] = rotations(kind, columns.rotations[seen], bool(columns.degrees), where)
    poses[seen, :3, 3] = scale * columns.positions[seen]
    _check_expected(columns, poses, scale, where)
    return poses


def from_markers(markers_m: FloatArray, stamps_ns: IntArray, labels: tuple[str, ...], what: str, body: str) -> Solved:
    """A body that is given by its markers only, markers_m (N, n, 3); its frame is ``in_body_frame``'s.

    Raises GtcalError where they are not those of one rigid body, or give no pose."""
    shape = MarkerShape(labels, in_body_frame(mean_shape(markers_m, labels, what), labels, what))
    found = fit(shape, markers_m)
    if not found.ok.any():
        raise GtcalError(f"{what}: the markers {', '.join(labels)} give no pose in any frame")
    pair = exchangeable(shape, found.limit_m)
    over = (
        np.zeros(len(markers_m), dtype=np.bool_)
        if pair is None
        else turned_over(found.world_T_body, stamps_ns, pair, what)
    )
    note = f"{body}: solved from {len(labels)} markers, residual {1000 * found.median_rms_m:.3g} mm rms (median)"
    note += _what_was_mended(found)
    note += f"; {_frames(over)} left out, turned over by swapped labels" if over.any() else ""
    return Solved(np.where(over[:, None, None], np.nan, found.world_T_body), (note,))


def from_both(poses: FloatArray, markers_m: FloatArray, labels: tuple[str, ...], what: str, body: str) -> Solved:
    """A body of which the file has both poses (N, 4, 4) and measured markers (N, n, 3). The markers fill the frames
    without a pose, and take the place of all poses where each marker is predicted better by the other markers than by
    the file's pose, which has seen it: filtered poses lag behind. The frame stays the file's.

    Raises GtcalError where the poses don't carry the markers along."""
    in_file = np.isfinite(poses).all(axis=(1, 2))
    ever = np.asarray(np.isfinite(markers_m).all(axis=2).any(axis=0))
    labels = tuple(label for i, label in enumerate(labels) if ever[i])
    markers_m = markers_m[:, ever]
    if len(labels) < 3 or not in_file.any():
        return Solved(poses, ())
    try:
        own_m = mean_shape(markers_m, labels, f"{what}: the measured markers are not used")
    except GtcalError as error:  # the file's poses don't need them
        return Solved(poses, (f"{body}: {str(error).removeprefix(f'{what}: ')}",))
    shape = _in_file_frame(own_m, poses, markers_m, labels, what)
    if shape is None:
        return Solved(poses, ())
    found = fit(shape, markers_m)
    by_file_m, by_markers_m = _prediction_errors_m(poses, shape, markers_m, found)
    if by_file_m - by_markers_m > _WORTH_M:
        note = (
            f"{body}: solved from its {len(labels)} measured markers, which the file's poses miss by "
            f"{1000 * by_file_m:.3g} mm rms and each other by {1000 * by_markers_m:.3g} mm"
        )
        merged = np.where(found.ok[:, None, None], found.world_T_body, poses)
        return Solved(merged, (note + _what_was_mended(found),))
    filled = ~in_file & found.ok
    if not filled.any():
        return Solved(poses, ())
    rms_mm = 1000 * float(np.median(found.rms_m[filled]))
    note = (
        f"{body}: {_frames(filled)} without a pose in the file solved from the measured markers, residual "
        f"{rms_mm:.3g} mm rms (median)"
    )
    return Solved(np.where(filled[:, None, None], found.world_T_body, poses), (note,))


def _in_file_frame(
    own_m: FloatArray, poses: FloatArray, markers_m: FloatArray, labels: tuple[str, ...], what: str
) -> MarkerShape | None:
    """The markers' mean shape own_m (n, 3), placed where the file's poses put it on the whole. None where poses and
    markers were never there together."""
    rows = _spread(np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)) & np.isfinite(markers_m).any(axis=(1, 2))))
    found = fit(MarkerShape(labels, own_m), markers_m[rows])
    if not found.ok.any():
        return None
    body_T_own = inverse(poses[rows][found.ok]) @ found.world_T_body[found.ok]
    turned = Rotation.from_matrix(body_T_own[:, :3, :3])
    middle = turned.mean()
    off_deg = float(np.rad2deg(np.median((middle.inv() * turned).magnitude())))
    if off_deg > _LARGEST_DISAGREEMENT_DEG:
        raise GtcalError(
            f"{what}: the body's rotations differ from those of its markers {', '.join(labels)} by {off_deg:.3g} deg "
            "(median); are the axes right-handed, and are these its markers?"
        )
    return MarkerShape(labels, middle.apply(own_m) + np.median(body_T_own[:, :3, 3], axis=0))


def _prediction_errors_m(
    poses: FloatArray, shape: MarkerShape, markers_m: FloatArray, found: MarkerFit
) -> tuple[float, float]:
    """Rms error of a marker as the file's pose predicts it, and as the other markers do. The worst twentieth is left
    out. Infinite for the markers where three others are not enough."""
    n = len(shape.labels)
    complete = np.isfinite(markers_m).all(axis=(1, 2)) & np.isfinite(poses).all(axis=(1, 2))
    rows = _spread(np.flatnonzero(complete & found.ok & ~found.swapped & ~found.without_one))
    if n < 4 or not len(rows):
        return 0.0, np.inf
    measured, by_file = markers_m[rows], []
    by_others = []
    for i in range(n):
        without = measured.copy()
        without[:, i] = np.nan
        others, _ = register(shape.points_m, without)
        by_others.append(_distance_m(others, shape.points_m[i], measured[:, i]))
        by_file.append(_distance_m(poses[rows], shape.points_m[i], measured[:, i]))
    if not np.isfinite(by_others).all():
        return 0.0, np.inf
    return _trimmed_rms(np.concatenate(by_file)), _trimmed_rms(np.concatenate(by_others))


def _distance_m(world_T_body: FloatArray, point_m: FloatArray, measured_m: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(world_T_body[:, :3, :3] @ point_m + world_T_body[:, :3, 3] - measured_m, axis=1))


def _trimmed_rms(errors: FloatArray) -> float:
    kept = np.sort(errors)[: max(1, int(_TRIMMED * len(errors)))]
    return float(np.sqrt((kept**2).mean()))


def _spread(rows: IntArray) -> IntArray:
    """At most so many of these rows, evenly."""
    if len(rows) <= _JUDGED_FRAMES:
        return rows
    return rows[np.linspace(0, len(rows) - 1, _JUDGED_FRAMES).astype(np.int64)]


def _what_was_mended(found: MarkerFit) -> str:
    parts = [
        f"{_frames(mask)} {what}"
        for mask, what in (
            (found.swapped, "with two labels swapped back"),
            (found.without_one, "without one marker that contradicts the others"),
            (found.contradicting, "left out, their markers contradict each other"),
            (found.too_few, "left out, fewer than three markers"),
        )
        if mask.any()
    ]
    return "; " + "; ".join(parts) if parts else ""


def _frames(mask: BoolArray) -> str:
    n = int(mask.sum())
    return f"{n} frame" + ("" if n == 1 else "s")


def _chosen(take: MocapTake, body: str, selection: BodySelection) -> tuple[str | None, tuple[str, ...]]:
    """The body's name in the file, None for one that is solved from markers alone, and its markers' labels."""
    name, labels = selection.name, selection.markers
    if labels is not None:
        _check_labels(take, body, labels)
    if name is not None and name not in take.bodies:
        of_prefix = take.markers_of(name)
        if labels is not None or not of_prefix:
            raise GtcalError(f"{take.path}: {body}.name: the file holds no body {name!r}; {_holds(take, body)}")
        _check_labels(take, body, of_prefix)
        return None, of_prefix
    if name is None and labels is None:
        if len(take.bodies) != 1:
            field = "name" if take.bodies else "markers"
            raise GtcalError(f"{take.path}: say which one is {body}, in {body}.{field}; {_holds(take, body)}")
        name = next(iter(take.bodies))
    if name is None:
        assert labels is not None
        return None, labels
    return name, labels if labels is not None else take.markers_of(name)


def _check_labels(take: MocapTake, body: str, labels: tuple[str, ...]) -> None:
    for label in labels:
        if label not in take.markers:
            raise GtcalError(f"{take.path}: {body}.markers: the file holds no marker {label!r}; {_holds(take, body)}")
    if len(set(labels)) < len(labels):
        raise GtcalError(f"{take.path}: {body}.markers: a label stands twice: {', '.join(labels)}")
    if len(labels) < 3:
        raise GtcalError(f"{take.path}: {body}.markers: {len(labels)} given; a body needs three or more")


def _holds(take: MocapTake, body: str) -> str:
    """What there is to choose from."""
    if take.bodies:
        return f"it holds {listed('bodies', list(take.bodies))}"
    if not take.markers:
        return "it holds no body and no markers"
    by_prefix = f"; {body}.name: {' or '.join(take.prefixes)} takes all of one" if take.prefixes else ""
    return f"it holds no body, only {listed('markers', list(take.markers))}{by_prefix}"


def listed(what: str, names: list[str]) -> str:
    """'bodies a, b, c', and how many more."""
    more = f" and {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else ""
    return f"{what} {', '.join(names[:_SHOWN_NAMES])}{more}"


def _metres_per_unit(take: MocapTake, body: str, declared: PoseConventions) -> float:
    claimed = None if declared.length_unit is None else METRES_PER_UNIT[declared.length_unit]
    if take.metres_per_unit is None and claimed is None:
        raise GtcalError(
            f"{take.path}: the file doesn't state its length_unit, and gtcal doesn't guess it; add {body}.length_unit "
            "to the manifest: m or mm"
        )
    if take.metres_per_unit is not None and claimed is not None and take.metres_per_unit != claimed:
        unit = next(name for name, scale in METRES_PER_UNIT.items() if scale == take.metres_per_unit)
        raise GtcalError(
            f"{take.path}: the file's header says length_unit {unit}, but the manifest says {body}.length_unit: "
            f"{declared.length_unit}; correct the one that is wrong"
        )
    return take.metres_per_unit if take.metres_per_unit is not None else float(claimed or 1.0)


def _stamps_ns(take: MocapTake, body: str, selection: BodySelection) -> IntArray:
    if take.rate_hz is not None and selection.rate_hz not in (None, take.rate_hz):
        raise GtcalError(
            f"{take.path}: the file says {take.rate_hz:g} frames a second, but the manifest says {body}.rate_hz: "
            f"{selection.rate_hz:g}; correct the one that is wrong"
        )
    if take.stamps_ns is not None:
        return take.stamps_ns
    if selection.rate_hz is None:
        raise GtcalError(
            f"{take.path}: the file numbers its frames and doesn't state their rate; add {body}.rate_hz to the manifest"
        )
    return frame_stamps_ns(take.frames, selection.rate_hz)


def _check_declared(take: MocapTake, body: str, declared: PoseConventions, name: str | None) -> None:
    """Formats of mocap software leave nothing of these open; what the manifest states must be what they are."""
    kind = take.bodies[name].rotation if name is not None else None
    quaternion = "xyzw" if kind == "quaternion_xyzw" else None
    facts = {"quaternion": quaternion, "time_unit": take.time_unit, "pose": "world_T_body"}
    for field, fact in facts.items():
        claimed = getattr(declared, field)
        if claimed is not None and claimed != fact:
            said = f"format {take.format} has {fact} here" if fact else "there are no quaternions in the file"
            raise GtcalError(f"{take.path}: the manifest says {body}.{field}: {claimed}, but {said}; leave it out")


def _kinds_for(columns: BodyColumns) -> str:
    n = columns.rotations.shape[1]
    if n == 9:
        return "matrix_by_columns or matrix_by_rows"
    return "helical, or euler_xyz_intrinsic, euler_xyz_extrinsic and the like for the other orders"


def _check_expected(columns: BodyColumns, poses: FloatArray, scale: float, where: str) -> None:
    """Where the software says where its pose puts the markers, the pose as read must put them there. Rotations read
    with another convention than they were written, or axes that were mirrored, don't."""
    rows = _spread(np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))))
    for label, expected in columns.expected.items():
        in_world = scale * expected[rows]
        known = np.isfinite(in_world).all(axis=1)
        if not known.any():
            continue
        world_T_body = poses[rows[known]]
        in_body = np.einsum("nji,nj->ni", world_T_body[:, :3, :3], in_world[known] - world_T_body[:, :3, 3])
        off_m = float(np.median(np.linalg.norm(in_body - np.median(in_body, axis=0), axis=1)))
        if off_m > _LARGEST_DISAGREEMENT_M:
            raise GtcalError(
                f"{where}: its pose leaves its own marker {label!r} behind by {1000 * off_m:.3g} mm (median); are the "
                "axes right-handed, and the rotations written as the header says?"
            )
