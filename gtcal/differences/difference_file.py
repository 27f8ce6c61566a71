"""diff.json: the difference of two calibrations on disk."""

from __future__ import annotations

import json
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from gtcal.differences.difference import Change, Difference
from gtcal.files import write_text
from gtcal.results.calibration import Provenance
from gtcal.results.calibration_file import provenance_document

SCHEMA_VERSION = 1


def write_difference(path: Path | str, found: Difference, made: Provenance) -> None:
    """Write diff.json, whole or not at all. Raises GtcalError where it can't be written."""
    document = difference_document(found) | {"provenance": provenance_document(made)}
    write_text(Path(path), json.dumps(document, indent=1, allow_nan=False) + "\n")


def difference_document(found: Difference) -> dict[str, Any]:
    """As it stands in diff.json, but for how it was made."""
    return {
        "gtcal_difference": SCHEMA_VERSION,
        "verdict": found.verdict,
        "statements": list(found.statements),
        "notes": list(found.notes),
        "options": asdict(found.options),
        "b_ref_T_a_ref": None if found.aligned is None else found.aligned.tolist(),
        "changes": [_change(change, found) for change in found.changes],
    }


def _change(change: Change, found: Difference) -> dict[str, Any]:
    known = {name: value if isfinite(value) else None for name, value in asdict(change).items() if name != "what"}
    of_all = {"probability": change.probability, "verdict": change.verdict(found.options)}
    return {"what": change.what} | known | of_all
