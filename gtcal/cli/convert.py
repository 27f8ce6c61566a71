"""gtcal convert: camera files and trajectories from one tool's format to another's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro


def convert(
    input: tyro.conf.Positional[Path],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    to: str,
    from_: Annotated[str | None, tyro.conf.arg(name="from")] = None,
    name: str | None = None,
    quaternion: Literal["xyzw", "wxyz"] | None = None,
    length_unit: Literal["m", "mm"] | None = None,
    time_unit: Literal["ns", "us", "ms", "s"] | None = None,
    pose: Literal["world_T_body", "body_T_world"] | None = None,
    model: str | None = None,
    image_size_px: tuple[int, int] | None = None,
    nearest: bool = False,
) -> None:
    """Read a camera file or a trajectory of one tool and write it for another.

    Cameras: the formats that 'gtcal export' explains, and to read also gtcal, which is calibration.json. Trajectories:
    euroc_csv and tum, and to read all that a recording's manifest knows. Each format's pixel centres, units and orders
    are minded; what a file doesn't state is asked for, not guessed.

    Args:
        input: File or folder to read.
        output: File to write; for ros, ros_bag and colmap a folder.
        to: The format to write.
        from_: The format to read. Needed where the file doesn't tell.
        name: The one camera, or tracked body, to convert out of several.
        quaternion: A trajectory's order of the quaternion's numbers.
        length_unit: The unit of positions, of a trajectory or of a rig's cameras.
        time_unit: The unit of a trajectory's time stamps.
        pose: Whether a row of a trajectory holds the body's pose in the world, or its inverse.
        model: The cameras' model, by gtcal's name: fisheye62, pinhole_radtan, ...
        image_size_px: Width and height of the cameras' images.
        nearest: Where a lens can't be read or written as it is, take the nearest that can.
    """
    from gtcal.camera_files.formats import FOLDER_FORMATS
    from gtcal.convert import ConvertOptions
    from gtcal.convert import convert as convert_file
    from gtcal.files import check_outputs

    options = ConvertOptions(name, quaternion, length_unit, time_unit, pose, model, image_size_px, nearest)
    check_outputs([output], [input], folders=to in FOLDER_FORMATS)
    done = convert_file(input, output, to, as_format=from_, options=options)
    print(f"{done}\nwrote {output} as {to}")
