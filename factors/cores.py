"""How many cores there are to use, and work that is shared among them."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from threading import local
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

JOBS_VARIABLE = "GTCAL_JOBS"
"""The environment variable that says how many at most, where a machine is shared."""


def n_cores() -> int:
    """The cores that this process may use: those that the system gives it, and no more than GTCAL_JOBS says.

    Raises ValueError where that is set and is no whole number."""
    given = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    stated = os.environ.get(JOBS_VARIABLE)
    return min(given, max(int(stated), 1)) if stated else given


_thread = local()


def n_cores_here() -> int:
    """Those that this thread may share its work among: its own alone, where it is one of several that share some."""
    return 1 if getattr(_thread, "shares", False) else n_cores()


def in_order(function: Callable[[T], R], items: Collection[T]) -> Iterator[R]:
    """``function`` of each item, in their order, on all cores, at most one for each core ahead of the one that is asked
    for; of a single item here, which may share its own work. For work whose time goes into code that runs side by
    side: compiled kernels, numpy."""
    if len(items) < 2 or n_cores_here() == 1:
        yield from map(function, items)
        return
    ahead: deque[Future[R]] = deque()
    for item in items:
        ahead.append(_threads().submit(function, item))
        if len(ahead) > n_cores():
            yield ahead.popleft().result()
    while ahead:
        yield ahead.popleft().result()


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(n_cores(), "gtcal", initializer=setattr, initargs=(_thread, "shares", True))


if hasattr(os, "register_at_fork"):  # a child has none of its parent's threads, and would wait for them
    os.register_at_fork(after_in_child=_threads.cache_clear)
