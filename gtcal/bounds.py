"""How large a number from a file may be. What is beyond is a slip, or made to break what computes with it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from gtcal.errors import GtcalError

LARGEST = 2.0**63
"""Of any number: no whole number of 64 bits is beyond."""

LARGEST_STAMP_NS = 2**62
"""Of a time stamp: 146 years. The difference of two such is a whole number of 64 bits too."""

LARGEST_LENS = 1e9
"""Of a lens's parameter, in px or without unit."""

LARGEST_SIDE_PX = 100_000
"""Of an image."""

LARGEST_LENGTH_M = 1e9
"""Of a tracked body's position."""


def within(value: Any) -> bool:
    """Whether this is a finite number of at most LARGEST, or no number at all."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return True
    return abs(value) <= LARGEST and not (isinstance(value, float) and math.isnan(value))


def added(what: str, stamps_ns: npt.NDArray[np.int64], offset_ns: int) -> npt.NDArray[np.int64]:
    """The stamps (N,) and an offset. ``what``: whose. Raises GtcalError where they are no times then."""
    if not len(stamps_ns):
        return stamps_ns
    first, last = int(stamps_ns.min()) + offset_ns, int(stamps_ns.max()) + offset_ns
    for stamp_ns in (first, last):
        if abs(stamp_ns) > LARGEST_STAMP_NS:
            raise GtcalError(
                f"{what}: a time stamp is {stamp_ns} ns, {abs(stamp_ns) / 3.156e16:.0f} years from zero; check the "
                "unit of time and stamp_offset_ns"
            )
    return stamps_ns + offset_ns
