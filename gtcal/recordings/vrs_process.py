"""VRS's own reader, in a process of its own: damaged files make it end the whole program.

This file is both sides: imported, what starts the process and asks it; run as a script, what answers, with no other
module of gtcal's.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

_LONGEST_S = 60


class VrsRefusedError(Exception):
    """What VRS's reader says of a file that it can't read."""


class VrsEndedError(Exception):
    """VRS's reader ended its process, or took over a minute."""


class VrsProcess:
    """A VRS file, open in a process of its own for as long as this is there. For one thread.

    What it tells raises VrsRefusedError where the library does, VrsEndedError where the process ends."""

    def __init__(self, path: Path) -> None:
        command = [sys.executable, "-P", __file__, str(path)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
        weakref.finalize(self, _end, self._process)

    def image_streams(self) -> dict[str, int]:
        """The streams that may hold images, by id, and how many data records each has."""
        found: dict[str, int] = self._ask("image_streams")
        return found

    def stamps(self, stream: str, field: str) -> tuple[list[int | None], list[float]]:
        """Of a stream's data records, the whole number in this field of their metadata, and their own times in s."""
        found: tuple[list[int | None], list[float]] = self._ask("stamps", stream, field)
        return found

    def image(self, stream: str, record: int) -> tuple[np.ndarray | None, str]:
        """A data record's pixels, None where it has none, and their format."""
        found: tuple[np.ndarray | None, str] = self._ask("image", stream, record)
        return found

    def _ask(self, *question: str | int) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        too_long = threading.Timer(_LONGEST_S, self._process.kill)
        too_long.start()
        try:
            pickle.dump(question, self._process.stdin)
            self._process.stdin.flush()
            refused, answer = pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise VrsEndedError from None
        finally:
            too_long.cancel()
        if refused:
            raise VrsRefusedError(answer)
        return answer


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    for pipe in (process.stdin, process.stdout):
        with suppress(BrokenPipeError):  # a question that nobody reads any more
            if pipe is not None:
                pipe.close()
    process.wait()


class _Reader:
    """The side that answers."""

    def __init__(self, path: str) -> None:
        from pyvrs import ImageConversion, RecordType, SyncVRSReader

        self._data = RecordType.DATA
        self._reader = SyncVRSReader(path, auto_read_configuration_records=True)
        self._grey = ImageConversion.NORMALIZE_GREY8

    def image_streams(self) -> dict[str, int]:
        found = {
            name: int(self._reader.get_records_count(name, self._data)) for name in sorted(self._reader.stream_ids)
        }
        return {name: count for name, count in found.items() if count and self._reader.might_contain_images(name)}

    def stamps(self, stream: str, field: str) -> tuple[list[int | None], list[float]]:
        records = self._records(stream)
        self._reader.skip_trailing_blocks(int(stream.split("-")[0]), self._data, 1)  # reads no pixels
        captured = [_number(records[i], field) for i in range(len(records))]
        return captured, [float(time_s) for time_s in records.get_timestamp_list()]

    def image(self, stream: str, record: int) -> tuple[np.ndarray | None, str]:
        self._reader.set_image_conversion(self._grey)
        found = self._records(stream)[record]
        if not found.n_image_blocks:
            return None, "no image"
        return np.array(found.image_blocks[0]), str(found.image_specs[0].pixel_format)

    def _records(self, stream: str) -> Any:
        return self._reader.filtered_by_fields(stream_ids={stream}, record_types={"data"})


def _number(record: Any, field: str) -> int | None:
    fields = record.metadata_blocks[0] if record.n_metadata_blocks else {}
    return int(fields[field]) if field in fields else None


def _answer_all(path: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the other side's to handle, which then asks no more
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the library prints as it likes
    readers: dict[str, _Reader] = {}
    with suppress(EOFError):
        while True:
            what, *arguments = pickle.load(sys.stdin.buffer)
            try:
                readers[what] = readers.get(what) or _Reader(path)  # one that skips the pixels skips them for good
                answer = False, getattr(readers[what], what)(*arguments)
            except Exception as error:  # whatever a damaged file makes the library raise
                answer = True, " ".join(str(error).split()) or type(error).__name__
            pickle.dump(answer, answers)
            answers.flush()


if __name__ == "__main__":
    _answer_all(sys.argv[1])
