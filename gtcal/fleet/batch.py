"""Many jobs: which have to be run and why, and running them so that nothing that was reported is ever lost."""

from __future__ import annotations

import sqlite3
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

from gtcal.errors import GtcalError
from gtcal.files import sha256_of
from gtcal.fleet import index
from gtcal.fleet.inputs import changed_inputs, gtcal_version, inputs_of, key_of, plain
from gtcal.fleet.jobs import Job
from gtcal.fleet.record import Contents, Record
from gtcal.fleet.run_job import Accepted, Outcome, Task, last_before, lost_record
from gtcal.fleet.store import Store
from gtcal.fleet.workers import Workers
from gtcal.progress import Progress, silent

_WAITING_SHARE = 0.25
"""So many tasks for each worker wait ready beside those that are being done: none is idle, and few are in the way of
who stops the batch."""

_LOOK_S = 0.2
"""How often it is asked whether to stop."""


@dataclass(frozen=True)
class Plan:
    """What is to be done about a job. why: in words. done: the record of the result that is there, where nothing is."""

    job: Job
    run: bool
    why: str
    done: Record | None = None


@dataclass
class Batch:
    """What came of a batch.

    ended: the record of each job that was run, in the order in which they ended. unchanged: the plans of those that did
    not have to be. Records are without their inputs and options. not_run: those that were still to be run when it was
    stopped."""

    ended: list[Record] = field(default_factory=list)
    unchanged: list[Plan] = field(default_factory=list)
    not_run: list[Job] = field(default_factory=list)

    @property
    def failed(self) -> list[Record]:
        """Those without a result."""
        return [record for record in self.ended if record.state != "done"]

    @property
    def verdicts(self) -> list[tuple[Record, str]]:
        """Of all its verifications, those that were there before among them."""
        there = [plan.done for plan in self.unchanged if plan.done is not None]
        return [(record, record.verdict) for record in (*there, *self.ended) if record.verdict]


Stopping = Callable[[], bool]
Ended = Callable[[Record], None]


def accepted_of(store: Store, connection: sqlite3.Connection, rig: str) -> tuple[Accepted, ...]:
    """A rig's accepted calibrations, by time: its first, and those that were said to be."""
    named = store.accepted_names(rig)
    made = [
        record
        for _, record in index.records(connection, rig=rig)
        if record.kind == "calibrate" and record.state == "done"
    ]
    chosen = [record for place, record in enumerate(made) if place == 0 or record.accept or record.name in named]
    return tuple(
        Accepted(record.taken_ns, store.folder_of(record) / record.result_file)
        for record in chosen
        if record.taken_ns is not None
    )


AcceptedOf = Callable[[str], tuple[Accepted, ...]]
"""A rig's accepted calibrations, by time."""


def plan_of(connection: sqlite3.Connection, job: Job, accepted: AcceptedOf) -> Plan:
    """What is to be done about a job, by the files' sizes and times, and their contents where those are others. To be
    asked after the rig's calibrations are done."""
    done = index.current_of(connection, job.identity)
    if done is None:
        return Plan(job, True, "new")
    if done.state != "done":
        return Plan(job, True, f"{done.state} before: {done.error}")
    why = _why_again(connection, job, done, accepted)
    return Plan(job, bool(why), why or "done before", done)


def _why_again(connection: sqlite3.Connection, job: Job, done: Record, accepted: AcceptedOf) -> str:
    if done.versions.get("gtcal") != gtcal_version():
        return f"gtcal was {done.versions.get('gtcal')}, and is {gtcal_version()}"
    options = plain(job.options)
    if done.options != options:
        unlike = sorted(name for name in {*options, *done.options} if options.get(name) != done.options.get(name))
        return f"other options: {', '.join(unlike)}"
    if (job.taken_ns is not None and job.taken_ns != done.taken_ns) or job.accept != done.accept:
        return "another date, or accepted otherwise"
    calibration = _calibration_now(job, done, accepted)
    if calibration != done.calibration_sha256:
        return "another calibration"
    if not changed_inputs(done.inputs) and _same_key(job, done):
        return ""
    try:
        inputs = inputs_of(Path(entry.path) for entry in done.inputs)
    except GtcalError as error:
        return str(error)
    if key_of(job, inputs, calibration) == done.key:
        index.renew_signatures(connection, done, inputs)
        return ""
    before = {entry.path: entry.sha256 for entry in done.inputs}
    changed = [Path(entry.path).name for entry in inputs if before[entry.path] != entry.sha256]
    return f"changed: {', '.join(changed)}" if changed else "other recordings, or a report is asked for"


def _same_key(job: Job, done: Record) -> bool:
    """Whether a job has the key of a result, its files being as they were."""
    return key_of(job, done.inputs, done.calibration_sha256) == done.key


def _calibration_now(job: Job, done: Record, accepted: AcceptedOf) -> str:
    """The SHA-256 of the calibration that the job would verify now; empty for a calibration."""
    if job.kind == "calibrate":
        return ""
    if job.calibration is not None:
        return sha256_of(job.calibration)
    there = accepted(job.rig)
    return sha256_of(last_before(there, done.taken_ns or 0).path) if there else ""


@dataclass(frozen=True)
class _Order:
    """The jobs that can be planned at once, and by rig those that wait for the rig's calibrations."""

    ready: tuple[Job, ...]
    waiting: dict[str, list[Job]]

    @staticmethod
    def of(jobs: Sequence[Job]) -> _Order:
        calibrated = {job.rig for job in jobs if job.kind == "calibrate"}
        waiting: dict[str, list[Job]] = {}
        ready = []
        for job in jobs:
            if job.kind != "calibrate" and job.calibration is None and job.rig in calibrated:
                waiting.setdefault(job.rig, []).append(job)
            else:
                ready.append(job)
        return _Order(tuple(sorted(ready, key=lambda job: job.kind != "calibrate")), waiting)


def plan(store: Store | None, jobs: Sequence[Job]) -> list[Plan]:
    """What a batch would run, and why; nothing is run. store: None for one that is yet to be made."""
    if store is None or not store.index_path.exists():
        return [Plan(job, True, "new") for job in jobs]
    order = _Order.of(jobs)
    with index.opened_index(store.index_path) as connection:
        connection.execute("PRAGMA query_only = ON")  # a batch may be writing to it
        accepted = cache(partial(accepted_of, store, connection))
        first = {job.identity: plan_of(connection, job, accepted) for job in order.ready}
        to_come = {rig for (rig, kind, _), made in first.items() if made.run and kind == "calibrate"}
        later = {
            job.identity: plan_of(connection, job, accepted) for waiting in order.waiting.values() for job in waiting
        }
    plans = first | later
    return [_with_calibrations_to_come(plans[job.identity], to_come, order) for job in jobs]


def _with_calibrations_to_come(made: Plan, to_come: set[str], order: _Order) -> Plan:
    if made.run or made.job.rig not in to_come or made.job not in order.waiting.get(made.job.rig, ()):
        return made
    return Plan(made.job, False, "done before; again if its calibration comes out otherwise", made.done)


def run_batch(
    store: Store,
    jobs: Sequence[Job],
    workers: Workers,
    command_line: tuple[str, ...],
    *,
    progress: Progress = silent,
    stopping: Stopping = lambda: False,
    ended: Ended = lambda record: None,
) -> Batch:
    """Run what has to be, the verifications of a rig after its calibrations. Results are put in place before ``ended``
    is told of them. ``stopping``: whether to hand out no more; what runs comes to its end. To be called with the
    store's lock held.

    Raises GtcalError where the store can't be written."""
    with index.opened_index(store.index_path) as connection:
        return _Run(store, connection, jobs, workers, command_line, progress, stopping, ended).run()


class _Run:
    """One batch while it runs."""

    def __init__(
        self,
        store: Store,
        connection: sqlite3.Connection,
        jobs: Sequence[Job],
        workers: Workers,
        command_line: tuple[str, ...],
        progress: Progress,
        stopping: Stopping,
        ended: Ended,
    ) -> None:
        self._store, self._connection, self._workers = store, connection, workers
        self._command_line, self._progress, self._stopping, self._ended = command_line, progress, stopping, ended
        order = _Order.of(jobs)
        self._queue, self._waiting = deque(order.ready), order.waiting
        self._to_calibrate = dict.fromkeys(order.waiting, 0)
        for job in order.ready:
            if job.kind == "calibrate" and job.rig in self._to_calibrate:
                self._to_calibrate[job.rig] += 1
        self._running: dict[int, Task] = {}
        self._total, self._done, self._number = len(jobs), 0, 0
        self._accepted_of = cache(partial(accepted_of, store, connection))  # asked when all of a rig's are done
        self._batch = Batch()

    def run(self) -> Batch:
        self._progress("jobs", 0, self._total)
        while self._running or (self._queue and not self._stopping()):
            self._hand_out()
            if self._running and (finished := self._workers.next_finished(_LOOK_S)) is not None:
                task = self._running.pop(finished.number)
                self._keep(task, finished.outcome or Outcome(lost_record(task, finished.lost)))
                self._settle(task.job)
        self._batch.not_run = [*self._queue, *(job for rig in self._waiting for job in self._waiting[rig])]
        return self._batch

    def _hand_out(self) -> None:
        room = self._workers.n + 1 + int(_WAITING_SHARE * self._workers.n) if self._queue else 0
        while self._queue and len(self._running) < room and not self._stopping():
            job = self._queue.popleft()
            made = plan_of(self._connection, job, self._accepted_of)
            if not made.run:
                self._skip(made)
                self._settle(job)
                continue
            task = Task(
                job,
                self._command_line,
                () if job.kind == "calibrate" else self._accepted_of(job.rig),
                frozenset({made.done.key} if made.done is not None else ()),
            )
            self._number += 1
            self._running[self._number] = task
            self._workers.submit(self._number, task)

    def _keep(self, task: Task, outcome: Outcome) -> None:
        if outcome.unchanged:
            done = index.current_of(self._connection, task.job.identity)
            self._skip(Plan(task.job, False, "done before, of the same contents", done))
            return
        self._store.put(outcome)
        index.insert(self._connection, outcome.record, outcome.contents if not outcome.record.error else Contents())
        self._batch.ended.append(_slim(outcome.record))
        self._ended(outcome.record)

    def _skip(self, made: Plan) -> None:
        self._batch.unchanged.append(replace(made, done=None if made.done is None else _slim(made.done)))

    def _settle(self, job: Job) -> None:
        """A job is done with; after a rig's last calibration, its verifications can be planned."""
        self._done += 1
        self._progress("jobs", self._done, self._total)
        if job.kind == "calibrate" and job.rig in self._to_calibrate:
            self._to_calibrate[job.rig] -= 1
            if self._to_calibrate[job.rig] == 0:
                self._queue.extend(self._waiting.pop(job.rig))


def _slim(record: Record) -> Record:
    """Without what takes room and is in the index: a batch of many jobs keeps one for each."""
    return replace(record, inputs=(), options={}, versions={}, command_line=())


def exit_code(batch: Batch) -> int:
    """0: all is done and holds; 1: a job has no result; 3: a calibration does not hold; 4: it can't be told."""
    from gtcal.verification.verdict import overall_verdict
    from gtcal.verification.verification import Verdict

    if batch.failed:
        return 1
    return overall_verdict(Verdict(verdict) for _, verdict in batch.verdicts).exit_code
