"""What users read first: the README and the chapters of the guide, as they stand in their files."""

from __future__ import annotations

import re
from pathlib import Path

import gtcal.guide

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *sorted(Path(gtcal.guide.__file__).parent.glob("*.md")))
ALL = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)


def block(mark: str, language: str) -> str:
    """The block of code that follows ``<!-- mark -->``, which stands once in all of it."""
    (found,) = re.findall(rf"<!-- {mark} -->\n```{language}\n(.*?)```", ALL, re.DOTALL)
    return found
