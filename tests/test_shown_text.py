"""Text from outside acts on nothing: no terminal, no page, no figure, no spreadsheet."""

from __future__ import annotations

import csv
import logging
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from calibration_support import HEADSET, simulated
from cli_support import run
from rich.console import Group
from rich.table import Table
from rich.text import Text

from gtcal.cli.terminal import Terminal
from gtcal.names import fault_of_name
from gtcal.plain import OneLine, csv_cell, one_line, printable, xml_text
from gtcal.recordings.recording import write_recording
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.lollypop_recording import write_lollypop_recording

HOSTILE = ("[red]left[bold]", "=1+1", "$a^2$ <b>&amp;", ":smile: \u202eevil")


def test_a_terminal_shows_text_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    table = Table(title="[bold]title", caption="[/nonsense]")
    table.add_column("[/red]")
    table.add_row("[/red] \x1b[31m \x9b")
    Terminal(width=80).print(Group(table, Text("\x1b]0;title\x07")), "[/red] :smile:")
    shown = capsys.readouterr().out
    for part in ("[bold]title", "[/nonsense]", "[/red]", "\\x1b[31m", "\\x9b", "\\x1b]0;title", ":smile:"):
        assert part in shown
    assert all(letter.isprintable() or letter == "\n" for letter in shown)


def test_every_control_character_is_shown_and_none_acts() -> None:
    every = "".join(map(chr, range(0x3000))) + "\ud800"
    assert not {letter for letter in printable(every) if not letter.isprintable() and ord(letter) < 0xA0} - {"\n", "\t"}
    assert "\n" not in one_line(every)
    printable(every).encode()
    record = logging.LogRecord("gtcal", logging.WARNING, "", 0, "%s", ("two\nlines\x1b",), None)
    assert OneLine("%(name)s: %(message)s").format(record) == "gtcal: two\\nlines\\x1b"
    ElementTree.fromstring(xml_text(b"<a>" + bytes(range(1, 32)) + b"</a>"))


FORMULAS = ("=1+1", "+1", "-1", "@a", " =1", "a;=1+1", "a\t=1+1", 'a"=1', "a,=1", ";=1", "a", "caf\u00e9 2")


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
def test_no_spreadsheet_runs_a_cell_whatever_separates_its_cells(separator: str) -> None:
    for text in FORMULAS:
        (row,) = csv.reader([separator.join(("1", csv_cell(text), "2"))], delimiter=separator)
        assert [row[0], row[2:]] == ["1", ["2"]]  # in one cell
        assert row[1] in (text, f"'{text}")
        assert not row[1].lstrip().startswith(("=", "+", "-", "@"))


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording and one of the Lollypop, whose folder has a name to fear too, with the cameras named like this."""
    folder = tmp_path_factory.mktemp("hostile")
    assert not any(map(fault_of_name, HOSTILE))  # they may be names
    simulation = simulated(HEADSET)
    new = dict(zip(simulation.recording.cameras, HOSTILE, strict=True))
    device = LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene, n_frames=150)
    for recording, write, name in (
        (simulation.recording, write_recording, "rec"),
        (simulate_lollypop(device, seed=2).recording, write_lollypop_recording, "=\x1b[31m[red]"),
    ):
        named = replace(
            recording,
            cameras={new[name]: replace(camera, name=new[name]) for name, camera in recording.cameras.items()},
            detections={new[name]: found for name, found in recording.detections.items()},
        )
        write(named, folder / name)
    assert run("calibrate", folder / "rec", "-o", folder / "cal.json", "--no-effects", "-q").code == 0
    (folder / "other.json").write_text((folder / "cal.json").read_text() + "\n")
    return folder


@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(["info", "rec", "--figure", "out.svg"], marks=pytest.mark.long),
        ["info", "cal.json", "--figure", "out.svg"],
        pytest.param(
            ["calibrate", "rec", "--no-effects", "-v", "-o", "out.json", "--report", "out.html"], marks=pytest.mark.long
        ),
        ["detect", "rec"],
        ["uncertainty", "cal.json"],
        pytest.param(
            ["diff", "cal.json", "other.json", "-o", "out.json", "--figure", "out.svg"], marks=pytest.mark.long
        ),
        ["verify", "cal.json", "LOLLYPOP", "-v", "-o", "out.json", "--report", "out.html", "--sightings", "out.csv"],
        pytest.param(
            ["drift", "cal.json", "LOLLYPOP", "-o", "out.json", "--csv", "out.csv", "--figure", "out.svg"],
            marks=pytest.mark.long,
        ),
        pytest.param(["compare", "rec", "--lollypop", "LOLLYPOP"], marks=pytest.mark.long),
        pytest.param(["selfcheck", "rec"], marks=pytest.mark.long),
        pytest.param(["report", "cal.json", "--recording", "rec", "-o", "out.html"], marks=pytest.mark.long),
        ["export", "cal.json", "--to", "numpy", "-o", "out.npz"],
        ["verify", "cal.json", "\x1b[31m\nabsent"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_no_name_acts(arguments: list[str], ground: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for file in ground.iterdir():
        (tmp_path / file.name).symlink_to(file)
    monkeypatch.setenv("COLUMNS", "400")
    ran = run(*[str(argument).replace("LOLLYPOP", "=\x1b[31m[red]") for argument in arguments])
    assert ran.code in ((1,) if "absent" in arguments[-1] else (0, 3, 4)), ran.err
    assert "Traceback" not in ran.err
    assert all(letter.isprintable() or letter in "\n\u202e" for letter in ran.out + ran.err)
    if arguments[0] not in ("report", "export", "uncertainty", "compare") and ran.code != 1:
        assert "[red]left[bold]" in ran.out
        assert ":smile:" in ran.out
    for figure in tmp_path.glob("out.svg"):
        words = "".join(ElementTree.fromstring(figure.read_bytes()).itertext())
        assert arguments[0] == "drift" or all(name in words for name in HOSTILE)  # drift draws letters as paths
    for page in tmp_path.glob("out.html"):
        assert "\x1b" not in page.read_text()
        assert "<b>&amp;" not in page.read_text()
        assert "&lt;b&gt;&amp;amp;" in page.read_text()
    for table in tmp_path.glob("out.csv"):
        rows = list(csv.reader(table.open()))
        assert len({len(row) for row in rows}) == 1
        assert not any(cell.startswith("=") for row in rows for cell in row)
        for line in table.read_text().splitlines():
            assert not any(cell.startswith("=") for cell in next(csv.reader([line], delimiter=";")))
