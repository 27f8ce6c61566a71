"""What the commands for fleets print with --json, and the file of jobs that they read, as models."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gtcal.fleet.jobs_file import JobEntry, JobsHead
from gtcal.recordings.manifest import Entry

_Kind = Literal["calibrate", "verify", "drift"]
_Verdict = Literal["pass", "fail", "inconclusive", ""]


class Jobs(JobsHead):
    """A file of jobs for 'gtcal batch'."""

    jobs: list[JobEntry] = Field(description="The jobs.")


class PlannedJob(Entry):
    """A job of 'gtcal batch --dry-run'."""

    rig: str
    name: str
    kind: _Kind
    runs: bool = Field(description="Whether it would run.")
    why: str


class BatchPlan(Entry):
    """What 'gtcal batch --dry-run --json' prints."""

    gtcal_batch_plan: Literal[1]
    jobs: list[PlannedJob]


class EndedJob(Entry):
    """A job of a batch."""

    rig: str
    name: str
    kind: _Kind
    ran: bool = Field(description="false: it was done before.")
    state: Literal["done", "failed", "lost"]
    error: str = Field(description="Why there is no result; else empty.")
    verdict: _Verdict
    taken_utc: str | None
    duration_s: float
    folder: str | None = Field(description="Of the result, in the store.")


class NamedJob(Entry):
    """A job that was not run."""

    rig: str
    name: str
    kind: _Kind


class BatchResult(Entry):
    """What 'gtcal batch --json' prints."""

    gtcal_batch: Literal[1]
    store: str
    jobs: list[EndedJob]
    not_run: list[NamedJob] = Field(description="Where the batch was stopped.")


class Left(Entry):
    """Days until a tolerance is left, and an interval of 90 %; null where that may never be."""

    middle: float | None
    low: float | None
    high: float | None


class FindingOfRig(Entry):
    """A camera that is no longer what it was."""

    camera: str
    what: str
    noticed_utc: str
    kind: Literal["drift", "step"] | None
    rate: float | None = Field(description="A day of a drift, or all of a step, in the unit.")
    rate_sigma: float | None
    unit: str
    days_left: Left | None


class MeasureOfRecording(Entry):
    """A number of a recording."""

    camera: str = Field(description="Empty for the rig, 'body/board' for the board on its body.")
    quantity: str = Field(description="Its name, which ends with its unit.")
    value: float
    sigma: float | None = Field(description="1-sigma; null where nobody knows.")


class RecordingOfRig(Entry):
    """A recording in a rig's history."""

    name: str
    kind: _Kind
    taken_utc: str
    verdict: _Verdict
    measures: list[MeasureOfRecording]
    remarks: list[str]


class FailureOfRig(Entry):
    """A recording without a result."""

    name: str
    kind: _Kind
    state: Literal["failed", "lost"]
    error: str


class Rig(Entry):
    """A rig's history."""

    rig: str
    status: Literal["fails", "changed", "can't tell", "holds", "not verified"]
    accepted: str | None = Field(description="The calibration in use.")
    sentences: list[str]
    findings: list[FindingOfRig]
    charts_watched: int
    autocorrelation: float
    recordings: list[RecordingOfRig]
    failures: list[FailureOfRig]


class HistoryResult(Entry):
    """What 'gtcal history --json' prints."""

    gtcal_history: Literal[1]
    run_length: float
    rigs: list[Rig]


class WatchLine(Entry):
    """A line that 'gtcal watch' prints."""

    gtcal_watch: Literal[1]
    rig: str
    name: str
    verdict: Literal["pass", "fail", "inconclusive"] | None
    error: str | None
    remarks: list[str]
    taken_utc: str | None
    seconds_after_it_ended: float
