"""What the terminal shows of rigs over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.text import Text

from gtcal.cli.fleet_tables import STYLES, shown_time
from gtcal.cli.folded_table import FoldedTable
from gtcal.cli.terminal import Terminal
from gtcal.fleet.history import Event, History
from gtcal.fleet.jobs import utc
from gtcal.fleet.measures import BOARD, RIG

_FEW = 12
_BARS = "▁▂▃▄▅▆▇█"
_STATUS_STYLES = {"fails": "bold red", "changed": "bold yellow", "holds": "bold green"}


def print_fleet(histories: Sequence[History]) -> None:
    """Print a row per rig, and what is to be said of those that are no longer what they were."""
    table = FoldedTable()
    for heading in ("rig", "status", "last verified", "RMSE px, over time", "accepted calibration"):
        table.add_column(heading, no_wrap=True)
    table.add_column("recordings", justify="right")
    table.add_column("failed", justify="right")
    for history in histories:
        last = history.last_verified
        table.add_row(
            history.rig,
            Text(history.status, style=_STATUS_STYLES.get(history.status, "")),
            "" if last is None else shown_time(last.taken_ns),
            sparkline(_pooled(history.verifications)),
            "" if history.accepted is None else history.accepted.record.name,
            str(len(history.events)),
            str(len(history.failures) or ""),
        )
    console = Terminal()
    console.print(table)
    for history in histories:
        for line in history.sentences:
            console.print(Text(line, style=_STATUS_STYLES.get(history.status, "")))
    if not any(history.sentences for history in histories):
        console.print("No rig is other than it was, beyond chance.")


def _pooled(events: Sequence[Event]) -> list[float]:
    return [event.measures[RIG, "rmse_px"][0] for event in events if (RIG, "rmse_px") in event.measures]


def sparkline(values: Sequence[float], most: int = 32) -> str:
    """The last values as bars from zero to the largest."""
    shown = list(values)[-most:]
    largest = max(shown, default=0.0)
    if not largest > 0.0:
        return ""
    return "".join(_BARS[round((len(_BARS) - 1) * max(value, 0.0) / largest)] for value in shown)


def print_history(history: History, run_length: float, *, verbose: bool = False) -> None:
    """Print the verifications and, with ``verbose``, the calibrations, and what is to be said."""
    console = Terminal()
    console.print(Text(f"{history.rig}: {history.status}", style=_STATUS_STYLES.get(history.status, "bold")))
    if history.verifications:
        console.print(_verifications(history, verbose))
    if history.calibrations and (verbose or not history.verifications):
        console.print(_calibrations(history))
    for record in history.failures:
        console.print(Text(f"{record.name} ({record.kind}): {record.state}: {record.error}", style="red"))
    for line in history.sentences:
        console.print(Text(line, style="bold"))
    if not history.sentences:
        console.print("No camera is other than it was, beyond chance.")
    console.print(
        f"{history.n_watched} charts of the store are watched together: one false alarm in {run_length:g} rounds; "
        f"autocorrelation {history.autocorrelation:.2f}"
    )


def _verifications(history: History, verbose: bool) -> FoldedTable:
    events = history.verifications if verbose else history.verifications[-_FEW:]
    table = FoldedTable(
        "verifications" + ("" if len(events) == len(history.verifications) else f", the last {len(events)}"),
        caption="RMSE in px; in brackets the mean error",
    )
    table.add_column("recording", no_wrap=True)
    table.add_column("taken, UTC", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for camera in history.cameras:
        table.add_column(camera, justify="right")
    table.add_column("all, mm", justify="right")
    for event in events:
        verdict = event.record.verdict
        cells = [_error(event, camera) for camera in history.cameras]
        mm = event.measures.get((RIG, "rmse_mm"), (np.nan, np.nan))[0]
        table.add_row(
            event.record.name, shown_time(event.taken_ns), Text(verdict, style=STYLES.get(verdict, "")), *cells,
            f"{mm:.2f}",
        )  # fmt: skip
    trends = [sparkline([e.measures[c, "rmse_px"][0] for e in history.verifications if (c, "rmse_px") in e.measures])
              for c in history.cameras]  # fmt: skip
    table.add_section()
    table.add_row("over time", "", "", *trends, "")
    return table


def _error(event: Event, camera: str) -> str:
    if (camera, "rmse_px") not in event.measures:
        return "-"
    bias = np.linalg.norm([event.measures.get((camera, f"bias_{axis}_px"), (np.nan, 0.0))[0] for axis in "xy"])
    return f"{event.measures[camera, 'rmse_px'][0]:.3f} ({bias:.2f})"


def _calibrations(history: History) -> FoldedTable:
    table = FoldedTable(
        "calibrations, against the accepted one",
        caption="how far each camera is from where the accepted calibration has it, mm; ± largest 1-sigma of an axis",
    )
    table.add_column("recording", no_wrap=True)
    table.add_column("taken, UTC", no_wrap=True)
    table.add_column("", no_wrap=True)
    for heading in (*history.cameras, "board"):
        table.add_column(heading, justify="right")
    for event in history.calibrations:
        accepted = history.accepted is not None and event.record == history.accepted.record
        cells = [_move(event, what) for what in (*history.cameras, BOARD)]
        table.add_row(event.record.name, shown_time(event.taken_ns), "accepted" if accepted else "", *cells)
    return table


def _move(event: Event, camera: str) -> str:
    axes = [event.measures.get((camera, f"moved_{axis}_mm")) for axis in "xyz"]
    known = [axis for axis in axes if axis is not None]
    if len(known) < len(axes):
        return "-"
    return f"{np.linalg.norm([value for value, _ in known]):.3f} ± {max(sigma for _, sigma in known):.3f}"


def history_document(histories: Sequence[History], run_length: float) -> dict[str, Any]:
    """For --json."""
    return {"gtcal_history": 1, "run_length": run_length, "rigs": [_rig_document(history) for history in histories]}


def _rig_document(history: History) -> dict[str, Any]:
    return {
        "rig": history.rig,
        "status": history.status,
        "accepted": None if history.accepted is None else history.accepted.record.name,
        "sentences": list(history.sentences),
        "findings": [
            {
                "camera": finding.camera,
                "what": finding.what,
                "noticed_utc": utc(finding.alarm_ns).isoformat(),
                "kind": None if finding.change is None else finding.change.kind,
                "rate": None if finding.change is None else finding.change.rate,
                "rate_sigma": None if finding.change is None else finding.change.rate_sigma,
                "unit": finding.unit,
                "days_left": None
                if finding.left is None
                else {"middle": finding.left.middle, "low": finding.left.low, "high": finding.left.high},
            }
            for finding in history.findings
        ],
        "charts_watched": history.n_watched,
        "autocorrelation": history.autocorrelation,
        "recordings": [
            {
                "name": event.record.name,
                "kind": event.record.kind,
                "taken_utc": utc(event.taken_ns).isoformat(),
                "verdict": event.record.verdict,
                "measures": [
                    {"camera": camera, "quantity": quantity, "value": value, "sigma": sigma}
                    for (camera, quantity), (value, sigma) in event.measures.items()
                ],
                "remarks": list(event.remarks),
            }
            for event in history.events
        ],
        "failures": [
            {"name": record.name, "kind": record.kind, "state": record.state, "error": record.error}
            for record in history.failures
        ],
    }
