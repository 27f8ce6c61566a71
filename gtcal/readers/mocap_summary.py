"""What a file of mocap data holds, before anyone says which of its bodies is wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gtcal.camera import BoolArray
from gtcal.errors import GtcalError
from gtcal.files import check_regular, is_there
from gtcal.readers import c3d, motive_csv, qualisys_tsv, rosbag, trc, vicon_csv
from gtcal.readers.euroc_csv import open_euroc_csv
from gtcal.readers.mocap_take import METRES_PER_UNIT, MocapTake
from gtcal.readers.poses import PoseConventions
from gtcal.readers.tum import open_tum
from gtcal.recordings.detections import IntArray
from gtcal.recordings.text_table import TIME_UNIT_DIGITS, Kind, TextTable

_HEAD_BYTES = 1 << 16
_TAKES: dict[str, Callable[[Path], MocapTake]] = {
    "motive_csv": motive_csv.read_motive_take,
    "vicon_csv": vicon_csv.read_vicon_take,
    "qualisys_tsv": qualisys_tsv.read_qualisys_take,
    "c3d": c3d.read_c3d_take,
    "trc": trc.read_trc_take,
}
_TEXT_HEADS: dict[str, Callable[[str], bool]] = {
    "motive_csv": motive_csv.is_motive_csv,
    "vicon_csv": vicon_csv.is_vicon_csv,
    "qualisys_tsv": qualisys_tsv.is_qualisys_tsv,
    "trc": trc.is_trc,
}
_LOST_FRAMES = 1.5


@dataclass(frozen=True)
class BodySummary:
    """A body of a file, or a set of labels with one prefix ('box:left' and others), of which a body can be solved.

    n_seen: frames with a pose; of a set of labels, frames with three of its markers or more.
    n_gaps, longest_gap_s: between seen frames; None where the file has no time.
    rotation: what the numbers of its rotations are, None where the manifest has to say.
    markers: the labels of its measured markers.
    from_markers: it has no pose in the file and is solved from its markers.
    """

    name: str
    n_seen: int
    n_gaps: int
    longest_gap_s: float | None
    rotation: str | None
    markers: tuple[str, ...] = ()
    from_markers: bool = False


@dataclass(frozen=True)
class MocapSummary:
    """What a file of mocap data holds.

    bodies: those that ``name`` in the manifest can choose; for one there is no need to.
    markers: frames in which each was seen, by label.
    n_frames, rate_hz, start_ns, duration_s: rate and times None where the file doesn't state them. The rate is the
        median one where the file states none.
    length_unit: None where the file doesn't state it.
    open_fields: the manifest's fields that must be given, since the file doesn't state them.
    stated: what else the header states. notes: what is odd about the file.
    """

    path: Path
    format: str
    bodies: tuple[BodySummary, ...]
    markers: dict[str, int]
    n_frames: int
    rate_hz: float | None
    start_ns: int | None
    duration_s: float | None
    length_unit: str | None
    open_fields: tuple[str, ...] = ()
    stated: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def detect_mocap_format(path: Path) -> str | None:
    """The name in ``TRAJECTORY_READERS`` of the format that a file or a bag's folder has, by its own head; None where
    it is none of them."""
    if not is_there(path):
        return None
    check_regular(path)
    if rosbag.is_rosbag(path) or path.is_dir():
        return rosbag.FORMAT if rosbag.is_rosbag(path) else None
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return None
    if c3d.is_c3d(head):
        return c3d.FORMAT
    text = head.decode("utf-8-sig", errors="replace")
    for name, fits in _TEXT_HEADS.items():
        if fits(text):
            return name
    return _columns_format(path) if "\0" not in text else None


def inspect_mocap(path: Path, format: str | None = None) -> MocapSummary:
    """What a file holds. ``format``: a name in ``TRAJECTORY_READERS``; by default ``detect_mocap_format``'s.

    Raises GtcalError where the format is unknown, or the file is damaged."""
    if not path.exists():
        raise GtcalError(f"{path}: there is no such file")
    name = format or detect_mocap_format(path)
    if name in _TAKES:
        return _of_take(_TAKES[name](path))
    if name == rosbag.FORMAT:
        return _of_bag(path)
    if name == "euroc_csv":
        return _of_table(path, name, *open_euroc_csv(path))
    if name == "tum":
        return _of_table(path, name, *open_tum(path))
    known = ", ".join(("euroc_csv", "tum", *_TAKES, rosbag.FORMAT))
    what = f"{name!r} is no format" if name else "is of no format that gtcal knows"
    raise GtcalError(f"{path}: {what}; formats: {known}")


def _columns_format(path: Path) -> str | None:
    """euroc_csv or tum where the columns are theirs."""
    for name, opened in (("tum", open_tum), ("euroc_csv", open_euroc_csv)):
        try:
            table, columns, _ = opened(path)
            if table.n_columns:
                table.read(columns)
                return name
        except GtcalError:
            continue
    return None


def _of_take(take: MocapTake) -> MocapSummary:
    bodies = [
        BodySummary(name, *_seen(take, body.seen()), body.rotation, body.markers) for name, body in take.bodies.items()
    ]
    for prefix in take.prefixes:
        if prefix not in take.bodies:
            labels = take.markers_of(prefix)
            seen = np.sum([np.isfinite(take.markers[label]).all(axis=1) for label in labels], axis=0) >= 3
            bodies.append(BodySummary(prefix, *_seen(take, seen), None, labels, from_markers=True))
    fields = {
        "length_unit": take.metres_per_unit is None,
        "rate_hz": take.stamps_ns is None,
        "rotation": any(body.rotation is None for body in take.bodies.values()),
    }
    stamps_ns = take.stamps_ns
    return MocapSummary(
        path=take.path,
        format=take.format,
        bodies=tuple(bodies),
        markers={label: int(np.isfinite(at).all(axis=1).sum()) for label, at in take.markers.items()},
        n_frames=take.n_frames,
        rate_hz=take.rate_hz or _rate_hz(stamps_ns),
        start_ns=None if stamps_ns is None or not len(stamps_ns) else int(stamps_ns[0]),
        duration_s=_duration_s(stamps_ns),
        length_unit=next((name for name, scale in METRES_PER_UNIT.items() if scale == take.metres_per_unit), None),
        open_fields=tuple(name for name, is_open in fields.items() if is_open),
        stated=take.stated,
        notes=take.notes,
    )


def _of_bag(path: Path) -> MocapSummary:
    """The bodies of a bag each have their own stamps; the summary's are those of all."""
    parts = [_of_take(take) for take in rosbag.read_rosbag_takes(path).values()]
    starts = [part.start_ns for part in parts if part.start_ns is not None]
    ends = [
        part.start_ns + round(part.duration_s * 1e9)
        for part in parts
        if part.start_ns is not None and part.duration_s is not None
    ]
    most = max(parts, key=lambda part: part.n_frames)
    return MocapSummary(
        path=path,
        format=rosbag.FORMAT,
        bodies=tuple(body for part in parts for body in part.bodies),
        markers={},
        n_frames=most.n_frames,
        rate_hz=most.rate_hz,
        start_ns=min(starts),
        duration_s=(max(ends) - min(starts)) * 1e-9 if ends else None,
        length_unit="m",
        stated={body.name: part.stated["frame"] for part in parts for body in part.bodies},
        notes=tuple(note for part in parts for note in part.notes),
    )


def _of_table(
    path: Path, name: str, table: TextTable, columns: list[tuple[str, Kind]], stated: PoseConventions
) -> MocapSummary:
    rows = table.read(columns)
    stamps_ns = None
    if stated.time_unit in TIME_UNIT_DIGITS and len(rows):
        stamps_ns = table.stamps_ns(rows["stamp"], stated.time_unit)
        table.check_strictly_increasing(stamps_ns)
    gaps = (0, None) if stamps_ns is None else _gaps(stamps_ns)
    rotation = None if stated.quaternion is None else f"quaternion_{stated.quaternion}"
    return MocapSummary(
        path=path,
        format=name,
        bodies=(BodySummary(path.stem, len(rows), *gaps, rotation),),
        markers={},
        n_frames=len(rows),
        rate_hz=_rate_hz(stamps_ns),
        start_ns=None if stamps_ns is None else int(stamps_ns[0]),
        duration_s=_duration_s(stamps_ns),
        length_unit=stated.length_unit,
        open_fields=tuple(
            field for field in ("quaternion", "length_unit", "time_unit") if getattr(stated, field) is None
        ),
    )


def _seen(take: MocapTake, seen: BoolArray) -> tuple[int, int, float | None]:
    """Seen frames, gaps and the longest: missing rows and blank ones alike."""
    n_seen = int(seen.sum())
    if take.stamps_ns is None:
        frames = take.frames[seen]
        return n_seen, int((np.diff(frames) > 1).sum()), None
    return n_seen, *_gaps(take.stamps_ns[seen], take.stamps_ns)


def _gaps(stamps_ns: IntArray, of_all_ns: IntArray | None = None) -> tuple[int, float | None]:
    """How many gaps there are between the stamps, and the longest in seconds, 0 for none. The usual interval is the
    median one, of all frames."""
    if len(stamps_ns) < 2:
        return 0, 0.0
    intervals = np.diff(stamps_ns)
    usual = float(np.median(np.diff(of_all_ns if of_all_ns is not None else stamps_ns)))
    long = intervals[intervals > _LOST_FRAMES * usual]
    return len(long), float(long.max()) * 1e-9 if len(long) else 0.0


def _rate_hz(stamps_ns: IntArray | None) -> float | None:
    if stamps_ns is None or len(stamps_ns) < 2:
        return None
    return 1e9 / float(np.median(np.diff(stamps_ns)))


def _duration_s(stamps_ns: IntArray | None) -> float | None:
    if stamps_ns is None or not len(stamps_ns):
        return None
    return float(stamps_ns[-1] - stamps_ns[0]) * 1e-9
