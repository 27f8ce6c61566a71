"""A calibration in the files of other tools."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from gtcal.camera_files.calibration_rig import calibration_rig
from gtcal.camera_files.formats import CAMERA_FILE_WRITERS, write_rig
from gtcal.camera_files.rig import OUR_PIXELS, Rig
from gtcal.files import InputFile
from gtcal.results.calibration import Calibration

EXPORT_FORMATS = tuple(CAMERA_FILE_WRITERS)
"""The formats that a calibration can be written in."""


def export_calibration(
    calibration: Calibration, path: Path, format_name: str, *, nearest: bool = False, source: InputFile | None = None
) -> list[str]:
    """Write a calibration in one of EXPORT_FORMATS, whole or not at all; returns a line for each thing that the
    format could not hold.

    nearest: write the nearest lens model that the format knows where it can't express a camera's.
    source: the calibration's file; the notes in what is written name it.

    Raises GtcalError for an unknown format, a lens that it can't express, or a file that can't be written."""
    rig = calibration_rig(calibration)
    return write_rig(rig, path, format_name, made_by("export", rig, source), nearest=nearest)


def made_by(command: str, rig: Rig, source: InputFile | None) -> list[str]:
    """What every file says about itself: how it was made, its frames and its units."""
    origin = "" if source is None else f" from {source.path.name}, SHA-256 {source.sha256}"
    return [
        f"made by gtcal {command}, version {version('gtcal')}{origin}",
        f"ref is {rig.ref_words}; camera_T_ref takes coordinates in ref to coordinates in the camera"
        if rig.posed
        else "the cameras are not placed in a common frame",
        f"metres; camera frame x right, y down, z forward; {OUR_PIXELS}",
    ]
