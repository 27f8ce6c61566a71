"""gtcal doctor: what is wrong with a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from rich.text import Text

    from gtcal.doctor.findings import Diagnosis, Finding
    from gtcal.progress import Progress


def doctor(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")],
    *,
    calibration: Path | None = None,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Find out what is wrong with a recording: what, the evidence, and the lines of its manifest to change.

    It tries what usually goes wrong, and sees by how the images and the mocap then agree whether that is it: units,
    quaternion order, inverse poses, handedness, swapped bodies or cameras, time stamps in s, ms, us or ns, clocks that
    differ, the board's size, gaps and tag order, images mirrored, turned or of another size, the order of the lens's
    coefficients. Then it calibrates, and tells what that warns of: markers and cameras that moved, views that
    contradict the rest, a lens or a board that is not as stated. A recording that can't be read as it stands is read
    with other lines in its manifest. Of poses in place of corners those of the cameras are read otherwise too. A
    recording of the Lollypop is judged by a calibration that is given. Nothing is changed on disk but the corners that
    are detected in images, which are kept as by 'gtcal calibrate'.

    Exit code: 0 where nothing is wrong, 1 where something is.

    Args:
        recording: Folder with the manifest (recording.yaml or recording.json), or the manifest itself.
        calibration: Of a recording of the Lollypop: the calibration, taken as right, by which it is judged.
        output: JSON file to write the findings to.
        json: Print the findings as JSON in place of words ('gtcal schema diagnosis').
        quiet: Show no progress and print nothing: the exit code tells.
    """
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.doctor.diagnose import diagnose
    from gtcal.doctor.diagnosis_file import diagnosis_document, write_diagnosis
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.doctor import diagnose_poses
    from gtcal.pose_recordings.recording import holds_poses
    from gtcal.recordings.manifest import named_files

    if output is not None:
        check_outputs([output], [*named_files(recording), *([calibration] if calibration is not None else [])])
    with shown_progress(quiet) as progress:
        found = (
            (diagnose_poses if holds_poses(recording) else diagnose)(recording, progress=progress)
            if calibration is None
            else _lollypop(recording, calibration, progress)
        )
    if output is not None:
        write_diagnosis(output, found)
    if json:
        print_json(diagnosis_document(found))
    elif not quiet:
        for part in diagnosis_parts(found):
            Terminal().print(part, soft_wrap=True)
        if output is not None:
            print(f"written: {output}")
    return 0 if found.healthy else 1


def _lollypop(recording: Path, calibration: Path, progress: Progress) -> Diagnosis:
    from gtcal.doctor.lollypop import diagnose_lollypop
    from gtcal.results.calibration_file import read_calibration
    from gtcal.verification.lollypop_recording import load_lollypop_recording

    return diagnose_lollypop(load_lollypop_recording(recording), read_calibration(calibration), progress=progress)


def diagnosis_parts(found: Diagnosis) -> list[Text]:
    """Line by line: each finding with its evidence and what to do, the notes, the outcome."""
    from rich.text import Text

    parts = [part for number, finding in enumerate(found.findings, start=1) for part in _finding(number, finding)]
    parts += [Text(f"note: {note}", style="cyan") for note in found.notes]
    return [*parts, Text(found.statement, style="green" if found.healthy else "bold red")]


def _finding(number: int, finding: Finding) -> list[Text]:
    from rich.text import Text

    alternatives = (f"   alternative that the data do not rule out: {text}" for text in finding.alternatives)
    return [
        Text(f"{number}. {finding.fault}: {finding.says}", style="bold"),
        Text(f"   evidence: {finding.evidence}"),
        *(Text(f"   write in the manifest:  {text}", style="green") for text in finding.lines),
        *(Text(f"   do: {text}", style="green") for text in finding.advice),
        *(Text(text, style="yellow") for text in alternatives),
        Text(""),
    ]
