"""Text files of numbers in columns: parsed by NumPy's C reader, or by Arrow's on all cores where they are large and it
is installed; explained line by line only where that fails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from os import SEEK_END
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
import numpy.typing as npt

from gtcal.arrow import columns_of_csv
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import TABLE_BYTES, MiB, check_regular
from gtcal.recordings.detections import IntArray

Kind = Literal["stamp", "integer", "number", "ignored"]
# A time stamp stays text until it is scaled to whole nanoseconds: 1606153863362296104 has no float64.
_DTYPES: dict[Kind, str] = {"stamp": "S40", "integer": "i8", "number": "f8", "ignored": "S1"}
_WORTH_ARROW = 8 * MiB  # its import takes as long as a file of that size
_LONGEST_STAMP = 39  # one less, so that a text that NumPy's reader cut off is told from one that fits
TIME_UNIT_DIGITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Decimal digits between each unit of time and the nanosecond."""


@dataclass(frozen=True)
class TextTable:
    """The head of a text file of columns, and on demand its rows.

    separator: between fields; None for any white space.
    comments: the lines before the first row that start with '#', and the line of column names, without '#'.
    skip_lines: lines before the first row.
    n_columns: fields of the first row, 0 where the file has no rows.
    """

    path: Path
    separator: str | None
    comments: tuple[str, ...]
    skip_lines: int
    n_columns: int

    def header(self) -> tuple[str, ...]:
        """The column names: the fields of the last line before the first row. None where that line isn't there
        or has no separator, and so is prose."""
        names = self.split(self.comments[-1]) if self.comments else ()
        return names if len(names) > 1 else ()

    def holds(self, names: tuple[str, ...]) -> bool:
        """Whether these are its columns, in this order."""
        return self.header() == names

    def split(self, line: str) -> tuple[str, ...]:
        return tuple(field.strip() for field in line.split(self.separator))

    def read(self, columns: Sequence[tuple[str, Kind]]) -> npt.NDArray[Any]:
        """All rows, as a structured array with these columns (name, kind), one for each field of a row. Stamps are
        text, or whole numbers where all of them are.

        Raises GtcalError with file and line where a row has another number of fields, or a field is not a
        whole number, not a number, NaN or infinite."""
        rows = self._plain_numbers(columns)
        if rows is None:
            rows = self._any_numbers(columns)
        for name, kind in columns:
            if kind == "number":
                self._check_finite(name, rows[name])
        return rows

    def _plain_numbers(self, columns: Sequence[tuple[str, Kind]]) -> npt.NDArray[Any] | None:
        """Of a large file that holds nothing else."""
        if self.separator != "," or self.path.stat().st_size < _WORTH_ARROW:
            return None
        types = {name: np.float64 if kind == "number" else np.int64 for name, kind in columns if kind != "ignored"}
        found = columns_of_csv(self.path, self.skip_lines, [name for name, _ in columns], types)
        if found is None:
            return None
        dtypes = [(name, types.get(name, _DTYPES["ignored"])) for name, _ in columns]
        rows = np.zeros(len(found[0]), dtypes)
        for name, column in zip(types, found, strict=True):
            rows[name] = column
        return rows

    def _any_numbers(self, columns: Sequence[tuple[str, Kind]]) -> npt.NDArray[Any]:
        dtype = np.dtype([(name, _DTYPES[kind]) for name, kind in columns])
        if self.n_columns == 0:
            return np.empty(0, dtype)
        try:
            with _open(self.path) as file:
                rows = np.loadtxt(file, dtype=dtype, delimiter=self.separator, skiprows=self.skip_lines, ndmin=1)
        except ValueError as error:
            raise self._explain(columns, error) from error
        return rows

    def last_line_has_no_end(self) -> bool:
        """Whether the file ends within a line, as one that is cut off does: its last number may have lost digits."""
        with self.path.open("rb") as file:
            file.seek(0, SEEK_END)
            file.seek(max(0, file.tell() - 1))
            return file.read(1) not in (b"\n", b"\r", b"")

    def stamps_ns(self, stamps: npt.NDArray[np.bytes_] | IntArray, time_unit: str) -> IntArray:
        """(N,) time stamps, given as ``read`` gives them in ``time_unit`` (s, ms, us, ns), as nanoseconds: exact
        where they have no more decimals than that, else rounded.

        Raises GtcalError with file and line where one is no number or too large for its unit."""
        scale = 10 ** TIME_UNIT_DIGITS[time_unit]
        try:
            whole = stamps.astype(np.int64)
        except (ValueError, OverflowError):
            return self._decimal_stamps_ns(np.asarray(stamps, np.bytes_), time_unit)
        too_large = np.flatnonzero(np.abs(whole.astype(np.float64)) * scale >= 2.0**63)
        if len(too_large):
            row = int(too_large[0])
            raise self.error(row, _too_large(str(whole[row]), time_unit))
        return whole * scale

    def _decimal_stamps_ns(self, texts: npt.NDArray[np.bytes_], time_unit: str) -> IntArray:
        digits = TIME_UNIT_DIGITS[time_unit]
        stamps = np.empty(len(texts), dtype=np.int64)
        for row, text in enumerate(np.char.decode(texts, "latin-1").tolist()):
            try:
                stamp_ns = Decimal(text).scaleb(digits)
                too_large = abs(stamp_ns) >= 2**63
            except ArithmeticError:
                raise self.error(row, f"time stamp {text!r} is not a finite number") from None
            if too_large or len(text) > _LONGEST_STAMP:
                raise self.error(row, _too_large(text, time_unit))
            stamps[row] = int(stamp_ns.to_integral_value())
        return stamps

    def check_strictly_increasing(self, stamps_ns: IntArray) -> None:
        """Raises GtcalError naming the line of the first time stamp that repeats or goes backward."""
        bad = np.flatnonzero(np.diff(stamps_ns) <= 0)
        if not len(bad):
            return
        row = int(bad[0]) + 1
        what = "repeats" if stamps_ns[row] == stamps_ns[row - 1] else "goes backward from"
        raise self.error(
            row,
            f"time stamp {stamps_ns[row]} ns {what} that of the row before"
            + ("" if what == "repeats" else f", {stamps_ns[row - 1]} ns")
            + "; time stamps must increase from row to row",
        )

    def error(self, row: int, message: str) -> GtcalError:
        """An error about row ``row``, with its file and line."""
        return GtcalError(f"{self.path}:{self.line_of(row)}: {message}")

    def line_of(self, row: int) -> int:
        """The line number, from 1, of row ``row``."""
        return next(line for index, (line, _) in enumerate(self._lines()) if index == row)

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Line number and text of each row, as NumPy's reader takes them."""
        with _open(self.path) as file:
            for number, line in enumerate(file, start=1):
                row = line.partition("#")[0].strip("\n")
                if number > self.skip_lines and row.strip():
                    yield number, row

    def _check_finite(self, name: str, values: FloatArray) -> None:
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            row = int(bad[0])
            raise self.error(row, f"{name} is {values[row]}; expected a finite number")

    def _explain(self, columns: Sequence[tuple[str, Kind]], error: ValueError) -> GtcalError:
        """The first row that NumPy's reader could not take, in words."""
        for number, line in self._lines():
            fields = self.split(line)
            if len(fields) != len(columns):
                return GtcalError(
                    f"{self.path}:{number}: fields in the row: {len(fields)}, expected {len(columns)}"
                    + _damage_hint(line, len(fields) < len(columns))
                )
            for (name, kind), field in zip(columns, fields, strict=True):
                if not _parses(field, kind):
                    shown = "empty" if not field else repr(field)
                    expected = "a whole number" if kind == "integer" else "a number"
                    return GtcalError(f"{self.path}:{number}: {name} is {shown}; expected {expected}")
        return GtcalError(f"{self.path}: can't be read as a table: {error}")


def open_table(path: Path, separator: str | None) -> TextTable:
    """Look at the head of a text file of columns. The first line that is no comment holds the column names where
    it doesn't start like a number. A byte-order mark and any line ending are taken.

    Raises GtcalError where the file is missing, unreadable or empty."""
    comments: list[str] = []
    named = False
    number = 0
    with _open(path) as file:
        for number, raw in enumerate(file):
            line = raw.strip()
            if line and not line.startswith("#"):
                fields = line.partition("#")[0].split(separator)
                if named or line[0] in "+-.0123456789" or _parses(fields[0].strip(), "number"):
                    return TextTable(path, separator, tuple(comments), number, len(fields))
                named = True
            if line:
                comments.append(line.lstrip("#").strip())
    if not comments:
        raise GtcalError(f"{path}: the file is empty")
    return TextTable(path, separator, tuple(comments), number + 1, 0)


def _open(path: Path) -> IO[str]:
    """Open for reading. Bytes that are no UTF-8 become a character that no number holds, so that the row they
    stand in is named."""
    check_regular(path, TABLE_BYTES)
    try:
        return path.open(encoding="utf-8-sig", errors="replace")
    except FileNotFoundError:
        raise GtcalError(f"{path}: there is no such file") from None
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error


def _parses(field: str, kind: Kind) -> bool:
    if kind == "ignored":
        return True
    if "_" in field:  # Python's 1_000 is a damaged number here
        return False
    try:
        int(field) if kind == "integer" else float(field)
    except ValueError:
        return False
    return True


def _too_large(stamp: str, time_unit: str) -> str:
    return f"time stamp {stamp} is too large for {time_unit}; check the time unit"


def _damage_hint(line: str, too_few: bool) -> str:
    if ";" in line:
        return ", separated by commas (is this an export with ';' and decimal commas?)"
    return " (is the file cut off?)" if too_few else ""
