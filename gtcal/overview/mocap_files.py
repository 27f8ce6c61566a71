"""What a file of a mocap holds, of whatever format ``gtcal.readers`` knows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gtcal.errors import GtcalError
from gtcal.readers import MocapSummary, inspect_mocap, pose_list
from gtcal.readers.pose_list import inspect_pose_list
from gtcal.recordings.bag_images import BAG_SUFFIXES

MOCAP_SUFFIXES = (".csv", ".tsv", ".txt", ".tum", ".c3d", ".trc", ".npy", *BAG_SUFFIXES)


@dataclass(frozen=True)
class MocapBody:
    """One tracked body of a file.

    name: in the file, None where the file holds but one and the manifest needs none. called: what people call it: in
    the file, or by it. open_fields: of the manifest's entry, which the file leaves open. n_samples. span_ns: first and
    last stamp, None where that is open."""

    path: Path
    format: str
    name: str | None
    called: str
    open_fields: tuple[str, ...]
    n_samples: int
    span_ns: tuple[int, int] | None


def mocap_bodies(path: Path) -> tuple[MocapBody, ...]:
    """The tracked bodies of a file; none where it is no file of a mocap, or one that can't be read."""
    try:
        return _bodies(inspect_mocap(path))
    except GtcalError:
        return _listed(path)


def _listed(path: Path) -> tuple[MocapBody, ...]:
    """The body of a list of poses without time."""
    try:
        found = inspect_pose_list(path)
    except GtcalError:
        return ()
    if found is None:
        return ()
    n_poses, open_fields = found
    return (MocapBody(path, pose_list.FORMAT, None, _by_file(path), open_fields, n_poses, None),)


def _bodies(summary: MocapSummary) -> tuple[MocapBody, ...]:
    alone = len(summary.bodies) == 1
    span_ns = None
    if summary.start_ns is not None and summary.duration_s is not None and "time_unit" not in summary.open_fields:
        span_ns = (summary.start_ns, summary.start_ns + round(summary.duration_s * 1e9))
    return tuple(
        MocapBody(
            summary.path,
            summary.format,
            None if alone else body.name,
            _by_file(summary.path) if body.name == summary.path.stem else body.name,
            tuple(name for name in summary.open_fields if name != "rotation" or body.rotation is None),
            body.n_seen,
            span_ns,
        )
        for body in summary.bodies
    )


def _by_file(path: Path) -> str:
    """data.csv is called by its folder."""
    return path.parent.name if path.stem in ("data", "poses", "trajectory") else path.stem
