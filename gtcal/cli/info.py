"""gtcal info: what is in a recording or a result, at a glance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from gtcal.progress import Progress
    from gtcal.recordings.recording import Recording
    from gtcal.verification.lollypop_recording import LollypopRecording


def info(
    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PATH")],
    *,
    figure: Path | None = None,
    detect: bool = False,
    live: bool = False,
    enough_mm: float = 0.2,
    enough_deg: float = 0.02,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Show what is in a recording, a mocap export, a calibration.json or a verification.json, at a glance.

    Of a recording: cameras and tracked bodies with their rates, gaps and lost samples, how many images have a pose of
    every body, how much of each image had corners, and how far the bodies moved and turned; of a mocap export its
    bodies, markers and gaps, and what a manifest has to say beside it; of a result what its command printed. Corners
    are those that the recording gives or that were kept from a detection before.

    Args:
        path: Folder of a recording, its manifest, a file of mocap data, or a result file.
        figure: Picture to write, .png or .svg. Of a recording: when cameras and mocap recorded, where the images had
            corners, how the bodies moved. Of a calibration: where the cameras are. Of a verification: the heat maps.
        detect: Look for the board in images where that was not done yet, as 'gtcal detect' does, and keep the corners.
        live: Watch a recording that is being made: after each change of its files say how sure each camera is by now,
            what is still weak and where to hold the board, until Ctrl-C ends it. Of images one each half second is
            looked at.
        enough_mm: With --live, the 1-sigma of a camera's place that is enough.
        enough_deg: With --live, that of its attitude.
        json: Print it as JSON in place of tables ('gtcal schema summary'; of a mocap export 'mocap-file', of results
            'calibration' or 'verification').
        quiet: Print nothing.
    """
    from gtcal.cli.progress import shown_progress
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs
    from gtcal.overview.kind import Kind, kind_of
    from gtcal.readers import detect_mocap_format

    if live:
        if figure is not None or detect or json or quiet:
            raise GtcalError("--live prints what it sees and goes without --figure, --detect, --json and --quiet")
        _live(path, enough_mm, enough_deg)
        return
    check_outputs([figure], [path])
    if detect_mocap_format(path) is not None:
        _mocap_file(path, figure, json, quiet)
        return
    kind = kind_of(path)
    if kind is Kind.CALIBRATION:
        _calibration(path, figure, json, quiet)
    elif kind is Kind.VERIFICATION:
        _verification(path, figure, json, quiet)
    else:
        with shown_progress(quiet) as progress:
            recording = _loaded(path, kind is Kind.LOLLYPOP_RECORDING, detect, progress)
        _recording(recording, figure, json, quiet)
    if figure is not None and not quiet:
        print(f"written: {figure}")


def _live(path: Path, enough_mm: float, enough_deg: float) -> None:
    from rich.live import Live

    from gtcal.cli.info_tables import look_shown
    from gtcal.cli.terminal import Terminal
    from gtcal.overview.live import Enough, watch

    console, enough = Terminal(), Enough(enough_mm, enough_deg)
    if not console.is_terminal:
        for look in watch(path, enough):
            console.print(look_shown(look))
            console.file.flush()
    with Live(console=console, auto_refresh=False) as shown:
        for look in watch(path, enough):
            shown.update(look_shown(look), refresh=True)


def _mocap_file(path: Path, figure: Path | None, json: bool, quiet: bool) -> None:
    from gtcal.cli.info_tables import mocap_file_document, print_mocap_file
    from gtcal.cli.json_output import print_json
    from gtcal.errors import GtcalError
    from gtcal.readers import inspect_mocap

    if figure is not None:
        raise GtcalError(f"{path}: is a file of mocap data, of which there is no picture; leave out --figure")
    summary = inspect_mocap(path)
    if json:
        print_json(mocap_file_document(summary))
    elif not quiet:
        print_mocap_file(summary)


def _loaded(path: Path, lollypop: bool, detect: bool, progress: Progress) -> Recording | LollypopRecording:
    from gtcal.recordings.recording import load_recording
    from gtcal.verification.lollypop_recording import detected_lollypop, load_lollypop_recording
    from gtcal.workflow import detected

    if lollypop:
        loaded = load_lollypop_recording(path)
        return detected_lollypop(loaded, progress=progress) if detect else loaded
    recording = load_recording(path)
    return detected(recording, progress=progress) if detect else recording


def _recording(recording: Recording | LollypopRecording, figure: Path | None, json: bool, quiet: bool) -> None:
    from gtcal.cli.info_tables import print_summary, summary_document
    from gtcal.cli.json_output import print_json
    from gtcal.files import check_outputs
    from gtcal.overview.summary import summarise

    check_outputs([figure], recording.files)
    summary = summarise(recording)
    if figure is not None:
        from gtcal.overview.summary_figure import draw_recording

        draw_recording(figure, summary)
    if json:
        print_json(summary_document(summary))
    elif not quiet:
        print_summary(summary)


def _calibration(path: Path, figure: Path | None, json: bool, quiet: bool) -> None:
    from gtcal.cli.info_tables import print_provenance
    from gtcal.cli.json_output import print_json
    from gtcal.cli.tables import print_calibration
    from gtcal.results.calibration_file import calibration_document, read_calibration

    calibration = read_calibration(path)
    if figure is not None:
        from gtcal.overview.result_figures import draw_calibration

        draw_calibration(figure, calibration)
    if json:
        print_json(calibration_document(calibration))
    elif not quiet:
        print_calibration(calibration, verbose=True)
        print_provenance(calibration.provenance)


def _verification(path: Path, figure: Path | None, json: bool, quiet: bool) -> None:
    from gtcal.cli.info_tables import print_provenance
    from gtcal.cli.json_output import print_json
    from gtcal.cli.verification_tables import print_verification
    from gtcal.verification.verification_file import read_verification, verification_document

    verification = read_verification(path)
    if figure is not None:
        from gtcal.overview.result_figures import draw_verification

        draw_verification(figure, verification)
    if json:
        print_json(verification_document(verification))
    elif not quiet:
        print_verification(verification, verbose=True)
        print_provenance(verification.provenance)
