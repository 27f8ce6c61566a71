"""Files written whole or not at all, and their fingerprints."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from gtcal.errors import GtcalError


@dataclass(frozen=True)
class InputFile:
    """A file (or folder of files) that a result was computed from. ``sha256`` is 64 hex digits."""

    path: Path
    sha256: str


@contextmanager
def write_aside(path: Path, *, binary: bool = False) -> Iterator[IO]:
    """Open a new file beside ``path`` for writing and put it in the place of ``path`` on leaving. Where the
    body raises, ``path`` stays as it was. The folder is made where it is missing. Text is UTF-8 with ``\\n``.

    Raises GtcalError where the file can't be written."""
    aside = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("xb") if binary else aside.open("x", encoding="utf-8", newline="\n") as file:
            yield file
        aside.replace(path)
    except OSError as error:
        raise GtcalError(f"{path}: can't be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            aside.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises GtcalError where it can't be written."""
    with write_aside(path) as file:
        file.write(text)


def write_folder(path: Path, texts: dict[str, str]) -> None:
    """Write text files, by name, into a folder that is made where it is missing. Nothing is put in place before all of
    them are on the disk beside it.

    Raises GtcalError where they can't be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name}.", suffix=".part", dir=path.parent) as aside:
            for name, text in texts.items():
                write_text(Path(aside) / name, text)
            path.mkdir(exist_ok=True)
            for name in texts:
                (Path(aside) / name).replace(path / name)
    except OSError as error:
        raise GtcalError(f"{path}: can't be written: {error.strerror or error}") from error


def fingerprint(path: Path) -> InputFile:
    """The SHA-256 of a file, or of the names and contents of the files directly in a folder."""
    if path.is_dir():
        total = hashlib.sha256()
        for file in sorted(path.iterdir()):
            if file.is_file():
                total.update(f"{file.name}\0{_sha256(file)}\n".encode())
        return InputFile(path, total.hexdigest())
    return InputFile(path, _sha256(path))


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error
