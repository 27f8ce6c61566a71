"""Apache Arrow, where it is installed: columns read from text on all cores, and Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors.cores import n_cores
from gtcal.errors import GtcalError

if TYPE_CHECKING:
    import pyarrow

ColumnArray = npt.NDArray[np.int64] | npt.NDArray[np.float64]


def columns_of_csv(
    path: Path, skip_lines: int, names: Sequence[str], types: dict[str, type[np.int64] | type[np.float64]]
) -> list[ColumnArray] | None:
    """The columns ``types`` of a CSV with these ``names``, in the order of types; None where the library isn't there,
    or the text is anything but plain numbers."""
    try:
        import pyarrow
        from pyarrow import csv
    except ImportError:
        return None
    pyarrow.set_cpu_count(n_cores())
    try:
        table = csv.read_csv(
            path,
            csv.ReadOptions(skip_rows=skip_lines, column_names=list(names), use_threads=n_cores() > 1),
            csv.ParseOptions(quote_char=False),
            csv.ConvertOptions(
                column_types={name: pyarrow.from_numpy_dtype(dtype) for name, dtype in types.items()},
                include_columns=list(types),
                null_values=[],
            ),
        )
    except pyarrow.ArrowException:
        return None
    return [table[name].to_numpy() for name in types]


def parquet() -> pyarrow.parquet:
    """The module, on as many cores as may be used. Raises GtcalError where it isn't installed."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise GtcalError("Parquet needs pyarrow: pip install 'gtcal[parquet]'") from None
    pyarrow.set_cpu_count(n_cores())
    return parquet
