"""How many cores there are to use."""

from __future__ import annotations

import os

JOBS_VARIABLE = "GTCAL_JOBS"
"""The environment variable that says how many at most, where a machine is shared."""


def n_cores() -> int:
    """The cores that this process may use: those that the system gives it, and no more than GTCAL_JOBS says.

    Raises ValueError where that is set and is no whole number."""
    given = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    stated = os.environ.get(JOBS_VARIABLE)
    return min(given, max(int(stated), 1)) if stated else given
