"""gtcal's own calibration.json as a camera file."""

from __future__ import annotations

from pathlib import Path

from gtcal.camera_files.rig import ReadOptions, Rig


def recognises(document: object) -> bool:
    """Whether this is what a calibration.json looks like."""
    return isinstance(document, dict) and "gtcal_calibration" in document


def read_gtcal(path: Path, options: ReadOptions) -> Rig:
    """The cameras of a calibration.json, in its ref. Raises GtcalError for a file that is none, or damaged."""
    from gtcal.camera_files.calibration_rig import calibration_rig  # with GTSAM, which other formats need not wait for
    from gtcal.results.calibration_file import read_calibration

    return calibration_rig(read_calibration(path))
