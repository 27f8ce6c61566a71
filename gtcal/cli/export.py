"""gtcal export: a calibration in the files of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro


def export(
    calibration: tyro.conf.Positional[Path],
    *,
    to: Literal["kalibr", "opencv", "numpy"],
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    nearest: bool = False,
) -> None:
    """Write a calibration as a file of another tool: Kalibr's camchain, OpenCV's FileStorage (YAML), NumPy's npz.

    Args:
        calibration: calibration.json, as gtcal calibrate writes it.
        to: The format.
        output: File to write.
        nearest: Where the format can't express a lens, write the nearest that it can in place of refusing.
    """
    from gtcal.camera_files import export_calibration
    from gtcal.results.calibration_file import read_calibration

    export_calibration(read_calibration(calibration), output, to, nearest=nearest)
    print(f"wrote {output}")
