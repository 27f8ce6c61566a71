"""What a batch costs beside the solve, how it grows, and what store, history and site take.

batch: verifications of simulated recordings (4 cameras, --frames frames each), as 10, 100, ... --jobs jobs, through
    'gtcal batch' on --workers processes: jobs a minute against as many processes that do nothing but solve, the time of
    a core that each job takes beside its solve, the memory of the coordinating process; what a rig costs a day.
index: --jobs jobs (by default 1,000, 10,000, 100,000) without any solve: what scheduling, writing and indexing alone
    take, and the histories of all rigs.
site: a site of --jobs recordings: how long it takes to write, and to open in a headless Chromium.
sharing: one recording of --jobs images, detected and calibrated with its images shared by 1 and by --workers processes.

    python scripts/benchmark_fleet.py batch --jobs 100
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import psutil
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
from gtcal.simulation import SimulationOptions, quest3_like_rig, simulate, write_simulation

N_RIGS = 10
VERIFIED_A_DAY = 4
COMMAND = ("benchmark_fleet.py",)
DAY_NS = 86_400_000_000_000


@dataclass(frozen=True)
class Prepared:
    """The recordings of one rig: the job that calibrates it, and those that verify."""

    calibrate: Job
    verify: tuple[Job, ...]


def prepared(folder: Path, frames: int, n_days: int = 7) -> Prepared:
    """Simulated, and calibrated."""
    options = FleetOptions(n_rigs=1, n_days=n_days, verification_frames=frames, calibrated_every=n_days)
    jobs = read_jobs(write_fleet(folder / "recordings", options, workers=0))
    calibrate = next(job for job in jobs if job.kind == "calibrate")
    first = Store.made(folder / "first")
    run_batch(first, [calibrate], InThisProcess(), COMMAND)
    (path,) = first.path.rglob("calibration.json")
    return Prepared(calibrate, tuple(replace(job, calibration=path) for job in jobs if job.kind == "verify"))


def sizes(most: int, least: int = 10) -> Iterator[int]:
    """``least``, ten times as many, ... and the most."""
    n = least
    while n < most:
        yield n
        n *= 10
    yield most


def many(jobs: tuple[Job, ...], n: int, n_rigs: int = N_RIGS) -> list[Job]:
    """n jobs over these recordings, on as many days as it takes, for so many rigs."""
    first_ns = jobs[0].taken_ns
    assert first_ns is not None
    return [
        replace(
            jobs[number % len(jobs)],
            rig=f"rig{number % n_rigs:02d}",
            name=f"day {number // n_rigs}",
            taken_ns=first_ns + number // n_rigs * DAY_NS,
        )
        for number in range(n)
    ]


@dataclass(frozen=True)
class Solve:
    """What a job takes of a process that does nothing else, so many of them side by side: its time, and its core's."""

    job_s: float
    cpu_s: float


def solved(jobs: list[Job]) -> Solve:
    """The mean of these jobs, in this process."""
    run_task(Task(jobs[0], COMMAND))  # kernels are compiled or read
    started, cpu_started = time.perf_counter(), time.process_time()
    for job in jobs:
        run_task(Task(job, COMMAND))
    return Solve((time.perf_counter() - started) / len(jobs), (time.process_time() - cpu_started) / len(jobs))


def bare(jobs: list[Job], workers: int) -> Solve:
    """In as many processes at once as a batch has."""
    with ProcessPoolExecutor(workers, get_context("spawn"), begin_worker) as pool:
        found = list(pool.map(solved, [jobs] * workers))
    return Solve(sum(one.job_s for one in found) / workers, sum(one.cpu_s for one in found) / workers)


def cpu_s() -> float:
    """Of this process and those below it."""
    own = psutil.Process()
    times = [process.cpu_times() for process in (own, *own.children(recursive=True))]
    return float(sum(each.user + each.system for each in times))


@dataclass(frozen=True)
class Grown:
    """What one batch of ``n`` jobs took: its time, that of all cores and of the coordinator's; and what came after."""

    n: int
    batch_s: float
    cpu_s: float
    coordinator_s: float
    again_s: float
    history_s: float
    site_s: float
    memory_mib: float


def measured(folder: Path, jobs: tuple[Job, ...], n: int, workers: int) -> Grown:
    """A batch of n jobs into a new store, the same again, history and site."""
    store, wanted = Store.made(folder / f"store{n}"), many(jobs, n)
    with store.locked(), dask_workers(jobs=workers) as cluster:
        warm = [replace(job, rig="warm") for job in many(jobs, 2 * workers, 1)]
        run_batch(store, warm, cluster, COMMAND)  # kernels are compiled or read in every worker
        all_s, own_s, started = cpu_s(), time.process_time(), time.perf_counter()
        assert not run_batch(store, wanted, cluster, COMMAND).failed
        batch_s, own_s, all_s = time.perf_counter() - started, time.process_time() - own_s, cpu_s() - all_s
        started = time.perf_counter()
        assert not run_batch(store, wanted, cluster, COMMAND).ended
        again_s = time.perf_counter() - started
    started = time.perf_counter()
    histories(store)
    history_s = time.perf_counter() - started
    started = time.perf_counter()
    write_site(folder / f"site{n}", store, run_length=RUN_LENGTH)
    return Grown(n, batch_s, all_s, own_s, again_s, history_s, time.perf_counter() - started, memory_mib())


def memory_mib() -> float:
    """The most that this process has taken so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def of_batches(console: Console, folder: Path, arguments: argparse.Namespace) -> None:
    workers, made = arguments.workers, prepared(folder, arguments.frames)
    solve = bare(list(made.verify), workers)
    grown = [measured(folder, made.verify, n, workers) for n in sizes(arguments.jobs or 1000)]
    rate = 60.0 * workers / solve.job_s
    console.print(
        f"the bare solve of {arguments.frames} frames, 4 cameras, in {workers} processes side by side: {rate:.0f} jobs "
        f"a minute, {1e3 * solve.cpu_s:.0f} ms of a core each"
    )
    table = Table(title=f"batch on {workers} processes")
    for heading in ("jobs", "s", "jobs a minute", "of the bare solve's", "core, ms a job", "beside the solve"):
        table.add_column(heading, justify="right")
    for heading in ("coordinator, ms a job", "its MiB", "done before, s", "history, s", "site, s"):
        table.add_column(heading, justify="right")
    for one in grown:
        per_minute, each_s = 60.0 * one.n / one.batch_s, one.cpu_s / one.n
        table.add_row(
            f"{one.n:,}",
            f"{one.batch_s:.1f}",
            f"{per_minute:.0f}",
            f"{100.0 * per_minute / rate:.0f} %",
            f"{1e3 * each_s:.0f}",
            f"{100.0 * (each_s / solve.cpu_s - 1.0):+.0f} %",
            f"{1e3 * one.coordinator_s / one.n:.1f}",
            f"{one.memory_mib:.0f}",
            f"{one.again_s:.2f}",
            f"{one.history_s:.2f}",
            f"{one.site_s:.1f}",
        )
    console.print(table)
    begin_worker()
    calibrated = solved([made.calibrate])
    size_mb = {job.kind: sum(map(len, run_task(Task(job, COMMAND)).files.values())) / 1e6 for job in
               (made.calibrate, made.verify[0])}  # fmt: skip
    core_s = calibrated.cpu_s + VERIFIED_A_DAY * grown[-1].cpu_s / grown[-1].n
    mb = size_mb["calibrate"] + VERIFIED_A_DAY * size_mb["verify"]
    console.print(
        f"on paper, a calibration and {VERIFIED_A_DAY} verifications of a rig each day, corners given: {core_s:.1f} s "
        f"of a core and {mb:.1f} MB; of 10,000 rigs {10_000 * core_s / 3600.0:.1f} hours of a core and "
        f"{10.0 * mb:.0f} GB a day"
    )


@dataclass(frozen=True)
class Indexed:
    """What n jobs took whose outcome is there at once: their batch, and the histories of all rigs. MiB: the most by
    then."""

    batch_s: float
    batch_core_s: float
    batch_mib: float
    history_s: float
    history_mib: float


def without_solve(folder: Path, jobs: tuple[Job, ...], outcome: Outcome, n: int) -> Indexed:
    """A record of each is written and indexed, and no result."""

    def at_once(task: Task) -> Outcome:
        record = replace(outcome.record, rig=task.job.rig, name=task.job.name, taken_ns=task.job.taken_ns)
        return replace(outcome, record=record, files={RECORD: record_text(record)})

    store, wanted = Store.made(folder / f"without{n}"), many(jobs, n, n_rigs=max(N_RIGS, n // 100))
    started, core_started = time.perf_counter(), time.process_time()
    with store.locked():
        run_batch(store, wanted, InThisProcess(at_once), COMMAND)
    batch_s, core_s, mib = time.perf_counter() - started, time.process_time() - core_started, memory_mib()
    started = time.perf_counter()
    histories(store)
    history_s = time.perf_counter() - started
    shutil.rmtree(store.path)
    return Indexed(batch_s, core_s, mib, history_s, memory_mib())


def of_index(console: Console, folder: Path, arguments: argparse.Namespace) -> None:
    made = prepared(folder, arguments.frames)
    outcome = run_task(Task(made.verify[0], COMMAND))
    table = Table(title="jobs without the solve: scheduled, written and indexed by one process")
    for heading in ("jobs", "s", "core, ms a job", "MiB", "histories, s", "MiB"):
        table.add_column(heading, justify="right")
    for n in sizes(arguments.jobs or 100_000, 1000):
        took = without_solve(folder, made.verify, outcome, n)
        core = f"{1e3 * took.batch_core_s / n:.2f}"
        shown = (
            f"{took.batch_s:.1f}",
            core,
            f"{took.batch_mib:.0f}",
            f"{took.history_s:.1f}",
            f"{took.history_mib:.0f}",
        )
        table.add_row(f"{n:,}", *shown)
    console.print(table)


CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "chrome")
_CLOCK = (
    "<script>addEventListener('load', () => { document.documentElement.dataset.ms = performance.now(); });</script>"
)


def opened_ms(page: Path, folder: Path) -> float:
    """From asking for a page to when all of it is there, in a headless Chromium that was just started."""
    chromium = next(filter(None, map(shutil.which, CHROMIUM)))
    timed = page.with_name(f"timed-{page.name}")
    timed.write_text(page.read_text(encoding="utf-8").replace("<head>", f"<head>{_CLOCK}", 1), encoding="utf-8")
    flags = ("--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}", "--dump-dom")
    shown = subprocess.run([chromium, *flags, timed.as_uri()], capture_output=True, text=True, check=True, timeout=300)
    timed.unlink()
    found = re.search(r'data-ms="([\d.]+)"', shown.stdout)
    assert found is not None
    return float(found[1])


def of_site(console: Console, folder: Path, arguments: argparse.Namespace) -> None:
    made, n = prepared(folder, arguments.frames), arguments.jobs or 1000
    outcomes = {job.identity: run_task(Task(job, COMMAND)) for job in made.verify}

    def known(task: Task) -> Outcome:
        job = task.job
        before = outcomes[made.verify[int(job.name.split()[1]) % len(made.verify)].identity]
        record = replace(before.record, rig=job.rig, name=job.name, taken_ns=job.taken_ns)
        return replace(before, record=record, files={**before.files, RECORD: record_text(record)})

    store, site = Store.made(folder / "store"), folder / "site"
    with store.locked():
        run_batch(store, many(made.verify, n), InThisProcess(known), COMMAND)
    started = time.perf_counter()
    write_site(site, store, run_length=RUN_LENGTH)
    written_s = time.perf_counter() - started
    size_mb = sum(path.stat().st_size for path in site.rglob("*") if path.is_file()) / 1e6
    console.print(f"site of {n:,} recordings of {N_RIGS} rigs: written in {written_s:.1f} s, {size_mb:.0f} MB")
    table = Table(title="opened in a headless Chromium, ms, the middle one of 5")
    table.add_column("page")
    table.add_column("KB", justify="right")
    table.add_column("ms", justify="right")
    pages = {"the fleet": site / "index.html", "a rig": site / "rigs" / "rig00.html"}
    pages["a recording"] = next((site / "recordings" / "rig00").iterdir())
    for what, page in pages.items():
        taken = sorted(opened_ms(page, folder) for _ in range(5))
        table.add_row(what, f"{page.stat().st_size / 1e3:.0f}", f"{taken[2]:.0f}")
    console.print(table)


def of_sharing(console: Console, folder: Path, arguments: argparse.Namespace) -> None:
    n = arguments.jobs or 600
    options = SimulationOptions(rig=quest3_like_rig().scaled(0.5), n_frames=n // 4, duration_s=n / 4 / 1.5)
    manifest = write_simulation(simulate(options, seed=1), folder / "recording", images=True)
    small = replace(options, n_frames=24, duration_s=16.0)
    write_simulation(simulate(small, seed=1), folder / "small", images=False)
    jobs_file = folder / "jobs.yaml"
    jobs_file.write_text(
        "gtcal_jobs: 1\noptions: {calibrate: {effects: false, mocap_noise: exact}}\njobs:\n"
        "  - {rig: rig, recording: recording, taken: 2026-03-02}\n  - {rig: rig, recording: small, taken: 2026-03-01}\n"
    )
    long, warm = read_jobs(jobs_file)
    table = Table(title=f"one recording of {n:,} images (640 x 512), detected and calibrated")
    for heading in ("processes", "s"):
        table.add_column(heading, justify="right")
    for workers in sorted({1, arguments.workers}):
        shutil.rmtree(manifest.parent / ".gtcal", ignore_errors=True)
        store = Store.made(folder / f"store{workers}")
        with store.locked(), dask_workers(jobs=workers) as cluster:
            run_batch(store, [replace(warm, name=f"warm {i}") for i in range(2 * workers)], cluster, COMMAND)
            started = time.perf_counter()
            assert not run_batch(store, [long], cluster, COMMAND).failed
            table.add_row(str(workers), f"{time.perf_counter() - started:.1f}")
    console.print(table)


PARTS = {"batch": of_batches, "index": of_index, "site": of_site, "sharing": of_sharing}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--jobs", type=int, help="how many, or the most; see above")
    parser.add_argument("--frames", type=int, default=300, help="of each recording (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=n_cores(), help="processes (default: %(default)s)")
    arguments = parser.parse_args()
    os.environ.pop("GTCAL_JOBS", None)
    with tempfile.TemporaryDirectory() as name:
        PARTS[arguments.part](Console(), Path(name), arguments)


if __name__ == "__main__":
    main()
