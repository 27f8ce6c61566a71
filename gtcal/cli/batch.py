"""gtcal batch: many recordings of many rigs, into one store."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gtcal.fleet.batch import Batch
    from gtcal.fleet.jobs import Job
    from gtcal.fleet.record import Record
    from gtcal.fleet.store import Store
    from gtcal.fleet.workers import Workers
    from gtcal.progress import Progress


def batch(
    jobs_: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="jobs-file", metavar="JOBS")],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="STORE")] = Path("store"),
    dry_run: bool = False,
    processes: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None,
    scheduler: str | None = None,
    taken_from: Literal["stamps", "name"] = "stamps",
    reports: bool = False,
    json: bool = False,
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Calibrate, verify and follow many recordings of many rigs, and keep the results in a store.

    JOBS is a folder, in which every recording is taken (FOLDER/RIG/RECORDING), or a file that lists them, as YAML:

        gtcal_jobs: 1
        options: {verify: {max_rmse_px: 0.4}}       # by kind, for all; names as of the command, with _ for -
        jobs:
          - {rig: rig07, recording: rig07/2026-05-04_board, accept: true}
          - {rig: rig07, recording: rig07/2026-05-05_lollypop, taken: 2026-05-05T08:10, options: {confidence: 0.9}}
          - {rig: rig07, kind: drift, name: may, recordings: [rig07/2026-05-05_lollypop, rig07/2026-05-06_lollypop]}

    or as CSV with the same fields in its header (options.max_rmse_px is an option, recordings are separated by ';').
    All of it is checked before anything runs. kind is calibrate, verify or drift; by default what the manifest is for.
    A verification is of 'calibration', or of the rig's last accepted calibration before it: its first, and those with
    'accept: true' (or 'gtcal history RIG --accept NAME').

    What was done before with the same files, options and gtcal is skipped; what has changed is done anew; what has
    failed is tried again. A recording that fails is a line and a record, and the others go on. Ctrl-C once hands out no
    more and finishes what runs, twice stops. Run the same command again to go on.

    Exit codes: 0 all is done and every calibration that was verified holds, 1 a job has no result, 3 a calibration does
    not hold, 4 it can't be told, 130 stopped.

    Args:
        jobs_: YAML or CSV file of jobs, or a folder of recordings.
        output: Folder of the store; made where it is missing.
        dry_run: List what would run and why, and run nothing.
        processes: So many, each on one core; by default one a core. 0: in this process, one after the other, without
            Dask.
        scheduler: Address of a running Dask scheduler (tcp://host:8786) whose workers do the jobs; they must see the
            recordings and the store under the same paths, and have gtcal installed.
        taken_from: When recordings were taken whose jobs don't say: by their time stamps, which then have to be dates,
            or by their names, as 2026-05-12_board.
        reports: Write a report on each calibration and verification too.
        json: Print JSON in place of tables ('gtcal schema batch').
        verbose: List every job, not only those without a pass.
        quiet: Show no progress and print nothing; the exit code tells.
    """
    from gtcal.cli.fleet_tables import batch_document, plan_document, print_batch, print_plans
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.errors import GtcalError
    from gtcal.fleet.batch import exit_code, plan
    from gtcal.fleet.jobs import JobsError
    from gtcal.fleet.jobs_file import read_jobs
    from gtcal.fleet.store import Store
    from gtcal.plain import one_line

    if processes is not None and processes < 0:
        raise GtcalError(f"--processes {processes}: expected 0 or more")
    if processes is not None and scheduler is not None:
        raise GtcalError("--processes are this batch's own, not those of the cluster at --scheduler: give one of them")
    try:
        stated = read_jobs(jobs_, taken_from=taken_from, report=reports)
    except JobsError as error:
        for line in error.lines:
            print(f"gtcal: {one_line(line)}", file=sys.stderr)
        return 1
    if dry_run:
        plans = plan(Store.opened(output) if output.exists() else None, stated)
        if json:
            print_json(plan_document(plans))
        elif not quiet:
            print_plans(plans, verbose=verbose)
        return 0
    store = Store.made(output)
    with store.locked(), shown_progress(quiet) as progress:
        found, was_stopped = _run(store, stated, processes, scheduler, progress, quiet)
    if json:
        print_json(batch_document(store, found))
    elif not quiet:
        print_batch(store, found, verbose=verbose)
    return 130 if was_stopped else exit_code(found)


def _run(
    store: Store, jobs: Sequence[Job], n: int | None, scheduler: str | None, progress: Progress, quiet: bool
) -> tuple[Batch, bool]:
    """The batch, and whether it was stopped."""
    from gtcal.fleet.batch import run_batch
    from gtcal.fleet.index import opened_index
    from gtcal.fleet.rebuild import catch_up

    store.clear_left_aside()
    with opened_index(store.index_path) as connection:
        taken_up = catch_up(store, connection)
    if not quiet:
        for line in taken_up:
            print(f"note: {line}: put right", file=sys.stderr)
    command_line = (Path(sys.argv[0]).name, *sys.argv[1:])
    told = (lambda record: None) if quiet else _tell
    with _stopping() as stopped, _workers(n, scheduler) as workers:
        found = run_batch(
            store, jobs, workers, command_line, progress=progress, stopping=lambda: bool(stopped), ended=told
        )
        return found, bool(stopped)


@contextmanager
def _workers(n: int | None, scheduler: str | None) -> Iterator[Workers]:
    from gtcal.fleet.workers import InThisProcess, dask_workers

    if n == 0:
        yield InThisProcess()
        return
    with dask_workers(scheduler=scheduler, jobs=n) as workers:
        yield workers


@contextmanager
def _stopping() -> Iterator[list[int]]:
    """Something is in the list after the first Ctrl-C; the second is the usual one."""
    import signal
    import threading

    pressed: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield pressed
        return

    def press(number: int, frame: object) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)
        print("gtcal: finishing what runs; Ctrl-C again stops at once", file=sys.stderr)

    before = signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, before)


def _tell(record: Record) -> None:
    """A line on a job without a result."""
    from gtcal.plain import one_line

    if record.error:
        line = f"{record.rig}/{record.name} ({record.kind}): {record.state}: {record.error}"
        print(one_line(line), file=sys.stderr)
