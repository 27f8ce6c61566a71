"""What a worker does: one job, from the recording's files to the text of its result. It writes nothing; whoever asked
puts the result into the store."""

from __future__ import annotations

import datetime
import hashlib
import json
import logging
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gtcal.errors import GtcalError
from gtcal.files import InputFile, fingerprint
from gtcal.fleet.inputs import files_of, gtcal_version, inputs_of, key_of, plain
from gtcal.fleet.jobs import FIRST_DATE_NS, RESULT_FILES, Job
from gtcal.fleet.record import (
    RECORD,
    Contents,
    Input,
    Record,
    State,
    contents_of_calibration,
    contents_of_drift,
    contents_of_verification,
    record_text,
)

REPORT = "report.html"


class LostWorkersError(Exception):
    """Those with whom a job was shared were killed, by the system or for the memory that it took."""


@dataclass(frozen=True)
class Accepted:
    """A calibration that a rig is used with from ``taken_ns`` on."""

    taken_ns: int
    path: Path


@dataclass(frozen=True)
class Task:
    """A job with what else a worker has to know.

    accepted: the rig's accepted calibrations, for a job that names none. done_keys: of the results that are there."""

    job: Job
    command_line: tuple[str, ...]
    accepted: tuple[Accepted, ...] = ()
    done_keys: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Outcome:
    """What came of a task.

    unchanged: there is a result of the same key, and nothing was done. files: by name, what is to be written; the
    record is among them, for a result that there is."""

    record: Record
    contents: Contents = field(default_factory=Contents)
    files: dict[str, str] = field(default_factory=dict)
    unchanged: bool = False


@dataclass(frozen=True)
class _Made:
    """A result: its document, when its recording was taken, and the report on it."""

    text: str
    contents: Contents
    taken_ns: int
    verdict: str = ""
    report: str = ""


def run_task(task: Task) -> Outcome:
    """Do a job. A failure is an outcome too; only what ends the process, or a lack of memory, is not."""
    started, began = time.perf_counter(), _now()
    inputs: tuple[Input, ...] = ()
    key, used = "", None
    try:
        inputs = inputs_of(files_of(task.job))
        used = _calibration_of(task)
        key = key_of(task.job, inputs, used.sha256 if used else "")
        if key in task.done_keys:
            return Outcome(_record(task, key, began, 0.0, inputs, used), unchanged=True)
        made = _made(task, used)
    except GtcalError as error:
        return Outcome(_record(task, key, began, time.perf_counter() - started, inputs, used, error=str(error)))
    except (MemoryError, LostWorkersError):
        raise
    except Exception as error:  # a bug, but of this recording only
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = f"a bug in gtcal: {type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
        logging.getLogger("gtcal").debug("%s", traceback.format_exc())
        return Outcome(_record(task, key, began, time.perf_counter() - started, inputs, used, error=text))
    record = _record(task, key, began, time.perf_counter() - started, inputs, used, made=made)
    files = {RESULT_FILES[task.job.kind]: made.text} | ({REPORT: made.report} if made.report else {})
    return Outcome(record, made.contents, {RECORD: record_text(record), **files})


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


def _record(
    task: Task,
    key: str,
    began: str,
    seconds: float,
    inputs: tuple[Input, ...],
    used: InputFile | None,
    *,
    made: _Made | None = None,
    error: str = "",
) -> Record:
    state: State = "failed" if error else "done"
    return Record(
        rig=task.job.rig,
        kind=task.job.kind,
        name=task.job.name,
        key=key,
        state=state,
        error=error,
        verdict=made.verdict if made else "",
        taken_ns=made.taken_ns if made else task.job.taken_ns,
        accept=task.job.accept,
        calibration_sha256=used.sha256 if used else "",
        options=plain(task.job.options),
        versions={"gtcal": gtcal_version()},
        command_line=task.command_line,
        created_utc=began,
        duration_s=seconds,
        inputs=inputs,
        result_sha256=hashlib.sha256(made.text.encode()).hexdigest() if made else "",
    )


def lost_record(task: Task, reason: str) -> Record:
    """Of a job whose workers ended before it did."""
    return replace(_record(task, "", _now(), 0.0, (), None, error=reason), state="lost")


def _calibration_of(task: Task) -> InputFile | None:
    """The calibration that a job verifies."""
    job = task.job
    if job.kind == "calibrate":
        return None
    if job.calibration is not None:
        return fingerprint(job.calibration)
    if not task.accepted:
        raise GtcalError(
            f"rig {job.rig!r} has no calibration in the store; calibrate it first, or name one with 'calibration'"
        )
    taken_ns = job.taken_ns if job.taken_ns is not None else _stamped_ns(job)
    return fingerprint(last_before(task.accepted, taken_ns).path)


def last_before(accepted: Sequence[Accepted], taken_ns: int) -> Accepted:
    """The calibration that was in use at that time; before the first, that one. Its own recording may be the same
    minute's."""
    before = [one for one in accepted if one.taken_ns <= taken_ns]
    return max(before, key=lambda one: one.taken_ns) if before else min(accepted, key=lambda one: one.taken_ns)


def _stamped_ns(job: Job) -> int:
    """When a recording of the Lollypop was taken, by its own stamps."""
    from gtcal.verification.lollypop_recording import load_lollypop_recording

    return dated(int(load_lollypop_recording(job.recordings[0]).device_body.stamps_ns[0]))


def dated(stamp_ns: int) -> int:
    """The stamp. Raises GtcalError where it counts from the start of a take, and is no date."""
    if stamp_ns < FIRST_DATE_NS:
        raise GtcalError(
            f"the first time stamp is {stamp_ns} ns, which counts from the start of the take: say when it was taken "
            "with 'taken' in the jobs, or by the recording's name and --taken-from name"
        )
    return stamp_ns


def _made(task: Task, used: InputFile | None) -> _Made:
    if task.job.kind == "calibrate":
        return _calibrated(task)
    assert used is not None
    return _verified(task, used) if task.job.kind == "verify" else _drifted(task, used)


def _calibrated(task: Task) -> _Made:
    from gtcal.estimation.options import CalibrationOptions
    from gtcal.recordings.recording import load_recording
    from gtcal.results.calibration_file import write_calibration
    from gtcal.workflow import calibrate, detected

    options = task.job.options
    assert isinstance(options, CalibrationOptions)
    with _quiet():
        recording = detected(load_recording(task.job.recordings[0]))
        found = calibrate(recording, options)
    found = replace(found, provenance=replace(found.provenance, command_line=task.command_line))
    report = ""
    if task.job.report:
        from gtcal.report import gather_evidence, render

        report = render(found, evidence=gather_evidence(found, recording))
    first_ns = min(int(seen.stamps_ns[0]) for seen in recording.detections.values() if len(seen.stamps_ns))
    return _Made(
        _written(write_calibration, found), contents_of_calibration(found), _taken(task.job, first_ns), report=report
    )


def _verified(task: Task, used: InputFile) -> _Made:
    from gtcal.results.calibration_file import read_calibration
    from gtcal.verification.lollypop_recording import load_lollypop_recording
    from gtcal.verification.verification import VerificationOptions
    from gtcal.verification.verification_file import write_verification
    from gtcal.verification.workflow import verify

    options = task.job.options
    assert isinstance(options, VerificationOptions)
    calibration = read_calibration(used.path)
    with _quiet():
        found = verify(load_lollypop_recording(task.job.recordings[0]), calibration, options, inputs=(used,))
    found = replace(found, provenance=replace(found.provenance, command_line=task.command_line))
    report = ""
    if task.job.report:
        from gtcal.report import render

        report = render(calibration, verification=found)
    return _Made(
        _written(write_verification, found),
        contents_of_verification(found),
        _taken(task.job, found.first_stamp_ns),
        str(found.verdict),
        report,
    )


def _drifted(task: Task, used: InputFile) -> _Made:
    from gtcal.results.calibration_file import read_calibration
    from gtcal.results.provenance import provenance
    from gtcal.verification.drift import verify_series, write_drift_json
    from gtcal.verification.lollypop_recording import load_lollypop_recording
    from gtcal.verification.verification import VerificationOptions

    options, job, started = task.job.options, task.job, time.perf_counter()
    assert isinstance(options, VerificationOptions)
    with _quiet():
        loaded = [(path.parent.name, load_lollypop_recording(path)) for path in job.recordings]
        found = verify_series(loaded, read_calibration(used.path), options, inputs=(used,))
    inputs = (used, *(entry for _, recording in loaded for entry in recording.inputs))
    made = provenance(options, inputs, time.perf_counter() - started)
    text = _written(lambda path, drift: write_drift_json(path, drift, _by(made, task)), found)
    last_ns = found.verifications[-1].first_stamp_ns
    return _Made(text, contents_of_drift(json.loads(text)), _taken(job, last_ns), str(found.verdict))


def _by(made: Any, task: Task) -> Any:
    return replace(made, command_line=task.command_line)


def _written(write: Any, found: Any) -> str:
    """What a result's file holds, as ``write`` writes it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        write(path, found)
        return path.read_text(encoding="utf-8")


def _taken(job: Job, stamp_ns: int) -> int:
    return job.taken_ns if job.taken_ns is not None else dated(stamp_ns)


@contextmanager
def _quiet() -> Iterator[None]:
    """Warnings on the way to a result are in it; here nobody reads them."""
    logger = logging.getLogger("gtcal")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
