"""Tables that never cut a number: where the terminal is too narrow, columns go under each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
from rich.text import Text

_LEAST_TEXT = 24
"""Text wraps, but is left this wide."""

_LEAST_CAPTION = 72
"""Words below a narrow table may go beyond it."""

_PADDING, _EDGES = 2, 2


class FoldedTable(Table):
    """A table in the house's style, whose first column is for the rows' names. What does not fit beside them in the
    terminal's width stands below, with the names again."""

    def __init__(self, title: str | None = None, *, caption: str | None = None, **options: Any) -> None:
        style: dict[str, Any] = {"box": box.SIMPLE_HEAD, "collapse_padding": True, "title_style": "bold"}
        left = {"title_justify": "left", "caption_justify": "left"}
        super().__init__(title=title, caption=caption, **{**style, **left, **options})

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widest = 0
        for index, columns in enumerate(self._parts(console, options.max_width)):
            part = FoldedTable(padding=self.padding)
            part.title = self.title if index == 0 else None
            part.columns, part.rows = _copied(columns), self.rows
            widest = max(widest, console.measure(part, options=options).maximum)
            yield from Table.__rich_console__(part, console, options)
        if self.caption:
            width = min(max(widest, _LEAST_CAPTION), options.max_width)
            caption = console.render_str(str(self.caption), style=self.caption_style or "table.caption")
            yield from console.render(caption, options.update(width=width, no_wrap=False, overflow="fold"))
            yield Text()

    def _parts(self, console: Console, width: int) -> Iterator[list[Column]]:
        """The columns that stand side by side, the names first each time."""
        names, *others = self.columns
        first = _width(console, names) + _EDGES
        here, used = [names], first
        for column in others:
            own = _width(console, column)
            if used + own > width and len(here) > 1:
                yield here
                here, used = [names], first
            here, used = [*here, column], used + own
        yield here


def _width(console: Console, column: Column) -> int:
    widest = max((console.measure(cell).maximum for cell in (column.header, *column.cells)), default=0)
    wraps = column.justify == "left" and not column.no_wrap
    return (min(widest, _LEAST_TEXT) if wraps else widest) + _PADDING


def _copied(columns: Sequence[Column]) -> list[Column]:
    """With their cells, numbered anew."""
    copies = []
    for index, column in enumerate(columns):
        copy = column.copy()
        copy._index, copy._cells = index, column._cells
        copies.append(copy)
    return copies
