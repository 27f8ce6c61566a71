"""Tables in a terminal of any width: no number is cut off."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.text import Text

from gtcal.cli.folded_table import FoldedTable
from gtcal.cli.terminal import Terminal

NUMBERS = [[f"{row}{column}.{column}23456" for column in range(6)] for row in range(3)]


def table() -> FoldedTable:
    made = FoldedTable("what it is", caption="what it means")
    made.add_column("", no_wrap=True)
    for heading in ("RMSE", "median", "95 %", "worst", "mm", "deg"):
        made.add_column(heading, justify="right")
    made.add_column("verdict")
    for name, row in zip(("cam0", "cam1", "a camera"), NUMBERS, strict=True):
        made.add_row(name, *row, Text("moved, within the tolerance and so on"))
    return made


def shown(width: int | None) -> str:
    terminal = Terminal(file=StringIO(), **({} if width is None else {"width": width, "force_terminal": True}))
    terminal.print(table())
    return terminal.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize("width", [30, 45, 60, 80, 120])
def test_no_number_is_cut_off_however_narrow(width: int) -> None:
    text = Text.from_ansi(shown(width)).plain
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    words = text.split()
    for row in NUMBERS:
        for number in row:
            assert words.count(number) == 1
    assert words.count("cam1") == len([line for line in text.splitlines() if line.strip().startswith("cam0")])
    assert text.count("what it is") == text.count("what it means") == 1


def test_a_pipe_has_no_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = shown(None).splitlines()
    assert any(all(number in line for number in NUMBERS[0]) and "so on" in line for line in lines)
    wide = Terminal(file=StringIO())
    wide.print("a warning " * 60)
    assert wide.file.getvalue().count("\n") == 1  # type: ignore[attr-defined]


def test_a_caption_is_not_squeezed_under_a_narrow_part() -> None:
    made = table()
    made.caption = "what the numbers above mean, in words that take more than one line of a narrow terminal"
    for width in (45, 60, 200):
        terminal = Terminal(file=StringIO(), width=width, force_terminal=True)
        terminal.print(made)
        lines = Text.from_ansi(terminal.file.getvalue()).plain.splitlines()  # type: ignore[attr-defined]
        first = next(line for line in lines if line.startswith("what the numbers"))
        assert 30 < len(first) <= width
        assert lines[-1].strip() == ""
