"""Recordings without time: images, corners and poses that go together by number.

Inside, the place of a time stamp is taken by the number, so that all that pairs views and poses works on both; what
would be made of the time between two numbers (interpolation, clocks, rates, correlation in time) is left out where a
recording is numbered."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

NUMBER_NS = 1_000_000_000
"""From one number to the next in a column of stamps. It only has to be so wide that nobody takes two for one."""

LARGEST_NUMBER = 2_000_000_000


def stamps_of(numbers: IntArray) -> IntArray:
    """(N,) what stands for these numbers in a column of stamps."""
    return np.asarray(numbers, dtype=np.int64) * NUMBER_NS


def numbers_of(stamps_ns: IntArray) -> IntArray:
    """(N,) the numbers that these stamps of a numbered recording stand for."""
    return np.asarray(stamps_ns, dtype=np.int64) // NUMBER_NS


def number_of_name(name: str) -> int:
    """The number in a file's name: its last digits, as 12 in frame_0012.png.

    Raises GtcalError where there are none."""
    found = re.findall(r"\d+", Path(name).stem)
    if not found or int(found[-1]) > LARGEST_NUMBER:
        raise GtcalError(f"the name {name!r} has no number; expected one as in frame_0012.png")
    return int(found[-1])


def listed_numbers(numbers: IntArray, most: int = 6) -> str:
    """'3, 7, 8 and 12 more'."""
    shown = ", ".join(str(number) for number in numbers[:most].tolist())
    return shown + (f" and {len(numbers) - most} more" if len(numbers) > most else "")
