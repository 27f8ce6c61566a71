"""What the terminal shows of results: tables that a person can judge in ten seconds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from factors.rigid import inverse
from gtcal.calibration import ERRORS_IN_VARIABLES, NAIVE, Calibration, StageReport, pose_difference
from gtcal.camera import FloatArray
from gtcal.recording import Recording
from gtcal.simulation import GroundTruth

_COVARIANCES = {
    NAIVE: "of pixel noise alone, with the mocap taken as exact (too small where the mocap is noisy)",
    ERRORS_IN_VARIABLES: "of pixel noise and the mocap noise given",
}


def print_calibration(calibration: Calibration, *, notes: Sequence[str] = (), verbose: bool = False) -> None:
    """Print the cameras, the board and the warnings; ``verbose`` adds the stages and what was left out and why."""
    parts: list[RenderableType] = [camera_table(calibration), _board_line(calibration)]
    if verbose:
        parts += [stage_table(calibration.stages), *_dropped_lines(calibration)]
    parts += [Text(f"note: {note}", style="cyan") for note in notes]
    parts += [Text(f"warning: {warning}", style="yellow") for warning in calibration.warnings]
    Console().print(Group(*parts))


def camera_table(calibration: Calibration) -> Table:
    """A row per camera: how well it fits, from how much, where it is and how sure that is."""
    table = Table(
        box=box.SIMPLE_HEAD,
        caption=f"residuals in px over the corners used; 1-sigma: {_COVARIANCES[calibration.covariance_kind]}",
        caption_justify="left",
    )
    table.add_column("camera")
    for heading in ("RMSE", "median", "95 %", "views", "corners", "left out"):
        table.add_column(heading, justify="right")
    table.add_column("position in ref, mm", justify="right")
    table.add_column("1-sigma, mm", justify="right")
    table.add_column("deg", justify="right")
    for name, camera in calibration.cameras.items():
        residuals, pose = camera.residuals, camera.camera_T_ref
        table.add_row(
            name,
            f"{residuals.rmse_px:.3f}",
            f"{residuals.median_px:.3f}",
            f"{residuals.p95_px:.3f}",
            str(residuals.n_views),
            str(residuals.n_corners),
            _left_out(calibration, name),
            _vector(1e3 * pose.position_of_a_in_b_m),
            _largest(pose.position_of_a_in_b_sigma_mm, 3),
            _largest(pose.rotation_sigma_deg, 4),
        )
    return table


def _left_out(calibration: Calibration, camera: str) -> str:
    dropped = [entry for entry in calibration.dropped if entry.camera == camera]
    views, corners = sum(entry.n_views for entry in dropped), sum(entry.n_corners for entry in dropped)
    if not corners:
        return "-"
    return f"{_count(views, 'view')}, {_count(corners, 'corner')}" if views else _count(corners, "corner")


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _board_line(calibration: Calibration) -> Text:
    pose = calibration.body_T_board
    line = f"body_T_board: origin at ({_vector(1e3 * pose.a_T_b[:3, 3])}) mm"
    if pose.covariance is not None:
        mm, deg = _largest(pose.position_of_b_in_a_sigma_mm, 3), _largest(pose.rotation_sigma_deg, 4)
        line += f", 1-sigma {mm} mm, {deg} deg"
    return Text(line)


def stage_table(stages: Sequence[StageReport]) -> Table:
    """A row per stage."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("stage")
    for heading in ("iterations", "error before", "after"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for heading in ("median residual, px", "s"):
        table.add_column(heading, justify="right")
    for stage in stages:
        table.add_row(
            f"{stage.stage}  {stage.name}" if stage.stage else stage.name,
            str(stage.iterations) if stage.iterations else "",
            _number(stage.error_before),
            _number(stage.error_after),
            stage.error_unit,
            _number(stage.median_px),
            f"{stage.duration_s:.2f}",
        )
    return table


def _dropped_lines(calibration: Calibration) -> list[Text]:
    return [
        Text(
            f"left out of {entry.camera}: {_count(entry.n_views, 'view')}, {_count(entry.n_corners, 'corner')}: "
            f"{entry.reason}"
        )
        for entry in calibration.dropped
    ]


def detection_table(recording: Recording) -> Table:
    """A row per camera: how much of the board its images show."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("camera")
    for heading in ("images", "with board", "corners", "median per view", "of board"):
        table.add_column(heading, justify="right")
    for name, detections in recording.detections.items():
        per_view = np.diff(detections.view_start)
        images = str(len(recording.images[name])) if name in recording.images else "-"
        median = f"{np.median(per_view):.0f}" if len(per_view) else "0"
        table.add_row(
            name, images, str(detections.n_views), str(detections.n_corners), median, str(recording.board.n_corners)
        )
    return table


def _vector(components: FloatArray) -> str:
    return ", ".join(f"{component:.2f}" for component in components)


def _largest(sigmas: FloatArray | None, digits: int) -> str:
    return "-" if sigmas is None else f"{sigmas.max():.{digits}f}"


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4g}"


def print_errors(calibration: Calibration, truth: GroundTruth) -> None:
    """Print how far a calibration of a simulated recording is from the truth."""
    table = Table(box=box.SIMPLE_HEAD, title="difference from the truth", title_justify="left")
    table.add_column("transform")
    for heading in ("position, mm", "rotation, deg"):
        table.add_column(heading, justify="right")
    for name, camera in calibration.cameras.items():
        found, true = inverse(camera.camera_T_ref.a_T_b), inverse(truth.camera_T_ref[name])
        table.add_row(f"camera_T_ref of {name}", *_difference(found, true))
    table.add_row("body_T_board", *_difference(calibration.body_T_board.a_T_b, truth.body_T_board))
    Console().print(table)


def _difference(found: FloatArray, true: FloatArray) -> tuple[str, str]:
    position_mm, rotation_deg = pose_difference(found, true)
    return f"{position_mm:.3f}", f"{rotation_deg:.4f}"
