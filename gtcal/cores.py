"""Work on all cores: threads, as nearly all the time goes into compiled code that runs side by side."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock

import cv2

_opencv_threads = Lock()
_most: int | None = None


def use_cores(most: int) -> None:
    """From now on this process uses at most so many cores, as one worker of several on a machine. To be called before
    anything is computed; results don't depend on it."""
    from factors.reprojection import use_threads  # loads GTSAM, which not all who ask for cores need

    global _most
    _most = most
    cv2.setNumThreads(most)
    use_threads(most)


def n_cores() -> int:
    """The cores that this process may use."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return there if _most is None else min(there, _most)


@contextmanager
def all_cores(workers: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """A pool of ``workers`` threads (default: one per core), with OpenCV's own threads, which would compete for the
    same cores, switched off. Where something fails or the user interrupts, what is still queued is dropped."""
    with _opencv_threads, ThreadPoolExecutor(workers or n_cores()) as pool:
        before = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            yield pool
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
        finally:
            cv2.setNumThreads(before)
