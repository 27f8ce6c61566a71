"""One self-contained HTML file: no network, no second file."""

from __future__ import annotations

import base64
import hashlib
import math
from pathlib import Path

from jinja2 import Environment
from markupsafe import Markup

from gtcal.errors import GtcalError
from gtcal.files import write_text
from gtcal.pages import page_environment
from gtcal.progress import Progress, silent
from gtcal.report.calibration_part import calibration_part
from gtcal.report.evidence import Evidence
from gtcal.report.verification_part import verification_part
from gtcal.results.calibration import Calibration
from gtcal.verification.verification import Verification


def write_report(
    path: Path,
    calibration: Calibration,
    *,
    evidence: Evidence | None = None,
    verification: Verification | None = None,
    progress: Progress = silent,
) -> None:
    """Write the report on a calibration. ``evidence``: its residuals on a recording (see ``gather_evidence``), without
    which there are no figures of them. ``verification``: what an independent recording says of it.

    Raises GtcalError where the file can't be written, an image can't be read, or the verification is of cameras that
    the calibration hasn't."""
    text = render(calibration, evidence=evidence, verification=verification, progress=progress)
    write_text(path, text)


def render(
    calibration: Calibration,
    *,
    evidence: Evidence | None = None,
    verification: Verification | None = None,
    progress: Progress = silent,
) -> str:
    """The page as text. Raises as ``write_report``."""
    if verification is not None:
        _check_cameras(calibration, verification)
    return page_of(
        "report.html.j2",
        calibration=calibration,
        part=calibration_part(calibration, evidence, verification, progress=progress),
        verification=verification,
        verified=verification_part(verification, calibration) if verification is not None else None,
        recording=evidence.recording if evidence is not None else None,
    )


def page_of(template: str, **parts: object) -> str:
    """A page by one of this package's templates, in the reports' style."""
    environment = _environment()
    style, script = (_own_text(environment, name) for name in ("report.css", "scene.js"))
    return environment.get_template(template).render(style=style, script=script, **parts)


def _check_cameras(calibration: Calibration, verification: Verification) -> None:
    for name in verification.cameras:
        if name not in calibration.cameras:
            raise GtcalError(
                f"the verification is of camera {name!r}, which the calibration hasn't; its cameras: "
                f"{', '.join(calibration.cameras)}"
            )


def _environment() -> Environment:
    environment = page_environment("gtcal.report")
    environment.filters["number"] = _number
    environment.filters["sha256"] = _source
    return environment


def _own_text(environment: Environment, name: str) -> Markup:
    """A file of this package, put into the page as it is."""
    assert environment.loader is not None
    return Markup(environment.loader.get_source(environment, name)[0])


def _source(text: str) -> str:
    """How a Content-Security-Policy names a style or a script that may act, by what is in it: nothing else may."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _number(value: float | None, digits: int = 4) -> str:
    """Significant digits; nothing for a number that there isn't."""
    return "" if value is None or math.isnan(value) else f"{value:.{digits}g}"
