"""Columns of numbers in a Parquet file: small, typed, and read faster than text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gtcal.arrow import parquet
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import TABLE_BYTES, check_regular, staged
from gtcal.recordings.detections import IntArray
from gtcal.recordings.text_table import Kind

SUFFIX = ".parquet"


@dataclass(frozen=True)
class ParquetTable:
    """The names of a Parquet file's columns, and on demand its rows. What ``TextTable`` is to text."""

    path: Path
    names: tuple[str, ...]

    def header(self) -> tuple[str, ...]:
        return self.names

    def holds(self, names: tuple[str, ...]) -> bool:
        """Whether it has these columns, in any order."""
        return set(names) <= set(self.names)

    def read(self, columns: Sequence[tuple[str, Kind]]) -> npt.NDArray[Any]:
        """All rows of these columns (name, kind), as a structured array.

        Raises GtcalError with file and row where one has no number, one that isn't whole, or isn't finite."""
        try:
            table = parquet().read_table(self.path, columns=[name for name, _ in columns])
        except GtcalError:
            raise
        except Exception as error:  # whatever damaged bytes make Arrow raise
            raise _damaged(self.path, error) from error
        dtypes: dict[Kind, type] = {"stamp": np.int64, "integer": np.int64, "number": np.float64}
        rows = np.empty(table.num_rows, [(name, dtypes[kind]) for name, kind in columns])
        for name, _ in columns:
            rows[name] = self._column(name, table[name], rows.dtype[name].type)
        return rows

    def _column(self, name: str, column: Any, dtype: type) -> npt.NDArray[Any]:
        if column.null_count:
            raise self.error(int(np.flatnonzero(column.is_null().to_numpy())[0]), f"{name} is empty")
        values = column.to_numpy()
        whole, wanted = values.dtype.kind in "iu", "a whole number" if dtype is np.int64 else "a number"
        if values.dtype.kind == "M" and dtype is np.int64:  # Arrow's time stamps
            return np.asarray(values.astype("datetime64[ns]").astype(np.int64))
        if not (whole or (dtype is np.float64 and values.dtype.kind == "f")):
            raise GtcalError(f"{self.path}: {name} is a column of {column.type}; expected {wanted} in each row")
        bad = np.flatnonzero(~np.isfinite(values)) if dtype is np.float64 else np.flatnonzero(values > _LARGEST)
        if len(bad):
            raise self.error(int(bad[0]), f"{name} is {values[bad[0]]}; expected {wanted}")
        return np.asarray(values)

    def stamps_ns(self, stamps: IntArray, time_unit: str) -> IntArray:
        """(N,) time stamps, which are in ns."""
        assert time_unit == "ns"
        return stamps

    def error(self, row: int, message: str) -> GtcalError:
        """An error about row ``row``, counted from 1."""
        return GtcalError(f"{self.path}: row {row + 1}: {message}")


_LARGEST = np.iinfo(np.int64).max


def open_parquet(path: Path) -> ParquetTable:
    """Look at the names of a Parquet file's columns.

    Raises GtcalError where it is missing, none or damaged, would fill the memory, or pyarrow isn't installed."""
    check_regular(path, TABLE_BYTES)
    if not path.exists():
        raise GtcalError(f"{path}: there is no such file")
    try:
        found = parquet().ParquetFile(path)
        size = 8 * found.metadata.num_rows * found.metadata.num_columns
        names = tuple(found.schema_arrow.names)
        found.close()
    except GtcalError:
        raise
    except Exception as error:  # whatever damaged bytes make Arrow raise
        raise _damaged(path, error) from error
    if size > TABLE_BYTES:
        raise GtcalError(f"{path}: unpacks to more than {TABLE_BYTES // 2**20} MiB, too much for such a file")
    return ParquetTable(path, names)


def write_parquet(path: Path, columns: dict[str, IntArray | FloatArray]) -> None:
    """Write columns of one length, every bit. Raises GtcalError where that can't be."""
    library = parquet()
    import pyarrow

    with staged(path) as aside:
        library.write_table(pyarrow.table(columns), aside, compression="zstd")


def _damaged(path: Path, error: Exception) -> GtcalError:
    return GtcalError(f"{path}: is no Parquet file, or damaged: {' '.join(str(error).split()) or 'cut off'}")
