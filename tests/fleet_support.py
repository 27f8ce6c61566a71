"""A small simulated fleet, its results, and workers that give them again without the work."""

from __future__ import annotations

import os
import pickle
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

from gtcal.fleet.record import RECORD, record_text
from gtcal.fleet.run_job import Outcome, Task, _now
from gtcal.fleet.simulated import FleetOptions

SMALL = FleetOptions(
    n_rigs=2,
    n_days=14,
    calibrated_every=14,
    verified_every=(1, 3, 5),
    n_frames=24,
    verification_frames=60,
    duration_s=12.0,
)

KNOWN = "GTCAL_TEST_OUTCOMES"
"""The variable with the file of outcomes, for workers in other processes."""


@cache
def _known(path: str) -> dict[tuple[str, str, str], Outcome]:
    return pickle.loads(Path(path).read_bytes())


def again(task: Task) -> Outcome:
    """The outcome that the job had before, as if it were of now."""
    time.sleep(0.01)
    before = _known(os.environ[KNOWN])[task.job.identity]
    if before.record.key in task.done_keys:
        return replace(before, unchanged=True)
    record = replace(before.record, created_utc=_now())
    return replace(before, record=record, files={**before.files, RECORD: record_text(record)})


def deadly(task: Task) -> Outcome:
    """As ``again``, but the process dies over jobs of some names: 'once' the first time, 'always' each time; and
    'memory' runs out of it."""
    mark = Path(os.environ[KNOWN]).with_name(f"died-{task.job.rig}-{task.job.name}")
    if task.job.rig == "always" or (task.job.rig == "once" and not mark.exists()):
        mark.touch()
        os._exit(9)
    if task.job.rig == "memory":
        raise MemoryError
    return again(task)
