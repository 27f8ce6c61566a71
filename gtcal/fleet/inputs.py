"""What a job is done from, and the key that is another when any of it is: contents, options and gtcal's version."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gtcal.estimation.options import CalibrationOptions
from gtcal.files import fingerprint
from gtcal.fleet.jobs import Job
from gtcal.fleet.record import Input
from gtcal.recordings.manifest import named_files
from gtcal.results.provenance import plain_options
from gtcal.verification.verification import VerificationOptions

ABSENT = ""


def gtcal_version() -> str:
    """The installed one."""
    try:
        return version("gtcal")
    except PackageNotFoundError:
        return "not installed as a package"


def signature(path: Path) -> str:
    """Size and times of a file, or of the files directly in a folder: another when it was touched. ``ABSENT`` where
    there is nothing.

    The time of the last change (ctime) is among them, which no program can set."""
    try:
        entries = [path] if not path.is_dir() else sorted(file for file in path.iterdir() if file.is_file())
        stats = [(entry.name, entry.stat()) for entry in entries]
    except OSError:
        return ABSENT
    text = json.dumps([(name, s.st_size, s.st_mtime_ns, s.st_ctime_ns) for name, s in stats])
    return hashlib.sha256(text.encode()).hexdigest()


def files_of(job: Job) -> tuple[Path, ...]:
    """The manifests of a job and all that they name. Raises GtcalError where there is none."""
    return tuple(dict.fromkeys(file for manifest in job.recordings for file in named_files(manifest)))


def inputs_of(paths: Iterable[Path]) -> tuple[Input, ...]:
    """What is there, by its contents. Raises GtcalError where a file can't be read."""
    found = []
    for path in paths:
        before = signature(path)  # what changes while it is read is read again the next time
        found.append(Input(str(path.absolute()), fingerprint(path).sha256, before))
    return tuple(found)


def plain(options: CalibrationOptions | VerificationOptions) -> dict[str, Any]:
    """Options as JSON has them."""
    document: dict[str, Any] = json.loads(json.dumps(plain_options(options)))
    return document


def key_of(job: Job, inputs: tuple[Input, ...], calibration_sha256: str) -> str:
    """The same for a job that need not be done again: by what its files hold, wherever they are now."""
    home = job.recordings[0].parent.absolute()
    document = {
        "job": [*job.identity, job.taken_ns, job.accept, job.report],
        "inputs": [(os.path.relpath(entry.path, home), entry.sha256) for entry in inputs],
        "calibration": calibration_sha256,
        "options": plain(job.options),
        "gtcal": gtcal_version(),
    }
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def changed_inputs(inputs: Iterable[Input]) -> tuple[str, ...]:
    """The inputs that may have changed since, by their signatures alone."""
    return tuple(
        entry.path for entry in inputs if not entry.signature or signature(Path(entry.path)) != entry.signature
    )
