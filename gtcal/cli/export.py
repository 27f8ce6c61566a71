"""gtcal export: a calibration in the files of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

Format = Literal[
    "kalibr",
    "opencv",
    "basalt",
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
    to: Format | Literal["rerun"],
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    nearest: bool = False,
    recording: Path | None = None,
    lollypop: Path | None = None,
    images: bool = True,
) -> None:
    """Write a calibration as a file of another tool.

    kalibr: camchain YAML. basalt: calibration JSON. opencv: FileStorage YAML. ros: a folder with camera_info YAML for
    each camera and a ROS 2 launch file of static transforms. ros_bag: a ROS 2 bag of the same as messages. colmap: a
    folder with rig_config.json and the sparse model's text files. aria: Project Aria's device JSON. hot3d:
    camera_models.json. umetrack: its JSON. anipose, pose2sim: their TOML. numpy: npz, which loses nothing.

    rerun: an .rrd for rerun's viewer (rerun out.rrd): the cameras, and of --recording the board and its body over time,
    images with detections and enlarged residuals, and of --lollypop the errors of its sightings.

    Args:
        calibration: calibration.json, as gtcal calibrate writes it.
        to: The format.
        output: File to write; for ros, ros_bag and colmap a folder.
        nearest: Where the format can't express a lens, write the nearest that it can in place of refusing.
        recording: For rerun: a recording of the calibrated rig, its folder or manifest.
        lollypop: For rerun: a recording of the Lollypop.
        images: For rerun: with the recording's images.
    """
    from gtcal.camera_files.export import export_calibration
    from gtcal.camera_files.formats import FOLDER_FORMATS
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, fingerprint
    from gtcal.results.calibration_file import read_calibration

    if to == "rerun":
        _export_to_rerun(calibration, output, recording, lollypop, images=images)
        return
    if recording is not None or lollypop is not None:
        raise GtcalError(f"--recording and --lollypop are for rerun; {to} holds the calibration alone")
    check_outputs([output], [calibration], folders=to in FOLDER_FORMATS)
    lost = export_calibration(
        read_calibration(calibration), output, to, nearest=nearest, source=fingerprint(calibration)
    )
    print("\n".join([f"wrote {output}", *lost]))


def _export_to_rerun(
    calibration: Path, output: Path, recording: Path | None, lollypop: Path | None, *, images: bool
) -> None:
    from gtcal.cli.progress import shown_progress
    from gtcal.files import check_outputs
    from gtcal.recordings.recording import load_recording
    from gtcal.report.rerun_file import write_rerun
    from gtcal.results.calibration_file import read_calibration
    from gtcal.verification.lollypop_recording import load_lollypop_recording
    from gtcal.verification.workflow import verify

    found = read_calibration(calibration)
    loaded = None if recording is None else load_recording(recording)
    device = None if lollypop is None else load_lollypop_recording(lollypop)
    check_outputs([output], [calibration, *(file for one in (loaded, device) if one is not None for file in one.files)])
    with shown_progress(quiet=False) as progress:
        verification = None if device is None else verify(device, found, progress=progress)
        write_rerun(output, found, recording=loaded, verification=verification, images=images, progress=progress)
    print(f"wrote {output}; open it with: rerun {output}")
