"""What is to be done: one recording after the other, of which rig, and with which options."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from gtcal.errors import GtcalError
from gtcal.estimation.options import CalibrationOptions
from gtcal.verification.verification import VerificationOptions

JobKind = Literal["calibrate", "verify", "drift"]
KINDS: tuple[JobKind, ...] = ("calibrate", "verify", "drift")

RESULT_FILES: dict[JobKind, str] = {
    "calibrate": "calibration.json",
    "verify": "verification.json",
    "drift": "drift.json",
}
"""What a job of each kind writes."""

FIRST_DATE_NS = 946_684_800_000_000_000
"""2000-01-01. Stamps before it count from the start of their take, and say nothing of the date."""


class JobsError(GtcalError):
    """Jobs that are wrong, a line each."""

    def __init__(self, lines: Sequence[str]) -> None:
        self.lines = tuple(lines)
        more = f" (and {len(lines) - 1} more jobs are wrong)" if len(lines) > 1 else ""
        super().__init__(f"{lines[0]}{more}")


@dataclass(frozen=True)
class Job:
    """One thing to do.

    rig, name: of which rig, and what the recording is called in its history; with ``kind`` they say which job it is.
    recordings: the manifests to read; one, but of a drift.
    options: of the calibration, or of the verification.
    calibration: the calibration.json to verify; None for the rig's last accepted one before the recording.
    taken_ns: when it was taken, in ns since 1970 UTC; None where the recording's own stamps tell.
    accept: of a calibration: the rig is used with it from then on, and its history begins anew.
    report: whether to write a report too.
    where: in which line of which file it is stated."""

    rig: str
    name: str
    kind: JobKind
    recordings: tuple[Path, ...]
    options: CalibrationOptions | VerificationOptions
    calibration: Path | None = None
    taken_ns: int | None = None
    accept: bool = False
    report: bool = False
    where: str = field(default="", compare=False)

    @property
    def identity(self) -> tuple[str, str, str]:
        """What tells it from other jobs, and is the same when it is done anew."""
        return self.rig, self.kind, self.name

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.rig}/{self.name} ({self.kind})"


def check_distinct(jobs: Sequence[Job]) -> None:
    """Raises JobsError where two jobs are called the same."""
    first: dict[tuple[str, str, str], Job] = {}
    lines = [
        f"{job.where}: {job.title} is stated twice, in {first[job.identity].where} too; give one of them another 'name'"
        for job in jobs
        if first.setdefault(job.identity, job) is not job
    ]
    if lines:
        raise JobsError(lines)


def taken_ns_of(text: str) -> int:
    """A date and time in ISO 8601, in UTC where it states no zone, as ns since 1970. Raises GtcalError where it is
    none."""
    try:
        at = datetime.datetime.fromisoformat(text)
    except ValueError:
        raise GtcalError(f"{text!r} is no time; expected a date as 2026-05-12 or 2026-05-12T08:30") from None
    return _ns(at)


def _ns(at: datetime.datetime) -> int:
    zoned = at if at.tzinfo else at.replace(tzinfo=datetime.UTC)
    return round(zoned.timestamp() * 1e6) * 1000


_DATE_IN_NAME = re.compile(r"(\d{4})-?(\d{2})-?(\d{2})(?:[T_ -]+(\d{2})[-:h]?(\d{2})(?:[-:m]?(\d{2}))?)?")


def taken_ns_in(name: str) -> int:
    """The date (and time) in a recording's name, as 2026-05-12_board or 20260512-0830, in UTC. Raises GtcalError where
    there is none."""
    found = _DATE_IN_NAME.search(name)
    try:
        if found is None:
            raise ValueError
        return _ns(datetime.datetime(*(int(part) for part in found.groups() if part)))  # type: ignore[arg-type]
    except ValueError:
        raise GtcalError(f"{name!r} holds no date, as 2026-05-12 or 2026-05-12_08-30") from None


def utc(stamp_ns: int) -> datetime.datetime:
    """The moment of a stamp."""
    return datetime.datetime.fromtimestamp(stamp_ns / 1e9, datetime.UTC)
