"""A comparison of methods on disk."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import Any

from gtcal.baselines.compare import Compared
from gtcal.files import write_text
from gtcal.results.calibration_file import provenance_document

SCHEMA_VERSION = 1


def write_comparison(path: Path | str, found: tuple[Compared, ...]) -> None:
    """Write the comparison as JSON, whole or not at all. Raises GtcalError where it can't be written."""
    write_text(Path(path), json.dumps(comparison_document(found), indent=1, allow_nan=False) + "\n")


def comparison_document(found: tuple[Compared, ...]) -> dict[str, Any]:
    """As it stands in the file."""
    joint = found[0].calibration
    assert joint is not None
    return {
        "gtcal_comparison": SCHEMA_VERSION,
        "methods": [_row(row) for row in found],
        "provenance": provenance_document(joint.provenance),
    }


def _row(row: Compared) -> dict[str, object]:
    numbers = {
        name: value if value is not None and isfinite(value) else None
        for name, value in vars(row).items()
        if name.endswith(("_px", "_mm", "_deg", "_s"))
    }
    poses = (
        {}
        if row.calibration is None
        else {
            "camera_T_ref": {name: c.camera_T_ref.a_T_b.tolist() for name, c in row.calibration.cameras.items()},
            "body_T_board": row.calibration.body_T_board.a_T_b.tolist(),
        }
    )
    return {"method": row.method, "failure": row.failure, **numbers, **poses}
