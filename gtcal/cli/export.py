"""gtcal export: a calibration in the files of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

Format = Literal[
    "kalibr",
    "basalt",
    "opencv",
    "ros",
    "ros_bag",
    "colmap",
    "aria",
    "hot3d",
    "umetrack",
    "anipose",
    "pose2sim",
    "numpy",
]


def export(
    calibration: tyro.conf.Positional[Path],
    *,
    to: Format,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    nearest: bool = False,
) -> None:
    """Write a calibration as a file of another tool.

    kalibr: camchain YAML. basalt: calibration JSON. opencv: FileStorage YAML. ros: a folder with camera_info YAML for
    each camera and a ROS 2 launch file of static transforms. ros_bag: a ROS 2 bag of the same as messages. colmap: a
    folder with rig_config.json and the sparse model's text files. aria: Project Aria's device JSON. hot3d:
    camera_models.json. umetrack: its JSON. anipose, pose2sim: their TOML. numpy: npz, which loses nothing.

    Args:
        calibration: calibration.json, as gtcal calibrate writes it.
        to: The format.
        output: File to write; for ros, ros_bag and colmap a folder.
        nearest: Where the format can't express a lens, write the nearest that it can in place of refusing.
    """
    from gtcal.camera_files.export import export_calibration
    from gtcal.camera_files.formats import FOLDER_FORMATS
    from gtcal.files import check_outputs, fingerprint
    from gtcal.results.calibration_file import read_calibration

    check_outputs([output], [calibration], folders=to in FOLDER_FORMATS)
    lost = export_calibration(
        read_calibration(calibration), output, to, nearest=nearest, source=fingerprint(calibration)
    )
    print("\n".join([f"wrote {output}", *lost]))
