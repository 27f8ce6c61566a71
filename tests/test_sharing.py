"""One long recording, whose images all workers of a cluster look at: what comes of it is the same, bit for bit."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, LocalCluster, get_worker

from gtcal.detection import many_images
from gtcal.errors import GtcalError
from gtcal.estimation.options import CalibrationOptions
from gtcal.fleet import sharing
from gtcal.fleet.batch import run_batch
from gtcal.fleet.jobs import Job
from gtcal.fleet.run_job import Task, run_task
from gtcal.fleet.store import Store
from gtcal.fleet.workers import DaskWorkers, dask_workers
from gtcal.results.calibration_file import write_calibration
from gtcal.simulation import SimulationOptions, quest3_like_rig, simulate, write_simulation
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.verification import VerificationOptions

COMMAND = ("gtcal", "batch")
HALF = quest3_like_rig().scaled(0.5)
SOME_TIME_NS = 1_772_440_200_000_000_000


def untimed(text: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    document["provenance"] |= {"created_utc": "", "duration_s": 0.0}
    for stage in document.get("stages", ()):
        stage["duration_s"] = 0.0
    return document


def result_of(store: Store, name: str) -> dict[str, Any]:
    (path,) = store.path.glob(f"results/*/*/*/{name}")
    return untimed(path.read_text())


def test_ranges_of_images_on_several_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = simulate_lollypop(LollypopOptions(rig=HALF, n_frames=6, duration_s=12.0), seed=2)
    write_lollypop_simulation(simulation, tmp_path / "recording", images=True)
    write_calibration(tmp_path / "calibration.json", simulation.true_calibration())
    manifest = tmp_path / "recording" / "recording.yaml"
    options = VerificationOptions()
    job = Job("rig", "one", "verify", (manifest,), options, tmp_path / "calibration.json", SOME_TIME_NS)
    undivided = run_task(Task(job, COMMAND))
    assert not undivided.record.error
    shutil.rmtree(tmp_path / "recording" / ".gtcal")
    looked, each = [], sharing.look_at_each

    def counted(images: Any, tasks: Any, looking: Any) -> Any:
        looked.append((get_worker().name, len(tasks)))
        return each(images, tasks, looking)

    monkeypatch.setattr(many_images, "WORTH_PROCESSES", 6)
    monkeypatch.setattr(sharing, "PER_RANGE", 5)
    monkeypatch.setattr(sharing, "look_at_each", counted)
    store = Store.made(tmp_path / "store")
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        found = run_batch(store, [job], DaskWorkers(client), COMMAND)
    assert not found.failed
    assert sorted(n for _, n in looked) == 4 * [1] + 4 * [5]
    assert len({name for name, _ in looked}) == 2
    assert result_of(store, "verification.json") == untimed(undivided.files["verification.json"])


def test_images_that_changed_meanwhile_are_told(tmp_path: Path) -> None:
    simulation = simulate_lollypop(LollypopOptions(rig=HALF, n_frames=2, duration_s=12.0), seed=2)
    manifest = write_lollypop_simulation(simulation, tmp_path / "recording", images=True)
    looking = many_images.Looking(simulation.recording.device, None)
    camera = next(iter(simulation.recording.cameras))
    with pytest.raises(GtcalError, match="have changed while they were looked at"):
        sharing.look_at_range((manifest,), "once", camera, "other images", looking, [(0, None)])


@pytest.mark.long
def test_a_calibration_whose_detection_is_shared_by_processes_one_of_which_is_killed(tmp_path: Path) -> None:
    simulation = simulate(SimulationOptions(rig=HALF, n_frames=80, duration_s=53.0), seed=4)
    manifest = write_simulation(simulation, tmp_path / "recording", images=True)
    job = Job("rig", "one", "calibrate", (manifest,), CalibrationOptions(effects=False), None, SOME_TIME_NS)
    store = Store.made(tmp_path / "store")
    with dask_workers(jobs=2) as workers:
        pids = list(workers._client.run(os.getpid).values())

        def kill() -> None:
            time.sleep(4.0)  # while they look at images
            os.kill(pids[0], signal.SIGKILL)

        threading.Thread(target=kill).start()
        found = run_batch(store, [job], workers, COMMAND)
    assert not found.failed
    shutil.rmtree(tmp_path / "recording" / ".gtcal")
    undivided = run_task(Task(job, COMMAND))
    assert result_of(store, "calibration.json") == untimed(undivided.files["calibration.json"])
