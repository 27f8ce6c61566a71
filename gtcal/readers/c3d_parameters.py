"""The parameters of a C3D file, walked record by record: ezc3d's C++ takes them at their word, and a damaged file ends
the process. What is not as the format defines it is refused here first."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gtcal.errors import GtcalError

INTEL, DEC, MIPS = 84, 85, 86
"""How a C3D file writes numbers."""
_BLOCK = 512
_SIZES = {-1: 1, 1: 1, 2: 2, 4: 4}
_MOST_DIMENSIONS = 7


@dataclass(frozen=True)
class Parameter:
    """A parameter's type (-1 text, 1, 2 whole numbers of so many bytes, 4 floats), dimensions and bytes."""

    kind: int
    dimensions: tuple[int, ...]
    data: bytes

    def numbers(self, processor: int) -> list[float]:
        """Its numbers, none of a text. Whole numbers of two bytes are taken as unsigned, as counts are written."""
        order = ">" if processor == MIPS else "<"
        if self.kind == 4:
            data = self.data
            if processor == DEC:  # words exchanged, and four times the value
                words = np.frombuffer(data, dtype="<u2").reshape(-1, 2)[:, ::-1]
                return [float(value) / 4 for value in np.ascontiguousarray(words).view("<f4").ravel()]
            return [float(value) for value in np.frombuffer(data, dtype=f"{order}f4")]
        if self.kind in (1, 2):
            return [float(value) for value in np.frombuffer(self.data, dtype=f"{order}u{self.kind}")]
        return []


def read_parameters(path: Path, section: bytes) -> dict[str, Parameter]:
    """The parameters 'GROUP:NAME' of a parameter section, its 4 bytes of header included.

    Raises GtcalError where a record leaves the section or is not as the format defines it."""
    order = ">" if section[3] == MIPS else "<"
    groups: dict[int, str] = {}
    records: list[tuple[int, str, Parameter]] = []
    at = 4
    while True:
        length, identity = struct.unpack_from("<bb", _within(path, section, at, 2))
        if length == 0:
            break
        name = _within(path, section, at + 2, abs(length)).decode("latin-1")
        if identity == 0 or not name.isprintable() or not name.isascii():
            raise _damaged(path, f"a record at byte {at} has no name")
        offset_at = at + 2 + abs(length)
        (offset,) = struct.unpack_from(f"{order}H", _within(path, section, offset_at, 2))
        end = _content(path, section, offset_at + 2, identity, name.upper(), groups, records)
        if offset == 0:
            break
        if offset_at + offset != end:
            raise _damaged(path, f"parameter {name} takes {end - offset_at} bytes, but the next is {offset} bytes away")
        at = end
    return _named(path, groups, records)


def _content(
    path: Path,
    section: bytes,
    at: int,
    identity: int,
    name: str,
    groups: dict[int, str],
    records: list[tuple[int, str, Parameter]],
) -> int:
    """What follows the offset of a record: a group's description, or a parameter's data and description. Returns where
    it ends."""
    if identity < 0:
        if -identity in groups or name in groups.values():
            raise _damaged(path, f"group {name} stands twice")
        groups[-identity] = name
    else:
        kind, n_dimensions = struct.unpack_from("<bB", _within(path, section, at, 2))
        if kind not in _SIZES or n_dimensions > _MOST_DIMENSIONS:
            raise _damaged(path, f"parameter {name} is of no known type")
        dimensions = tuple(_within(path, section, at + 2, n_dimensions))
        size = math.prod(dimensions) * _SIZES[kind]
        data = _within(path, section, at + 2 + n_dimensions, size)
        records.append((identity, name, Parameter(kind, dimensions, data)))
        at += 2 + n_dimensions + size
    (described,) = _within(path, section, at, 1)
    _within(path, section, at + 1, described)
    return at + 1 + described


def _named(path: Path, groups: dict[int, str], records: list[tuple[int, str, Parameter]]) -> dict[str, Parameter]:
    named: dict[str, Parameter] = {}
    for identity, name, parameter in records:
        if identity not in groups:
            raise _damaged(path, f"parameter {name} belongs to no group")
        key = f"{groups[identity]}:{name}"
        if key in named:
            raise _damaged(path, f"parameter {key} stands twice")
        named[key] = parameter
    return named


def _within(path: Path, section: bytes, at: int, size: int) -> bytes:
    if at + size > len(section):
        raise _damaged(path, "its parameters run past their end")
    return section[at : at + size]


def _damaged(path: Path, what: str) -> GtcalError:
    return GtcalError(f"{path}: is a damaged C3D file: {what}")
