"""The same rig, days later: what moved, and a calibration that goes on from the earlier one.

Simulates a headset's recording and another one some days later, before which a camera was bumped; calibrates both, and
shows what 'gtcal diff' and 'gtcal calibrate --from' say of them. Each command is printed with its output.

    python scripts/example_next_day.py
    python scripts/example_next_day.py --figure moved.png
"""

from __future__ import annotations

import argparse
import os
import shlex
import tempfile
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from gtcal import read_calibration
from gtcal.cli import main as gtcal

QUIET = (
    "simulate -o monday --seed 3 -q",
    "simulate -o friday --seed 3 --take 2 --fault camera --fault-camera side_left --frames 20 -q",
)
SHOWN = (
    "calibrate monday -o monday.json -q",
    "calibrate friday -o friday.json -q",
    "diff monday.json friday.json --figure moved.png",
    "calibrate friday --from monday.json --from-days 4 -o from_monday.json -q",
    "calibrate monday friday -o both.json -q",
)
RESULTS = {"friday alone": "friday.json", "from monday, 4 days ago": "from_monday.json", "together": "both.json"}


def shown(command: str) -> None:
    """Run a command and print it as a person types it, with what it says."""
    print(f"$ gtcal {command}", flush=True)
    gtcal(shlex.split(command))


def sigmas() -> Table:
    """How sure each calibration of the last recording is."""
    table = Table(title="largest 1-sigma of a camera's place, mm", box=box.SIMPLE_HEAD, title_justify="left")
    found = {name: read_calibration(path) for name, path in RESULTS.items()}
    cameras = list(next(iter(found.values())).cameras)
    for heading in ("", *cameras):
        table.add_column(heading, justify="right" if heading else "left")
    for name, calibration in found.items():
        poses = [calibration.cameras[camera].camera_T_ref for camera in cameras]
        largest = [
            max(pose.position_of_a_in_b_sigma_mm) for pose in poses if pose.position_of_a_in_b_sigma_mm is not None
        ]
        table.add_row(name, *(f"{mm:.3f}" for mm in largest))
    return table


def carried_over_lines() -> list[str]:
    """What the second calibration says of the first."""
    carried = read_calibration(RESULTS["from monday, 4 days ago"]).carried_over
    assert carried is not None
    return [carried.statement, *(f"since then: {line}" for line in carried.moved)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, help="where to keep the figure of the difference")
    figure = parser.parse_args().figure
    kept = None if figure is None else figure.resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for command in (*QUIET, *SHOWN):
            shown(command)
        Console(width=100).print(sigmas())
        for line in carried_over_lines():
            print(line)
        if kept is not None:
            kept.write_bytes(Path("moved.png").read_bytes())


if __name__ == "__main__":
    main()
