"""Lines of a manifest as people say them, 'platform.quaternion: wxyz', written into its fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml

from gtcal.errors import GtcalError
from gtcal.recordings.manifest import Manifest, manifest_of
from gtcal.recordings.recording import Loader, Recording, recording_of

Fields = dict[str, Any]


def with_lines(fields: Fields, lines: Iterable[str]) -> Fields:
    """The fields of a manifest with these lines written in: each a field's place, a colon and its value in YAML.

    Raises GtcalError where a line is none, or its place lies within a field that holds no fields."""
    changed = deepcopy(fields)
    for line in lines:
        place, colon, value = line.partition(": ")
        *parents, name = place.split(".")
        entry = changed
        for parent in parents:
            entry = entry.setdefault(parent, {}) if isinstance(entry, dict) else None
        if not colon or not isinstance(entry, dict):
            raise GtcalError(f"{line!r} is no line of this manifest; expected a place as platform.quaternion: wxyz")
        entry[name] = yaml.safe_load(value)
    return changed


def line_of(place: str, value: Any) -> str:
    """The line that writes this value: in YAML's flow style, every digit."""
    flow = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
    return f"{place}: {flow.removesuffix('...' + chr(10)).strip()}"


class ManifestFile:
    """The manifest of a recording on disk, with changes to it that are tried but not written."""

    def __init__(self, path: Path, fields: Fields) -> None:
        self.path = path
        self.fields = fields

    def changed(self, lines: Iterable[str]) -> ManifestFile:
        """With these lines written in."""
        return ManifestFile(self.path, with_lines(self.fields, lines))

    def manifest(self) -> Manifest:
        """The manifest. Raises GtcalError as ``read_manifest``."""
        return manifest_of(self.path, self.fields)

    def recording(self) -> Recording:
        """What it describes. Raises GtcalError as ``load_recording``."""
        return recording_of(self.path, self.manifest())

    def loader(self) -> Loader:
        """What reads its parts."""
        return Loader(self.path)

    def reads(self, body: str) -> bool:
        """Whether the trajectory of this body can be read: what its file's header states can't be contradicted."""
        try:
            self.loader().trajectory(body, self.manifest().bodies[body])
        except GtcalError:
            return False
        return True

    def stated(self, body: str, field: str, choices: Mapping[str, float] | Iterable[str]) -> str | None:
        """Which of these choices of a field the trajectory is read with, be it by the manifest or by its header."""
        if value := self.fields.get(body, {}).get(field):
            return str(value)
        readable = [c for c in choices if self.changed([f"{body}.{field}: {c}"]).reads(body)]
        return readable[0] if len(readable) == 1 else None
