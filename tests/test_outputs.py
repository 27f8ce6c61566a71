"""What is written never takes the place of what is read, nor of what is no file; and that is asked before the work."""

from __future__ import annotations

import inspect
import json
import os
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from calibration_support import HEADSET, simulated
from cli_support import files_in, run

from gtcal.cli import COMMANDS
from gtcal.errors import GtcalError
from gtcal.files import check_outputs, write_aside, write_folder, write_text
from gtcal.simulation import write_simulation
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation

OUTPUTS = ("output", "report", "csv", "figure", "sightings")
"""What commands call the paths that they write to."""

# By command: its arguments without outputs, and a file that it reads.
READING: dict[str, tuple[list[str], str]] = {
    "calibrate": (["rec"], "rec/platform.csv"),
    "doctor": (["rec"], "rec/platform.csv"),
    "info": (["rec"], "rec/recording.yaml"),
    "selfcheck": (["rec"], "rec/board_body.csv"),
    "compare": (["rec", "--lollypop", "lollypop"], "lollypop/device_body.csv"),
    "uncertainty": (["cal.json"], "cal.json"),
    "verify": (["cal.json", "lollypop"], "lollypop/device_body.csv"),
    "drift": (["cal.json", "lollypop"], "cal.json"),
    "diff": (["cal.json", "other.json"], "other.json"),
    "report": (["cal.json", "--recording", "rec", "--lollypop", "lollypop"], "rec/board_body.csv"),
    "export": (["cal.json", "--to", "kalibr", "--nearest"], "cal.json"),
    "convert": (["rec/platform.csv", "--to", "tum"], "rec/platform.csv"),
    "board": (["--file", "board.yaml"], "board.yaml"),
    "init": (["rec", "--force"], "rec/platform.csv"),
    "detect": (["rec"], ""),  # what it writes has the cameras' names; below
    "simulate": ([], ""),  # a folder, which has to be new or empty
    "demo": ([], ""),  # the same
    "schema": ([], ""),  # reads nothing
    "completion": (["bash"], ""),  # the same
    "guide": (["trust"], ""),  # only its own chapters
    "batch": ([], ""),  # into a store, which is new or one of gtcal's own; test_fleet.py
    "history": ([], ""),  # of a store
    "watch": ([], ""),  # runs on and on
    "site": ([], ""),  # of a store, into a folder that has to be new or a site
}


def outputs_of(command: str) -> list[str]:
    parameters = inspect.signature(getattr(import_module(f"gtcal.cli.{command}"), command)).parameters
    return [name for name in parameters if name in OUTPUTS]


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings, a calibration and a board."""
    folder = tmp_path_factory.mktemp("outputs")
    simulation = simulated(HEADSET)
    write_simulation(simulation, folder / "rec", images=False)
    device = LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene, n_frames=60)
    write_lollypop_simulation(simulate_lollypop(device, seed=2), folder / "lollypop", images=False)
    (folder / "board.yaml").write_text("preset: paper_a2\n")
    assert run("calibrate", folder / "rec", "-o", folder / "cal.json", "--no-effects", "-q").code == 0
    (folder / "other.json").write_text((folder / "cal.json").read_text() + "\n")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in files_in(folder) if ".gtcal" not in name}


CASES = [(command, option) for command, (_, read) in READING.items() if read for option in outputs_of(command)]


def test_every_command_is_thought_of() -> None:
    assert set(READING) == set(COMMANDS)


@pytest.mark.parametrize("by", ["name", "link", "hard link"])
@pytest.mark.parametrize(("command", "option"), CASES)
def test_no_output_is_an_input(
    command: str, option: str, by: str, ground: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments, read = READING[command]
    target = tmp_path / f"it{Path(read).suffix}"
    if by == "link":
        target.symlink_to(ground / read)
    elif by == "hard link":
        os.link(ground / read, target)
    else:
        target = ground / read
    before = contents(ground)
    monkeypatch.chdir(ground)
    ran = run(command, *arguments, f"--{option}", target)
    assert ran.code == 1
    assert str(target) in ran.err
    assert "give another file" in ran.err
    assert ran.err.count("\n") == 1
    assert contents(ground) == before


def test_corners_do_not_take_the_place_of_corners_that_are_read(ground: Path) -> None:
    folder = ground / "renamed"
    folder.mkdir()
    for file in (ground / "rec").iterdir():
        if file.is_file():
            (folder / file.name.replace("_detections", "")).write_bytes(file.read_bytes())
    manifest = folder / "recording.yaml"
    manifest.write_text(manifest.read_text().replace("_detections.csv", ".csv"))
    before = contents(folder)
    ran = run("detect", folder, "-o", folder)
    assert ran.code == 1
    assert "is what is read here" in ran.err
    assert contents(folder) == before


@pytest.mark.parametrize(("command", "option"), CASES)
def test_what_can_not_be_written_is_told_before_the_work(
    command: str, option: str, ground: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ground)
    before = contents(ground)
    ran = run(command, *READING[command][0], f"--{option}", "/proc/no/such/out.png")
    assert ran.code == 1
    assert "can't be written" in ran.err
    assert contents(ground) == before  # not even the other outputs


def test_two_outputs_are_two_files(ground: Path, tmp_path: Path) -> None:
    ran = run("calibrate", ground / "rec", "-o", tmp_path / "a", "--report", tmp_path / "b" / ".." / "a")
    assert ran.code == 1
    assert "written twice" in ran.err


def test_an_output_is_of_its_kind(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GtcalError, match="is a folder; give a file"):
        check_outputs([tmp_path])
    with pytest.raises(GtcalError, match="is a file; give a folder"):
        check_outputs([tmp_path / "file"], folders=True)
    for impossible in ("x" * 300, "x/" * 3000, "file/inside", "nul\0"):
        with pytest.raises(GtcalError, match="can't be written"):
            check_outputs([tmp_path / impossible])
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere" / "file")
    for text in ("new", "again"):  # dangling at first
        write_text(tmp_path / "link", text)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "elsewhere" / "file").read_text() == text
    (tmp_path / "elsewhere" / "folder").mkdir()
    (tmp_path / "elsewhere" / "folder" / "a").symlink_to(tmp_path / "elsewhere" / "file")
    (tmp_path / "to_folder").symlink_to(tmp_path / "elsewhere" / "folder")
    write_folder(tmp_path / "to_folder", {"a": "through both"})
    assert (tmp_path / "to_folder").is_symlink()
    assert (tmp_path / "elsewhere" / "file").read_text() == "through both"


@pytest.fixture
def fifo(tmp_path: Path) -> Iterator[tuple[Path, list[bytes]]]:
    """A named pipe, and what its reader got out of it."""
    path, got = tmp_path / "pipe", []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: got.append(path.read_bytes()))
    reader.start()
    yield path, got
    reader.join(timeout=10)


def test_a_pipe_is_written_to_as_it_is(fifo: tuple[Path, list[bytes]]) -> None:
    path, got = fifo
    check_outputs([path, path])
    with write_aside(path, binary=True) as file:
        file.write(b"tail")
        file.seek(0)  # as writers of archives do
        file.write(b"head")
    while not got:
        pass
    assert got == [b"head"]
    assert stat.S_ISFIFO(path.stat().st_mode)
    assert list(path.parent.iterdir()) == [path]


def test_a_device_stays_one() -> None:
    check_outputs([Path("/dev/null")])
    write_text(Path("/dev/null"), "gone")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        ["uncertainty", "cal.json", "--output"],
        ["diff", "cal.json", "other.json", "--output=/dev/stdout"],
        ["drift", "cal.json", "lollypop", "--output"],
        ["schema", "-o"],
    ],
)
def test_what_reads_standard_output_gets_the_file_and_no_words(arguments: list[str], ground: Path) -> None:
    stdout = [] if arguments[-1].endswith("/dev/stdout") else ["/dev/stdout"]
    command = [sys.executable, "-m", "gtcal", *arguments, *stdout]
    done = subprocess.run(command, cwd=ground, capture_output=True, timeout=120)
    assert done.returncode in (0, 3, 4)
    json.loads(done.stdout)
    assert done.stderr or arguments[0] == "schema"


@pytest.mark.long
@pytest.mark.parametrize("to", ["pipe", "file"])
def test_standard_output_takes_a_file(to: str, ground: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gtcal", "export", "cal.json", "--to", "numpy", "-o", "/dev/stdout"]
    with (tmp_path / "out").open("wb") as file:
        done = subprocess.run(
            command,
            cwd=ground,
            stdout=subprocess.PIPE if to == "pipe" else file,
            stderr=subprocess.PIPE,
            check=True,
            timeout=60,
        )
    text = done.stdout if to == "pipe" else (tmp_path / "out").read_bytes()
    assert text.startswith(b"PK")
    assert b"wrote" not in text  # the words are elsewhere
    assert b"wrote /dev/stdout" in done.stderr


def test_a_long_name_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / ("é" * 120 + ".json")
    check_outputs([path])
    write_text(path, "{}")
    assert path.read_text() == "{}"
