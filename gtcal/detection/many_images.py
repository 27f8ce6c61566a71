"""The board in many images at once: in threads where they are few, else in processes, started once and kept.

Threads share Python's lock, of which each image needs a fifth of its time: from some five on they are in each other's
way. Processes are not, but take a second or two of each core before the first image. What is found is the same.

Images that can be pickled, as files are, are read by the process that looks at them. The others, videos, are read in
their order by one thread here and handed on. Inside ``looked_at_by`` many images are handed to others altogether, as a
cluster's workers.
"""

from __future__ import annotations

import pickle
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2

from factors.cores import JOBS_VARIABLE
from gtcal.board import Board
from gtcal.camera import Camera
from gtcal.cores import all_cores, n_cores
from gtcal.detection.corner_search import PredictedBoard, SeenBoard
from gtcal.detection.view_detection import see_board
from gtcal.errors import GtcalError
from gtcal.recordings.images import GreyImage, Images, read_if_whole
from gtcal.verification.lollypop import Lollypop
from gtcal.verification.lollypop_detection import see_lollypop

WORTH_PROCESSES = 300
"""So many images, and processes are started for them."""

_PER_TASK = 4
_IN_FLIGHT = 4  # images read ahead for each process

Seen = SeenBoard | GtcalError
"""What one image shows, or why it can't be read."""


@dataclass(frozen=True)
class Looking:
    """How each image is looked at. camera: where it has parameters, they help to predict corners."""

    board: Board | Lollypop
    camera: Camera | None

    def __call__(self, image: GreyImage, predicted: PredictedBoard | None = None) -> SeenBoard:
        if isinstance(self.board, Lollypop):
            return see_lollypop(image, self.board, self.camera, predicted)
        return see_board(image, self.board, self.camera, predicted)


def look_at(
    images: Images,
    indices: Sequence[int],
    looking: Looking,
    *,
    predicted: Mapping[int, PredictedBoard] | None = None,
    jobs: int | None = None,
    of_all: int | None = None,
) -> Iterator[tuple[int, Seen]]:
    """Each index and what its image shows, in the order in which they are done.

    predicted: by index, where the board should be, for the images of which that is known. jobs: threads or processes,
    by default as many as there are cores. of_all: how many images will be looked at, where these are a part of them.

    Raises GtcalError where an image is of another size than expected, or a process dies."""
    jobs = jobs or n_cores()
    tasks = [(index, (predicted or {}).get(index)) for index in indices]
    many, others = max(len(tasks), of_all or 0) >= WORTH_PROCESSES, _others.get()
    if many and others is not None:
        return others(images, tasks, looking)
    if jobs == 1 or not many:
        return _in_threads(images, tasks, looking, jobs)
    if _travels(images):
        return _by_files(images, tasks, looking, jobs)
    return _handed_on(images, tasks, looking, jobs)


Task = tuple[int, PredictedBoard | None]
Tasks = Sequence[Task]

Others = Callable[[Images, Tasks, Looking], Iterator[tuple[int, Seen]]]
"""Looks at images as ``look_at`` does."""

_others: ContextVar[Others | None] = ContextVar("others", default=None)


@contextmanager
def looked_at_by(others: Others) -> Iterator[None]:
    """Inside, and in this thread, images that are many are handed to ``others``."""
    before = _others.set(others)
    try:
        yield
    finally:
        _others.reset(before)


def look_at_each(images: Images, tasks: Tasks, looking: Looking) -> Iterator[tuple[int, Seen]]:
    """One image after the other, in their order."""
    return (_look(images, looking, task) for task in tasks)


def _in_threads(images: Images, tasks: Tasks, looking: Looking, jobs: int) -> Iterator[tuple[int, Seen]]:
    with all_cores(jobs) as pool:
        for future in as_completed([pool.submit(_look, images, looking, task) for task in tasks]):
            yield future.result()


def _look(images: Images, looking: Looking, task: Task) -> tuple[int, Seen]:
    index, predicted = task
    image = read_if_whole(images, index)
    return index, image if isinstance(image, GtcalError) else looking(image, predicted)


def _travels(images: Images) -> bool:
    """Whether another process can read them."""
    try:
        pickle.dumps(images)
    except (TypeError, AttributeError, pickle.PicklingError):  # a lock, an open file
        return False
    return True


def _by_files(images: Images, tasks: Tasks, looking: Looking, jobs: int) -> Iterator[tuple[int, Seen]]:
    """What all images have in common goes to the processes in a file, which each reads once."""
    with _processes(jobs) as submit, tempfile.TemporaryDirectory(prefix="gtcal_") as folder:
        common = Path(folder) / "common.pickle"
        common.write_bytes(pickle.dumps((images, looking)))
        parts = (tasks[i : i + _PER_TASK] for i in range(0, len(tasks), _PER_TASK))
        for future in as_completed([submit(_look_at_files, str(common), part) for part in parts]):
            yield from future.result()


def _look_at_files(common: str, tasks: Tasks) -> list[tuple[int, Seen]]:
    images, looking = _loaded(common)
    return [_look(images, looking, task) for task in tasks]


@lru_cache(maxsize=1)
def _loaded(common: str) -> Any:
    return pickle.loads(Path(common).read_bytes())


def _handed_on(images: Images, tasks: Tasks, looking: Looking, jobs: int) -> Iterator[tuple[int, Seen]]:
    with _processes(jobs) as submit:
        waiting: dict[Future[SeenBoard], int] = {}
        for index, predicted in sorted(tasks, key=lambda task: task[0]):
            image = read_if_whole(images, index)
            if isinstance(image, GtcalError):
                yield index, image
                continue
            waiting[submit(looking, image, predicted)] = index
            if len(waiting) >= _IN_FLIGHT * jobs:
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                yield from ((waiting.pop(future), future.result()) for future in done)
        for future in as_completed(waiting):
            yield waiting[future], future.result()


@contextmanager
def _processes(jobs: int) -> Iterator[Callable[..., Future[Any]]]:
    """How to hand work to the processes. Where something fails or the user interrupts, they are ended.

    Raises GtcalError where one of them dies."""
    from loky import get_reusable_executor
    from loky.process_executor import BrokenProcessPool

    environment = dict.fromkeys((JOBS_VARIABLE, "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    executor = get_reusable_executor(jobs, timeout=_IDLE_S, initializer=_begin, env=environment)
    try:
        yield executor.submit
    except BrokenProcessPool:
        raise GtcalError(
            "a process that detects the board was ended from outside, as systems do when memory is short; "
            "use fewer at a time: --jobs N or the environment variable GTCAL_JOBS"
        ) from None
    except BaseException:
        executor.shutdown(kill_workers=True)
        raise


_IDLE_S = 60


def _begin() -> None:
    """In each process: one thread, and Ctrl-C is the parent's to handle."""
    cv2.setNumThreads(1)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
