"""The guide: chapters in Markdown that are installed with the package and read without a network.

A chapter is a file NAME.md of this folder; its first line says ``# Name: what it is about``."""

from __future__ import annotations

import re
from importlib.resources import files

CHAPTERS = (
    "words",
    "manifest",
    "formats",
    "boards",
    "numbered",
    "poses",
    "clock",
    "calibrate",
    "doctor",
    "trust",
    "verify",
    "changes",
    "fleet",
    "python",
    "measured",
)
"""In the order in which one would read them."""

_COMMENT = re.compile(r"^<!--.*?-->\n", re.MULTILINE)


def markdown(chapter: str) -> str:
    """A chapter's text, without the marks that tests find examples by."""
    return _COMMENT.sub("", files(__name__).joinpath(f"{chapter}.md").read_text(encoding="utf-8"))


def about(chapter: str) -> str:
    """What a chapter is about, in a few words."""
    return markdown(chapter).partition("\n")[0].partition(": ")[2]
