"""The index of a store: SQLite, for those who look; made from the files, and made anew from them where they disagree.

The schema's version is SQLite's user_version; MIGRATIONS brings an older index up to it, step by step. Tables:

job: a row for each record (``gtcal.fleet.record.Record``), its provenance with it; the current one of several that
    were made of the same recording is in the view ``current``.
input: the files that a job was done from, with their SHA-256. measure: value and sigma by camera ('' for the rig) and
    quantity, whose name ends with its unit. pose: camera_T_ref by camera and body_T_board ('body/board'), as JSON, row
    by row, m, covariances as in calibration.json. remark: findings and warnings, in order.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from gtcal.errors import GtcalError
from gtcal.fleet.measures import as_rows
from gtcal.fleet.record import Contents, Input, Record

MIGRATIONS = (
    """
    CREATE TABLE job (
      id INTEGER PRIMARY KEY,
      rig TEXT NOT NULL, kind TEXT NOT NULL, name TEXT NOT NULL, key TEXT NOT NULL,
      state TEXT NOT NULL CHECK (state IN ('done', 'failed', 'lost')),
      error TEXT NOT NULL, verdict TEXT NOT NULL, taken_ns INTEGER, accept INTEGER NOT NULL,
      calibration_sha256 TEXT NOT NULL, options TEXT NOT NULL, versions TEXT NOT NULL, command_line TEXT NOT NULL,
      created_utc TEXT NOT NULL, duration_s REAL NOT NULL, result_sha256 TEXT NOT NULL,
      UNIQUE (rig, kind, name, key, created_utc)
    );
    CREATE TABLE input (
      job INTEGER NOT NULL REFERENCES job ON DELETE CASCADE, place INTEGER NOT NULL,
      path TEXT NOT NULL, sha256 TEXT NOT NULL, signature TEXT NOT NULL, PRIMARY KEY (job, place)
    ) WITHOUT ROWID;
    CREATE TABLE measure (
      job INTEGER NOT NULL REFERENCES job ON DELETE CASCADE,
      camera TEXT NOT NULL, quantity TEXT NOT NULL, value REAL NOT NULL, sigma REAL,
      PRIMARY KEY (job, camera, quantity)
    ) WITHOUT ROWID;
    CREATE TABLE pose (
      job INTEGER NOT NULL REFERENCES job ON DELETE CASCADE,
      what TEXT NOT NULL, matrix TEXT NOT NULL, covariance TEXT, PRIMARY KEY (job, what)
    ) WITHOUT ROWID;
    CREATE TABLE remark (
      job INTEGER NOT NULL REFERENCES job ON DELETE CASCADE, place INTEGER NOT NULL, text TEXT NOT NULL,
      PRIMARY KEY (job, place)
    ) WITHOUT ROWID;
    """,
    """
    CREATE INDEX job_by_time ON job (rig, taken_ns);
    CREATE VIEW current AS SELECT * FROM (
      SELECT *, row_number() OVER (PARTITION BY rig, kind, name ORDER BY created_utc DESC, id DESC) AS age FROM job
    ) WHERE age = 1;
    """,
)
SCHEMA_VERSION = len(MIGRATIONS)

_RECORD_COLUMNS = (
    "rig",
    "kind",
    "name",
    "key",
    "state",
    "error",
    "verdict",
    "taken_ns",
    "accept",
    "calibration_sha256",
    "options",
    "versions",
    "command_line",
    "created_utc",
    "duration_s",
    "result_sha256",
)
_AS_JSON = ("options", "versions", "command_line")


@contextmanager
def opened_index(path: Path, *, new: bool = False) -> Iterator[sqlite3.Connection]:
    """The index in a file, made or brought up to date where it has to be. ``new``: what is there goes.

    Raises GtcalError where it is of a newer gtcal, or no index."""
    if new:
        for suffix in ("", "-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
    try:
        connection = sqlite3.connect(path, isolation_level=None)
        try:
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            _migrate(connection, path)
            yield connection
        finally:
            connection.close()
    except sqlite3.OperationalError as error:
        raise GtcalError(f"{path}: the index can't be used: {' '.join(str(error).split())}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # also where SQLite tells of what it found in there
        said = " ".join(str(error).split())
        raise GtcalError(f"{path}: the index is damaged ({said}); 'gtcal history --rebuild' makes it anew") from error


def _migrate(connection: sqlite3.Connection, path: Path) -> None:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > SCHEMA_VERSION:
        raise GtcalError(f"{path}: has index schema {version}, this gtcal reads up to {SCHEMA_VERSION}; update gtcal")
    for number, script in enumerate(MIGRATIONS[version:], start=version + 1):
        connection.executescript(f"BEGIN IMMEDIATE; {script} PRAGMA user_version = {number}; COMMIT;")


def insert(connection: sqlite3.Connection, record: Record, contents: Contents) -> None:
    """Keep a record and what it found, all of it or nothing, in the place of a failure of the same job."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        connection.execute(
            "DELETE FROM job WHERE rig = ? AND kind = ? AND name = ? AND state <> 'done'", record.identity
        )
        _insert(connection, record, contents)
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # a full disk has ended it already
            connection.execute("ROLLBACK")
        raise


def _insert(connection: sqlite3.Connection, record: Record, contents: Contents) -> None:
    places = ", ".join("?" * len(_RECORD_COLUMNS))
    cursor = connection.execute(
        f"INSERT INTO job ({', '.join(_RECORD_COLUMNS)}) VALUES ({places})", tuple(_cells(record))
    )
    job = cursor.lastrowid
    connection.executemany(
        "INSERT INTO input VALUES (?, ?, ?, ?, ?)",
        [(job, place, entry.path, entry.sha256, entry.signature) for place, entry in enumerate(record.inputs)],
    )
    connection.executemany(
        "INSERT INTO measure VALUES (?, ?, ?, ?, ?)",
        [(job, one.camera, one.quantity, one.value, one.sigma) for one in contents.measures],
    )
    connection.executemany(
        "INSERT INTO pose VALUES (?, ?, ?, ?)",
        [
            (job, pose.what, *(None if part is None else json.dumps(part) for part in as_rows(pose)))
            for pose in contents.poses
        ],
    )
    connection.executemany(
        "INSERT INTO remark VALUES (?, ?, ?)", [(job, place, text) for place, text in enumerate(contents.remarks)]
    )


def _cells(record: Record) -> Iterator[Any]:
    for name in _RECORD_COLUMNS:
        value = getattr(record, name)
        yield json.dumps(value) if name in _AS_JSON else value


def _record(row: tuple[Any, ...], inputs: tuple[Input, ...]) -> Record:
    given = dict(zip(_RECORD_COLUMNS, row, strict=True))
    try:
        given |= {name: json.loads(given[name]) for name in _AS_JSON}
        given |= {"accept": bool(given["accept"]), "command_line": tuple(given["command_line"]), "inputs": inputs}
    except (TypeError, ValueError) as error:
        raise sqlite3.DatabaseError(f"a row is no record: {error}") from error
    return Record(**given)


def records(
    connection: sqlite3.Connection, *, rig: str | None = None, current: bool = True
) -> Iterator[tuple[int, Record]]:
    """The records with their numbers, in order of time, without their inputs; those that are current, or all."""
    where, given = ("WHERE rig = ?", (rig,)) if rig is not None else ("", ())
    source = "current" if current else "job"
    rows = connection.execute(
        f"SELECT id, {', '.join(_RECORD_COLUMNS)} FROM {source} {where} ORDER BY taken_ns, rig, name, kind, id", given
    )
    for number, *row in rows.fetchall():
        yield number, _record(tuple(row), ())


def with_inputs(connection: sqlite3.Connection, number: int, record: Record) -> Record:
    """The record of this number with its inputs."""
    rows = connection.execute("SELECT path, sha256, signature FROM input WHERE job = ? ORDER BY place", (number,))
    return replace(record, inputs=tuple(Input(*row) for row in rows))


def current_of(connection: sqlite3.Connection, identity: tuple[str, str, str]) -> Record | None:
    """The last record of a job, with its inputs."""
    row = connection.execute(
        f"SELECT id, {', '.join(_RECORD_COLUMNS)} FROM job WHERE rig = ? AND kind = ? AND name = ? "
        "ORDER BY created_utc DESC, id DESC LIMIT 1",
        identity,
    ).fetchone()
    return None if row is None else with_inputs(connection, row[0], _record(row[1:], ()))


def renew_signatures(connection: sqlite3.Connection, record: Record, inputs: Iterable[Input]) -> None:
    """Keep the signatures of inputs that were touched, and hold what they held; nothing where the index is only looked
    at."""
    if connection.execute("PRAGMA query_only").fetchone() == (1,):
        return
    rows = [(entry.signature, *record.identity, record.key, entry.path) for entry in inputs]
    connection.executemany(
        "UPDATE input SET signature = ? WHERE job IN "
        "(SELECT id FROM job WHERE rig = ? AND kind = ? AND name = ? AND key = ?) AND path = ?",
        rows,
    )


def rigs(connection: sqlite3.Connection) -> list[str]:
    """All rigs, by name."""
    return [rig for (rig,) in connection.execute("SELECT DISTINCT rig FROM job ORDER BY rig")]


def rows_of(connection: sqlite3.Connection, table: str, numbers: Iterable[int]) -> Iterator[tuple[Any, ...]]:
    """The rows of 'measure', 'pose' or 'remark' of these jobs, in order."""
    wanted = json.dumps(list(numbers))
    yield from connection.execute(f"SELECT * FROM {table} WHERE job IN (SELECT value FROM json_each(?))", (wanted,))
