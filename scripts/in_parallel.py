"""What the studies share: the same computation of many simulated recordings, on all cores, with its progress shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress

T, R = TypeVar("T"), TypeVar("R")


def in_parallel(of: Callable[[T], R], tasks: Sequence[T], workers: int | None, description: str) -> Iterator[R]:
    """``of`` each task, in their order. workers: processes, as many as there are cores by default."""
    with ProcessPoolExecutor(workers) as pool, Progress(console=Console(stderr=True)) as progress:
        yield from progress.track(pool.map(of, tasks), total=len(tasks), description=description)
