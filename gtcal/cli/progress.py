"""Progress in the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gtcal.progress import Progress, silent


@contextmanager
def shown_progress(quiet: bool = False) -> Iterator[Progress]:
    """A bar for each piece of work, on stderr; nothing where ``quiet``, or where stderr is no terminal but a log."""
    if quiet:
        yield silent
        return
    from rich.markup import escape
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    from gtcal.cli.terminal import Terminal
    from gtcal.plain import printable

    console = Terminal(stderr=True)
    with Bars(console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(escape(printable(what)))
            bars.update(tasks[what], completed=done, total=total)

        yield show
