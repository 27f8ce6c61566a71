"""gtcal report: a calibration, and its verification, on one page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from gtcal.progress import Progress
    from gtcal.recordings.recording import Recording
    from gtcal.results.calibration import Calibration
    from gtcal.verification.lollypop_recording import LollypopRecording
    from gtcal.verification.verification import Verification


def report(
    calibration: tyro.conf.Positional[Path],
    *,
    recording: Path | None = None,
    verification: Path | None = None,
    lollypop: Path | None = None,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("report.html"),
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Show a calibration, and what it rests on, in one HTML file that needs no network.

    With the recording it was computed from: residuals over the image, the field angle and time, the image's coverage
    and the board's poses in 3-D. With another recording of the same rig and board, the same as hold-out errors. With a
    verification: the verdict first, and heat maps; with the Lollypop's recording also its worst frames. Of a
    calibration from poses in place of corners: residuals in mm and deg by camera, time and distance.

    Args:
        calibration: calibration.json.
        recording: Folder with the recording's manifest, or the manifest itself.
        verification: verification.json, as 'gtcal verify' writes it.
        lollypop: Folder or manifest of the Lollypop's recording, to verify again with (by the tolerances of
            --verification, where given), which shows every sighting and the worst images.
        output: File to write.
        quiet: Show no progress and print nothing.
    """
    from gtcal.cli.progress import shown_progress
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.calibration_file import is_pose_calibration
    from gtcal.report import gather_evidence, write_report
    from gtcal.results.calibration_file import read_calibration
    from gtcal.verification.lollypop_recording import load_lollypop_recording

    if is_pose_calibration(calibration):
        _report_poses(calibration, recording, verification or lollypop, output, quiet=quiet)
        return
    read = read_calibration(calibration)
    loaded = None if recording is None else _main_recording(recording)
    device = load_lollypop_recording(lollypop) if lollypop is not None else None
    files = [path for path in (calibration, verification) if path is not None]
    check_outputs([output], (*files, *(file for source in (loaded, device) if source for file in source.files)))
    with shown_progress(quiet) as progress:
        verified = _verification(calibration, read, verification, device, progress)
        evidence = gather_evidence(read, loaded, progress=progress) if loaded is not None else None
        write_report(output, read, evidence=evidence, verification=verified, progress=progress)
    if not quiet:
        print(f"written: {output}")


def _main_recording(path: Path) -> Recording:
    """The recording, or of several boards that of the first, which a calibration is mainly of."""
    from gtcal.recordings.recording import load_recording
    from gtcal.several_boards.recording import holds_boards, load_boards

    return next(iter(load_boards(path).values())) if holds_boards(path) else load_recording(path)


def _report_poses(path: Path, recording: Path | None, verified: Path | None, output: Path, *, quiet: bool) -> None:
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.calibration_file import read_pose_calibration
    from gtcal.pose_recordings.recording import load_pose_recording
    from gtcal.pose_recordings.report import write_pose_report

    if verified is not None:
        raise GtcalError(f"{path}: is a calibration from poses, without lenses: {verified} can't be seen through it")
    read = read_pose_calibration(path)
    loaded = load_pose_recording(recording) if recording is not None else None
    check_outputs([output], (path, *(loaded.files if loaded is not None else ())))
    write_pose_report(output, read, loaded)
    if not quiet:
        print(f"written: {output}")


def _verification(
    path: Path, calibration: Calibration, file: Path | None, lollypop: LollypopRecording | None, progress: Progress
) -> Verification | None:
    """As read from its file, or again from its recording. ``path``: the calibration's."""
    from gtcal.errors import GtcalError
    from gtcal.files import fingerprint
    from gtcal.verification.verification_file import read_verification
    from gtcal.verification.workflow import verify

    read = read_verification(file) if file is not None else None
    used = fingerprint(path)
    if read is not None and used.sha256 not in {entry.sha256 for entry in read.provenance.inputs}:
        raise GtcalError(f"{file}: is the verification of another calibration than {path}; verify this one")
    if lollypop is None:
        return read
    options = read.options if read is not None else None
    return verify(lollypop, calibration, options, progress=progress, inputs=(used,))
