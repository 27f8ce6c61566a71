"""gtcal compare: other methods on the same recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from gtcal.baselines.compare import Compared, Comparison
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
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Calibrate a recording by the joint solution and by other methods, and compare.

    The paper's three stages without the mocap's noise; the closed forms of Tsai-Lenz, Park-Martin, Daniilidis, Zhuang,
    Shah and Li and the nonlinear method of Dornaika-Horaud, all from PnP poses; Sturm's with a measured board-to-body
    transform; and P3P on retroreflective markers seen in the image. Judged by the reprojection RMSE on the board's
    views that the joint solution keeps and, much better, by a second recording of the Lollypop; by the truth where
    ground_truth.json is beside a simulated recording. Of a recording of poses in place of corners, the methods on poses
    against the joint estimate on SE(3).

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
        json: Print the result as JSON in place of tables ('gtcal schema comparison').
        quiet: Show no progress and print nothing.
    """
    from gtcal.baselines.compare import Comparison, compare_markers
    from gtcal.baselines.compare import compare as run
    from gtcal.baselines.compare_file import comparison_document, write_comparison
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.errors import GtcalError
    from gtcal.estimation.options import CalibrationOptions
    from gtcal.estimation.priors_file import read_priors
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.recording import holds_poses
    from gtcal.recordings.recording import load_recording
    from gtcal.simulation import read_ground_truth
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
        _compare_poses(recording, options, json, quiet)
        return
    loaded = load_recording(recording)
    beside = _truth_beside(loaded.path)
    truth = None if beside is None else read_ground_truth(beside.parent)
    device = load_lollypop_recording(lollypop) if lollypop is not None else None
    read = [path for path in (measured_x, markers, beside) if path is not None]
    check_outputs([output], (*read, *loaded.files, *(device.files if device is not None else ())))
    with shown_progress(quiet) as progress:
        found = run(loaded, device, options, measured_body_T_board=body_T_board, truth=truth, progress=progress)
        if markers is not None:
            seen = compare_markers(markers, loaded, found.joint, device, truth=truth, seed=seed)
            found = Comparison((*found, seen))
    if output is not None:
        write_comparison(output, found)
    if json:
        print_json(comparison_document(found))
    if json or quiet:
        return
    console = Terminal()
    for part in comparison_parts(found):
        console.print(part)
    if body_T_board is None:
        console.print("Sturm's method is left out: it needs --measured-x", highlight=False)
    if output is not None:
        console.print(f"written: {output}", highlight=False)


def _truth_beside(manifest: Path | None) -> Path | None:
    """The file of the truth that lies beside the manifest of a simulated recording."""
    from gtcal.simulation.ground_truth import GROUND_TRUTH_NAME

    path = None if manifest is None else manifest.parent / GROUND_TRUTH_NAME
    return path if path is not None and path.is_file() else None


def _compare_poses(recording: Path, options: CalibrationOptions, json: bool, quiet: bool) -> None:
    from gtcal.cli.json_output import print_json
    from gtcal.cli.pose_tables import closed_form_table
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.terminal import Terminal
    from gtcal.pose_recordings.calibration import calibrate_pose_recording
    from gtcal.pose_recordings.calibration_file import pose_comparison_document
    from gtcal.pose_recordings.recording import load_pose_recording

    loaded = load_pose_recording(recording)
    with shown_progress(quiet) as progress:
        found = calibrate_pose_recording(loaded, options, progress=progress)
    if json:
        print_json(pose_comparison_document(found.closed_forms))
    elif not quiet:
        Terminal().print(closed_form_table(found.closed_forms))


def comparison_parts(found: Comparison) -> list[Table | Text]:
    """The methods side by side; of those that failed, why."""
    from rich.text import Text

    failed = (Text(f"{row.method}: {row.failure}") for row in found if row.failure)
    return [_table(found), *failed]


def _table(found: Comparison) -> Table:
    from gtcal.cli.tables import new_table

    with_truth = any(row.truth_mm is not None for row in found)
    table = new_table(
        "methods on the same recording",
        caption="px: RMSE; 1-sigma: the largest of a camera, by the method's covariance, of those without one by "
        "leaving out each tenth of the frames in turn (blind to what errs alike in all frames); from joint"
        + (", from truth" if with_truth else "")
        + ": how far the farthest camera is off",
    )
    headings = ("board, px", "Lollypop, px", "1-sigma, mm", "deg", "from joint, mm", "deg")
    for heading in (*headings, *(("from truth, mm", "deg") if with_truth else ()), "s"):
        table.add_column(heading, justify="right")
    for row in found:
        table.add_row(row.method, *_cells(row, with_truth), f"{row.duration_s:.2f}")
    return table


def _cells(row: Compared, with_truth: bool) -> list[str]:
    if row.failure:
        return ["failed", *[""] * (7 if with_truth else 5)]
    mm = (row.sigma_mm, row.difference_mm, *((row.truth_mm,) if with_truth else ()))
    deg = (row.sigma_deg, row.difference_deg, *((row.truth_deg,) if with_truth else ()))
    pairs = zip((_shown(value, 3) for value in mm), (_shown(value, 4) for value in deg), strict=True)
    return [_shown(row.board_rmse_px, 3), _shown(row.lollypop_rmse_px, 3), *(cell for pair in pairs for cell in pair)]


def _shown(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
