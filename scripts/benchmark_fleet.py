"""What a batch costs beside the solve, how it grows, and what the store, history and site take.

Verifications of simulated recordings (4 cameras, --frames frames each), as 10, 100, ... --jobs jobs: jobs per minute of
'gtcal batch' on --workers processes against as many times the rate of the bare solve in one of them; the memory of the
coordinating process; history and site of the store. Then --simulated jobs without any solve: what scheduling, writing
and indexing alone take.

    python scripts/benchmark_fleet.py --jobs 100 --simulated 2000
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from gtcal.cores import n_cores
from gtcal.fleet.batch import run_batch
from gtcal.fleet.history import RUN_LENGTH, histories
from gtcal.fleet.jobs import Job
from gtcal.fleet.jobs_file import read_jobs
from gtcal.fleet.record import RECORD, record_text
from gtcal.fleet.run_job import Outcome, Task, run_task
from gtcal.fleet.simulated import FleetOptions, write_fleet
from gtcal.fleet.site import write_site
from gtcal.fleet.store import Store
from gtcal.fleet.workers import InThisProcess, begin_worker, dask_workers

N_RIGS = 10
VERIFIED_A_DAY = 4
COMMAND = ("benchmark_fleet.py",)


@dataclass(frozen=True)
class Grown:
    """What one batch of ``n`` jobs took."""

    n: int
    batch_s: float
    coordinator_s: float
    again_s: float
    history_s: float
    site_s: float
    memory_mib: float


def sizes(most: int) -> Iterator[int]:
    """10, 100, ... and the most."""
    n = 10
    while n < most:
        yield n
        n *= 10
    yield most


def many(jobs: tuple[Job, ...], n: int) -> list[Job]:
    """n jobs over these recordings, on as many days as it takes, for ``N_RIGS`` rigs."""
    day_ns = 86_400_000_000_000
    found = []
    for number in range(n):
        job = jobs[number % len(jobs)]
        turn = number // N_RIGS
        assert job.taken_ns is not None
        found.append(
            replace(job, rig=f"rig{number % N_RIGS:02d}", name=f"day {turn}", taken_ns=jobs[0].taken_ns + turn * day_ns)
        )
    return found


@dataclass(frozen=True)
class Bare:
    """What a job takes of one process that does nothing else: of its time and of its core, and its result's size."""

    job_s: float
    cpu_s: float
    size_mb: float


def bare(jobs: tuple[Job, ...]) -> Bare:
    """The mean of these jobs."""
    tasks = [Task(job, COMMAND) for job in jobs]
    outcome = run_task(tasks[0])  # kernels are compiled or read
    started, cpu_started = time.perf_counter(), time.process_time()
    for task in tasks:
        run_task(task)
    n, size = len(tasks), sum(len(text.encode()) for text in outcome.files.values())
    return Bare((time.perf_counter() - started) / n, (time.process_time() - cpu_started) / n, size / 1e6)


def measured(folder: Path, jobs: tuple[Job, ...], n: int, workers: int) -> Grown:
    """A batch of n jobs into a new store, the same again, history and site."""
    store, wanted = Store.made(folder / f"store{n}"), many(jobs, n)
    with store.locked(), dask_workers(jobs=workers) as cluster:
        run_batch(store, many(jobs, 2 * workers), cluster, COMMAND)  # kernels are compiled or read in every worker
        took, cpu = [], []
        for _ in range(2):
            started, cpu_started = time.perf_counter(), time.process_time()
            assert not run_batch(store, wanted, cluster, COMMAND).failed
            took.append(time.perf_counter() - started)
            cpu.append(time.process_time() - cpu_started)
    started = time.perf_counter()
    histories(store)
    history_s = time.perf_counter() - started
    started = time.perf_counter()
    write_site(folder / f"site{n}", store, run_length=RUN_LENGTH)
    site_s = time.perf_counter() - started
    return Grown(n, took[0], cpu[0], took[1], history_s, site_s, memory_mib())


def memory_mib() -> float:
    """The most that this process has taken so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def without_solve(folder: Path, jobs: tuple[Job, ...], outcome: Outcome, n: int) -> tuple[float, float, float]:
    """Seconds for n jobs whose outcome is there at once, for the same again, and for their histories."""

    def at_once(task: Task) -> Outcome:
        record = replace(outcome.record, rig=task.job.rig, name=task.job.name, taken_ns=task.job.taken_ns)
        return replace(outcome, record=record, files={**outcome.files, RECORD: record_text(record)})

    store, wanted = Store.made(folder / "simulated"), many(jobs, n)
    started = time.perf_counter()
    with store.locked():
        run_batch(store, wanted, InThisProcess(at_once), COMMAND)
    batch_s = time.perf_counter() - started
    started = time.perf_counter()
    histories(store)
    return batch_s, time.perf_counter() - started, memory_mib()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1000, help="the most (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=300, help="of each recording (default: %(default)s)")
    parser.add_argument("--simulated", type=int, default=100_000, help="jobs without a solve (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=n_cores(), help="processes (default: %(default)s)")
    arguments = parser.parse_args()
    console = Console()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = FleetOptions(n_rigs=1, n_days=14, verification_frames=arguments.frames, calibrated_every=14)
        all_jobs = read_jobs(write_fleet(folder / "recordings", options, workers=arguments.workers))
        calibrate = next(job for job in all_jobs if job.kind == "calibrate")
        first = Store.made(folder / "first")
        run_batch(first, [calibrate], InThisProcess(), COMMAND)
        (path,) = first.path.rglob("calibration.json")
        jobs = tuple(replace(job, calibration=path) for job in all_jobs if job.kind == "verify")
        grown = [measured(folder, jobs, n, arguments.workers) for n in sizes(arguments.jobs)]
        begin_worker()
        verified, calibrated = bare(jobs), bare((calibrate,))
        outcome = run_task(Task(jobs[0], COMMAND))
        simulated = without_solve(folder, jobs, outcome, arguments.simulated)
    rate = 60.0 / verified.job_s
    console.print(
        f"the bare solve of {arguments.frames} frames, 4 cameras, in one process: {rate:.0f} jobs a minute, "
        f"{1e3 * verified.cpu_s:.0f} ms of a core each"
    )
    table = Table(title=f"batch on {arguments.workers} processes")
    for heading in ("jobs", "s", "jobs a minute", "of the bare solve's", "coordinator: core, ms a job", "MiB"):
        table.add_column(heading, justify="right")
    for heading in ("done before, s", "history, s", "site, s"):
        table.add_column(heading, justify="right")
    for one in grown:
        per_minute = 60.0 * one.n / one.batch_s
        table.add_row(
            f"{one.n:,}",
            f"{one.batch_s:.1f}",
            f"{per_minute:.0f}",
            f"{100.0 * per_minute / (arguments.workers * rate):.0f} %",
            f"{1e3 * one.coordinator_s / one.n:.1f}",
            f"{one.memory_mib:.0f}",
            f"{one.again_s:.2f}",
            f"{one.history_s:.2f}",
            f"{one.site_s:.1f}",
        )
    console.print(table)
    batch_s, history_s, mib = simulated
    console.print(
        f"{arguments.simulated:,} jobs without the solve: {batch_s:.1f} s to schedule, write and index them "
        f"({1e3 * batch_s / arguments.simulated:.2f} ms a job), {history_s:.1f} s for all histories, {mib:.0f} MiB"
    )
    core_s = calibrated.cpu_s + VERIFIED_A_DAY * verified.cpu_s
    size_mb = calibrated.size_mb + VERIFIED_A_DAY * verified.size_mb
    console.print(
        f"on paper, a calibration and {VERIFIED_A_DAY} verifications of a rig each day, corners given: {core_s:.1f} s "
        f"of a core and {size_mb:.1f} MB; of 10,000 rigs {10_000 * core_s / 3600.0:.0f} hours of a core and "
        f"{10.0 * size_mb:.0f} GB a day"
    )


if __name__ == "__main__":
    main()
