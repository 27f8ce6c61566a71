"""gtcal guide: the chapters that the program brings along."""

from __future__ import annotations

from typing import Annotated

import tyro


def guide(topic: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[TOPIC]")] = "") -> None:
    """Show a chapter of the guide, which is installed with the program: what a manifest says, which files are read,
    how a verdict comes about, parts of one's own in Python, and more.

    In a terminal it is set for reading ('gtcal guide trust | less' to page); into a pipe or a file it goes as Markdown.

    Args:
        topic: The chapter; without it, the list of them.
    """
    import sys

    from gtcal.errors import GtcalError
    from gtcal.guide import CHAPTERS, about, markdown
    from gtcal.recordings.manifest import did_you_mean

    if not topic:
        width = max(map(len, CHAPTERS))
        print("\n".join(f"gtcal guide {name:{width}}  {about(name)}" for name in CHAPTERS))
    elif topic not in CHAPTERS:
        near = did_you_mean(topic, CHAPTERS)
        raise GtcalError(f"the guide has no chapter {topic!r}{near}; chapters: {', '.join(CHAPTERS)}")
    elif sys.stdout.isatty():
        from gtcal.cli.markdown import shown_markdown
        from gtcal.cli.terminal import Terminal

        Terminal().print(shown_markdown(markdown(topic)), crop=False)
    else:
        print(markdown(topic), end="")
