"""gtcal selfcheck: what a recording says about its own calibration."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from rich.table import Table

    from gtcal.selfchecks.selfcheck import SelfCheck


def selfcheck(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")],
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    folds: int = 5,
    calibrate_intrinsics: bool = False,
    refine_intrinsics: bool = False,
    mocap_noise: Literal["estimate", "exact"] = "estimate",
    clock: Literal["trust", "estimate", "per_camera"] = "trust",
    seed: int = 0,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Check a calibration against its own recording: halves of it, frames held out, and each image by itself.

    Three checks, each with a plain statement. Split half: calibrations from the first and the second half, whose
    difference should be what the covariance of the whole lets expect. Hold-out: each block of time predicted by a
    calibration that has not seen it, for the estimate taken and for stages 3 and 4, with the spread of the cameras'
    positions. Chain against PnP: how much of the error is of lens model and detector, of the mocap, and of the
    calibration.

    They can't find an error that is in the whole recording alike; 'gtcal verify' with a second recording can.

    Args:
        recording: Folder with the manifest (recording.yaml or recording.json), or the manifest itself.
        output: JSON file to write with all of it.
        folds: Blocks of time to hold out in turn.
        calibrate_intrinsics: As for 'gtcal calibrate'.
        refine_intrinsics: As for 'gtcal calibrate'.
        mocap_noise: As for 'gtcal calibrate'.
        clock: 'estimate' or 'per_camera': correct the clocks' offset first, as 'gtcal calibrate' does.
        seed: Of the random starting rotations of stage 1.
        json: Print the result as JSON in place of tables ('gtcal schema selfcheck').
        quiet: Show no progress and print nothing.
    """
    from gtcal.cli.calibrate import intrinsics_mode
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.estimation.options import CalibrationOptions
    from gtcal.files import check_outputs
    from gtcal.recordings.recording import load_recording
    from gtcal.selfchecks.selfcheck import selfcheck as run
    from gtcal.selfchecks.selfcheck_file import selfcheck_document, write_selfcheck

    mode = intrinsics_mode("auto", calibrate=calibrate_intrinsics, refine=refine_intrinsics)
    options = CalibrationOptions(intrinsics=mode, mocap=mocap_noise, clock=clock, seed=seed)
    loaded = load_recording(recording)
    check_outputs([output], loaded.files)
    with shown_progress(quiet) as progress:
        found = run(loaded, options, n_folds=folds, progress=progress)
    if output is not None:
        write_selfcheck(output, found)
    if json:
        print_json(selfcheck_document(found))
    if json or quiet:
        return
    console = Terminal()
    for table in selfcheck_tables(found):
        console.print(table)
    for line in (*found.statements, *(f"note: {note}" for note in found.notes)):
        console.print(line, highlight=False)
    if output is not None:
        console.print(f"written: {output}", highlight=False)


def selfcheck_tables(found: SelfCheck) -> list[Table]:
    """Halves, blocks of time, and where the error is."""
    from gtcal.cli.tables import new_table
    from gtcal.selfchecks.folds import DEFAULT

    halves = new_table("first half of the recording against the second")
    for heading in ("difference, mm", "deg", "squared, of expected", "chance of more"):
        halves.add_column(heading, justify="right")
    for part in () if found.halves is None else (*found.halves.by_unknown, found.halves.overall):
        moved = "" if isnan(part.position_mm) else f"{part.position_mm:.3f}"
        turned = "" if isnan(part.angle_deg) else f"{part.angle_deg:.4f}"
        halves.add_row(part.what, moved, turned, f"{part.per_dof:.2f}", f"{part.probability:.2g}")
    names = [camera.camera for camera in found.cameras]
    held_out = new_table(
        f"{found.n_folds} blocks of time, each predicted without having been seen",
        caption="by camera: standard deviation of its position over the blocks, mm",
    )
    for heading in ("RMSE, px", *names):
        held_out.add_column(heading, justify="right")
    for hold_out in found.hold_outs:
        what = "as taken" if hold_out.stage == DEFAULT else f"stage {hold_out.stage}"
        held_out.add_row(what, f"{hold_out.rmse_px:.3f}", *(f"{hold_out.spread_mm[name]:.3f}" for name in names))
    parts = new_table("where the error is, px RMS")
    for heading in ("lens, detector", "mocap", "calibration", "held out", "PnP to chain, mm", "deg"):
        parts.add_column(heading, justify="right")
    for camera in found.cameras:
        lengths = (camera.pnp_px, camera.mocap_px, camera.calibration_px, camera.hold_out_px, camera.scatter_mm)
        parts.add_row(camera.camera, *(f"{length:.3f}" for length in lengths), f"{camera.scatter_deg:.4f}")
    return [halves, held_out, parts] if found.halves is not None else [held_out, parts]
