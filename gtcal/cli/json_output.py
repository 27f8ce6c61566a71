"""Results as JSON on standard output, for programs: one document, its kind and schema's version first."""

from __future__ import annotations

import json
import math
from typing import Any

SCHEMA_VERSION = 1
"""Of all that --json prints. Fields may come with it; what one means changes with the version."""


def print_json(kind: str, document: dict[str, Any]) -> None:
    """Print ``document`` under 'gtcal_<kind>'; what is no finite number is null."""
    print(json.dumps({f"gtcal_{kind}": SCHEMA_VERSION, **plain(document)}, indent=1, allow_nan=False))


def plain(value: Any) -> Any:
    """As JSON knows it."""
    if isinstance(value, dict):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
