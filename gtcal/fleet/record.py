"""record.json: what one job was, how it ended, and what it was made from. With the result beside it, it holds all that
the index has."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from gtcal.errors import GtcalError
from gtcal.fleet.jobs import KINDS, RESULT_FILES, JobKind
from gtcal.fleet.measures import (
    Measure,
    Pose,
    measures_of_calibration,
    measures_of_verification,
    poses_of,
    remarks_of_drift,
    remarks_of_verification,
)
from gtcal.names import check_name
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import read_calibration
from gtcal.results.result_file import read_result
from gtcal.verification.drift import SCHEMA_VERSION as DRIFT_VERSION
from gtcal.verification.verification import Verification
from gtcal.verification.verification_file import read_verification

SCHEMA_VERSION = 1
RECORD = "record.json"

State = Literal["done", "failed", "lost"]
"""done: there is a result. failed: told in a line why not. lost: whoever worked on it was killed, or ran out of memory,
as often as it was tried."""


@dataclass(frozen=True)
class Input:
    """A file (or a folder of files) that a job was done from. signature: size and times when it was read, which tell
    without reading it again that it is still the same; empty where nobody knows."""

    path: str
    sha256: str
    signature: str = ""


@dataclass(frozen=True)
class Record:
    """One job that was done, or was tried.

    rig, kind, name: as of a ``Job``. key: of inputs, options and gtcal's version; empty where nobody came so far.
    error: why there is no result; else empty. verdict: of a verification or drift; else empty.
    taken_ns: when the recording was taken. accept: as of a ``Job``.
    calibration_sha256: of the calibration.json that was verified; else empty.
    options: as they were given. versions, command_line, created_utc, duration_s, inputs: its provenance.
    result_sha256: of the result's file; empty where there is none."""

    rig: str
    kind: JobKind
    name: str
    key: str
    state: State
    error: str
    verdict: str
    taken_ns: int | None
    accept: bool
    calibration_sha256: str
    options: dict[str, Any]
    versions: dict[str, str]
    command_line: tuple[str, ...]
    created_utc: str
    duration_s: float
    inputs: tuple[Input, ...]
    result_sha256: str

    @property
    def identity(self) -> tuple[str, str, str]:
        """As of a ``Job``."""
        return self.rig, self.kind, self.name

    @property
    def result_file(self) -> str:
        """What the result is called, beside the record."""
        return RESULT_FILES[self.kind]


@dataclass(frozen=True)
class Contents:
    """What the index keeps of a result, beside its record."""

    measures: tuple[Measure, ...] = ()
    poses: tuple[Pose, ...] = ()
    remarks: tuple[str, ...] = ()


def contents_of_calibration(found: Calibration) -> Contents:
    """Of a calibration."""
    return Contents(measures_of_calibration(found), poses_of(found), found.warnings)


def contents_of_verification(found: Verification) -> Contents:
    """Of a verification."""
    return Contents(measures_of_verification(found), (), remarks_of_verification(found))


def contents_of_drift(document: dict[str, Any]) -> Contents:
    """Of a drift.json."""
    return Contents(remarks=remarks_of_drift(document))


def read_contents(record: Record, folder: Path) -> Contents:
    """What the index keeps, from the result's file. Raises GtcalError where that is damaged."""
    path = folder / record.result_file
    if record.kind == "calibrate":
        return contents_of_calibration(read_calibration(path))
    if record.kind == "verify":
        return contents_of_verification(read_verification(path))
    return read_result(path, "drift", DRIFT_VERSION, contents_of_drift)


def record_text(record: Record) -> str:
    """The record as a file holds it: without the signatures, which are of this machine."""
    document = {"gtcal_record": SCHEMA_VERSION, **vars(record)}
    document["inputs"] = [{"path": entry.path, "sha256": entry.sha256} for entry in record.inputs]
    lines = (f" {json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in document.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def read_record(path: Path) -> Record:
    """Read what ``record_text`` gives. Raises GtcalError where the file is missing, damaged or of a newer gtcal."""
    return read_result(path, "record", SCHEMA_VERSION, _record)


def _record(document: dict[str, Any]) -> Record:
    given = {field.name: document[field.name] for field in fields(Record)}
    for what in ("rig", "name"):
        check_name(what, given[what])
    if given["kind"] not in KINDS:
        raise GtcalError(f"kind {given['kind']!r} is none of {', '.join(KINDS)}")
    given["inputs"] = tuple(Input(str(entry["path"]), str(entry["sha256"])) for entry in document["inputs"])
    given["command_line"] = tuple(given["command_line"])
    return Record(**given)
