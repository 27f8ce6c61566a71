"""gtcal doctor: what is wrong with a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from gtcal.cli.terminal import Terminal
    from gtcal.doctor.findings import Diagnosis, Finding


def doctor(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")],
    *,
    json: Path | None = None,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Find out what is wrong with a recording: what, the evidence, and the lines of its manifest to change.

    It tries what usually goes wrong, and sees by how the images and the mocap then agree whether that is it: units,
    quaternion order, inverse poses, handedness, swapped bodies or cameras, time stamps in s, ms, us or ns, clocks that
    differ, the board's size, gaps and tag order, images mirrored, turned or of another size, the order of the lens's
    coefficients. A recording that can't be read as it stands is read with other lines in its manifest. Nothing is
    changed on disk but the corners that are detected in images, which are kept as by 'gtcal calibrate'. Of poses in
    place of corners those of the cameras are read otherwise too.

    Exit code: 0 where nothing is wrong, 1 where something is.

    Args:
        recording: Folder with the manifest (recording.yaml or recording.json), or the manifest itself.
        json: JSON file to write the findings to.
        quiet: Show no progress and print nothing: the exit code tells.
    """
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.doctor.diagnose import diagnose
    from gtcal.doctor.diagnosis_file import write_diagnosis
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.doctor import diagnose_poses
    from gtcal.pose_recordings.recording import holds_poses
    from gtcal.recordings.manifest import named_files

    if json is not None:
        check_outputs([json], named_files(recording))
    with shown_progress(quiet) as progress:
        found = (diagnose_poses if holds_poses(recording) else diagnose)(recording, progress=progress)
    if json is not None:
        write_diagnosis(json, found)
    if not quiet:
        _show(Terminal(), found)
        if json is not None:
            print(f"written: {json}")
    return 0 if found.healthy else 1


def _show(console: Terminal, found: Diagnosis) -> None:
    def line(text: str, style: str = "") -> None:
        console.print(text, style=style, highlight=False, soft_wrap=True)

    for number, finding in enumerate(found.findings, start=1):
        _show_finding(line, number, finding)
    for note in found.notes:
        line(f"note: {note}", "cyan")
    line(found.statement, "green" if found.healthy else "bold red")


def _show_finding(line: Callable[..., None], number: int, finding: Finding) -> None:
    line(f"{number}. {finding.fault}: {finding.says}", "bold")
    line(f"   evidence: {finding.evidence}")
    for text in finding.lines:
        line(f"   write in the manifest:  {text}", "green")
    for text in finding.advice:
        line(f"   do: {text}", "green")
    for text in finding.alternatives:
        line(f"   alternative that the data do not rule out: {text}", "yellow")
    line("")
