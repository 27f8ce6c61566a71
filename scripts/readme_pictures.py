"""The README's pictures, made by the program itself.

Runs 'gtcal demo' and 'gtcal demo --fleet' and takes screenshots of the top of the report and of the fleet's page in a
headless Chromium (without one, those pictures are left as they are, which one line says), then runs
scripts/figure_heatmaps.py.

    python scripts/readme_pictures.py
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from rich.console import Console

CHROMIUMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--virtual-time-budget=4000",  # ms, for the 3-D view to be drawn
)
REPORT_SIZE_PX = (1100, 1391)
FLEET_SIZE_PX = (1240, 590)
LARGEST_KB = 300
HEAT_MAPS = Path(__file__).parent / "figure_heatmaps.py"


def report_picture(chromium: str, work: Path, output: Path) -> None:
    """The demo's report, down to its worst frames."""
    demo = work / "demo"
    _run(sys.executable, "-m", "gtcal", "demo", "--output", str(demo), "--quiet")
    screenshot(chromium, work, demo / "report.html", REPORT_SIZE_PX, output)


def fleet_picture(chromium: str, work: Path, output: Path) -> None:
    """The fleet's page of the demo's site."""
    demo = work / "fleet"
    _run(sys.executable, "-m", "gtcal", "demo", "--fleet", "--output", str(demo), "--quiet")
    screenshot(chromium, work, demo / "site" / "index.html", FLEET_SIZE_PX, output)


def screenshot(chromium: str, work: Path, page: Path, size_px: tuple[int, int], output: Path) -> None:
    """The top of a page, in a window of this size."""
    shot, size = work / output.name, "--window-size={},{}".format(*size_px)
    profile = f"--user-data-dir={work / 'profile'}"
    _run(chromium, *FLAGS, profile, size, f"--screenshot={shot}", page.resolve().as_uri())
    _save_small(shot, output)


def heat_map_picture(work: Path, output: Path) -> None:
    _run(sys.executable, str(HEAT_MAPS), "--output", str(work / "heatmaps"))
    _save_small(work / "heatmaps.png", output)


def _save_small(shot: Path, output: Path) -> None:
    """With a palette. Stops where that is still too large for a README."""
    small = shot.with_suffix(".small.png")
    Image.open(shot).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(small, optimize=True)
    size_kb = small.stat().st_size / 1000
    if size_kb > LARGEST_KB:
        raise SystemExit(f"{output}: would have {size_kb:.0f} kB; a README's picture has {LARGEST_KB} kB at most")
    output.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(small, output)


def _run(*command: str) -> None:
    """Stops with what the command says where it fails."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: failed with exit code {done.returncode}\n{done.stderr}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path(__file__).parent / "pictures",
        help="folder to write the pictures into",
    )
    folder: Path = parser.parse_args().output
    console = Console(stderr=True)
    chromium = next(filter(None, map(shutil.which, CHROMIUMS)), None)
    with tempfile.TemporaryDirectory() as work:
        if chromium is None:
            print(f"report.png, fleet.png: skipped: no Chromium is on the path (none of {', '.join(CHROMIUMS)})")
        else:
            with console.status("running the demo, a minute or so"):
                report_picture(chromium, Path(work), folder / "report.png")
            print(f"written: {folder / 'report.png'}")
            with console.status("running the demo of a fleet, a few minutes"):
                fleet_picture(chromium, Path(work), folder / "fleet.png")
            print(f"written: {folder / 'fleet.png'}")
        with console.status("drawing the heat maps"):
            heat_map_picture(Path(work), folder / "heatmaps.png")
        print(f"written: {folder / 'heatmaps.png'}")


if __name__ == "__main__":
    main()
