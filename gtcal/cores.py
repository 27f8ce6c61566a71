"""Work on all cores, or on as many as the user says."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock

import cv2

from factors.cores import JOBS_VARIABLE
from factors.cores import n_cores as n_cores

_opencv_threads = Lock()

if os.environ.get(JOBS_VARIABLE):
    cv2.setNumThreads(n_cores())


def use_cores(most: int) -> None:
    """From now on this process, and those that it starts, use at most so many cores, as one worker of several on a
    machine. To be called before anything is computed; results don't depend on it."""
    os.environ[JOBS_VARIABLE] = str(most)
    cv2.setNumThreads(most)


@contextmanager
def all_cores(workers: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """A pool of ``workers`` threads (default: one per core), with OpenCV's own threads, which would compete for the
    same cores, switched off. For work whose time goes into compiled code that runs side by side. Where something fails
    or the user interrupts, what is still queued is dropped."""
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
