"""Many recordings of many rigs: jobs, the store and its index, batches that are cut off, and what is shown of them."""

from __future__ import annotations

import json
import os
import pickle
import random
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import look_at
from cli_support import files_in, run
from fleet_support import KNOWN, SMALL, again, deadly

from gtcal.cli.json_schemas import MODELS
from gtcal.errors import GtcalError
from gtcal.fleet import index
from gtcal.fleet import workers as workers_module
from gtcal.fleet.batch import plan, run_batch
from gtcal.fleet.history import histories
from gtcal.fleet.inputs import gtcal_version
from gtcal.fleet.jobs import Job, JobsError, taken_ns_in, taken_ns_of, utc
from gtcal.fleet.jobs_file import read_jobs
from gtcal.fleet.measures import Measure
from gtcal.fleet.rebuild import catch_up, rebuild
from gtcal.fleet.record import RECORD, Contents, Input, Record, read_record, record_text
from gtcal.fleet.recording_page import recording_page
from gtcal.fleet.run_job import Outcome, Task, run_task
from gtcal.fleet.simulated import write_fleet
from gtcal.fleet.site import _environment
from gtcal.fleet.store import Store
from gtcal.fleet.watch import Station
from gtcal.fleet.watch_page import verdict
from gtcal.fleet.workers import InThisProcess, dask_workers
from gtcal.verification.verification import VerificationOptions

COMMAND = ("gtcal", "batch")


@dataclass(frozen=True)
class Fleet:
    """A small fleet's recordings, its jobs, the store that a batch made of them, and each job's outcome."""

    jobs_file: Path
    jobs: tuple[Job, ...]
    store: Store
    outcomes: dict[tuple[str, str, str], Outcome]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    folder = tmp_path_factory.mktemp("fleet")
    jobs_file = write_fleet(folder / "recordings", SMALL, workers=0)
    document = yaml.safe_load(jobs_file.read_text())
    document["options"] = {"calibrate": {"effects": False, "mocap_noise": "exact"}}
    jobs_file.write_text(yaml.safe_dump(document))
    outcomes: dict[tuple[str, str, str], Outcome] = {}

    def kept(task: Task) -> Outcome:
        outcomes[task.job.identity] = run_task(task)
        return outcomes[task.job.identity]

    jobs, store = read_jobs(jobs_file), Store.made(folder / "store")
    found = run_batch(store, jobs, InThisProcess(kept), COMMAND)
    assert not found.failed
    assert len(found.ended) == len(jobs) == 14
    (folder / "outcomes").write_bytes(pickle.dumps(outcomes))
    os.environ[KNOWN] = str(folder / "outcomes")
    return Fleet(jobs_file, jobs, store, outcomes)


@pytest.fixture
def copied(fleet: Fleet, tmp_path: Path) -> Store:
    """The store, copied: a folder is all of it."""
    shutil.copytree(fleet.store.path, tmp_path / "copy")
    return Store.opened(tmp_path / "copy")


def untimed(store: Store) -> dict[str, object]:
    """All that a store's files say, by job, but for times."""
    found: dict[str, object] = {}
    for path in store.record_files():
        record = read_record(path)
        told = [replace(record, created_utc="", duration_s=0.0, result_sha256="")]
        if record.state == "done":
            result = json.loads((path.parent / record.result_file).read_text())
            result["provenance"] |= {"created_utc": "", "duration_s": 0.0}
            for stage in result.get("stages", ()):
                stage["duration_s"] = 0.0
            told.append(result)
        assert str(record.identity) not in found
        found[str(record.identity)] = told
    return found


def agrees(store: Store) -> bool:
    """Whether the index says what the files say, and nothing is left aside."""
    with index.opened_index(store.index_path) as connection:
        assert not catch_up(store, connection)
    return not rebuild(store) and not store.left_aside()


# --- jobs


def test_every_wrong_job_is_a_line(fleet: Fleet, tmp_path: Path) -> None:
    good = "recording: rig01/2026-03-02_board"
    wrong = {
        "{rig: a, recording: nowhere}": "there is no such recording",
        f"{{rig: a, {good}, option: {{}}}}": "option: is not a field; did you mean 'options'?",
        f"{{rig: a, {good}, kind: verify, options: {{max_rmse: 1}}}}": "did you mean 'max_rmse_px'?",
        f"{{rig: a, {good}, kind: verify, options: {{max_rmse_px: -1}}}}": "max_rmse_px: -1",
        f"{{rig: a, {good}, options: {{intrinsics: best}}}}": "options.intrinsics: is 'best'",
        f"{{rig: a, {good}, options: {{kernel: Best}}}}": "options.kernel: unknown robust kernel",
        f"{{rig: a, {good}, options: {{mocap_sigma_mm: 1}}}}": "go together",
        f"{{rig: a, {good}, taken: Friday}}": "taken: 'Friday' is no time",
        f"{{rig: a/b, {good}}}": "separator of paths",
        f"{{rig: a, {good}, calibration: c.json}}": "calibration: is what 'verify' and 'drift' need",
        f"{{rig: a, kind: verify, {good}, accept: true}}": "accept: is of a calibration",
        f"{{rig: a, kind: drift, {good}, calibration: c.json}}": "c.json: there is no such file",
        f"{{{good}}}": "rig: is missing",
        "just text": "is no job",
    }
    file = fleet.jobs_file.with_name("wrong.yaml")
    file.write_text("gtcal_jobs: 1\njobs:\n" + "".join(f"  - {job}\n" for job in wrong))
    with pytest.raises(JobsError) as caught:
        read_jobs(file)
    for number, (line, said) in enumerate(zip(caught.value.lines, wrong.values(), strict=True), start=3):
        assert line.startswith(f"{file}:{number}: ")
        assert said in line
    ran = run("batch", file, "-o", tmp_path / "new")
    assert ran.code == 1
    assert ran.err.count("\n") == len(wrong)
    assert not (tmp_path / "new").exists()


def test_jobs_as_csv_and_as_a_folder(fleet: Fleet) -> None:
    file = fleet.jobs_file.with_name("jobs.csv")
    file.write_text(
        "rig,kind,recording,recordings,taken,options.confidence,name\n"
        "rig01,verify,rig01/2026-03-03_lollypop,,2026-03-03T08:30,0.9,\n"
        "rig01,drift,,rig01/2026-03-03_lollypop; rig01/2026-03-05_lollypop,2026-03-05,,march\n"
    )
    verified, drifted = read_jobs(file)
    assert verified.options == VerificationOptions(confidence=0.9)
    assert verified.taken_ns == taken_ns_of("2026-03-03T08:30:00Z")
    assert (drifted.name, len(drifted.recordings)) == ("march", 2)
    file.write_text("rig,recordin\n")
    with pytest.raises(GtcalError, match=r"jobs\.csv:1: 'recordin' is no field"):
        read_jobs(file)
    file.unlink()
    found = read_jobs(fleet.jobs_file.parent, taken_from="name")
    assert {job.identity for job in found} == {job.identity for job in fleet.jobs}
    assert taken_ns_in("2026-03-02_board") == taken_ns_of("2026-03-02") == found[0].taken_ns
    assert taken_ns_in("take 20260302-0830") == taken_ns_of("2026-03-02T08:30")
    with pytest.raises(GtcalError, match="holds no date"):
        taken_ns_in("2026-13-02_board")


def test_what_is_printed_for_programs_has_a_schema(fleet: Fleet) -> None:
    ran = run("batch", fleet.jobs_file, "-o", fleet.store.path, "--dry-run", "--json")
    MODELS["batch-plan"].model_validate(json.loads(ran.out))
    MODELS["jobs"].model_validate(yaml.safe_load(fleet.jobs_file.read_text()))
    for name in MODELS:
        assert json.loads(run("schema", name).out)["additionalProperties"] is False
    assert run("schema", "jobs", "--lollypop").code == 1


def test_two_jobs_of_one_name(fleet: Fleet) -> None:
    file = fleet.jobs_file.with_name("twice.yaml")
    job = "{rig: a, recording: rig01/2026-03-02_board}"
    file.write_text(f"gtcal_jobs: 1\njobs:\n  - {job}\n  - {job}\n")
    with pytest.raises(JobsError, match=r"twice\.yaml:4: a/2026-03-02_board \(calibrate\) is stated twice"):
        read_jobs(file)


# --- what has to be done again


def test_done_is_skipped_and_changed_is_done_anew(fleet: Fleet, copied: Store, tmp_path: Path) -> None:
    assert not any(made.run for made in plan(copied, fleet.jobs))
    shutil.copytree(fleet.jobs_file.parent, tmp_path / "moved")
    jobs = read_jobs(tmp_path / "moved" / fleet.jobs_file.name)
    again_there = run_batch(copied, jobs, InThisProcess(), COMMAND)
    assert len(again_there.unchanged) + len(again_there.ended) == len(jobs)
    assert not again_there.ended  # the same contents elsewhere
    verified = next(job for job in jobs if job.kind == "verify")
    body = verified.recordings[0].with_name("device_body.csv")
    body.touch()
    assert not any(made.run for made in plan(fleet.store, fleet.jobs))
    other = replace(verified, options=VerificationOptions(max_rmse_px=0.4))
    (made,) = plan(copied, [other])
    assert made.why == "other options: max_rmse_px"
    body.write_text("".join(body.read_text().splitlines(keepends=True)[:-1]))
    found = run_batch(copied, [verified], InThisProcess(), COMMAND)
    assert [record.identity for record in found.ended] == [verified.identity]
    with index.opened_index(copied.index_path) as connection:
        current = [record for _, record in index.records(connection) if record.identity == verified.identity]
        every = [r for _, r in index.records(connection, current=False) if r.identity == verified.identity]
    assert (len(current), len(every)) == (1, 2)
    assert current[0].key != every[0].key
    assert agrees(copied)


def test_another_version_and_another_calibration_are_reasons(
    fleet: Fleet, copied: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    verified = [job for job in fleet.jobs if job.kind == "verify" and job.rig == "rig01"]
    calibration = copied.path / "other.json"
    source = next(copied.path.glob("results/rig01/*/*/calibration.json"))
    calibration.write_text(source.read_text() + "\n")
    assert {made.why for made in plan(copied, [replace(job, calibration=calibration) for job in verified])} == {
        "another calibration"
    }
    monkeypatch.setattr("gtcal.fleet.batch.gtcal_version", lambda: "99")
    assert {made.why for made in plan(copied, fleet.jobs)} == {f"gtcal was {gtcal_version()}, and is 99"}


def test_a_failure_is_a_record_and_tried_again(fleet: Fleet, tmp_path: Path) -> None:
    folder = tmp_path / "one"
    shutil.copytree(fleet.jobs_file.parent / "rig01", folder / "rig01")
    broken = folder / "rig01" / "2026-03-03_lollypop" / "device_body.csv"
    kept = broken.read_text()
    broken.write_text("nonsense\n")
    ran = run("batch", folder, "--taken-from", "name", "-j", 0, "-o", tmp_path / "store", "--json")
    assert ran.code == 1
    document = json.loads(ran.out)
    MODELS["batch"].model_validate(document)
    (failed,) = [job for job in document["jobs"] if job["state"] == "failed"]
    assert failed["name"] == "2026-03-03_lollypop"
    assert "device_body.csv" in failed["error"]
    assert len(document["jobs"]) == 7
    assert agrees(Store(tmp_path / "store"))
    ran = run("batch", folder, "--taken-from", "name", "-j", 0, "-o", tmp_path / "store", "--dry-run")
    assert "failed before" in ran.out
    broken.write_text(kept)
    ran = run("batch", folder, "--taken-from", "name", "-j", 0, "-o", tmp_path / "store")
    assert ran.code in (0, 4)
    assert "1 done, 6 done before" in ran.out
    assert not list((tmp_path / "store" / "failures").rglob("*.json"))


def test_a_date_is_not_guessed(fleet: Fleet) -> None:
    job = replace(next(job for job in fleet.jobs if job.kind == "verify"), taken_ns=None)
    from gtcal.fleet.run_job import dated

    assert dated(taken_ns_of("2026-03-03")) == taken_ns_of("2026-03-03")
    with pytest.raises(GtcalError, match="counts from the start of the take"):
        dated(12_000_000_000)
    outcome = run_task(Task(job, COMMAND))
    assert "has no calibration in the store" in outcome.record.error


# --- the store and its index


def test_the_index_is_made_anew_from_the_files(fleet: Fleet, copied: Store) -> None:
    assert agrees(copied)
    with index.opened_index(copied.index_path) as connection:
        connection.execute("UPDATE measure SET value = value + 1 WHERE quantity = 'rmse_mm' AND job = 3")
        connection.execute("DELETE FROM job WHERE id = 1")
    gone = next(copied.path.glob("results/rig02/*lollypop/*"))
    shutil.rmtree(gone)
    lines = rebuild(copied)
    assert len(lines) == 3
    assert sum("was not in the index" in line for line in lines) == 1
    assert sum("is not in the files" in line for line in lines) == 1
    assert sum("the index had other measures" in line for line in lines) == 1
    assert agrees(copied)
    copied.index_path.write_bytes(b"no database at all" * 100)
    ran = run("history", "-s", copied.path)
    assert ran.code == 1
    assert "--rebuild" in ran.err
    assert run("history", "-s", copied.path, "--rebuild").code in (0, 3, 4)
    assert agrees(copied)


def test_an_older_index_is_brought_up_to_date_and_a_newer_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "index.sqlite"
    connection = sqlite3.connect(path)
    connection.executescript(index.MIGRATIONS[0] + "PRAGMA user_version = 1;")
    connection.close()
    with index.opened_index(path) as connection:
        assert connection.execute("SELECT count(*) FROM current").fetchone() == (0,)
        assert connection.execute("PRAGMA user_version").fetchone() == (index.SCHEMA_VERSION,)
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        connection.execute(f"PRAGMA user_version = {index.SCHEMA_VERSION + 1}")
    with pytest.raises(GtcalError, match="update gtcal"), index.opened_index(path):
        pass


def test_records_come_back_as_they_were(fleet: Fleet) -> None:
    for outcome in fleet.outcomes.values():
        record = outcome.record
        plain = replace(record, inputs=tuple(replace(entry, signature="") for entry in record.inputs))
        assert read_record(fleet.store.file_of(record)) == plain
        assert record.command_line == COMMAND
        assert json.loads(outcome.files[record.result_file])["provenance"]["command_line"] == list(COMMAND)


def test_a_second_batch_is_refused(fleet: Fleet, copied: Store) -> None:
    with copied.locked():
        ran = run("batch", fleet.jobs_file, "-o", copied.path, "-j", 0)
    assert ran.code == 1
    assert ran.err.count("\n") == 1
    assert f"another gtcal (process {os.getpid()} on " in ran.err
    assert run("batch", fleet.jobs_file, "-o", copied.path, "-j", 0, "-q").code in (0, 4)


def test_a_store_is_no_other_folder(fleet: Fleet, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("")
    for command in (
        ["batch", fleet.jobs_file, "-o", tmp_path / "mine"],
        ["site", tmp_path / "mine", "-s", fleet.store.path],
    ):
        ran = run(*command)
        assert ran.code == 1
        assert "give a" in ran.err or "choose another" in ran.err
    assert files_in(tmp_path / "mine") == {"thesis.txt"}


# --- nothing is lost


def test_ten_kills_lose_nothing(fleet: Fleet, tmp_path: Path) -> None:
    """The process that writes is killed at random moments; then the batch is run to its end."""
    rolls = random.Random(0)
    store = Store.made(tmp_path / "store")
    told_file = tmp_path / "told"
    killed = 0
    while killed < 10:
        if killed % 4 == 3:  # from the beginning, so that there is something to be killed at
            shutil.rmtree(store.path)
            Store.made(store.path)
            told_file.unlink(missing_ok=True)
        pid = os.fork()
        if pid == 0:
            _batch_in_a_child(store, fleet.jobs, told_file)
        time.sleep(rolls.uniform(0.0, 0.25))
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        killed += 1
        there = {str(read_record(path).identity) for path in store.record_files()}  # all of them whole
        told = set(told_file.read_text().splitlines()[:-1]) if told_file.exists() else set()
        assert told <= there
    with store.locked():
        store.clear_left_aside()
        with index.opened_index(store.index_path) as connection:
            catch_up(store, connection)
        found = run_batch(store, fleet.jobs, InThisProcess(again), COMMAND)
    assert not found.failed
    assert untimed(store) == untimed(fleet.store)
    assert agrees(store)


def _batch_in_a_child(store: Store, jobs: tuple[Job, ...], told_file: Path) -> None:
    try:
        with store.locked(), told_file.open("a") as told:
            store.clear_left_aside()
            with index.opened_index(store.index_path) as connection:
                catch_up(store, connection)

            def tell(record: object) -> None:
                told.write(f"{record.identity}\n")  # type: ignore[attr-defined]
                told.flush()

            run_batch(store, jobs, InThisProcess(again), COMMAND, ended=tell)
    finally:
        os._exit(0)


@pytest.mark.long
def test_killed_workers_are_replaced_and_recorded(fleet: Fleet, tmp_path: Path) -> None:
    """On a real cluster: a worker that dies once, jobs that always kill theirs or run out of memory, and the others."""
    (calibrate, *verify) = [job for job in fleet.jobs if job.rig == "rig01"]
    jobs = [calibrate, verify[0], *(replace(calibrate, rig=rig) for rig in ("once", "always", "memory"))]
    outcomes = {**fleet.outcomes}
    for job in jobs[2:]:
        before = fleet.outcomes[calibrate.identity]
        outcomes[job.identity] = replace(before, record=replace(before.record, rig=job.rig))
    (tmp_path / "outcomes").write_bytes(pickle.dumps(outcomes))
    store, before_env = Store.made(tmp_path / "store"), os.environ[KNOWN]
    os.environ[KNOWN] = str(tmp_path / "outcomes")
    try:
        with store.locked(), dask_workers(jobs=2, do=deadly) as workers:
            found = run_batch(store, jobs, workers, COMMAND)
    finally:
        os.environ[KNOWN] = before_env
    states = {record.rig: (record.state, record.error) for record in found.ended if record.kind == "calibrate"}
    assert states["rig01"] == states["once"] == ("done", "")
    assert states["always"] == ("lost", "its workers were killed, by the system or for the memory that it took")
    assert states["memory"] == ("lost", "it ran out of memory, 3 times")
    assert (tmp_path / "died-once-2026-03-02_board").exists()
    assert agrees(store)


@pytest.mark.long
def test_a_lost_scheduler_is_a_line_and_late_workers_are_waited_for(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Of a real 'dask scheduler', whose 'dask worker' comes after the batch."""
    monkeypatch.setattr(workers_module, "_TOLD_AFTER_S", 0.5)
    address, store = f"tcp://127.0.0.1:{_free_port()}", Store.made(tmp_path / "store")
    tests = str(Path(__file__).parent)  # whose functions the worker is to run
    environment = os.environ | {"PYTHONPATH": f"{tests}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    with pytest.raises(GtcalError, match=r"no Dask scheduler answers there"), dask_workers(scheduler=address):
        pass
    started: list[subprocess.Popen[bytes]] = []

    def start(*command: str) -> None:
        program = [sys.executable, "-m", "distributed.cli." + command[0], *command[1:], "--no-dashboard"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        started.append(subprocess.Popen(program, env=environment, cwd=tmp_path, **quiet))  # type: ignore[call-overload]

    def ended(record: Record) -> None:
        told.append(record.identity)
        if len(told) == 3:
            started[0].kill()

    told: list[tuple[str, str, str]] = []
    try:
        start("dask_scheduler", "--host", "127.0.0.1", "--port", address.split(":")[-1])
        _until(lambda: _answers(address))
        threading.Timer(3.0, start, ("dask_worker", address, "--nthreads", "1")).start()
        with (
            pytest.raises(GtcalError, match=rf"the Dask scheduler {address} was lost; what was done is in the store"),
            store.locked(),
            dask_workers(scheduler=address, do=again) as workers,
        ):
            run_batch(store, fleet.jobs, workers, COMMAND, ended=ended)
    finally:
        for process in started:
            process.kill()
            process.wait()
    assert f"the cluster at {address} has no workers; waiting for them" in caplog.text
    assert 3 <= len(told) < len(fleet.jobs)
    assert agrees(store)
    assert not run_batch(store, fleet.jobs, InThisProcess(again), COMMAND).failed
    assert untimed(store) == untimed(fleet.store)


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def _answers(address: str) -> bool:
    with socket.socket() as asking:
        return asking.connect_ex(("127.0.0.1", int(address.split(":")[-1]))) == 0


def _until(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.1)


def test_a_full_disk_is_a_line_and_no_half_file(fleet: Fleet, tmp_path: Path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=700k", "tmpfs", str(small)], capture_output=True).returncode:
        pytest.skip("no file system of its own can be made here")
    try:
        store = Store.made(small / "store")
        with pytest.raises(GtcalError, match=r"full|No space left"):
            run_batch(store, fleet.jobs, InThisProcess(again), COMMAND)
        for path in store.record_files():
            record = read_record(path)
            json.loads((path.parent / record.result_file).read_text())
        assert not store.left_aside()
        subprocess.run(["mount", "-o", "remount,size=60m", str(small)], check=True)
        with index.opened_index(store.index_path) as connection:
            catch_up(store, connection)
        assert not run_batch(store, fleet.jobs, InThisProcess(again), COMMAND).failed
        assert untimed(store) == untimed(fleet.store)
    finally:
        subprocess.run(["umount", str(small)], check=True)


def test_a_batch_that_is_stopped_goes_on_later(fleet: Fleet, tmp_path: Path) -> None:
    store, asked = Store.made(tmp_path / "store"), []

    def stopping() -> bool:
        asked.append(None)
        return len(asked) > 6

    found = run_batch(store, fleet.jobs, InThisProcess(again), COMMAND, stopping=stopping)
    assert 0 < len(found.ended) < len(fleet.jobs)
    assert len(found.ended) + len(found.not_run) == len(fleet.jobs)
    rest = run_batch(store, fleet.jobs, InThisProcess(again), COMMAND)
    assert len(rest.ended) == len(found.not_run)
    assert untimed(store) == untimed(fleet.store)


# --- what is shown


@pytest.mark.long
def test_the_site_in_a_browser(fleet: Fleet, copied: Store, tmp_path: Path) -> None:
    record = next(r for r in map(read_record, copied.record_files()) if r.kind == "verify" and r.rig == "rig02")
    hostile = replace(record, rig="<img src=x onerror=alert(1)>", name="a & b")
    copied.put(Outcome(hostile, files={RECORD: record_text(hostile), **_result_of(copied, record)}))
    rebuild(copied)
    assert run("site", tmp_path / "site", "-s", copied.path, "-q").code == 0
    recording = "recordings/rig01/2026-03-10_lollypop.verify.html"
    for page, images in (("index.html", 0), ("rigs/rig01.html", 4), (recording, 0)):
        for width_px in (1300, 400):
            seen = look_at(tmp_path / "site" / page, tmp_path, width_px=width_px)
            assert (seen.heard, seen.console, seen.missing) == ([], [], [])
            assert seen.images == images
            assert seen.overflow_px <= 0
    text = (tmp_path / "site" / "index.html").read_text()
    assert "<img" not in text
    assert "&lt;img src=x" in text
    assert "http" not in text.replace("http-equiv", "")


def test_a_recording_without_a_report_has_a_page(fleet: Fleet) -> None:
    history = histories(fleet.store)["rig01"]
    for event in (history.events[0], history.events[-1]):
        record = replace(event.record, name="<b>a</b>", inputs=(Input("/data/<i>", 64 * "0"),))
        text = recording_page(_environment(), event, record, "pass", "✓", "../../rigs/rig01.html")
        assert "<b>a" not in text
        assert "&lt;b&gt;a" in text
        assert "/data/&lt;i&gt;, SHA-256 0000000000000000…" in text
        for camera in history.cameras:
            assert f'<th class="num">{camera}</th>' in text
        words = {"verify": "mean error outwards, px", "calibrate": "moved along z, mm"}
        assert words[record.kind] in text
        assert f"{event.measures['front_left', 'rmse_px'][0]:.3g}"[:4] in text


def _result_of(store: Store, record: object) -> dict[str, str]:
    path = store.folder_of(record) / "verification.json"  # type: ignore[arg-type]
    return {"verification.json": path.read_text()}


def test_history_is_shown_and_written(fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    store = fleet.store.path
    ran = run("history", "rig01", "-s", store, "--figure", "f.png", "--to", "parquet", "-v")
    assert ran.code in (0, 4)
    assert "2026-03-10_lollypop" in ran.out
    assert "one false alarm in 1000 rounds" in ran.out
    assert (tmp_path / "f.png").stat().st_size > 20_000
    import pandas

    frame = pandas.read_parquet(tmp_path / "history.parquet")
    assert set(frame.rig) == {"rig01"}
    rmse = frame[(frame.quantity == "rmse_px") & (frame.kind == "verify") & (frame.camera == "front_left")]
    assert len(rmse) == 6
    assert ((rmse.value > 0.05) & (rmse.value < 0.5)).all()
    assert frame.key.str.len().eq(64).all()
    assert run("history", "-s", store, "--to", "csv").code in (0, 4)
    assert len(pandas.read_csv(tmp_path / "history.csv")) == 2 * len(frame)
    document = json.loads(run("history", "rig02", "-s", store, "--json").out)
    MODELS["history"].model_validate(document)
    assert [rig["rig"] for rig in document["rigs"]] == ["rig02"]
    ran = run("history", "rig99", "-s", store)
    assert (ran.code, ran.err.count("\n")) == (1, 1)
    assert "rigs: rig01, rig02" in ran.err


def test_the_station_shows_each_verdict(fleet: Fleet, copied: Store, tmp_path: Path) -> None:
    folder = tmp_path / "arriving"
    source = fleet.jobs_file.parent / "rig01" / "2026-03-05_lollypop"
    (folder / "rig01").mkdir(parents=True)
    station = Station(folder, copied, VerificationOptions(), COMMAND, taken_from="name", settle_s=0.1)
    arriving = folder / "rig01" / "2026-03-06_new"
    arriving.mkdir()
    for file in sorted(source.iterdir(), key=lambda path: path.name == "recording.yaml"):
        assert not list(station.completed())  # no manifest yet
        shutil.copy(file, arriving)
    assert not list(station.completed())
    assert station.waits
    time.sleep(0.12)
    ((manifest, idle_s),) = station.completed()
    seen = station.verify(manifest, idle_s)
    assert seen is not None
    assert seen.record.identity == ("rig01", "verify", "2026-03-06_new")
    assert seen.record.verdict == fleet.outcomes["rig01", "verify", "2026-03-05_lollypop"].record.verdict
    assert not list(station.completed())
    assert not station.waits
    assert agrees(copied)
    (arriving / "device_body.csv").write_text("<b>nonsense\n")
    ran = run("watch", folder, "-s", copied.path, "--once", "--settle-s", 0.1, "--taken-from", "name")
    assert ran.code == 1
    line = json.loads(ran.out)
    MODELS["watch"].model_validate(line)
    assert line["verdict"] is None
    assert "device_body.csv" in line["error"]
    page = (copied.path / "watch.html").read_text()
    assert "no verdict" in page
    assert "<b>" not in page
    passed = verdict(replace(seen, record=replace(seen.record, verdict="pass")))
    assert (passed.word, passed.remarks) == ("pass", ())


def test_the_rigs_that_changed_are_named_and_no_other(tmp_path: Path) -> None:
    """As the demo's: five rigs over eight weeks, of which one drifts, one is bumped and one has a lens that warms."""
    random, store = np.random.default_rng(0), Store.made(tmp_path / "store")
    days = np.array([day for day in range(56) if day % 7 in (1, 3, 5)], dtype=float)
    drift = {("rig02", "bias_x_px"): 0.008 * np.maximum(days - 14.0, 0.0)}
    bump = {("rig04", "bias_y_px"): 0.9 * (days > 38.0)}
    warmth = {("rig05", "bias_radial_px"): 0.02 * np.clip(days - 21.0, 0.0, 28.0)}
    harms = drift | bump | warmth
    quantities = ("bias_x_px", "bias_y_px", "bias_radial_px", "bias_tangential_px")
    with index.opened_index(store.index_path) as connection:
        for rig in (f"rig{number:02d}" for number in range(1, 6)):
            for place, day in enumerate(days):
                values = {
                    (camera, q): 0.03 * random.normal() + (harms.get((rig, q), 0.0 * days)[place] if c == 0 else 0.0)
                    for c, camera in enumerate("abcd")
                    for q in quantities
                }
                measures = [Measure(camera, q, value, 0.02) for (camera, q), value in values.items()]
                for camera in "abcd":
                    square = sum(values[camera, q] ** 2 for q in quantities[:3])
                    measures.append(Measure(camera, "rmse_px", float(np.sqrt(0.16**2 + square)), 0.01))
                index.insert(connection, record_on(rig, day), Contents(tuple(measures)))
    found = histories(store)
    named = {rig: [(f.camera, f.what) for f in one.findings] for rig, one in found.items() if one.findings}
    assert named == {
        "rig02": [("a", "bias")],
        "rig04": [("a", "bias")],
        "rig05": [("a", "radial bias")],
    }
    drifts, bumped, warms = (found[rig].findings[0] for rig in named)
    assert drifts.sentence("rig02").startswith("a of rig02 drifts: its bias by 0.0")
    assert drifts.change is not None
    assert drifts.left is not None
    assert drifts.change.rate == pytest.approx(0.008, abs=4.0 * drifts.change.rate_sigma)
    true_days = (np.sqrt(0.5**2 - 0.16**2) / 0.008 + 14.0) - days[-1]
    assert drifts.left.low < true_days < drifts.left.high
    assert "at once, before 11 Apr 2026" in bumped.sentence("rig04")
    assert "leaves the tolerance of 0.5 px RMSE now" in warms.sentence("rig05")
    assert [one.status for one in found.values()] == ["holds", "changed", "holds", "changed", "changed"]


def record_on(rig: str, day: float) -> Record:
    taken_ns = taken_ns_of("2026-03-02T08:30") + round(day * 86400e9)
    texts = {"key": f"{rig}{day}", "error": "", "verdict": "pass", "calibration_sha256": "", "result_sha256": ""}
    made = {"created_utc": f"{utc(taken_ns)}", "duration_s": 1.0, "versions": {}, "command_line": COMMAND, "inputs": ()}
    name = f"{utc(taken_ns):%Y-%m-%d}"
    return Record(
        rig=rig, kind="verify", name=name, state="done", taken_ns=taken_ns, accept=False, options={}, **texts, **made
    )  # type: ignore[arg-type]


def test_accepting_a_calibration_begins_anew(fleet: Fleet, copied: Store) -> None:
    first = fleet.outcomes["rig01", "calibrate", "2026-03-02_board"]
    later = replace(first.record, name="later", taken_ns=taken_ns_of("2026-03-09"))
    copied.put(replace(first, record=later, files={**first.files, RECORD: record_text(later)}))
    rebuild(copied)
    before = json.loads(run("history", "rig01", "-s", copied.path, "--json").out)["rigs"][0]
    assert before["accepted"] == "2026-03-02_board"
    assert run("history", "rig01", "-s", copied.path, "--accept", "nothing").code == 1
    after = json.loads(run("history", "rig01", "-s", copied.path, "--accept", "later", "--json").out)["rigs"][0]
    assert after["accepted"] == "later"
    assert not {made.why for made in plan(copied, fleet.jobs)} - {"done before"}  # the same calibration by another name
