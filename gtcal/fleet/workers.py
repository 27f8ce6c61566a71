"""Those who do the jobs: this process, the processes of a local Dask cluster, or a cluster that runs elsewhere."""

from __future__ import annotations

import logging
import math
import queue
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from gtcal.cores import n_cores, use_cores
from gtcal.errors import GtcalError
from gtcal.fleet.run_job import LostWorkersError, Outcome, Task, run_task
from gtcal.fleet.sharing import run_shared

if TYPE_CHECKING:
    from distributed import Client

_log = logging.getLogger("gtcal")

RETRIES = 2
"""How often a task is handed out again after its worker was killed, or ran out of memory. Of killed workers Dask itself
bears as many before it gives a task up, be it only that it shared one with a task that kills."""

_COUNT_EVERY_S = 1.0
_TOLD_AFTER_S = 5.0
_NONE_LEFT_S = 120.0
"""So long a batch waits for processes of its own that ended to come back."""

_OF_A_BUSY_MACHINE = {
    "distributed.scheduler.allowed-failures": RETRIES,
    "distributed.scheduler.worker-ttl": "30 minutes",  # a solve may keep its process from answering
    "distributed.comm.timeouts.connect": "120s",
    "distributed.comm.timeouts.tcp": "120s",
}
"""Dask's own patience is that of a machine with nothing else to do."""

DoTask = Callable[[Task], Outcome]


@dataclass(frozen=True)
class Finished:
    """A task that ended: with its outcome, or ``lost``, in words."""

    number: int
    outcome: Outcome | None
    lost: str = ""


class Workers(Protocol):
    """Those who do tasks, several at once."""

    @property
    def n(self) -> int:
        """How many tasks they do at once, at present."""

    def submit(self, number: int, task: Task) -> None:
        """Hand them a task, by a number of its own."""

    def next_finished(self, timeout_s: float) -> Finished | None:
        """The next task that ended; None where none does in that time."""


class InThisProcess:
    """One task after the other, here: for few, and to look for what is wrong."""

    n = 1

    def __init__(self, do: DoTask = run_task) -> None:
        self._do, self._waiting = do, list[tuple[int, Task]]()

    def submit(self, number: int, task: Task) -> None:
        self._waiting.append((number, task))

    def next_finished(self, timeout_s: float) -> Finished | None:
        if not self._waiting:
            return None
        number, task = self._waiting.pop(0)
        try:
            return Finished(number, self._do(task))
        except MemoryError:
            return Finished(number, None, "it ran out of memory")


class DaskWorkers:
    """The workers of a Dask cluster, one task each."""

    def __init__(self, client: Client, do: DoTask = run_shared, *, where: str = "") -> None:
        """where: the address of a cluster that is not this batch's own, to which others may add workers."""
        self._client, self._do, self._where = client, do, where
        self._told_to_wait = False
        self._seen_s = time.monotonic()
        self._ended: queue.SimpleQueue[tuple[int, Task, Any]] = queue.SimpleQueue()
        self._futures: dict[int, Any] = {}
        self._tries: dict[int, int] = {}
        self._n, self._counted_s = 1, -math.inf

    @property
    def n(self) -> int:
        if time.monotonic() > self._counted_s + _COUNT_EVERY_S:  # a cluster grows and shrinks
            self._check_scheduler()
            there = len(self._client.scheduler_info(n_workers=-1).get("workers", ()))
            self._n, self._counted_s = max(there, 1), time.monotonic()
            self._check_left(there)
        return self._n

    def _check_scheduler(self) -> None:
        if self._client.status in ("closing", "closed"):
            raise self._lost_scheduler()

    def _lost_scheduler(self) -> GtcalError:
        return GtcalError(
            f"the Dask scheduler {self._where} was lost; what was done is in the store: run it again to go on"
        )

    def _check_left(self, there: int) -> None:
        if there:
            self._seen_s, self._told_to_wait = time.monotonic(), False
        elif self._where:
            if time.monotonic() > self._seen_s + _TOLD_AFTER_S and not self._told_to_wait:
                self._told_to_wait = True
                _log.warning("the cluster at %s has no workers; waiting for them", self._where)
        elif time.monotonic() > self._seen_s + _NONE_LEFT_S:
            raise GtcalError("all processes of this batch ended, and none came back; run it again to go on")

    def submit(self, number: int, task: Task) -> None:
        self._check_scheduler()
        future = self._client.submit(self._do, task, pure=False, retries=0)
        self._futures[number] = future  # one that nobody holds is cancelled
        future.add_done_callback(lambda ended: self._ended.put((number, task, ended)))

    def next_finished(self, timeout_s: float) -> Finished | None:
        try:
            number, task, future = self._ended.get(timeout=timeout_s)
        except queue.Empty:
            _ = self.n  # which notices where nobody is left
            return None
        self._futures.pop(number)
        try:
            return Finished(number, future.result())
        except CancelledError:  # nobody but a lost scheduler cancels
            raise self._lost_scheduler() from None
        except Exception as error:
            self._tries[number] = self._tries.get(number, 0) + 1
            if _may_end_well(error) and self._tries[number] <= RETRIES:
                self.submit(number, task)
                return None
            return Finished(number, None, _words(error))


def _may_end_well(error: Exception) -> bool:
    """At another time, elsewhere: where memory was short, or the process was killed, perhaps by another job that had
    it before or after."""
    from distributed import KilledWorker

    return isinstance(error, MemoryError | KilledWorker | LostWorkersError)


def _words(error: Exception) -> str:
    from distributed import KilledWorker

    if isinstance(error, MemoryError):
        return f"it ran out of memory, {RETRIES + 1} times"
    if isinstance(error, KilledWorker | LostWorkersError):
        return "its workers were killed, by the system or for the memory that it took"
    return f"its worker failed: {type(error).__name__}: {error}"


@contextmanager
def dask_workers(
    *, scheduler: str | None = None, jobs: int | None = None, do: DoTask = run_shared
) -> Iterator[DaskWorkers]:
    """Workers of the cluster at ``scheduler``, or of a local one of ``jobs`` processes (by default one a core); each
    takes one core. On leaving, a local cluster ends.

    Raises GtcalError where Dask isn't installed, or nobody answers at that address; and inside, where all processes of
    a local cluster ended and none comes back, or the scheduler at that address is lost."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise GtcalError("batches run on Dask: pip install 'gtcal[fleet]', or give --processes 0") from None
    _silence_dask()
    with dask.config.set(_OF_A_BUSY_MACHINE):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="10s")
            except (OSError, ValueError) as error:
                raise GtcalError(f"--scheduler {scheduler}: no Dask scheduler answers there: {error}") from None
            with client:
                client.register_plugin(_one_core_each())
                yield DaskWorkers(client, do, where=scheduler)
            return
        cluster = LocalCluster(
            n_workers=jobs or n_cores(),
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",  # any that is free: other batches may run here
            silence_logs=logging.CRITICAL,
        )
        with cluster, Client(cluster) as client:
            client.register_plugin(_one_core_each())
            yield DaskWorkers(client, do)


def _silence_dask() -> None:
    """What it logs is told in words here, or put right."""
    for name in ["distributed", *logging.root.manager.loggerDict]:
        if name.split(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)


def _one_core_each() -> Any:
    from distributed import WorkerPlugin

    class OneCoreEach(WorkerPlugin):
        """A worker takes one core, and leaves Ctrl-C to whoever handed out the tasks."""

        name = "gtcal"

        def setup(self, worker: Any) -> None:
            begin_worker()

    return OneCoreEach()


def begin_worker() -> None:
    """In a worker's process, before its first task."""
    use_cores(1)
    with suppress(ValueError):  # not its main thread, as where a cluster's workers are threads
        signal.signal(signal.SIGINT, signal.SIG_IGN)
