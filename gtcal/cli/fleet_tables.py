"""What the terminal shows of batches and histories."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from rich.text import Text

from gtcal.cli.folded_table import FoldedTable
from gtcal.cli.terminal import Terminal
from gtcal.fleet.batch import Batch, Plan
from gtcal.fleet.jobs import utc
from gtcal.fleet.record import Record
from gtcal.fleet.store import Store

_FEW = 20
"""So many rows are shown where not all are asked for."""

STYLES = {"pass": "bold green", "fail": "bold red", "inconclusive": "bold yellow"}


def print_plans(plans: Sequence[Plan], *, verbose: bool = False) -> None:
    """Print what would run and why; of what would not, with ``verbose``."""
    table = FoldedTable("what would run")
    for heading in ("rig", "recording", "kind", "why"):
        table.add_column(heading)
    to_run = [plan for plan in plans if plan.run]
    shown = plans if verbose else to_run
    for plan in shown:
        table.add_row(plan.job.rig, plan.job.name, plan.job.kind, plan.why if plan.run else f"not run: {plan.why}")
    console = Terminal()
    if shown:
        console.print(table)
    console.print(f"{_count(len(to_run), 'job')} to run, {len(plans) - len(to_run)} done before")


def plan_document(plans: Sequence[Plan]) -> dict[str, Any]:
    """For --json."""
    return {
        "gtcal_batch_plan": 1,
        "jobs": [
            {"rig": p.job.rig, "name": p.job.name, "kind": p.job.kind, "runs": p.run, "why": p.why} for p in plans
        ],
    }


def print_batch(store: Store, batch: Batch, *, verbose: bool = False) -> None:
    """Print a row per job that is no pass (with ``verbose``, per job), and how many there are of each."""
    there = [plan.done for plan in batch.unchanged if plan.done is not None]
    records = [*there, *batch.ended]
    shown = [r for r in records if verbose or r.state != "done" or r.verdict not in ("", "pass")]
    console = Terminal()
    if shown:
        console.print(_table(shown if verbose else shown[:_FEW]))
    if len(shown) > _FEW and not verbose:
        console.print(f"and {len(shown) - _FEW} more; -v lists all")
    console.print(_summary(batch))
    console.print(f"store: {store.path}")


def _table(records: Sequence[Record]) -> FoldedTable:
    table = FoldedTable()
    table.add_column("rig", no_wrap=True)
    table.add_column("recording", no_wrap=True)
    table.add_column("taken, UTC", no_wrap=True)
    table.add_column("kind", no_wrap=True)
    table.add_column("outcome")
    table.add_column("s", justify="right")
    for record in records:
        table.add_row(
            record.rig, record.name, shown_time(record.taken_ns), record.kind, _outcome(record),
            f"{record.duration_s:.1f}",
        )  # fmt: skip
    return table


def _outcome(record: Record) -> Text:
    if record.error:
        return Text(f"{record.state}: {record.error}", style="bold red")
    return Text(record.verdict or "done", style=STYLES.get(record.verdict, ""))


def shown_time(taken_ns: int | None) -> str:
    """To the minute, in UTC."""
    return "" if taken_ns is None else f"{utc(taken_ns):%Y-%m-%d %H:%M}"


def _summary(batch: Batch) -> str:
    states = Counter(record.state for record in batch.ended)
    verdicts = Counter(verdict for _, verdict in batch.verdicts)
    parts = [f"{states['done']} done", f"{len(batch.unchanged)} done before"]
    parts += [f"{states[state]} {state}" for state in ("failed", "lost") if states[state]]
    parts += [f"{len(batch.not_run)} not run"] if batch.not_run else []
    told = [f"{verdicts[verdict]} {verdict}" for verdict in ("pass", "fail", "inconclusive") if verdicts[verdict]]
    return ", ".join(parts) + (f"; verifications: {', '.join(told)}" if told else "")


def batch_document(store: Store, batch: Batch) -> dict[str, Any]:
    """For --json."""
    there = [plan.done for plan in batch.unchanged if plan.done is not None]
    return {
        "gtcal_batch": 1,
        "store": str(store.path),
        "jobs": [
            *(_record_document(store, record, ran=False) for record in there),
            *(_record_document(store, record, ran=True) for record in batch.ended),
        ],
        "not_run": [{"rig": job.rig, "name": job.name, "kind": job.kind} for job in batch.not_run],
    }


def _record_document(store: Store, record: Record, *, ran: bool) -> dict[str, Any]:
    return {
        "rig": record.rig,
        "name": record.name,
        "kind": record.kind,
        "ran": ran,
        "state": record.state,
        "error": record.error,
        "verdict": record.verdict,
        "taken_utc": None if record.taken_ns is None else utc(record.taken_ns).isoformat(),
        "duration_s": record.duration_s,
        "folder": None if record.error else str(store.folder_of(record).relative_to(store.path)),
    }


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
