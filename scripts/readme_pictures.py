"""The README's pictures, made by the program itself.

Runs 'gtcal demo' and takes a screenshot of the top of its report in a headless Chromium (without one, that picture is
left as it is, which one line says), then runs scripts/figure_heatmaps.py.

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
LARGEST_KB = 300
HEAT_MAPS = Path(__file__).parent / "figure_heatmaps.py"


def report_picture(chromium: str, work: Path, output: Path) -> None:
    """The demo's report, down to its worst frames."""
    demo, shot = work / "demo", work / "report.png"
    _run(sys.executable, "-m", "gtcal", "demo", "--output", str(demo), "--quiet")
    size = "--window-size={},{}".format(*REPORT_SIZE_PX)
    page = (demo / "report.html").resolve().as_uri()
    _run(chromium, *FLAGS, f"--user-data-dir={work / 'profile'}", size, f"--screenshot={shot}", page)
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
            print(f"report.png: skipped: no Chromium is installed (none of {', '.join(CHROMIUMS)} is on the path)")
        else:
            with console.status("running the demo, a minute or so"):
                report_picture(chromium, Path(work), folder / "report.png")
            print(f"written: {folder / 'report.png'}")
        with console.status("drawing the heat maps"):
            heat_map_picture(Path(work), folder / "heatmaps.png")
        print(f"written: {folder / 'heatmaps.png'}")


if __name__ == "__main__":
    main()
