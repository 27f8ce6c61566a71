"""What ten million corners take: from files of detections on disk to calibration.json, time by phase and peak memory.

Simulates a headset and a board, both tracked, four cameras at 30 Hz (corners, not images), and writes the recording
once with Parquet and once with CSV. Then, in a process of its own each, as `gtcal calibrate` does it: start Python and
the libraries, read, calibrate with all that it does by default, write. Beside the time that passed, that of the CPU,
which other work on the machine makes no longer; and the same for a recording a tenth as long, which a linear growth
takes a tenth of the time for.

    python scripts/benchmark_large.py                    # 33,000 frames
    python scripts/benchmark_large.py --frames 3300      # a tenth of it
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.table import Table

from gtcal import CalibrationOptions, calibrate, load_recording, write_calibration
from gtcal.cores import n_cores
from gtcal.recordings.detection_files import DetectionFormat
from gtcal.recordings.recording import write_recording
from gtcal.simulation import simulate


def write_recordings(n_frames: int, folder: Path) -> None:
    """The same recording in a folder of each format's name."""
    from benchmark_solve import options_of  # what is measured does without its libraries

    recording = simulate(options_of(n_frames), seed=0).recording
    for detection_format in get_args(DetectionFormat):
        write_recording(recording, folder / detection_format, detection_format=detection_format)


def one_recording(recording: Path, output: Path) -> None:
    """Calibrate, and print what each part took, as JSON."""
    seconds = {"start Python, libraries": (time.time() - started_at(), time.process_time())}
    with timed(seconds, "read"):
        loaded = load_recording(recording)
    with timed(seconds, "calibrate"):
        found = calibrate(loaded, CalibrationOptions())
    with timed(seconds, "write"):
        write_calibration(output, found)
    stages = {f"stage {stage.stage}: {stage.name}": stage.iterations for stage in found.stages if stage.stage > 1}
    n_corners = sum(detections.n_corners for detections in loaded.detections.values())
    print(json.dumps({"seconds": seconds, "iterations": stages, "corners": n_corners, "peak_mib": peak_mib()}))


@contextmanager
def timed(seconds: dict[str, tuple[float, float]], what: str) -> Iterator[None]:
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    seconds[what] = time.perf_counter() - wall, time.process_time() - cpu


def started_at() -> float:
    """When this process was started, s since the epoch (Linux)."""
    ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    booted = re.search(r"btime (\d+)", Path("/proc/stat").read_text())
    return int(booted[1]) + ticks / os.sysconf("SC_CLK_TCK")


def peak_mib() -> float:
    """Of this process since it was started (Linux)."""
    return int(re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024


def measured(recording: Path, output: Path) -> dict:
    command = [sys.executable, __file__, "--recording", str(recording), str(output)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def table_of(sizes: list[int], console: Console) -> None:
    table = Table("frames", "corners", "files", title="s that passed (of CPU)", title_justify="left")
    columns = ("start Python, libraries", "read", "calibrate", "write")
    for heading in (*columns, "all of it", "peak memory, MiB", "iterations of stages 2, 3, 4"):
        table.add_column(heading, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        for n_frames in sizes:
            with console.status(f"simulating {n_frames:,} frames"):
                write_recordings(n_frames, Path(folder) / f"{n_frames}")
            for detection_format in get_args(DetectionFormat):
                with console.status(f"{n_frames:,} frames, {detection_format}"):
                    found = measured(Path(folder) / f"{n_frames}" / detection_format, Path(folder) / "calibration.json")
                seconds = found["seconds"]
                seconds["all of it"] = tuple(map(sum, zip(*seconds.values(), strict=True)))
                table.add_row(
                    f"{n_frames:,}",
                    f"{found['corners']:,}",
                    detection_format,
                    *(f"{seconds[part][0]:.1f} ({seconds[part][1]:.1f})" for part in (*columns, "all of it")),
                    f"{found['peak_mib']:.0f}",
                    ", ".join(f"{count}" for count in found["iterations"].values()),
                )
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=33_000)
    parser.add_argument("--recording", type=Path, nargs=2, metavar=("FOLDER", "OUTPUT"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.recording:
        one_recording(*arguments.recording)
        return
    console = Console(width=150)
    console.print(f"{n_cores()} cores, load {os.getloadavg()[0]:.1f} before")
    table_of([max(arguments.frames // 10, 300), arguments.frames], console)


if __name__ == "__main__":
    main()
