"""How long an operator waits for a verdict: from the end of a recording of 30 s to the line that 'gtcal watch' prints.

A recording of the Lollypop (4 cameras, 30 Hz) comes into the folder that a station watches as a recorder writes it:
images while it goes on, the mocap's poses and the manifest at its end. Once as images on disk (1280 x 1024 at
--image-scale 1), once as files of detections. Of the images every third is rendered, those that the station looks at;
the two between are copies of it, which are read too, to be fingerprinted. Two cores at most.

    python scripts/benchmark_watch.py --duration-s 10 --image-scale 0.5
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import yaml
from rich.console import Console
from rich.table import Table

from gtcal.results.calibration_file import write_calibration
from gtcal.simulation import quest3_like_rig
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop_guide import LOOKED_AT_HZ

COPIES = 2
"""Behind each rendered image."""


@dataclass(frozen=True)
class Waited:
    """kind: what came. mb: so much of it. seconds: from its last file's end to the verdict, of which settle_s are the
    station's own patience. cpu_s: what it took of a core meanwhile."""

    kind: str
    n_files: int
    mb: float
    seconds: float
    settle_s: float
    cpu_s: float
    verdict: str


def prepared(folder: Path, duration_s: float, scale: float, images: bool) -> Path:
    """The recording as it will come, and calibration.json beside it; as it is where it was made before."""
    if (folder / "calibration.json").is_file():
        return folder / "recording"
    options = LollypopOptions(
        rig=quest3_like_rig().scaled(scale), duration_s=duration_s, camera_rate_hz=LOOKED_AT_HZ if images else 30.0
    )
    simulation = simulate_lollypop(options, seed=3)
    write_lollypop_simulation(simulation, folder / "recording", images=images)
    if images:
        with_copies(folder / "recording", duration_s)
    write_calibration(folder / "calibration.json", simulation.true_calibration())
    return folder / "recording"


def with_copies(recording: Path, duration_s: float) -> None:
    """Between two images, copies of the first, at 30 Hz together."""
    step_ns = round(1e9 / LOOKED_AT_HZ / (COPIES + 1))
    manifest = yaml.safe_load((recording / "recording.yaml").read_text())
    for entry in manifest["cameras"].values():
        for image in sorted((recording / entry["images"]).glob("*.png")):
            for number in range(1, COPIES + 1):
                shutil.copyfile(image, image.with_name(f"{int(image.stem) + number * step_ns}.png"))


def come(source: Path, target: Path, duration_s: float) -> float:
    """Copy a recording as a recorder writes it, in its own time. Returns when its last file was there."""
    images = sorted(source.rglob("*.png"), key=lambda path: (int(path.stem), path.parent))
    rest = sorted((p for p in source.iterdir() if p.is_file()), key=lambda path: path.name == "recording.yaml")
    began = time.monotonic()
    for number, image in enumerate(images):
        time.sleep(max(0.0, began + duration_s * number / len(images) - time.monotonic()))
        path = target / image.relative_to(source)
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(image, path)
    target.mkdir(parents=True, exist_ok=True)
    if not images:
        time.sleep(duration_s)
    for file in rest:
        shutil.copyfile(file, target / file.name)
    return time.monotonic()


def cpu_s(pid: int) -> float:
    """Of a process and those below it."""
    own = psutil.Process(pid)
    return float(sum(sum(each.cpu_times()[:2]) for each in (own, *own.children(recursive=True))))


def waited(folder: Path, source: Path, kind: str, duration_s: float, settle_s: float) -> Waited:
    """Let one recording come into a folder that a station watches."""
    arriving = folder / "arriving"
    arriving.mkdir()
    command = [sys.executable, "-m", "gtcal", "watch", str(arriving), "-s", str(folder / "store"), "--rig", "rig01"]
    command += ["--calibration", str(source.with_name("calibration.json")), "--count", "2"]
    command += ["--settle-s", str(settle_s), "--taken-from", "name", "--jobs", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as station:
        assert station.stdout is not None
        assert station.stderr is not None
        station.stderr.readline()  # it watches
        ended = come(source, arriving / "2026-03-02_lollypop", duration_s)
        before_s = cpu_s(station.pid)
        said = json.loads(station.stdout.readline())
        seconds, taken_s = time.monotonic() - ended, cpu_s(station.pid) - before_s
        station.terminate()
    files = [path for path in source.rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    return Waited(kind, len(files), size / 1e6, seconds, settle_s, taken_s, said["verdict"] or said["error"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration-s", type=float, default=30.0, help="of the recording (default: %(default)s)")
    parser.add_argument("--image-scale", type=float, default=1.0, help="of 1280 x 1024 (default: %(default)s)")
    parser.add_argument("--keep", type=Path, help="folder for the simulated recordings, taken from there if they are")
    parser.add_argument("--settle-s", type=float, default=2.0, help="as of 'gtcal watch' (default: %(default)s)")
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    table = Table(title=f"from the end of a recording of {arguments.duration_s:g} s to the verdict, on two cores")
    for heading in ("recorded as", "files", "MB", "s", "of these to settle", "of a core, s", "verdict"):
        table.add_column(heading, justify="left" if heading in ("recorded as", "verdict") else "right")
    for kind in ("images", "detections"):
        with tempfile.TemporaryDirectory() as name:
            kept = (arguments.keep or Path(name)) / f"{kind}-{arguments.duration_s:g}-{arguments.image_scale:g}"
            source = prepared(kept, arguments.duration_s, arguments.image_scale, kind == "images")
            found = waited(Path(name), source, kind, arguments.duration_s, arguments.settle_s)
        table.add_row(
            found.kind,
            f"{found.n_files:,}",
            f"{found.mb:,.0f}",
            f"{found.seconds:.1f}",
            f"{found.settle_s:g}",
            f"{found.cpu_s:.1f}",
            found.verdict,
        )
    Console().print(table)


if __name__ == "__main__":
    main()
