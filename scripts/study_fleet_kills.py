"""A batch whose coordinator, a worker, or all of whose processes are killed at random moments, again and again.

Each time 'gtcal batch' is started on simulated recordings and killed (SIGKILL) after a random time; then every record
in the store must be whole, and every result that was there before must still be there. At last the batch is run to its
end, and all that it found must be what an undisturbed batch finds, bit for bit, but for times.

    python scripts/study_fleet_kills.py --kills 200
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.progress import track

from gtcal.errors import GtcalError
from gtcal.fleet import index
from gtcal.fleet.rebuild import catch_up, rebuild
from gtcal.fleet.record import read_record
from gtcal.fleet.simulated import FleetOptions, write_fleet
from gtcal.fleet.store import Store

WHOM = ("coordinator", "worker", "all")


def command(jobs: Path, store: Path) -> list[str]:
    """A batch on two processes."""
    return [sys.executable, "-m", "gtcal", "batch", str(jobs), "-o", str(store), "-j", "2", "-q"]


def children(pid: int) -> list[int]:
    """The processes below a process, all generations (Linux)."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += [child, *children(child)]
    return found


def killed(jobs: Path, store: Path, whom: str, after_s: float) -> None:
    """Start a batch and kill whom it says, or let it end before."""
    batch = subprocess.Popen(command(jobs, store), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        batch.wait(after_s)
    except subprocess.TimeoutExpired:
        below = children(batch.pid)
        chosen = {"coordinator": [batch.pid], "worker": random.sample(below, min(1, len(below)))}
        for pid in chosen.get(whom, [batch.pid, *below]):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        if whom == "worker":
            batch.wait()  # it goes on without
        batch.wait()


def results(store: Store) -> dict[str, str]:
    """All that a store's records and results say, by job, but for times. Raises GtcalError where one is not whole."""
    found = {}
    for path in store.record_files():
        record = read_record(path)
        if record.state == "done":
            result = json.loads((path.parent / record.result_file).read_text(encoding="utf-8"))
            result["provenance"] |= {"created_utc": "", "duration_s": 0.0, "command_line": []}
            for stage in result.get("stages", ()):
                stage["duration_s"] = 0.0
            found[f"{record.identity} {record.key}"] = json.dumps(result)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200, help="(default: %(default)s)")
    parser.add_argument("--longest-s", type=float, default=30.0, help="until a kill (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    random.seed(arguments.seed)
    console, whom_all = Console(), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = FleetOptions(n_rigs=2, n_days=28, verification_frames=120, duration_s=12.0, n_frames=40)
        jobs = write_fleet(folder / "recordings", options)
        subprocess.run(command(jobs, folder / "undisturbed"), check=False)
        wanted = results(Store.opened(folder / "undisturbed"))
        store = Store.made(folder / "store")
        lost = half = 0
        before: dict[str, str] = {}
        for _ in track(range(arguments.kills), console=Console(stderr=True)):
            whom = random.choice(WHOM)
            whom_all[whom] += 1
            killed(jobs, store.path, whom, random.uniform(0.0, arguments.longest_s))
            try:
                now = results(store)
            except (GtcalError, ValueError, OSError) as error:
                console.print(f"not whole: {error}")
                half += 1
                continue
            lost += len(set(before) - set(now))
            before = now
            if len(now) == len(wanted):  # to be killed again, there has to be something to do
                store = Store.made(folder / f"store-{time.monotonic_ns()}")
                before = {}
        subprocess.run(command(jobs, store.path), check=False)
        unlike = sum(results(store).get(job) != found for job, found in wanted.items())
        with store.locked(), index.opened_index(store.index_path) as connection:
            disagreed = catch_up(store, connection)
        disagreed += rebuild(store)
    console.print(
        f"{arguments.kills} kills ({', '.join(f'{n} of {whom}' for whom, n in whom_all.items())}): "
        f"{half} files not whole, {lost} results lost; the batch run to its end: {unlike} of {len(wanted)} results "
        f"other than undisturbed, index and files disagree in {len(disagreed)}"
    )


if __name__ == "__main__":
    main()
