"""The terminal, to which all tables and lines with text from outside go: it is shown as it is."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from gtcal.plain import printable

_OF_A_PIPE = 2000


class Terminal(Console):
    """Takes nothing in a text for markup, an emoji's name or a command to the terminal. Into a pipe or a file, no line
    is broken."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"markup": False, "emoji": False, **options})
        if not self.is_terminal and "COLUMNS" not in os.environ:
            self.width = _OF_A_PIPE

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))
