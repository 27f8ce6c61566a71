"""A library that damaged files make end the whole program reads them in a process of its own.

This file is both sides: imported, what starts the process and asks it; run as a script, what answers, with a file that
defines ``Reader`` and imports nothing of gtcal's.
"""

from __future__ import annotations

import os
import pickle
import runpy
import signal
import subprocess
import sys
import threading
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any

_LONGEST_S = 60


class RefusedError(Exception):
    """What the library says of what it can't read."""


class EndedError(Exception):
    """The library ended its process, or took over a minute."""


class OwnProcess:
    """A process that answers by a ``Reader`` for as long as this is there. For one thread at a time."""

    def __init__(self, reader: Path, *arguments: str) -> None:
        """reader: the file that defines it; arguments: of its construction, with the first question."""
        command = [sys.executable, "-P", __file__, str(reader), *arguments]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
        weakref.finalize(self, _end, self._process)

    def ask(self, method: str, *arguments: str | int) -> Any:
        """What this method of the reader returns.

        Raises RefusedError where it raises, EndedError where the process ends."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        too_long = threading.Timer(_LONGEST_S, self._process.kill)
        too_long.start()
        try:
            pickle.dump((method, *arguments), self._process.stdin)
            self._process.stdin.flush()
            refused, answer = pickle.load(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise EndedError from None
        finally:
            too_long.cancel()
        if refused:
            raise RefusedError(answer)
        return answer


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    for pipe in (process.stdin, process.stdout):
        with suppress(BrokenPipeError):  # a question that nobody reads any more
            if pipe is not None:
                pipe.close()
    process.wait()


def _answer_all(reader: str, *arguments: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the other side's to handle, which then asks no more
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the library prints as it likes
    made = None
    with suppress(EOFError):
        while True:
            method, *question = pickle.load(sys.stdin.buffer)
            try:
                made = made or runpy.run_path(reader)["Reader"](*arguments)
                answer = False, getattr(made, method)(*question)
            except Exception as error:  # whatever a damaged file makes the library raise
                answer = True, " ".join(str(error).split()) or type(error).__name__
            pickle.dump(answer, answers)
            answers.flush()


if __name__ == "__main__":
    _answer_all(*sys.argv[1:])
