"""gtcal verify: does a calibration still hold?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from gtcal.results.calibration import Calibration
    from gtcal.verification.verification import Verification


def verify(
    calibration: tyro.conf.Positional[Path],
    recording: tyro.conf.Positional[Path],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("verification.json"),
    report: Path | None = None,
    sightings: Path | None = None,
    clock: Literal["calibration", "estimate", "trust"] = "calibration",
    images: Literal["all", "expected"] = "all",
    max_rmse_px: float = 0.5,
    max_rmse_mm: float = 1.0,
    confidence: float = 0.95,
    max_viewing_angle_deg: float = 60.0,
    min_sightings: int = 50,
    min_coverage: float = 0.2,
    json: bool = False,
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Verify a calibration with an independent recording of the Lollypop, a device whose printed centre and mocap
    centroid are the same point.

    Prints a verdict, a table per camera and what the errors look like, and writes verification.json. Exit codes: 0 the
    calibration holds, 3 it does not, 4 the recording can't tell.

    Record some 30 s: carry the device through every camera's whole image, at the distances of use, held towards the
    camera. The recording's manifest has 'device: {preset: paper_lollypop}' and 'device_body: ...' where that of a
    board has 'board' and 'board_body'; all else is the same.

    The default tolerances come from the paper: 0.5 px is where its green ends, above every camera of its table (0.22
    to 0.44 px RMSE, noise of mocap and detection included); 1 mm is what 0.5 px are at 1 m through a focal length of
    500 px.

    Args:
        calibration: calibration.json.
        recording: Folder with the manifest of the Lollypop's recording, or the manifest itself.
        output: File to write.
        report: HTML file to write with the verdict's evidence: heat maps, worst images, errors over time (see
            'gtcal report', which also adds the calibration's own recording).
        sightings: CSV to write with every single error.
        clock: 'calibration': where 'gtcal calibrate --clock' found an offset between the clocks, it is applied here
            too. 'estimate': for clocks whose offset is another in every recording: it is found from the sightings, a
            single number from hundreds of them, and applied before anything is judged. 'trust': take the stamps as
            they are.
        images: Of cameras that come as images: 'all': every image is searched for the device. 'expected': some ten a
            second, where calibration and mocap say that it is seen, and near there: much faster, and as 'gtcal watch'
            does; where it is not found there, whole images are searched.
        max_rmse_px: Tolerance on the distance of image centre and mocap centre in the image (e_2D, RMSE).
        max_rmse_mm: Tolerance on the same, carried out to the device's depth (e_3D, RMSE).
        confidence: Of the bounds on the RMSE that decide. A tolerance is kept where the upper bound lies below it, and
            exceeded where the lower one lies above.
        max_viewing_angle_deg: Leave out frames that see the device more obliquely than this.
        min_sightings: A camera with fewer is inconclusive.
        min_coverage: A camera that was shown the device in a smaller share of its image is inconclusive.
        json: Print the result as JSON in place of tables ('gtcal schema verification').
        verbose: Print also what was left out and why.
        quiet: Show no progress and print nothing; the exit code tells.
    """
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.verification_tables import print_verification
    from gtcal.files import check_outputs, fingerprint
    from gtcal.results.calibration_file import read_calibration
    from gtcal.verification.lollypop_recording import load_lollypop_recording
    from gtcal.verification.verification import VerificationOptions
    from gtcal.verification.verification_file import verification_document, write_sightings, write_verification
    from gtcal.verification.workflow import verify as run

    options = VerificationOptions(
        clock=clock,
        images=images,
        max_rmse_px=max_rmse_px,
        max_rmse_mm=max_rmse_mm,
        confidence=confidence,
        max_viewing_angle_deg=max_viewing_angle_deg,
        min_sightings=min_sightings,
        min_coverage=min_coverage,
    )
    calibrated = read_calibration(calibration)
    loaded = load_lollypop_recording(recording)
    check_outputs((output, report, sightings), (calibration, *loaded.files))
    with shown_progress(quiet) as progress:
        found = run(loaded, calibrated, options, progress=progress, inputs=(fingerprint(calibration),))
        if report is not None:
            _write_report(report, calibrated, found)
    write_verification(output, found)
    if sightings is not None:
        write_sightings(sightings, found)
    if json:
        print_json(verification_document(found))
    elif not quiet:
        print_verification(found, notes=loaded.notes, verbose=verbose)
        print("written: " + ", ".join(str(path) for path in (output, report, sightings) if path is not None))
    return found.verdict.exit_code


def _write_report(path: Path, calibration: Calibration, verification: Verification) -> None:
    from gtcal.report import write_report

    write_report(path, calibration, verification=verification)
