"""doctor.json: a diagnosis on disk."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import Any

from gtcal.doctor.findings import Diagnosis, Finding
from gtcal.files import write_text

SCHEMA_VERSION = 1


def write_diagnosis(path: Path | str, found: Diagnosis) -> None:
    """Write a diagnosis as JSON, whole or not at all. Raises GtcalError where it can't be written."""
    write_text(Path(path), json.dumps(diagnosis_document(found), indent=1, allow_nan=False) + "\n")


def diagnosis_document(found: Diagnosis) -> dict[str, Any]:
    """As it stands in doctor.json."""
    return {
        "gtcal_diagnosis": SCHEMA_VERSION,
        "healthy": found.healthy,
        "statement": found.statement,
        "findings": [_finding(finding) for finding in found.findings],
        "unexplained": found.unexplained,
        "notes": list(found.notes),
        "misfit_mm": found.misfit_mm,
        "misfit_deg": found.misfit_deg,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "fault": finding.fault,
        "says": finding.says,
        "manifest_lines": list(finding.lines),
        "advice": list(finding.advice),
        "evidence": finding.evidence,
        "measure": finding.measure,
        "before": _or_none(finding.before),
        "after": _or_none(finding.after),
        "unit": finding.unit,
        "alternatives": list(finding.alternatives),
    }


def _or_none(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None
