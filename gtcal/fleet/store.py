"""The store: a folder whose state is its files, with an index of them that can be made anew.

STORE/
  gtcal_store.json                         that it is one, and how it is laid out
  results/RIG/NAME/KIND-TIME-KEY/          record.json, the result, and its report: put in place as a whole
  failures/RIG/NAME.KIND.json              the record of a job without a result
  accepted/RIG.json                        the calibrations that were accepted beside those of the jobs
  index.sqlite                             of all that (``gtcal.fleet.index``)
  lock                                     held by the one process that writes
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from gtcal.documents import read_text
from gtcal.errors import GtcalError
from gtcal.files import staged, write_text
from gtcal.fleet.record import RECORD, Record, record_text
from gtcal.fleet.run_job import Outcome
from gtcal.names import check_name
from gtcal.results.result_file import read_result

LAYOUT_VERSION = 1
_KEY_LETTERS = 8
_MARK = "gtcal_store.json"


@dataclass(frozen=True)
class Store:
    """The store in a folder."""

    path: Path

    @staticmethod
    def opened(path: Path) -> Store:
        """The store that is there. Raises GtcalError where there is none, or one of a newer gtcal."""
        if not (path / _MARK).is_file():
            raise GtcalError(f"{path}: is no store of results; 'gtcal batch JOBS -o {path}' makes one")
        read_result(path / _MARK, "store", LAYOUT_VERSION, lambda document: document)
        return Store(path)

    @staticmethod
    def made(path: Path) -> Store:
        """The store that is there, or a new one in a folder that is new or empty. Raises GtcalError where the folder
        holds something else."""
        if not (path / _MARK).exists():
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise GtcalError(f"{path}: is there, and is no store of results; give a new folder or an empty one")
            write_text(path / _MARK, json.dumps({"gtcal_store": LAYOUT_VERSION}) + "\n")
        return Store.opened(path)

    @property
    def index_path(self) -> Path:
        return self.path / "index.sqlite"

    def folder_of(self, record: Record) -> Path:
        """Where a result is: of each run another folder, so that none is ever written over."""
        moment = "".join(letter for letter in record.created_utc[:23] if letter.isalnum())
        called = f"{record.kind}-{moment}-{record.key[:_KEY_LETTERS]}"
        return self.path / "results" / record.rig / record.name / called

    def failure_of(self, record: Record) -> Path:
        """Where it is recorded that there is no result."""
        return self.path / "failures" / record.rig / f"{record.name}.{record.kind}.json"

    def put(self, outcome: Outcome) -> None:
        """Keep what came of a task: a result as a whole, or that there is none. Raises GtcalError where it can't be
        written."""
        record = outcome.record
        if record.state != "done":
            write_text(self.failure_of(record), record_text(record))
            return
        with staged(self.folder_of(record)) as aside:
            aside.mkdir()
            for name, text in outcome.files.items():
                (aside / name).write_text(text, encoding="utf-8", newline="\n")
        self.failure_of(record).unlink(missing_ok=True)

    def record_files(self) -> list[Path]:
        """Of every result, then of every failure."""
        return [*sorted(self.path.glob(f"results/*/*/*/{RECORD}")), *sorted(self.path.glob("failures/*/*.json"))]

    def file_of(self, record: Record) -> Path:
        """Where a record is."""
        return self.folder_of(record) / RECORD if record.state == "done" else self.failure_of(record)

    def left_aside(self) -> list[Path]:
        """What a process that was killed left of what it was writing."""
        return [path for path in self.path.rglob(".*.part") if path.is_dir()]

    def clear_left_aside(self) -> None:
        """To be called with the lock held."""
        for path in self.left_aside():
            shutil.rmtree(path, ignore_errors=True)

    def accepted_names(self, rig: str) -> frozenset[str]:
        """The calibrations of a rig that were accepted beside those of the jobs. Raises GtcalError where the file is
        damaged."""
        path = self._accepted_path(rig)
        if not path.is_file():
            return frozenset()
        return read_result(path, "accepted", 1, lambda document: frozenset(map(str, document["calibrations"])))

    def accept(self, rig: str, name: str) -> None:
        """Accept a calibration: the rig is used with it from its recording on. To be called with the lock held."""
        check_name("rig", rig)
        names = sorted(self.accepted_names(rig) | {name})
        write_text(self._accepted_path(rig), json.dumps({"gtcal_accepted": 1, "calibrations": names}, indent=1) + "\n")

    def _accepted_path(self, rig: str) -> Path:
        return self.path / "accepted" / f"{rig}.json"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """No other process writes to the store inside. The lock goes with the process, however that ends.

        Raises GtcalError where another holds it."""
        path = self.path / "lock"
        try:
            file = path.open("ab", buffering=0)
        except OSError as error:
            raise GtcalError(f"{path}: can't be written: {error.strerror}") from error
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                who = _holder(path)
                raise GtcalError(
                    f"{self.path}: another gtcal ({who}) is writing to this store; wait for it, or give another store"
                ) from None
            with suppress(OSError):  # who holds it is a courtesy, for which a full disk has no room
                file.truncate(0)
                file.write(f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            yield
            with suppress(OSError):
                file.truncate(0)


def _holder(path: Path) -> str:
    try:
        return read_text(path).strip() or "just begun"
    except GtcalError:
        return "unknown"
