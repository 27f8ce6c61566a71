"""Markdown in the terminal."""

from __future__ import annotations

from typing import ClassVar

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import CodeBlock, Markdown, MarkdownElement
from rich.segment import Segment
from rich.syntax import Syntax


class _Code(CodeBlock):
    """Lines of code and of tables are not broken: a terminal that is too narrow goes on in the next line by itself."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        text = str(self.text).rstrip()
        width = max(map(len, text.splitlines()), default=0)
        syntax = Syntax(text, self.lexer_name, theme=self.theme, background_color="default", code_width=width)
        for line in console.render_lines(syntax, options.update(width=width)):
            yield from (Segment("  "), *line, Segment.line())


class _Markdown(Markdown):
    elements: ClassVar[dict[str, type[MarkdownElement]]] = {
        **Markdown.elements,
        "fence": _Code,
        "code_block": _Code,
    }


def shown_markdown(text: str) -> Markdown:
    """To be printed."""
    return _Markdown(text, code_theme="ansi_dark", hyperlinks=False)
