"""What the manifest says about a body beyond how poses are written: which one of the file, and when."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

from gtcal.bounds import added
from gtcal.errors import GtcalError
from gtcal.readers.mocap_take import RotationKind
from gtcal.recordings.trajectory import Trajectory


@dataclass(frozen=True)
class BodySelection:
    """Which body of a file to read. None or 0: not stated.

    name: the body, segment, prefix of labels, topic or frame in the file.
    markers: labels of measured markers that the body is solved from.
    rotation: what the numbers of rotations are, where the file doesn't say.
    stamp_offset_ns: added to the file's stamps.
    rate_hz: frames a second, where the file has frame numbers only.
    """

    name: str | None = None
    markers: tuple[str, ...] | None = None
    rotation: RotationKind | None = None
    stamp_offset_ns: int = 0
    rate_hz: float | None = None


WHOLE_FILE = BodySelection()
"""For files of one body that say it all."""


def refuse_unused(path: Path, body: str, selection: BodySelection, used: set[str], format_name: str) -> None:
    """Raises GtcalError where the manifest states a field that this format has no use for."""
    for field in fields(BodySelection):
        if field.name not in used and getattr(selection, field.name) != field.default:
            raise GtcalError(f"{path}: {body}.{field.name}: format {format_name} has no use for it; leave it out")


def shifted(trajectory: Trajectory, stamp_offset_ns: int) -> Trajectory:
    """The trajectory with this added to its stamps."""
    stamps_ns = added(f"trajectory {trajectory.body!r}", trajectory.stamps_ns, stamp_offset_ns)
    return replace(trajectory, stamps_ns=stamps_ns) if stamp_offset_ns else trajectory
