"""gtcal detect: the board's corners in a recording's images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro


def detect(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")],
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    format: Literal["csv", "parquet"] = "csv",
    redo: bool = False,
    guided: bool = True,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Find the board in a recording's images, and keep the corners beside the recording.

    'gtcal calibrate' does this by itself; use 'detect' to look at the yield first, or to get the corners as files.
    What was found is reused until the images, the board or the intrinsics change. Of a recording that has its corners
    already, these are written as they are, in either format.

    Args:
        recording: Folder with the manifest (recording.yaml or recording.json), or the manifest itself.
        output: Folder for one file per camera with the columns timestamp_ns, corner_id, x_px, y_px; the manifest takes
            each as the camera's 'detections'.
        format: Of these files. 'parquet' is smaller and read faster than 'csv', for millions of
            corners; it needs pyarrow (pip install 'gtcal[parquet]').
        redo: Detect again, also where the manifest gives detections next to images.
        guided: Where a camera has many images, search the board in some only; the mocap and a calibration from those
            say where it is in the others, and its corners are fitted there. Faster, and finds more; the corners are
            the same.
        json: Print the yield as JSON in place of a table ('gtcal schema detection').
        quiet: Show no progress and print nothing.
    """
    from gtcal.arrow import parquet
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.tables import detection_document, detection_table
    from gtcal.cli.terminal import Terminal
    from gtcal.files import check_outputs
    from gtcal.recordings.detection_files import write_detections
    from gtcal.recordings.recording import load_recording
    from gtcal.workflow import detected

    loaded = load_recording(recording)
    if output is not None:
        check_outputs([output], folders=True)
        check_outputs((output / f"{name}.{format}" for name in loaded.cameras), loaded.files)
        if format == "parquet":
            parquet()  # before the work
    with shown_progress(quiet) as progress:
        found = detected(loaded, progress=progress, redo=redo, guided=guided)
    if output is not None:
        for name, detections in found.detections.items():
            write_detections(output / f"{name}.{format}", detections, numbered=loaded.numbered)
    if json:
        print_json(detection_document(found))
    elif not quiet:
        Terminal().print(detection_table(found))
