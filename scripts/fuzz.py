"""Spoilt files for every reader: what is not told in one line, takes more than 2 s, or more than 1 GiB.

    python scripts/fuzz.py --inputs 20000 --seed 1
    python scripts/fuzz.py --inputs 100000 --seed 2 --sum fuzz.json    (adds to what the file says of other seeds)

Good files of every kind that gtcal reads are written, spoilt at random (the same for the same seed), and read. A reader
may take a file or refuse it with a GtcalError; anything else is counted and shown, with the number of the input, which
``--only`` reads again, alone. It runs on all cores, in processes of their own, so that none takes the others down.
Readers that take long, those of bags above all, get fewer inputs than the others: the table says how many each.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from media_support import compressed_message, image_message, write_bag, write_video
from mocap_files import CUBE_M, from_zero, markers_of, write_c3d, write_motive, write_qualisys, write_trc, write_vicon
from support import EPOCH_NS, wandering_trajectory
from vrs_support import image_stream, write_vrs

from gtcal.baselines.marker_file import COLUMNS, read_marker_sightings
from gtcal.board import load_board
from gtcal.camera_files.calibration_rig import calibration_rig
from gtcal.camera_files.formats import CAMERA_FILE_WRITERS, FOLDER_FORMATS, read_rig, write_rig
from gtcal.cores import n_cores
from gtcal.detection.detect import _read_cache, _write_cache
from gtcal.errors import GtcalError
from gtcal.estimation.priors_file import read_priors
from gtcal.files import write_text
from gtcal.fleet.index import insert, opened_index, records
from gtcal.fleet.jobs import JobsError
from gtcal.fleet.jobs_file import read_jobs
from gtcal.fleet.record import Contents, Record, read_record, record_text
from gtcal.readers import TRAJECTORY_READERS, BodySelection, inspect_mocap, read_c3d, write_euroc_csv, write_tum
from gtcal.readers.mocap_exports import write_rosbag
from gtcal.readers.pose_list import read_pose_list, write_pose_list
from gtcal.readers.poses import PoseConventions
from gtcal.readers.rosbag import read_rosbag_takes
from gtcal.recordings.bag_images import bag_images
from gtcal.recordings.images import Images, image_folder, image_list, read_grey
from gtcal.recordings.manifest import named_files
from gtcal.recordings.recording import load_recording
from gtcal.recordings.video_images import video_images
from gtcal.recordings.vrs_images import vrs_images
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import SimulationOptions, quest3_like_rig, simulate, write_simulation
from gtcal.simulation.ground_truth import read_ground_truth
from gtcal.simulation.lollypop import LollypopOptions, exact_calibration, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop_recording import load_lollypop_recording, read_device
from gtcal.verification.verification_file import read_verification, write_verification
from gtcal.verification.workflow import verify

SLOW_S, LARGE_BYTES = 2.0, 2**30
_HANGS_S = 30
_CHUNK = 25_000  # to write the good files takes as long as to read a thousand


@dataclass(frozen=True)
class Target:
    """A file that is spoilt, and what reads it then. share: of how many inputs it gets one; 1 where it is quick."""

    name: str
    file: Path
    read: Callable[[], object]
    share: float = 1.0


@dataclass(frozen=True)
class Failed:
    """What an input did that it must not."""

    number: int
    target: str
    kind: str
    what: str


@dataclass
class Tally:
    """What became of a target's inputs."""

    inputs: int = 0
    refused: int = 0
    taken: int = 0
    failed: int = 0
    most_s: float = 0.0
    most_bytes: int = 0

    def add(self, other: Tally) -> None:
        self.inputs += other.inputs
        self.refused += other.refused
        self.taken += other.taken
        self.failed += other.failed
        self.most_s = max(self.most_s, other.most_s)
        self.most_bytes = max(self.most_bytes, other.most_bytes)


class _HangsError(BaseException):
    """It takes so long that waiting for it is no use."""


def main(
    inputs: int = 20_000,
    seed: int = 0,
    only: Annotated[int | None, tyro.conf.arg(help="This input alone.")] = None,
    of: Annotated[str, tyro.conf.arg(help="Of the targets, those alone in whose names this is.")] = "",
    minutes: Annotated[float, tyro.conf.arg(help="Begin no more inputs after so long.")] = np.inf,
    sum: Annotated[Path | None, tyro.conf.arg(help="Add the counts to those in this file, and show these.")] = None,
) -> int:
    """Spoil so many files, and say what was wrong. Exits with 1 where something was."""
    numbers = range(inputs) if only is None else range(only, only + 1)
    started = time.perf_counter()
    workers = 1 if only is not None else n_cores()
    failed, tallies = run(numbers, seed, workers=workers, of=of, until=time.monotonic() + 60.0 * minutes)
    for (target, kind, what), count in Counter((f.target, f.kind, f.what) for f in failed).most_common():
        first = next(f.number for f in failed if (f.target, f.kind, f.what) == (target, kind, what))
        print(f"{count:6} x {target}: {kind}: {what} (the first: --only {first})")
    seeds, kinds = [seed], Counter(f.kind for f in failed)
    if sum is not None:
        seeds, kinds, tallies = added_to(sum, seed, kinds, tallies)
    print_table(tallies)
    total = Tally()
    for tally in tallies.values():
        total.add(tally)
    print(
        f"{total.inputs:,} inputs of seed {', '.join(map(str, seeds))}: {kinds['uncaught']} uncaught, "
        f"{kinds['slow']} over {SLOW_S:g} s (longest {total.most_s:.2f} s), {kinds['large']} over 1 GiB (most "
        f"{total.most_bytes / 2**20:.0f} MiB), {kinds['crash']} crashes; {time.perf_counter() - started:.0f} s"
    )
    return 1 if failed else 0


def added_to(
    path: Path, seed: int, kinds: Counter[str], tallies: dict[str, Tally]
) -> tuple[list[int], Counter[str], dict[str, Tally]]:
    """The seeds, what was wrong and the tallies, with those of earlier runs in a file, which holds them all then."""
    before = json.loads(path.read_text()) if path.exists() else {"seeds": [], "wrong": {}, "targets": {}}
    if seed in before["seeds"]:
        raise SystemExit(f"{path}: holds seed {seed} already; give another")
    seeds, wrong = [*before["seeds"], seed], Counter(before["wrong"]) + kinds
    both = {name: Tally(**fields) for name, fields in before["targets"].items()}
    for name, tally in tallies.items():
        both.setdefault(name, Tally()).add(tally)
    targets = {name: vars(tally) for name, tally in both.items()}
    path.write_text(json.dumps({"seeds": seeds, "wrong": wrong, "targets": targets}, indent=1) + "\n")
    return seeds, wrong, both


def print_table(tallies: dict[str, Tally]) -> None:
    """A row a target."""
    table = Table()
    for heading in ("file", "inputs", "refused", "taken", "wrong", "longest, ms", "memory, MiB"):
        table.add_column(heading, justify="left" if heading == "file" else "right")
    for name, tally in sorted(tallies.items()):
        counts = (f"{count:,}" for count in (tally.inputs, tally.refused, tally.taken, tally.failed))
        table.add_row(name, *counts, f"{1e3 * tally.most_s:.0f}", f"{tally.most_bytes / 2**20:.0f}")
    Console(width=120).print(table)


def run(
    numbers: range, seed: int, *, workers: int, of: str = "", until: float = np.inf
) -> tuple[list[Failed], dict[str, Tally]]:
    """What failed, and what became of the inputs of each target. From ``until`` on, of the clock of the machine that
    all processes share (``time.monotonic``), no more are begun."""
    size = min(_CHUNK, -(-len(numbers) // workers))
    waiting = [numbers[i : i + size] for i in range(0, len(numbers), size)]
    failed: list[Failed] = []
    tallies: dict[str, Tally] = {}
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # a file is written twice for each input
    with tempfile.TemporaryDirectory(dir=memory) as folder, ThreadPool(workers) as pool:

        def one(place: int, chunk: range) -> None:
            while len(chunk):
                chunk = _in_a_process(Path(folder) / f"{place}_{chunk[0]}", chunk, seed, of, until, failed, tallies)

        pool.starmap(one, enumerate(waiting), chunksize=1)
    return failed, tallies


def _in_a_process(
    folder: Path, chunk: range, seed: int, of: str, until: float, failed: list[Failed], tallies: dict[str, Tally]
) -> range:
    """Read these inputs in a process of its own. What of them is left, where that crashes."""
    if time.monotonic() > until:
        return range(0)
    context = multiprocessing.get_context("spawn")  # none inherits the others' memory
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_run_chunk, args=(folder, chunk, seed, of, until, theirs))
    process.start()
    theirs.close()
    at, target = None, "?"
    try:
        while True:
            message = ours.recv()
            if isinstance(message, Failed):
                failed.append(message)
            elif isinstance(message, dict):
                for name, tally in message.items():
                    tallies.setdefault(name, Tally()).add(tally)
            else:
                at, target = message
    except EOFError:
        process.join()
    if process.exitcode and at is None:
        raise RuntimeError("the good files can't be made or read; see above")
    if not process.exitcode:
        return range(0)
    failed.append(Failed(at, target, "crash", f"exit code {process.exitcode}"))
    return range(at + 1, chunk[-1] + 1)


def _run_chunk(
    folder: Path, numbers: range, seed: int, of: str, until: float, pipe: multiprocessing.connection.Connection
) -> None:
    """Spoil and read these inputs. Through the pipe go the number and target before each, what failed, and the tallies:
    after each thousand, as the process may crash."""
    logging.disable()
    warnings.simplefilter("ignore")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    folder.mkdir()
    targets = [target for target in good_files(folder) if of in target.name]
    for target in targets:
        target.read()  # as it is, it can be read
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries of images say there what they think of them
    resource.setrlimit(resource.RLIMIT_AS, (_virtual_bytes() + LARGE_BYTES + 2**28,) * 2)
    signal.signal(signal.SIGALRM, _hang)
    tallies: dict[str, Tally] = {}
    shares = np.cumsum([target.share for target in targets]).tolist()
    for number in numbers:
        randomness = random.Random(f"{seed}:{number}")
        (target,) = randomness.choices(targets, cum_weights=shares)
        pipe.send((number, target.name))
        failure, tally = spoil_and_read(number, target, randomness)
        tallies.setdefault(target.name, Tally()).add(tally)
        if failure is not None:
            pipe.send(failure)
        if number % 1000 == 999:
            pipe.send(tallies)
            tallies = {}
        if time.monotonic() > until:
            break
    pipe.send(tallies)


def spoil_and_read(number: int, target: Target, randomness: random.Random) -> tuple[Failed | None, Tally]:
    """One input: what was wrong, and its tally."""
    good = target.file.read_bytes()
    target.file.write_bytes(spoilt(good, randomness))
    _PEAK.write_text("5")  # resets the most memory that this process has had
    before, started, wrong, refused = _resident_bytes(), _cpu_s(), None, False
    try:
        signal.alarm(_HANGS_S)
        target.read()
    except GtcalError as error:
        refused = True
        if "\n" in str(error) and not isinstance(error, JobsError):
            wrong = "uncaught", "a message of several lines"
    except _HangsError:
        wrong = "slow", f"over {_HANGS_S} s"
    except MemoryError as error:
        wrong = "large", _where(error)
    except Exception as error:
        wrong = "uncaught", _where(error)
    finally:
        signal.alarm(0)
        target.file.write_bytes(good)
    seconds = _cpu_s() - started
    took_bytes = max(0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before)
    if wrong is None and seconds > SLOW_S:
        wrong = "slow", f"over {SLOW_S:g} s"
    if wrong is None and took_bytes > LARGE_BYTES:
        wrong = "large", "over 1 GiB"
    failed = None if wrong is None else Failed(number, target.name, *wrong)
    tally = Tally(1, int(refused), int(wrong is None and not refused), int(wrong is not None), seconds, took_bytes)
    return failed, tally


_PEAK = Path("/proc/self/clear_refs")


def _cpu_s() -> float:
    """Of this process and those that it waited for: others may use the machine."""
    return time.process_time() + sum(os.times()[2:4])


def _hang(*_: object) -> None:
    raise _HangsError


def _where(error: BaseException) -> str:
    """The kind of an error, and the last line of gtcal's on its way."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/gtcal/" in frame.filename]
    last = frames[-1] if frames else traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}: {' '.join(str(error).split())[:80]}"


def _virtual_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


# Spoiling

_TOKENS = [
    *b"1e308 -1e308 1e19 0 -1 1 nan .nan inf .inf -.inf NaN Infinity 1e-320 99999999999999999999999 0x7fffffff".split(),
    *b'true null ~ "" [] {} [[1]] *a &a &a[*a] ../../x /dev/zero . [[[[[[[[ {{{{ - : , ; " # \''.split(),
    *(b"\xff\xfe", b"\x00", b"\x1b[31m", b"\xe2\x80\xa8", b"\n\n", b" ", b"\t", b"9" * 400, b"[" * 2000, b"x" * 5000),
]
_WORD = re.compile(rb"[A-Za-z0-9_.+-]+")


def spoilt(content: bytes, randomness: random.Random) -> bytes:
    """The bytes, spoilt in one to four ways."""
    for _ in range(randomness.choice((1, 1, 1, 2, 2, 4))):
        content = randomness.choice(_WAYS)(content, randomness)
    return content


def _word(content: bytes, randomness: random.Random) -> bytes:
    """A word or number for another of those near it."""
    start = randomness.randrange(max(1, len(content) - 2**8))
    words = list(_WORD.finditer(content, start, start + 2**10))
    if not words:
        return content
    word = randomness.choice(words)
    other = randomness.choice(words)[0] if randomness.random() < 0.3 else randomness.choice(_TOKENS)
    return content[: word.start()] + other + content[word.end() :]


def _inserted(content: bytes, randomness: random.Random) -> bytes:
    at = randomness.randrange(len(content) + 1)
    return content[:at] + randomness.choice(_TOKENS) + content[at:]


def _flipped(content: bytes, randomness: random.Random) -> bytes:
    other = bytearray(content)
    for _ in range(randomness.choice((1, 1, 4, 16)) if content else 0):
        other[randomness.randrange(len(other))] = randomness.choice((0, 0xFF, 0x7F, 0x80, randomness.randrange(256)))
    return bytes(other)


def _number(content: bytes, randomness: random.Random) -> bytes:
    """Four or eight bytes for those of a large number, mostly near the start, where sizes stand."""
    at = randomness.randrange(max(1, min(len(content), 400 if randomness.random() < 0.7 else len(content))))
    value = randomness.choice((b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0" * 4, b"\0\0\0\x80", b"\xff" * 8, b"\0\0\x10\0"))
    return content[:at] + value + content[at + len(value) :]


def _cut(content: bytes, randomness: random.Random) -> bytes:
    return content[: randomness.randrange(len(content) + 1)]


def _removed(content: bytes, randomness: random.Random) -> bytes:
    start = randomness.randrange(len(content) + 1)
    return content[:start] + content[start + randomness.choice((1, 4, 40, 400)) :]


def _repeated(content: bytes, randomness: random.Random) -> bytes:
    start = randomness.randrange(len(content) + 1)
    part = content[start : start + randomness.choice((1, 10, 100, 1000))]
    return content[:start] + part * randomness.choice((2, 3, 50)) + content[start:]


def _lines(content: bytes, randomness: random.Random) -> bytes:
    """A line left out, twice, or in the place of another."""
    lines = content.split(b"\n")
    at, other = randomness.randrange(len(lines)), randomness.randrange(len(lines))
    return b"\n".join(randomness.choice((lines[:at] + lines[at + 1 :], [*lines[:at], lines[other], *lines[at:]])))


_WAYS = (_word, _word, _word, _inserted, _flipped, _number, _cut, _removed, _repeated, _lines)


# Good files of every kind


def good_files(folder: Path) -> list[Target]:
    """Files of all kinds written into a folder, and their readers."""
    texts = [*_recordings(folder), *_results(folder), *_camera_files(folder), *_mocap_files(folder)]
    return [*texts, *_c3d(folder), *_images(folder), *_bags(folder), *_videos(folder), *_vrs(folder)]


def _simulation():
    headset = quest3_like_rig()
    rig = replace(headset, cameras=headset.cameras[:2], rig_T_camera=headset.rig_T_camera[:2])
    return simulate(SimulationOptions(rig=rig, n_frames=8, duration_s=1.0, mocap_rate_hz=40.0), seed=1)


def _recordings(folder: Path) -> list[Target]:
    simulation = _simulation()
    write_simulation(simulation, folder / "rec", images=False)
    device = LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene)
    device = replace(device, n_frames=30, duration_s=2.0, mocap_rate_hz=40.0)
    write_lollypop_simulation(simulate_lollypop(device, seed=2), folder / "lollypop", images=False)
    targets = []
    for name, load in (("rec", load_recording), ("lollypop", load_lollypop_recording)):
        for file in sorted((folder / name).iterdir()):
            if file.name != "ground_truth.json":
                targets.append(Target(f"{name}/{file.name}", file, partial(load, folder / name), 0.1))
    manifest = folder / "rec/recording.yaml"
    targets.append(Target("rec/recording.yaml as named", manifest, partial(named_files, manifest)))
    targets.append(Target("ground truth", folder / "rec/ground_truth.json", partial(read_ground_truth, folder / "rec")))
    (folder / "board.yaml").write_text(
        "type: charuco\ndictionary: DICT_5X5_100\nsquare_columns: 8\nsquare_rows: 6\n"
        "square_side_m: 0.04\nmarker_side_m: 0.03\n"
    )
    (folder / "device.yaml").write_text("device: {preset: paper_lollypop}\n")
    (folder / "priors.yaml").write_text(
        "gtcal_priors: 1\nbody_T_board: {position_mm: [1, 2, 3], rotvec_deg: [0, 0, 90], sigma_mm: 1, sigma_deg: 0.5}\n"
        "cameras:\n  cam0: {intrinsics: {fx: {value: 500.0, sigma: 1.0}}}\n"
    )
    rows = "front_left,{},600.5,500.5,0.1,0.2,0.3\n"
    stamps_ns = simulation.recording.detections["front_left"].stamps_ns.tolist()
    markers = folder / "markers.csv"
    markers.write_text(",".join(COLUMNS) + "\n" + "".join(rows.format(stamp_ns) for stamp_ns in stamps_ns))
    return [
        *targets,
        Target("markers seen", markers, partial(read_marker_sightings, markers, simulation.recording)),
        Target("board", folder / "board.yaml", partial(load_board, str(folder / "board.yaml"))),
        Target("device", folder / "device.yaml", partial(read_device, folder / "device.yaml")),
        Target("priors", folder / "priors.yaml", partial(read_priors, folder / "priors.yaml")),
    ]


def _exact(simulation):
    cameras = simulation.options.rig.cameras
    poses = dict(simulation.truth.camera_T_ref)
    return exact_calibration(simulation.recording.capture, cameras, poses)


def _results(folder: Path) -> list[Target]:
    simulation = _simulation()
    calibration = _exact(simulation)
    write_calibration(folder / "cal.json", calibration)
    write_verification(folder / "ver.json", verify(load_lollypop_recording(folder / "lollypop"), calibration))
    found = next(iter(simulation.recording.detections.values()))
    _write_cache(folder / "cache.npz", found, {})
    return [
        Target("calibration", folder / "cal.json", partial(read_calibration, folder / "cal.json")),
        Target("verification", folder / "ver.json", partial(read_verification, folder / "ver.json")),
        Target("cache", folder / "cache.npz", partial(_read_cache, folder / "cache.npz", simulation.recording.board)),
        *_fleet(folder),
    ]


def _fleet(folder: Path) -> list[Target]:
    """What a batch reads and keeps."""
    (folder / "jobs.yaml").write_text(
        "gtcal_jobs: 1\noptions: {verify: {confidence: 0.9}}\njobs:\n  - {rig: a, recording: rec, taken: 2026-03-02}\n"
        "  - {rig: a, kind: verify, recording: lollypop, calibration: cal.json, options: {max_rmse_px: 1.0}}\n"
    )
    (folder / "jobs.csv").write_text("rig,kind,recording,taken,options.confidence\na,verify,lollypop,2026-03-03,0.9\n")
    record = Record("a", "calibrate", "rec", "k", "done", "", "", 1, True, "", {}, {}, (), "2026", 1.0, (), "0" * 64)
    write_text(folder / "record.json", record_text(record))
    with opened_index(folder / "index.sqlite") as connection:
        insert(connection, record, Contents())
    return [
        *(Target(name, folder / name, partial(read_jobs, folder / name), 0.3) for name in ("jobs.yaml", "jobs.csv")),
        Target("record", folder / "record.json", partial(read_record, folder / "record.json")),
        Target("index", folder / "index.sqlite", partial(_index_read, folder / "index.sqlite"), 0.3),
    ]


def _index_read(path: Path) -> None:
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    with opened_index(path) as connection:
        list(records(connection, current=False))


def _camera_files(folder: Path) -> list[Target]:
    rig = calibration_rig(read_calibration(folder / "cal.json"))
    suffixes = {"numpy": ".npz", "kalibr": ".yaml", "opencv": ".yml", "anipose": ".toml", "pose2sim": ".toml"}
    targets = []
    for name in CAMERA_FILE_WRITERS:
        path = folder / (f"rig_{name}" + ("" if name in FOLDER_FORMATS else suffixes.get(name, ".json")))
        write_rig(rig, path, name, [], nearest=True)
        share = {"ros_bag": 0.01, "ros": 0.4, "colmap": 0.4}.get(name, 1.0)
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            targets.append(Target(f"{name} {file.name}", file, partial(read_rig, path, name), share))
        if name not in ("anipose",):
            targets.append(Target(f"{name} by itself", file, partial(read_rig, path, None), share))
    return targets


def _mocap_files(folder: Path) -> list[Target]:
    a = from_zero(wandering_trajectory("a", n=30, interval_ns=10_000_000))
    poses, labels = a.world_T_body, tuple(f"a:m{i}" for i in range(len(CUBE_M)))
    markers = dict(zip(labels, np.moveaxis(markers_of(poses), 1, 0), strict=True))
    write_motive(folder / "motive.csv", {"a": poses}, markers=markers, rate_hz=100.0)
    write_vicon(folder / "vicon.csv", segments={"a:root": poses})
    write_qualisys(folder / "qualisys.tsv", {"a": poses})
    write_trc(folder / "markers.trc", markers)
    write_euroc_csv(folder / "euroc.csv", a)
    write_tum(folder / "tum.txt", a)
    kinds = {
        "motive.csv": ("motive_csv", BodySelection()),
        "vicon.csv": ("vicon_csv", BodySelection(rotation="helical")),
        "qualisys.tsv": ("qualisys_tsv", BodySelection()),
        "markers.trc": ("trc", BodySelection(markers=labels)),
        "euroc.csv": ("euroc_csv", BodySelection()),
        "tum.txt": ("tum", BodySelection()),
    }
    targets = []
    for file, (kind, selection) in kinds.items():
        path = folder / file
        targets.append(Target(kind, path, partial(TRAJECTORY_READERS[kind], path, "a", PoseConventions(), selection)))
        targets.append(Target(f"{kind} summed up", path, partial(inspect_mocap, path)))
    write_pose_list(folder / "poses.csv", np.arange(len(poses)), poses)
    np.save(folder / "poses.npy", poses)
    for file in ("poses.csv", "poses.npy"):
        stated = PoseConventions(length_unit="m", quaternion="xyzw" if file == "poses.csv" else None)
        read = partial(read_pose_list, folder / file, "a", stated, BodySelection())
        targets.append(Target(file, folder / file, read))
    return targets


def _c3d(folder: Path) -> list[Target]:
    """A C3D file; none where its library is missing."""
    if find_spec("ezc3d") is None:
        return []
    poses = from_zero(wandering_trajectory("a", n=30, interval_ns=10_000_000)).world_T_body
    labels = tuple(f"m{i}" for i in range(len(CUBE_M)))
    path = write_c3d(folder / "markers.c3d", dict(zip(labels, np.moveaxis(markers_of(poses), 1, 0), strict=True)))
    return [Target("c3d", path, partial(read_c3d, path, "a", PoseConventions(), BodySelection(markers=labels)), 0.1)]


def _images(folder: Path) -> list[Target]:
    image = np.random.default_rng(1).integers(0, 255, (48, 64), dtype=np.uint8)
    (folder / "images").mkdir()
    for i, suffix in enumerate((".png", ".jpg", ".tiff", ".bmp", ".webp", ".pgm")):
        cv2.imwrite(str(folder / "images" / f"{1_000_000_000 + 50_000_000 * i}{suffix}"), image)
    names = sorted(file.name for file in (folder / "images").iterdir())
    listing = folder / "list.csv"
    listing.write_text("#timestamp [ns],filename\n" + "".join(f"{name.split('.')[0]},{name}\n" for name in names))
    return [
        *(
            Target(f"image {Path(name).suffix}", folder / "images" / name, partial(read_grey, folder / "images" / name))
            for name in names
        ),
        Target("image list", listing, partial(image_list, listing, folder / "images")),
        Target("image folder", folder / "images" / names[0], partial(image_folder, folder / "images")),
    ]


def _read_all(images: Images) -> None:
    for index in range(len(images)):
        images.read(index)


def _bags(folder: Path) -> list[Target]:
    """Bags of images and of poses, as ROS 1, SQLite and MCAP hold them; none where rosbags is missing."""
    if find_spec("rosbags") is None:
        return []
    image = np.random.default_rng(1).integers(0, 255, (12, 16), dtype=np.uint8)
    _, png = cv2.imencode(".png", image)
    rows = [(EPOCH_NS + 10**8 * i, EPOCH_NS + 10**8 * i, image_message(image)) for i in range(3)]
    packed = [(received, header, compressed_message(png.tobytes())) for received, header, _ in rows]
    targets = []
    for storage, name in (("ros1", "images.bag"), ("sqlite3", "images_sqlite"), ("mcap", "images_mcap")):
        path = write_bag(folder / name, {"/raw": rows, "/packed": packed}, storage=storage)
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            for topic in ("/raw", "/packed"):
                read = partial(_bag_read, path, topic)
                targets.append(Target(f"bag {storage} {file.suffix} {topic}", file, read, 0.03))
    poses = {"platform": wandering_trajectory("platform", n=20)}
    write_rosbag(folder, poses)
    for file in sorted((folder / "take").iterdir()):
        targets.append(Target(f"bag of poses {file.suffix}", file, partial(read_rosbag_takes, folder / "take"), 0.03))
    return targets


def _bag_read(path: Path, topic: str) -> None:
    _read_all(bag_images(path, topic))


def _videos(folder: Path) -> list[Target]:
    """Videos in two containers; none where PyAV is missing."""
    if find_spec("av") is None:
        return []
    image = np.random.default_rng(1).integers(0, 255, (48, 64), dtype=np.uint8)
    targets = []
    for name, codec, pixels in (("ffv1.mkv", "ffv1", "gray"), ("h264.mp4", "libx264", "yuv420p")):
        path = write_video(folder / name, [image] * 4, [0, 40, 80, 120], codec=codec, pixel_format=pixels)
        targets.append(Target(f"video {name}", path, partial(_video_read, path)))
    return targets


def _video_read(path: Path) -> None:
    _read_all(video_images(path, 0))


def _vrs(folder: Path) -> list[Target]:
    """A VRS file; none where its reader is missing."""
    if find_spec("pyvrs") is None:
        return []
    image = np.random.default_rng(1).integers(0, 255, (12, 16), dtype=np.uint8)
    stamps_ns = [EPOCH_NS + 10**8 * i for i in range(4)]
    path = write_vrs(folder / "glasses.vrs", [image_stream([image] * 4, [0.1, 0.2, 0.3, 0.4], stamps_ns)])
    return [Target("vrs", path, partial(_vrs_read, path), 0.005)]


def _vrs_read(path: Path) -> None:
    _read_all(vrs_images(path, "1201-1"))


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
