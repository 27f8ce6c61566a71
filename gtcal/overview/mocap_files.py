"""What a file of a mocap holds, of whatever format ``gtcal.readers`` knows."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gtcal import readers
from gtcal.errors import GtcalError
from gtcal.readers import TRAJECTORY_READERS, PoseConventions
from gtcal.recordings.bag_images import BAG_SUFFIXES

MOCAP_SUFFIXES = (".csv", ".tsv", ".txt", ".tum", ".c3d", ".trc", *BAG_SUFFIXES)
# What stands in for what a file leaves open, to look at the rest of it.
_STAND_INS: dict[str, Any] = {"quaternion": "wxyz", "length_unit": "m", "time_unit": "ns"}


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
    inspect = getattr(readers, "inspect_mocap", None)
    try:
        return _inspected(inspect(path)) if inspect is not None else _tried(path)
    except GtcalError:
        return ()


def _inspected(summary: Any) -> tuple[MocapBody, ...]:
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


def _tried(path: Path) -> tuple[MocapBody, ...]:
    """By whichever of the readers takes the file; without bags and other binary files."""
    if path.is_dir() or path.suffix.lower() in (".c3d", *BAG_SUFFIXES):
        return ()
    for name in sorted(TRAJECTORY_READERS, key=lambda name: name != "tum"):  # a CSV is no TUM text, but the other way
        found = _read(path, name)
        if found is not None:
            return (found,)
    return ()


def _read(path: Path, format_name: str) -> MocapBody | None:
    open_fields: list[str] = []
    while True:
        declared = PoseConventions(**{name: _STAND_INS[name] for name in open_fields})
        try:
            trajectory = TRAJECTORY_READERS[format_name](path, "body", declared)
        except GtcalError as error:
            unstated = re.search(r"doesn't state its (\w+)", str(error))
            if unstated is None or unstated[1] in open_fields:
                return None
            open_fields.append(unstated[1])
            continue
        stamps_ns = trajectory.stamps_ns
        span_ns = None if "time_unit" in open_fields else (int(stamps_ns[0]), int(stamps_ns[-1]))
        return MocapBody(path, format_name, None, _by_file(path), tuple(open_fields), len(stamps_ns), span_ns)


def _by_file(path: Path) -> str:
    """data.csv is called by its folder."""
    return path.parent.name if path.stem in ("data", "poses", "trajectory") else path.stem
