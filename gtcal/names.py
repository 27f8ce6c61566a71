"""What cameras, bodies and boards may be called. Files, topics and messages are named after them, and the names come
from files of others."""

from __future__ import annotations

import re
import unicodedata

from gtcal.errors import GtcalError

MOST_BYTES = 200
"""Of a name in UTF-8. With what is put before and behind, it is to fit in the 255 of a file's name."""

_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
_CONTROL = ("Cc", "Cs", "Zl", "Zp")  # control characters, halves of characters, ends of lines and paragraphs


def fault_of_name(name: str) -> str:
    """Why this can't be a name, as 'is empty'; nothing where it can. Letters of every script are welcome."""
    if not name.strip():
        return "is empty"
    if "/" in name or "\\" in name:
        return "has a separator of paths (/ or \\) in it"
    if any(unicodedata.category(letter) in _CONTROL for letter in name):
        return "has a control character in it"
    if (size := len(name.encode())) > MOST_BYTES:
        return f"is {size} bytes long, of at most {MOST_BYTES}"
    if name[-1] in ". ":
        return "ends with a dot or a space, which some systems drop"
    return "is reserved on some systems" if _RESERVED.fullmatch(name) else ""


def check_name(what: str, name: str) -> None:
    """Raises GtcalError where this can't be the name of a ``what``, a camera say."""
    if fault := fault_of_name(name):
        raise GtcalError(f"{what} {shown(name)}: the name {fault}; give it another")


def named(camera: str) -> str:
    """The name of a camera in a result, as it is. Raises GtcalError where it can be none."""
    check_name("camera", camera)
    return camera


def shown(name: str) -> str:
    """A name in a message, in quotes, without what could act on the terminal, and not all of a long one."""
    text = repr(name)
    return text if len(text) <= MOST_BYTES else f"{text[:60]}..."
