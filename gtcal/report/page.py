"""One self-contained HTML file: no network, no second file."""

from __future__ import annotations

import math
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from gtcal.calibration import Calibration
from gtcal.files import write_text
from gtcal.progress import Progress, silent
from gtcal.report.calibration_part import calibration_part
from gtcal.report.evidence import Evidence


def write_report(
    path: Path, calibration: Calibration, *, evidence: Evidence | None = None, progress: Progress = silent
) -> None:
    """Write the report on a calibration. ``evidence``: its residuals on a recording (see ``gather_evidence``), without
    which there are no figures of them.

    Raises GtcalError where the file can't be written."""
    write_text(path, render(calibration, evidence=evidence, progress=progress))


def render(calibration: Calibration, *, evidence: Evidence | None = None, progress: Progress = silent) -> str:
    """The page as text."""
    environment = _environment()
    return environment.get_template("report.html.j2").render(
        calibration=calibration,
        part=calibration_part(calibration, evidence, progress=progress),
        recording=evidence.recording if evidence is not None else None,
        style=_own_text(environment, "report.css"),
        script=_own_text(environment, "scene.js"),
    )


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("gtcal.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = _number
    return environment


def _own_text(environment: Environment, name: str) -> Markup:
    """A file of this package, put into the page as it is."""
    assert environment.loader is not None
    return Markup(environment.loader.get_source(environment, name)[0])


def _number(value: float | None, digits: int = 4) -> str:
    """Significant digits; nothing for a number that there isn't."""
    return "" if value is None or math.isnan(value) else f"{value:.{digits}g}"
