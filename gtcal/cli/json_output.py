"""Results as JSON on standard output, for programs: ``--json`` of every command that shows a table. One document, as
'gtcal schema' describes it, with nothing else beside it: progress, warnings and all other words go to stderr."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from typing import Any, TextIO

OPTION = "--json"

_standard_output: ContextVar[TextIO | None] = ContextVar("standard output", default=None)


@contextmanager
def alone_on_standard_output() -> Iterator[None]:
    """Inside, only ``print_json`` writes to standard output; what is printed otherwise goes to stderr."""
    before = _standard_output.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _standard_output.reset(before)


def print_json(document: dict[str, Any]) -> None:
    """Print a document; what is no finite number is null."""
    text = json.dumps(plain(document), indent=1, allow_nan=False)
    print(text, file=_standard_output.get() or sys.stdout, flush=True)


def plain(value: Any) -> Any:
    """As JSON knows it."""
    if isinstance(value, dict):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
