"""Files written whole or not at all, never over what they are made from, and their fingerprints."""

from __future__ import annotations

import hashlib
import os
import shutil
import sqlite3
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO

from gtcal.errors import GtcalError

_LONGEST_PREFIX = 40  # characters of a name in that of the folder beside it, which may be no longer than a name may


@dataclass(frozen=True)
class InputFile:
    """A file (or folder of files) that a result was computed from. ``sha256`` is 64 hex digits."""

    path: Path
    sha256: str


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path] = (), *, folders: bool = False) -> None:
    """To be asked before the work: that these paths (None: not asked for) can be written, and that none is one of the
    inputs, by whatever name, or the same as another. Of an input that is a folder, the files in it are inputs too.
    ``folders``: the outputs are to be folders.

    Raises GtcalError naming the output."""
    given = [path for path in outputs if path is not None]
    read = _identities(inputs)
    earlier: dict[tuple[int, int] | Path, Path] = {}
    for path in given:
        status = _status(path)
        if status is not None and (_is_stream(status) or is_standard_output(path)):
            continue
        if status is not None and (status.st_dev, status.st_ino) in read:
            source = read[status.st_dev, status.st_ino]
            raise GtcalError(f"{path}: is what is read here ({source}); give another file to write to")
        same = earlier.setdefault((status.st_dev, status.st_ino) if status else _real(path), path)
        if same is not path:
            raise GtcalError(f"{path}: is to be written twice, as {same} too; give two files")
        if status is not None and stat.S_ISDIR(status.st_mode) != folders:
            found, asked = ("file", "folder") if folders else ("folder", "file")
            raise GtcalError(f"{path}: is a {found}; give a {asked}")
        _check_writable(path, _real(path))


def _identities(inputs: Iterable[Path]) -> dict[tuple[int, int], Path]:
    """By device and number, the inputs that are there, and the files in those that are folders."""
    found = {}
    for path in inputs:
        for file in (path, *(sorted(path.iterdir()) if path.is_dir() else ())):
            if (status := _status(file)) is not None:
                found[status.st_dev, status.st_ino] = file
    return found


def _status(path: Path) -> os.stat_result | None:
    """Of what is at ``path``, None where there is nothing. Raises GtcalError where there can be nothing."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise _unwritable(path, error) from error


def _is_stream(status: os.stat_result) -> bool:
    """Whether it is a pipe, a device or a socket, which is written to as it is and never replaced."""
    return not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode)


def _real(path: Path) -> Path:
    """Where a path leads: links are followed, not replaced."""
    return Path(os.path.realpath(path))


def _check_writable(path: Path, target: Path) -> None:
    """Whether ``target`` if it is a folder, its folder, or that in which it is to be made, takes a file."""
    folder = target if target.is_dir() else next(parent for parent in target.parents if parent.exists())
    try:
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: Exception) -> GtcalError:
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return GtcalError(f"{path}: can't be written: {said}")


def is_there(path: Path) -> bool:
    """Whether there is something at a path, which may be no possible one."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def is_standard_output(path: Path) -> bool:
    """Whether what is written to ``path`` goes where this program prints, as to /dev/stdout."""
    try:
        return os.path.samestat(path.stat(), os.fstat(sys.__stdout__.fileno() if sys.__stdout__ else 1))
    except (OSError, ValueError):
        return False


@contextmanager
def staged(path: Path) -> Iterator[Path]:
    """A path of the same name in a hidden folder beside ``path``, for the body to write a file or a folder at. It
    is put in the place of ``path`` on leaving: a file or a new folder whole, into a folder that is there file by
    file. Where the body raises, ``path`` stays as it was. The folder around it is made where it is missing. A link is
    followed; what is written to a pipe or a device, /dev/stdout say, is handed to it whole.

    Raises GtcalError where it can't be written."""
    status = _status(path)
    stream = (status is not None and _is_stream(status)) or is_standard_output(path)
    target = _real(path)
    try:
        prefix = f".{target.name[:_LONGEST_PREFIX]}."
        with (
            nullcontext() if stream else _made(target.parent),
            TemporaryDirectory(prefix=prefix, suffix=".part", dir=None if stream else target.parent) as beside,
        ):
            aside = Path(beside) / path.name
            with _in_words_of(path, aside):
                yield aside
            _hand_over(aside, path) if stream else _put_in_place(aside, target)
    except (OSError, sqlite3.Error) as error:
        raise _unwritable(path, error) from error


@contextmanager
def _in_words_of(path: Path, aside: Path) -> Iterator[None]:
    """What goes wrong with the file aside is said of the path that was asked for."""
    try:
        yield
    except GtcalError as error:
        if str(aside) not in str(error):
            raise
        raise GtcalError(str(error).replace(str(aside), str(path))) from error


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """The folder, made where it is missing, with those around it; gone again where the body raises."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):  # others may have put something there
            for place in missing:
                place.rmdir()
        raise


def _put_in_place(aside: Path, target: Path) -> None:
    if aside.is_dir() and target.is_dir():
        for inner in aside.iterdir():
            _put_in_place(inner, _real(target / inner.name))
    else:
        aside.replace(target)


def _hand_over(aside: Path, stream: Path) -> None:
    """Write the file ``aside`` to a pipe or a device. Standard output is not opened a second time: what this program
    prints goes on behind."""
    with aside.open("rb") as source:
        if is_standard_output(stream):
            sys.stdout.flush()
            with os.fdopen(os.dup(sys.__stdout__.fileno() if sys.__stdout__ else 1), "wb") as sink:
                shutil.copyfileobj(source, sink)
        else:
            with stream.open("wb") as sink:
                shutil.copyfileobj(source, sink)


@contextmanager
def write_aside(path: Path, *, binary: bool = False) -> Iterator[IO]:
    """Open a new file for writing that takes the place of ``path`` on leaving, as ``staged`` has it. Text is UTF-8 with
    ``\\n``.

    Raises GtcalError where the file can't be written."""
    with staged(path) as aside, aside.open("xb") if binary else aside.open("x", encoding="utf-8", newline="\n") as file:
        yield file


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises GtcalError where it can't be written."""
    with write_aside(path) as file:
        file.write(text)


def write_folder(path: Path, texts: dict[str, str]) -> None:
    """Write text files, by name, into a folder that is made where it is missing. Nothing is put in place before all of
    them are on the disk beside it.

    Raises GtcalError where they can't be written."""
    with staged(path) as aside:
        aside.mkdir()
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8", newline="\n")


MiB = 2**20
DOCUMENT_BYTES, TABLE_BYTES, IMAGE_BYTES = 256 * MiB, 4096 * MiB, 1024 * MiB
"""The most that is read of a file of fields, of rows, and of an image: several times what any real one holds."""


def check_regular(path: Path, most_bytes: int | None = None) -> None:
    """To be asked before a file is read: a pipe or a device may never end, and what is far too large fills the memory.
    Whether there is a file at all is left to the reader.

    Raises GtcalError where there is something else than a file or a folder, or it is larger than that."""
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode) and not status.st_size:  # as those of /proc, some of which can't be read
            with path.open("rb") as file:
                file.read(1)
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        said = error.strerror if isinstance(error, OSError) else error
        raise GtcalError(f"{path}: can't be read: {said}") from None
    if _is_stream(status):
        raise GtcalError(f"{path}: is a pipe or a device; expected a file: write what it gives into one")
    if most_bytes is not None and stat.S_ISREG(status.st_mode) and status.st_size > most_bytes:
        raise GtcalError(
            f"{path}: holds {status.st_size / MiB:.0f} MiB, and such a file at most {most_bytes // MiB}; is it another?"
        )


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """The contents of a file. Raises GtcalError as ``check_regular``, OSError where it can't be read."""
    check_regular(path, most_bytes)
    with path.open("rb") as file:
        content = file.read(path.stat().st_size + 1)
        while len(content) <= most_bytes and (more := file.read(MiB)):
            content += more
    if len(content) > most_bytes:  # as of /proc, whose files state no size
        raise GtcalError(f"{path}: does not end after {most_bytes // MiB} MiB")
    return content


def fingerprint(path: Path) -> InputFile:
    """The SHA-256 of a file, or of the names and contents of the files directly in a folder."""
    check_regular(path)
    if path.is_dir():
        total = hashlib.sha256()
        for file in sorted(path.iterdir()):
            if file.is_file():
                total.update(f"{file.name}\0{sha256_of(file)}\n".encode())
        return InputFile(path, total.hexdigest())
    return InputFile(path, sha256_of(path))


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's contents, computed once in a run. Raises GtcalError where it can't be read."""
    check_regular(path)
    try:
        status = path.stat()
        return _digest(path, (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns))
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error


@lru_cache(maxsize=1_000_000)
def _digest(path: Path, _identity: tuple[int, ...]) -> str:
    """``_identity`` changes with every change of the file: no one can set the time of its last change (ctime)."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
