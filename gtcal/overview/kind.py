"""What a path leads to: a recording of a board or of a Lollypop, or a result."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from gtcal.errors import GtcalError
from gtcal.recordings.manifest import find_manifest, load_fields


class Kind(StrEnum):
    """By the field that tells."""

    RECORDING = "board"
    LOLLYPOP_RECORDING = "device"
    CALIBRATION = "gtcal_calibration"
    VERIFICATION = "gtcal_verification"


def kind_of(path: Path) -> Kind:
    """What is at ``path``.

    Raises GtcalError where there is nothing, or nothing of gtcal's."""
    manifest = find_manifest(path)
    fields = load_fields(manifest)
    for kind in (Kind.CALIBRATION, Kind.VERIFICATION, Kind.LOLLYPOP_RECORDING, Kind.RECORDING):
        if kind.value in fields:
            return kind
    if "gtcal_recording" in fields:
        return Kind.RECORDING  # which says what it lacks
    raise GtcalError(f"{manifest}: is no recording's manifest, no calibration and no verification of gtcal")
