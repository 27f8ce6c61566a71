"""A drafted manifest leaves open what only the user can know: such a value is the word QUESTION, with the question in
the comment above it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gtcal.documents import read_text
from gtcal.errors import GtcalError

OPEN = "QUESTION"
"""The value of a field that waits for an answer."""

_OPEN_LINE = re.compile(rf"^(?P<indent>\s*)[^#]*:\s*{OPEN}\s*(#.*)?$")
_ASKED = re.compile(rf"^\s*#\s*{OPEN}:\s*(?P<text>.*)$")


def check_answered(path: Path, fields: Any) -> None:
    """Raises GtcalError naming the first field of the manifest at ``path`` that is still open, and the question."""
    first = next(_open_fields(fields), None)
    if first is None:
        return
    line, question = _asked(path)
    raise GtcalError(f"{path}{line}: {first}: is still an open question{question}; replace {OPEN} by the answer")


def _open_fields(value: Any, where: str = "") -> Iterator[str]:
    """The dotted names of the open fields, in the order of the file."""
    if value == OPEN:
        yield where
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from _open_fields(part, f"{where}.{name}" if where else str(name))
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from _open_fields(part, f"{where}.{index}")


def _asked(path: Path) -> tuple[str, str]:
    """':line' of the first open field and ': question', as far as the text has them."""
    lines = read_text(path).splitlines()
    at = next((index for index, line in enumerate(lines) if _OPEN_LINE.match(line)), None)
    if at is None:
        return "", ""
    parts: list[str] = []
    for line in reversed(lines[:at]):
        asked = _ASKED.match(line)
        if not line.strip().startswith("#"):
            break
        parts.append(asked["text"] if asked else line.strip().lstrip("# "))
        if asked:
            return f":{at + 1}", f": {' '.join(reversed(parts)).rstrip('.')}"
    return f":{at + 1}", ""
