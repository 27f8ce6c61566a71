"""The station's page: one verdict, to be read from three metres, and what to do. It asks for itself anew every
second."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gtcal.files import write_text
from gtcal.fleet.watch import Seen
from gtcal.pages import page_environment

_TO_DO = {
    "pass": "The calibration holds. Go on.",
    "fail": "The calibration does not hold. Do not record with it: see what moved, and calibrate again.",
    "inconclusive": "The recording can't tell. Record the Lollypop again, longer, and through the whole image of every "
    "camera.",
    "": "The recording could not be verified. Look at the line below, and record again.",
}
_SIGNS = {"pass": "✓", "fail": "✗", "inconclusive": "?", "": "!"}
_MOST_REMARKS = 3


@dataclass(frozen=True)
class Shown:
    """What the page shows. kind: of the verdict, or 'waiting', or 'none' where there is none."""

    word: str
    sign: str
    kind: str
    title: str
    to_do: str
    remarks: tuple[str, ...] = ()


def waiting(folder: Path) -> Shown:
    """Before the first recording."""
    return Shown("waiting", "…", "waiting", "", f"for a recording of the Lollypop in {folder}")


def verdict(seen: Seen) -> Shown:
    """Of a recording."""
    record = seen.record
    remarks = (record.error,) if record.error else seen.remarks[:_MOST_REMARKS]
    return Shown(
        record.verdict or "no verdict",
        _SIGNS[record.verdict],
        record.verdict or "none",
        f"{record.rig}: {record.name}",
        _TO_DO[record.verdict],
        () if record.verdict == "pass" else remarks,
    )


def write_page(path: Path, shown: Shown) -> None:
    """Write the page. Raises GtcalError where it can't be written."""
    write_text(path, page_environment("gtcal.fleet").get_template("watch.html.j2").render(shown=shown))
