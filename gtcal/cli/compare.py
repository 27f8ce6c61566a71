"""gtcal compare: other methods on the same recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from rich.table import Table

    from gtcal.baselines.compare import Compared
    from gtcal.estimation.options import CalibrationOptions, IntrinsicsMode


def compare(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")],
    *,
    lollypop: Path | None = None,
    measured_x: Path | None = None,
    markers: Path | None = None,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    calibrate_intrinsics: bool = False,
    clock: Literal["trust", "estimate", "per_camera"] = "trust",
    seed: int = 0,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Calibrate a recording by the joint solution and by other methods, and compare.

    The paper's three stages without the mocap's noise; the closed forms of Tsai-Lenz, Park-Martin, Daniilidis, Zhuang,
    Shah and Li and the nonlinear method of Dornaika-Horaud, all from PnP poses; Sturm's with a measured board-to-body
    transform; and P3P on retroreflective markers seen in the image. Judged by the reprojection RMSE on the board's
    views that the joint solution keeps and, much better, by a second recording of the Lollypop. Of a recording of poses
    in place of corners, the methods on poses against the joint estimate on SE(3).

    Args:
        recording: Folder with the manifest (recording.yaml or recording.json), or the manifest itself.
        lollypop: Recording of the Lollypop to judge by.
        measured_x: For Sturm's method: YAML file that states body_T_board as measured by hand (a file of priors,
            see 'gtcal calibrate --help'; its sigmas are not used).
        markers: CSV file of markers seen in the images: columns camera, stamp_ns, x_px, y_px, and the marker's position
            in the mocap's world, x_m, y_m, z_m.
        output: JSON file to write.
        calibrate_intrinsics: As for 'gtcal calibrate'.
        clock: 'estimate' or 'per_camera': correct the clocks' offset first, as 'gtcal calibrate' does.
        seed: Of the random numbers.
        quiet: Show no progress and print nothing.
    """
    from gtcal.baselines.compare import compare as run
    from gtcal.baselines.compare import compare_markers
    from gtcal.baselines.compare_file import write_comparison
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.errors import GtcalError
    from gtcal.estimation.options import CalibrationOptions
    from gtcal.estimation.priors_file import read_priors
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.recording import holds_poses
    from gtcal.recordings.recording import load_recording
    from gtcal.verification.lollypop_recording import load_lollypop_recording

    body_T_board = None
    if measured_x is not None:
        prior = read_priors(measured_x).body_T_board
        if prior is None:
            raise GtcalError(f"{measured_x}: states no body_T_board, which Sturm's method needs")
        body_T_board = prior.a_T_b
    mode: IntrinsicsMode = "calibrate" if calibrate_intrinsics else "auto"
    options = CalibrationOptions(intrinsics=mode, clock=clock, seed=seed)
    if holds_poses(recording):
        if lollypop or measured_x or markers or output or calibrate_intrinsics or clock != "trust":
            raise GtcalError(f"{recording}: has poses in place of corners, which are compared without any option")
        _compare_poses(recording, options, quiet)
        return
    loaded = load_recording(recording)
    device = load_lollypop_recording(lollypop) if lollypop is not None else None
    read = [path for path in (measured_x, markers) if path is not None]
    check_outputs([output], (*read, *loaded.files, *(device.files if device is not None else ())))
    with shown_progress(quiet) as progress:
        found = run(loaded, device, options, measured_body_T_board=body_T_board, progress=progress)
        if markers is not None:
            found += (compare_markers(markers, loaded, found[0], device, seed=seed),)
    if output is not None:
        write_comparison(output, found)
    if quiet:
        return
    console = Terminal()
    console.print(_table(found))
    for failed in (row for row in found if row.failure):
        console.print(f"{failed.method}: {failed.failure}", highlight=False)
    if body_T_board is None:
        console.print("Sturm's method is left out: it needs --measured-x", highlight=False)
    if output is not None:
        console.print(f"written: {output}", highlight=False)


def _compare_poses(recording: Path, options: CalibrationOptions, quiet: bool) -> None:
    from gtcal.cli.pose_tables import closed_form_table
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.pose_recordings.calibration import calibrate_pose_recording
    from gtcal.pose_recordings.recording import load_pose_recording

    loaded = load_pose_recording(recording)
    with shown_progress(quiet) as progress:
        found = calibrate_pose_recording(loaded, options, progress=progress)
    if not quiet:
        Terminal().print(closed_form_table(found.closed_forms))


def _table(found: tuple[Compared, ...]) -> Table:
    from gtcal.cli.tables import new_table

    table = new_table(
        "methods on the same recording",
        caption="px: RMSE; mm, deg: how far the farthest camera is from the joint solution",
    )
    for heading in ("board, px", "Lollypop, px", "mm", "deg", "s"):
        table.add_column(heading, justify="right")
    for row in found:
        if row.failure:
            table.add_row(row.method, "failed", "", "", "", f"{row.duration_s:.2f}")
            continue
        lollypop = "-" if row.lollypop_rmse_px is None else f"{row.lollypop_rmse_px:.3f}"
        difference = f"{row.difference_mm:.3f}", f"{row.difference_deg:.4f}"
        table.add_row(row.method, f"{row.board_rmse_px:.3f}", lollypop, *difference, f"{row.duration_s:.2f}")
    return table
