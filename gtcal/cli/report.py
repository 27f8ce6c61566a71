"""gtcal report: a calibration on one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def report(
    calibration: tyro.conf.Positional[Path],
    *,
    recording: Path | None = None,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("report.html"),
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Show a calibration, and what it rests on, in one HTML file that needs no network.

    With the recording it was computed from: residuals over the image, the field angle and time, the image's coverage
    and the board's poses in 3-D. With another recording of the same rig and board, the same as hold-out errors.

    Args:
        calibration: calibration.json.
        recording: Folder with the recording's manifest, or the manifest itself.
        output: File to write.
        quiet: Show no progress and print nothing.
    """
    from gtcal.calibration_file import read_calibration
    from gtcal.cli.progress import shown_progress
    from gtcal.recording import load_recording
    from gtcal.report import gather_evidence, write_report

    read = read_calibration(calibration)
    with shown_progress(quiet) as progress:
        loaded = load_recording(recording) if recording is not None else None
        evidence = gather_evidence(read, loaded, progress=progress) if loaded is not None else None
        write_report(output, read, evidence=evidence, progress=progress)
    if not quiet:
        print(f"written: {output}")
