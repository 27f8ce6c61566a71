"""Text exports of mocap software: some lines of header, then rows of numbers in which a blank cell is an occlusion.

A take of an hour has a million rows and a hundred columns: the rows are parsed by a compiled kernel, straight from the
file's bytes.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import TABLE_BYTES, read_bytes

SEPARATORS = (",", ";", "\t")
_OK, _NO_NUMBER, _TOO_FEW, _TOO_MANY = 0, 1, 2, 3
_LONGEST_HEADER = 4096
_SHOWN = 24
_LOOKED_AT = 5
_MANY_DECIMALS = 9
_BLANK = b" \t\r\n,;"


@dataclass(frozen=True)
class Line:
    """A line of an export: its number from 1, the bytes that it takes, its text without the line ending."""

    number: int
    start: int
    end: int
    text: str

    def fields(self, separator: str) -> tuple[str, ...]:
        """The cells, at least one, without quotes and surrounding blanks."""
        try:
            cells = next(csv.reader([self.text.replace("\r", " ")], delimiter=separator), [])
        except csv.Error:  # a quote that never ends runs into the reader's limit
            cells = self.text.split(separator)
        return tuple(cell.strip() for cell in cells) or ("",)

    @property
    def blank(self) -> bool:
        """Nothing but separators and white space."""
        return not self.text.strip(" \t\r,;")


@dataclass(frozen=True)
class Rows:
    """A block of rows.

    values: (N, columns) float64, NaN where a cell is blank.
    first_line: the number of the first row's line; the rows follow each other without blank lines.
    end: where the block ends in the file's bytes.
    cut: the last line had no line ending, so that its last number may have lost digits: it is left out.
    """

    values: FloatArray
    first_line: int
    end: int
    cut: bool


@dataclass(frozen=True)
class TextExport:
    """A text export's bytes, without a byte-order mark."""

    path: Path
    data: bytes

    def lines(self, after: Line | None = None, *, start: int = 0, number: int = 1) -> Iterator[Line]:
        """The lines after that one, or from the byte ``start`` of line ``number`` on."""
        if after is not None:
            start, number = after.end, after.number + 1
        while start < len(self.data):
            end = self.data.find(b"\n", start)
            end = len(self.data) if end < 0 else end + 1
            text = self.data[start:end].decode("utf-8", errors="replace").rstrip("\r\n")
            yield Line(number, start, end, text)
            start, number = end, number + 1

    def header(self, most: int, after: Line | None = None) -> list[Line]:
        """At most so many lines from the start, or after a line."""
        return [line for line, _ in zip(self.lines(after), range(most), strict=False)]

    def rows(self, start: int, first_line: int, separator: str, n_columns: int) -> Rows:
        """The rows from the byte ``start`` to the next blank line or the end of the file. Cells beyond the columns
        may only be blank.

        Raises GtcalError with file and line where a cell is no number or a row has another number of cells."""
        buffer = np.frombuffer(self.data, dtype=np.uint8)
        decimal = self._decimal(buffer[start:], separator)
        n_lines = int(np.count_nonzero(buffer[start:] == ord("\n"))) + 1
        values = np.empty((n_lines, n_columns))
        found = np.zeros(4, dtype=np.int64)
        end = _parse_rows(buffer, start, ord(separator), ord(decimal), values, found)
        n_rows, problem, column, cell = (int(number) for number in found)
        if problem != _OK:
            raise self._explain(first_line + n_rows, problem, column, cell, separator, n_columns)
        cut = n_rows > 0 and end >= len(self.data) and not self.data.endswith((b"\n", b"\r"))
        return Rows(values[: n_rows - cut], first_line, end, cut)

    def check_end(self, rows: Rows) -> None:
        """Raises GtcalError naming the line where something follows after these rows."""
        rest = self.data[rows.end :]
        if rest.strip(_BLANK):
            offset = rows.end + len(rest) - len(rest.lstrip(_BLANK))
            line = self.data.count(b"\n", 0, offset) + 1
            raise self.error(line, "there are more rows after a blank line; expected the end of the file")

    def decimals(self, start: int, separator: str, column: int) -> int:
        """How many decimals the numbers of a column have, by the first rows from the byte ``start`` on: the first is
        often a plain 0."""
        cells = [line.fields(separator) for line, _ in zip(self.lines(start=start), range(_LOOKED_AT), strict=False)]
        return max((_decimals_of(row[column]) for row in cells if len(row) > column), default=0)

    def error(self, line: int, message: str) -> GtcalError:
        """An error about a line, with its file and number."""
        return GtcalError(f"{self.path}:{line}: {message}")

    def _decimal(self, numbers: npt.NDArray[np.uint8], separator: str) -> str:
        """The decimal sign. Commas are one only where they are no separator, and where there are no points."""
        if separator == "," or not np.any(numbers == ord(",")):
            return "."
        if np.any(numbers == ord(".")):
            raise GtcalError(
                f"{self.path}: the numbers have both points and commas; export them again with one decimal sign"
            )
        return ","

    def _explain(self, line: int, problem: int, column: int, cell: int, separator: str, n_columns: int) -> GtcalError:
        end = self.data.find(b"\n", cell)
        rest = self.data[cell : end if end >= 0 else len(self.data)].decode("utf-8", errors="replace")
        if problem == _NO_NUMBER:
            shown = rest.split(separator)[0].strip()[:_SHOWN]
            return self.error(line, f"column {column + 1} is {shown!r}; expected a number or a blank cell")
        if problem == _TOO_MANY:
            return self.error(
                line, f"the row has more than {n_columns} cells, the header's (are these decimal commas?)"
            )
        return self.error(line, f"cells in the row: {column}, expected {n_columns} (is the file cut off?)")


def open_export(path: Path) -> TextExport:
    """Read a text export.

    Raises GtcalError where the file is missing, unreadable, empty or no text of one byte per character."""
    try:
        data = read_bytes(path, TABLE_BYTES)
    except FileNotFoundError:
        raise GtcalError(f"{path}: there is no such file") from None
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise GtcalError(f"{path}: is UTF-16 text; save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if not data.strip():
        raise GtcalError(f"{path}: the file is empty")
    if b"\0" in data[:_LONGEST_HEADER]:
        raise GtcalError(f"{path}: is no text file")
    if b"\n" not in data and b"\r" in data:
        data = data.replace(b"\r", b"\n")
    return TextExport(path, data)


def separator_after(text: str, word: str) -> str | None:
    """The separator that follows the first word of a line, quoted or not; None where it isn't that word or has none."""
    rest = text.lstrip().removeprefix('"')
    if not rest.lower().startswith(word.lower()):
        return None
    follows = rest[len(word) :].removeprefix('"').lstrip(" ")[:1]
    return follows if follows in SEPARATORS and follows else None


def cut_note(path: Path) -> str:
    """What is said where a file's last line was left out."""
    return f"the last line of {path.name} has no ending, as if cut off, and was left out"


def row_notes(path: Path, frames_stated: str | None, rows: Rows) -> tuple[str, ...]:
    """What is odd about the rows: a last line without an ending, another number than the header states."""
    notes = []
    if rows.cut:
        notes.append(cut_note(path))
    if frames_stated is not None and frames_stated.isdigit() and int(frames_stated) != len(rows.values):
        notes.append(f"the header of {path.name} states {frames_stated} frames, but there are {len(rows.values)} rows")
    return tuple(notes)


def _decimals_of(cell: str) -> int:
    """How many decimals a number was printed with; many for one in another notation than 12.345."""
    number = cell.replace(",", ".").lstrip("+-")
    if not number.replace(".", "", 1).isdigit():
        return _MANY_DECIMALS
    return len(number.partition(".")[2])


def number_in(text: str) -> float | None:
    """A positive number of a header, decimal comma or point; None where it is none."""
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        return None
    return value if np.isfinite(value) and value > 0 and "_" not in text else None


_POWERS = np.array([float(10**k) for k in range(23)])
_SPLITTER = 134217729.0  # 2^27 + 1, Dekker's


@kernel
def _scaled(mantissa: np.uint64, exponent: int, powers: FloatArray) -> float:
    """mantissa * 10^exponent, to within an ulp for mantissas of more than 53 bits, else exact to rounding."""
    high = float(mantissa)
    if -22 <= exponent < 0:
        power = powers[-exponent]
        quotient = high / power
        if mantissa <= np.uint64(9007199254740992):
            return quotient
        low = float(np.int64(mantissa) - np.int64(high))
        c = _SPLITTER * quotient
        q_high = c - (c - quotient)
        q_low = quotient - q_high
        c = _SPLITTER * power
        p_high = c - (c - power)
        p_low = power - p_high
        product = quotient * power
        rounding = ((q_high * p_high - product) + q_high * p_low + q_low * p_high) + q_low * p_low
        return quotient + ((high - product) - rounding + low) / power
    if 0 <= exponent <= 22:
        return high * powers[exponent]
    return high * 10.0**exponent


@kernel
def _parse_rows(
    data: npt.NDArray[np.uint8],
    start: int,
    separator: int,
    decimal: int,
    values: FloatArray,
    found: npt.NDArray[np.int64],
) -> int:
    """Fill the rows of ``values`` from the lines of ``data`` until a blank one. ``found``: rows, problem, its column,
    the byte where its cell starts. Returns the byte after the last row."""
    n_rows, n_columns = values.shape
    n = len(data)
    position = start
    row = 0
    while position < n and row < n_rows:
        column = 0
        blank = True
        line_start = position
        while True:
            while position < n and (data[position] == 32 or (data[position] == 9 and separator != 9)):
                position += 1
            cell = position
            mantissa = np.uint64(0)
            exponent = 0
            digits = 0
            n_significant = 0
            fraction = False
            negative = False
            if position < n and (data[position] == 45 or data[position] == 43):
                negative = data[position] == 45
                position += 1
            while position < n:
                byte = data[position]
                if 48 <= byte <= 57:
                    digits += 1
                    if n_significant < 18:
                        mantissa = mantissa * np.uint64(10) + np.uint64(byte - 48)
                        if mantissa > 0:
                            n_significant += 1
                        if fraction:
                            exponent -= 1
                    elif not fraction:
                        exponent += 1
                elif byte == decimal and not fraction:
                    fraction = True
                else:
                    break
                position += 1
            value = np.nan
            if digits > 0:
                if position < n and (data[position] == 101 or data[position] == 69):  # e, E
                    position += 1
                    sign = 1
                    if position < n and (data[position] == 45 or data[position] == 43):
                        sign = -1 if data[position] == 45 else 1
                        position += 1
                    power = 0
                    power_digits = 0
                    while position < n and 48 <= data[position] <= 57:
                        power = power * 10 + int(data[position]) - 48 if power < 999 else power
                        power_digits += 1
                        position += 1
                    if power_digits == 0:
                        position = cell  # no number: told below
                        found[0], found[1], found[2], found[3] = row, _NO_NUMBER, column, cell
                        return position
                    exponent += sign * power
                value = 0.0 if mantissa == 0 else _scaled(mantissa, exponent, _POWERS)
                if negative:
                    value = -value
                blank = False
            elif position + 3 <= n and position == cell:
                a, b, c = data[position] | 32, data[position + 1] | 32, data[position + 2] | 32
                if a == 110 and b == 97 and c == 110:  # nan
                    position += 3
            while position < n and (data[position] == 32 or (data[position] == 9 and separator != 9)):
                position += 1
            ends_line = position >= n or data[position] == 10 or data[position] == 13
            if (not ends_line and data[position] != separator) or (digits == 0 and (fraction or negative)):
                found[0], found[1], found[2], found[3] = row, _NO_NUMBER, column, cell
                return position
            if not np.isfinite(value) and digits > 0:
                found[0], found[1], found[2], found[3] = row, _NO_NUMBER, column, cell
                return position
            if column < n_columns:
                values[row, column] = value
            elif digits > 0:
                found[0], found[1], found[2], found[3] = row, _TOO_MANY, column, cell
                return position
            column += 1
            if ends_line:
                break
            position += 1
        if position < n and data[position] == 13:
            position += 1
        if position < n and data[position] == 10:
            position += 1
        if blank:
            found[0] = row
            return line_start
        if column < n_columns:
            found[0], found[1], found[2], found[3] = row, _TOO_FEW, column, line_start
            return position
        row += 1
    found[0] = row
    return position
