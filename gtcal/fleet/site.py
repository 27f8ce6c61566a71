"""A static site of a store: a page of the fleet, a page of each rig, and a page of each recording: its report where
there is one. No server, no network; works from a file share."""

from __future__ import annotations

import math
import shutil
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment
from markupsafe import Markup

from gtcal.errors import GtcalError
from gtcal.files import staged
from gtcal.fleet import index
from gtcal.fleet.history import Event, History, histories
from gtcal.fleet.history_figure import history_pictures
from gtcal.fleet.jobs import utc
from gtcal.fleet.measures import BOARD, RIG
from gtcal.fleet.recording_page import recording_page
from gtcal.fleet.run_job import REPORT
from gtcal.fleet.store import Store
from gtcal.pages import page_environment
from gtcal.progress import Progress, silent

MARK = ".gtcal-site"
_SPARK_WIDTH, _SPARK_HEIGHT = 120, 26
_SIGNS = {"pass": "✓", "holds": "✓", "fail": "✗", "fails": "✗", "changed": "▲"}
_KINDS = {"holds": "pass", "fails": "fail", "changed": "inconclusive", "pass": "pass", "fail": "fail"}


@dataclass(frozen=True)
class RigRow:
    """A rig on the fleet's page. ``spark``: its RMSE over time, a polyline's points; ``last``: sortable."""

    history: History
    page: str
    kind: str
    sign: str
    last: str
    rmse_px: str
    spark: str


@dataclass(frozen=True)
class EventRow:
    """A recording on its rig's page. cells: by camera. page: of the recording, from there."""

    event: Event
    taken: str
    kind: str
    sign: str
    cells: tuple[str, ...]
    page: str
    accepted: bool = False


def write_site(path: Path, store: Store, *, run_length: float, progress: Progress = silent) -> int:
    """Write the site of a store into a folder that is new, empty, or of an earlier site. Returns the number of rigs.

    Raises GtcalError where the folder holds something else or can't be written."""
    if path.exists() and not (path / MARK).is_file() and (not path.is_dir() or any(path.iterdir())):
        raise GtcalError(f"{path}: is there already, and is no site of gtcal's; choose another folder")
    found = list(histories(store, run_length=run_length).values())
    environment = _environment()
    with staged(path) as aside, index.opened_index(store.index_path) as connection:
        aside.mkdir()
        (aside / MARK).touch()
        rows = []
        for done, history in enumerate(found):
            progress("pages of rigs", done, len(found))
            page = f"rigs/{quote(history.rig, safe='')}.html"
            rows.append(_rig_row(history, page))
            pages = _Pages(environment, aside, store, connection)
            _write(aside / "rigs" / f"{history.rig}.html", _rig_page(pages, history))
        progress("pages of rigs", len(found), len(found))
        _write(aside / "index.html", _fleet_page(environment, rows, run_length))
    return len(found)


@dataclass(frozen=True)
class _Pages:
    """Writes the recordings' pages."""

    environment: Environment
    aside: Path
    store: Store
    connection: sqlite3.Connection

    def written(self, event: Event, kind: str, sign: str) -> str:
        """Where the page of a recording is, from its rig's page: the report, or what the store has of it."""
        record = event.record
        target = Path("recordings", record.rig, f"{record.name}.{record.kind}.html")
        report = self.store.folder_of(record) / REPORT
        if report.is_file():
            (self.aside / target).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(report, self.aside / target)
        else:
            full = index.current_of(self.connection, record.identity) or record
            rig_page = f"../../rigs/{quote(record.rig, safe='')}.html"
            _write(self.aside / target, recording_page(self.environment, event, full, kind, sign, rig_page))
        return "../" + "/".join(quote(part, safe="") for part in target.parts)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")


def _environment() -> Environment:
    environment = page_environment("gtcal.fleet")
    environment.globals["style"] = _text("gtcal.report", "report.css") + _text("gtcal.fleet", "fleet.css")
    environment.globals["script"] = _text("gtcal.fleet", "fleet.js")
    return environment


def _text(package: str, name: str) -> Markup:
    """A file of our own, put into the page as it is."""
    return Markup((files(package) / "templates" / name).read_text(encoding="utf-8"))


def _rig_row(history: History, page: str) -> RigRow:
    last = history.last_verified
    pooled = [
        event.measures[RIG, "rmse_px"][0] for event in history.verifications if (RIG, "rmse_px") in event.measures
    ]
    return RigRow(
        history,
        page,
        _KINDS.get(history.status, "open"),
        _SIGNS.get(history.status, "?"),
        "" if not history.events else f"{utc(history.events[-1].taken_ns):%Y-%m-%d %H:%M}",
        _number(last.measures.get((RIG, "rmse_px"), (math.nan, math.nan))[0] if last else math.nan, 3),
        _spark(pooled),
    )


def _spark(values: Sequence[float]) -> str:
    """The points of a line from zero to the largest value."""
    if len(values) < 2:
        return ""
    largest = max(values) or 1.0
    step = _SPARK_WIDTH / (len(values) - 1)
    return " ".join(
        f"{step * place:.1f},{_SPARK_HEIGHT - (_SPARK_HEIGHT - 2) * value / largest:.1f}"
        for place, value in enumerate(values)
    )


def _fleet_page(environment: Environment, rows: Sequence[RigRow], run_length: float) -> str:
    counts = {status: sum(row.history.status == status for row in rows) for status in _ORDER}
    return environment.get_template("fleet.html.j2").render(
        rows=sorted(rows, key=lambda row: (_ORDER.index(row.history.status), row.history.rig)),
        counts={status: count for status, count in counts.items() if count},
        run_length=run_length,
        n_watched=rows[0].history.n_watched if rows else 0,
    )


_ORDER = ("fails", "changed", "can't tell", "not verified", "holds")
"""What needs somebody first."""


def _rig_page(pages: _Pages, history: History) -> str:
    whats = (*history.cameras, BOARD)
    return pages.environment.get_template("rig.html.j2").render(
        history=history,
        kind=_KINDS.get(history.status, "open"),
        sign=_SIGNS.get(history.status, "?"),
        pictures=history_pictures(history) if history.events else [],
        verifications=[
            _event_row(pages, history, event, [_error(event, camera) for camera in history.cameras])
            for event in reversed(history.verifications)
        ],
        calibrations=[
            _event_row(pages, history, event, [_move(event, what) for what in whats])
            for event in reversed(history.calibrations)
        ],
    )


def _event_row(pages: _Pages, history: History, event: Event, cells: list[str]) -> EventRow:
    record = event.record
    kind, sign = _KINDS.get(record.verdict, "open"), _SIGNS.get(record.verdict, "?")
    return EventRow(
        event,
        f"{utc(event.taken_ns):%Y-%m-%d %H:%M}",
        kind,
        sign,
        tuple(cells),
        pages.written(event, kind, sign),
        history.accepted is not None and history.accepted.record == record,
    )


def _error(event: Event, camera: str) -> str:
    return _number(event.measures.get((camera, "rmse_px"), (math.nan, math.nan))[0], 3)


def _move(event: Event, what: str) -> str:
    axes = [event.measures.get((what, f"moved_{axis}_mm"), (math.nan, math.nan)) for axis in "xyz"]
    size = math.hypot(*(value for value, _ in axes))
    return "" if math.isnan(size) else f"{size:.3f} ± {max(sigma for _, sigma in axes):.3f}"


def _number(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"
