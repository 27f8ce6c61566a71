"""Run the studies again whose results stand in scripts/RESULTS.md, and write what they print in place of what is there.

    python scripts/results.py --list                 # which there are
    python scripts/results.py study_basins.py        # one of them, or several
    python scripts/results.py "benchmark_fleet.py site"        # of a script's several, that with these arguments
    python scripts/results.py                        # all: hours

A block of RESULTS.md follows a line `<!-- run: SCRIPT ARGUMENTS -->`; what the script prints takes the place of the
text blocks up to the next heading, with a stamp: date, version, machine. Blocks of `<!-- with data: ... -->` stay as
they are: their data are not here.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "RESULTS.md"
_RUN = re.compile(
    r"<!-- run: (?P<command>\S+\.py[^>]*?) -->\n(?P<pictures>(?:!\[[^\n]*\n\n?)*)(?P<printed>.*?)(?=\n## |\Z)",
    re.DOTALL,
)
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_WIDTH = "150"


def commands(text: str) -> list[str]:
    """The studies that a file of results names, with their arguments."""
    return [found["command"] for found in _RUN.finditer(text)]


def names(name: str, command: str) -> bool:
    """Whether it is the command's script, or how the command begins."""
    return command.split()[: len(name.split())] == name.split()


def renewed(text: str, command: str, printed: str, stamp: str) -> str:
    """The file of results with what this command printed, and the stamp."""

    def with_new(found: re.Match[str]) -> str:
        if found["command"] != command:
            return found[0]
        return f"<!-- run: {command} -->\n{found['pictures']}```text\n{printed.strip()}\n```\n\n{stamp}\n"

    return _RUN.sub(with_new, text)


def printed_by(command: str) -> str:
    """What a script prints. Raises subprocess.CalledProcessError where it fails."""
    script, *arguments = command.split()
    environment = os.environ | {"COLUMNS": _WIDTH}
    run = [sys.executable, str(HERE / script), *arguments]
    ran = subprocess.run(run, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return "\n".join(line.rstrip() for line in _COLOURS.sub("", ran.stdout).splitlines())


def stamp_of_now() -> str:
    """Date, version and machine."""
    day = datetime.now(UTC).strftime("%Y-%m-%d")
    return f"Printed on {day} by gtcal {version('gtcal')}, {os.cpu_count()} cores of {_processor()}."


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE) if info.is_file() else []
    return names[0] if names else platform.processor() or platform.machine()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scripts", nargs="*", help="names of scripts, or commands; all of them by default")
    parser.add_argument("--list", action="store_true", help="print the commands, and run nothing")
    arguments = parser.parse_args()
    known = commands(RESULTS.read_text(encoding="utf-8"))
    wrong = [name for name in arguments.scripts if not any(names(name, command) for command in known)]
    if wrong:
        parser.error(f"{wrong[0]}: RESULTS.md has no results of it; it has those of {', '.join(known)}")
    for command in known:
        if arguments.scripts and not any(names(name, command) for name in arguments.scripts):
            continue
        print(command, flush=True)
        if not arguments.list:
            printed = printed_by(command)  # before the file is read: others may have written it meanwhile
            text = renewed(RESULTS.read_text(encoding="utf-8"), command, printed, stamp_of_now())
            RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
