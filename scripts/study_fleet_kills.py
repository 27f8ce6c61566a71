"""A batch whose coordinator, a worker, or all of whose processes are killed at random moments, again and again.

A small fleet's jobs are solved once, undisturbed. Then a batch on two processes that give these results again, each
after a random short time, is started and killed (SIGKILL) after a random time; after each kill every record in the
store must be whole, and every result that the batch had reported must be there. Each time all are done, a new store is
begun. At last a batch is run to its end on each store: what it then holds must be what the undisturbed one holds, bit
for bit but for times, and its index what its files say.

    python scripts/study_fleet_kills.py --kills 200
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import dask
from rich.console import Console
from rich.progress import track

from gtcal.errors import GtcalError
from gtcal.fleet import index
from gtcal.fleet.batch import run_batch
from gtcal.fleet.jobs import Job
from gtcal.fleet.jobs_file import read_jobs
from gtcal.fleet.rebuild import catch_up, rebuild
from gtcal.fleet.record import RECORD, Record, read_record, record_text
from gtcal.fleet.run_job import Outcome, Task, _now, run_task
from gtcal.fleet.simulated import FleetOptions, write_fleet
from gtcal.fleet.store import Store
from gtcal.fleet.workers import InThisProcess, dask_workers

WHOM = ("coordinator", "worker", "all")
COMMAND = ("study_fleet_kills.py",)

Outcomes = dict[tuple[str, str, str], Outcome]


@dataclass
class Toll:
    """What the kills did."""

    whom: Counter[str] = field(default_factory=Counter)
    half: int = 0
    lost: int = 0


def again(outcomes: Outcomes, longest_s: float, task: Task) -> Outcome:
    """The outcome that is known, after a while, as if it were of now."""
    time.sleep(random.uniform(0.0, longest_s))
    before = outcomes[task.job.identity]
    if before.record.key in task.done_keys:
        return replace(before, unchanged=True)
    record = replace(before.record, created_utc=_now())
    return replace(before, record=record, files={**before.files, RECORD: record_text(record)})


def in_a_child(batch: Callable[[], None]) -> int:
    """Begin it in a process of its own, with a group of its own."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.setpgid(0, 0)
            batch()
            code = 0
        finally:
            os._exit(code)
    return pid


def batch(store: Store, jobs: tuple[Job, ...], outcomes: Outcomes, told_file: Path | None) -> None:
    """One batch, as 'gtcal batch' runs it, that writes what it reports into a file."""

    def tell(record: Record) -> None:
        if told_file is not None:
            with told_file.open("a") as told:
                told.write(f"{record.identity}\n")

    with store.locked():
        store.clear_left_aside()
        with index.opened_index(store.index_path) as connection:
            catch_up(store, connection)
        with (
            dask.config.set({"distributed.worker.multiprocessing-method": "fork"}),
            dask_workers(jobs=2, do=partial(again, outcomes, 0.2)) as workers,
        ):
            run_batch(store, jobs, workers, COMMAND, ended=tell)


def below(pid: int) -> list[int]:
    """The processes below a process, all generations (Linux)."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += [child, *below(child)]
    return found


def kill(pid: int, whom: str, after_s: float) -> None:
    """Kill the coordinator, one of its workers, or all of them, after a while; a batch that lost a worker is left to
    end by itself."""
    time.sleep(after_s)
    workers = below(pid)
    chosen = {"coordinator": [pid], "worker": random.sample(workers, min(1, len(workers)))}.get(whom, [pid, *workers])
    for each in chosen:
        end(each)
    until = time.monotonic() + 60.0
    while whom == "worker" and time.monotonic() < until and os.waitpid(pid, os.WNOHANG) == (0, 0):
        time.sleep(0.05)
    for each in (pid, *workers):  # those whose coordinator is gone end by themselves, but later
        end(each)
    with suppress(ChildProcessError):
        os.waitpid(pid, 0)


def end(pid: int) -> None:
    """Kill a process, if it is there."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def results(store: Store) -> dict[str, str]:
    """All that a store's records and results say, by job, but for times. Raises GtcalError where one is not whole."""
    found = {}
    for path in store.record_files():
        record = read_record(path)
        text = [record_text(replace(record, created_utc="", duration_s=0.0))]
        if record.state == "done":
            result = json.loads((path.parent / record.result_file).read_text(encoding="utf-8"))
            text.append(json.dumps(result))
        found[str(record.identity)] = "".join(text)
    return found


def killed_again_and_again(
    folder: Path, jobs: tuple[Job, ...], outcomes: Outcomes, kills: int, longest_s: float
) -> tuple[Toll, list[Store]]:
    """That many kills; and the stores that they left."""
    toll, stores, told_file = Toll(), [Store.made(folder / "store0")], folder / "told"
    for _ in track(range(kills), console=Console(stderr=True)):
        whom = random.choice(WHOM)
        toll.whom[whom] += 1
        kill(in_a_child(partial(batch, stores[-1], jobs, outcomes, told_file)), whom, random.uniform(0.0, longest_s))
        try:
            there = results(stores[-1])
        except (GtcalError, ValueError, OSError) as error:
            Console(stderr=True).print(f"not whole: {error}", markup=False)
            toll.half += 1
            continue
        told = told_file.read_text().splitlines() if told_file.exists() else []
        toll.lost += len(set(told) - set(there))
        if len(there) == len(jobs):  # to be killed again, there has to be something to do
            stores.append(Store.made(folder / f"store{len(stores)}"))
            told_file.unlink(missing_ok=True)
    return toll, stores


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200, help="(default: %(default)s)")
    parser.add_argument("--longest-s", type=float, default=3.0, help="until a kill (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    random.seed(arguments.seed)
    console = Console()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = FleetOptions(
            n_rigs=2, n_days=14, calibrated_every=14, n_frames=24, verification_frames=60, duration_s=12.0
        )
        jobs = read_jobs(write_fleet(folder / "recordings", options, workers=0))
        known = folder / "outcomes.json"
        pid = in_a_child(partial(solve_undisturbed, jobs, folder / "undisturbed", known))  # whose threads end with it
        assert os.waitpid(pid, 0)[1] == 0
        outcomes = pickle.loads(known.read_bytes())
        wanted = results(Store.opened(folder / "undisturbed"))
        toll, stores = killed_again_and_again(folder, jobs, outcomes, arguments.kills, arguments.longest_s)
        unlike = disagreed = 0
        for store in stores:
            assert os.waitpid(in_a_child(partial(batch, store, jobs, outcomes, None)), 0)[1] == 0
            found = results(store)
            unlike += sum(found.get(job) != text for job, text in wanted.items()) + len(set(found) - set(wanted))
            with store.locked(), index.opened_index(store.index_path) as connection:
                disagreed += len(catch_up(store, connection))
            disagreed += len(rebuild(store)) + len(store.left_aside())
    of_whom = ", ".join(f"{n} of {whom if whom != 'all' else 'all of them'}" for whom, n in sorted(toll.whom.items()))
    console.print(
        f"{arguments.kills} kills ({of_whom}) of batches of {len(jobs)} jobs: {toll.half} files not whole, {toll.lost} "
        f"results lost that were reported; {len(stores)} batches run to their end: {unlike} results other than "
        f"undisturbed, {disagreed} disagreements of index and files"
    )


def solve_undisturbed(jobs: tuple[Job, ...], folder: Path, known: Path) -> None:
    """A batch that nothing disturbs, and the outcome of each of its jobs."""
    outcomes: Outcomes = {}

    def kept(task: Task) -> Outcome:
        outcomes[task.job.identity] = run_task(task)
        return outcomes[task.job.identity]

    assert not run_batch(Store.made(folder), jobs, InThisProcess(kept), COMMAND).failed
    known.write_bytes(pickle.dumps(outcomes))


if __name__ == "__main__":
    main()
