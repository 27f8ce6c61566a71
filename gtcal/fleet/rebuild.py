"""The index against the files: what a process that was killed put in place without a row is taken up, and all of it is
made anew where that is asked for."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from gtcal.errors import GtcalError
from gtcal.fleet import index
from gtcal.fleet.record import Contents, Record, read_contents, read_record
from gtcal.fleet.store import Store
from gtcal.progress import Progress, silent


def catch_up(store: Store, connection: sqlite3.Connection) -> list[str]:
    """Take up the results and failures that have no row, and drop the rows that have no file. A line on each. To be
    called with the lock held.

    Raises GtcalError where a record is damaged."""
    known = {store.file_of(record): number for number, record in index.records(connection, current=False)}
    there = store.record_files()
    lines = []
    for path in there:
        if path not in known:
            record = read_record(path)
            if record.state != "done" and _is_old(connection, record):
                path.unlink()
                continue
            index.insert(connection, record, _contents(record, path))
            lines.append(f"{_named(record)}: is in the files, and was not in the index")
    for path in sorted(set(known) - set(there)):
        connection.execute("DELETE FROM job WHERE id = ?", (known[path],))
        lines.append(f"{path.relative_to(store.path)}: was in the index, and is not in the files")
    return lines


def _is_old(connection: sqlite3.Connection, record: Record) -> bool:
    """Whether a failure's file was left where the job has since been done."""
    last = index.current_of(connection, record.identity)
    return last is not None and last.state == "done" and last.created_utc > record.created_utc


def _contents(record: Record, path: Path) -> Contents:
    return read_contents(record, path.parent) if record.state == "done" else Contents()


def _named(record: Record) -> str:
    return f"{record.rig}/{record.name} ({record.kind})"


def rebuild(store: Store, *, progress: Progress = silent) -> list[str]:
    """Make the index anew from the files. Returns a line on each row in which the two disagreed. To be called with the
    lock held.

    Raises GtcalError where a record or a result is damaged: then the index is as it was."""
    found = list(_all(store, progress))
    before = _rows_before(store)
    aside = store.index_path.with_name("index.new.sqlite")
    with index.opened_index(aside, new=True) as connection:
        for record, contents, _ in found:
            index.insert(connection, record, contents)
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.execute("PRAGMA journal_mode = DELETE")
        after = _rows(store, connection)
    for suffix in ("-wal", "-shm"):
        store.index_path.with_name(store.index_path.name + suffix).unlink(missing_ok=True)
    aside.replace(store.index_path)
    return list(_differences(before, after))


def _all(store: Store, progress: Progress) -> Iterator[tuple[Record, Contents, Path]]:
    paths = store.record_files()
    for done, path in enumerate(paths):
        progress("reading the store", done, len(paths))
        record = read_record(path)
        yield record, _contents(record, path), path
    progress("reading the store", len(paths), len(paths))


Rows = dict[str, tuple[object, ...]]
"""All that the index has of each record, by its file."""


def _rows_before(store: Store) -> Rows:
    """Of the index that is there; nothing of one that can't be read."""
    if not store.index_path.exists():
        return {}
    try:
        with index.opened_index(store.index_path) as connection:
            return _rows(store, connection)
    except GtcalError:
        return {}


def _rows(store: Store, connection: sqlite3.Connection) -> Rows:
    found = {}
    for number, record in index.records(connection, current=False):
        inputs = tuple(replace(entry, signature="") for entry in index.with_inputs(connection, number, record).inputs)
        tables = (
            tuple(row[1:] for row in index.rows_of(connection, table, [number]))
            for table in ("measure", "pose", "remark")
        )
        found[str(store.file_of(record).relative_to(store.path))] = (replace(record, inputs=inputs), *tables)
    return found


def _differences(before: Rows, after: Rows) -> Iterator[str]:
    for name in sorted({*before, *after}):
        if name not in before:
            yield f"{name}: is in the files, and was not in the index"
        elif name not in after:
            yield f"{name}: was in the index, and is not in the files"
        elif before[name] != after[name]:
            parts = ("record", "measures", "poses", "remarks")
            unlike = (part for part, one, other in zip(parts, before[name], after[name], strict=True) if one != other)
            yield f"{name}: the index had other {' and '.join(unlike)} than the files"
