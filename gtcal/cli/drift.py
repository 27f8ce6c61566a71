"""gtcal drift: a calibration over successive recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro


def drift(
    calibration: tyro.conf.Positional[Path],
    recordings: tyro.conf.Positional[tuple[Path, ...]],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("drift.json"),
    csv: Path | None = None,
    figure: Path | None = None,
    clock: Literal["calibration", "estimate", "trust"] = "calibration",
    max_rmse_px: float = 0.5,
    max_rmse_mm: float = 1.0,
    confidence: float = 0.95,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Verify a calibration with successive recordings of the Lollypop: when did it cease to hold, and is it on its way?

    Prints a table (RMSE of every camera in every recording), the first recording that fails and what it looks like, and
    whether the errors grow from recording to recording by more than chance. Exit codes as of 'gtcal verify', over all
    recordings: 0 all pass, 3 one fails, 4 one can't tell.

        gtcal drift calibration.json monday tuesday wednesday --figure drift.png

    Args:
        calibration: calibration.json.
        recordings: Folders of Lollypop recordings, in the order in which they were taken.
        output: JSON file to write.
        csv: CSV file to write, a row per recording and camera.
        figure: Figure to write: .png, .svg or .pdf. RMSE in px and mm with its bounds.
        clock: As of 'gtcal verify'; 'estimate' finds each recording's own offset.
        max_rmse_px: Tolerance on e_2D, as of 'gtcal verify'.
        max_rmse_mm: Tolerance on e_3D.
        confidence: Of the bounds.
        json: Print the result as JSON in place of tables ('gtcal schema drift').
        quiet: Show no progress and print nothing; the exit code tells.
    """
    import time

    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.verification_tables import print_drift
    from gtcal.files import check_outputs, fingerprint
    from gtcal.results.calibration_file import read_calibration
    from gtcal.results.provenance import provenance
    from gtcal.verification.drift import drift_document, verify_series, write_drift_csv, write_drift_json
    from gtcal.verification.drift_figure import draw_drift
    from gtcal.verification.lollypop_recording import load_lollypop_recording
    from gtcal.verification.verification import VerificationOptions

    started = time.perf_counter()
    options = VerificationOptions(clock=clock, max_rmse_px=max_rmse_px, max_rmse_mm=max_rmse_mm, confidence=confidence)
    calibrated = read_calibration(calibration)
    names = [path.resolve().name for path in recordings]
    if len(set(names)) < len(names):
        names = [str(path) for path in recordings]
    loaded = [(name, load_lollypop_recording(path)) for name, path in zip(names, recordings, strict=True)]
    check_outputs((output, csv, figure), (calibration, *(file for _, source in loaded for file in source.files)))
    own = fingerprint(calibration)
    with shown_progress(quiet) as progress:
        found = verify_series(loaded, calibrated, options, progress=progress, inputs=(own,))
    inputs = (own, *(entry for _, recording in loaded for entry in recording.inputs))
    made = provenance(options, inputs, time.perf_counter() - started)
    write_drift_json(output, found, made)
    if csv is not None:
        write_drift_csv(csv, found)
    if figure is not None:
        draw_drift(figure, found)
    if json:
        print_json(drift_document(found, made))
    elif not quiet:
        print_drift(found)
        print("written: " + ", ".join(str(path) for path in (output, csv, figure) if path is not None))
    return found.verdict.exit_code
