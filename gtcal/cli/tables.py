"""What the terminal shows of results: tables that a person can judge in ten seconds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.cli.folded_table import FoldedTable
from gtcal.cli.terminal import Terminal
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording
from gtcal.results.board_shape import BoardShape
from gtcal.results.calibration import Calibration, CameraCalibration, StageReport, pose_difference
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE
from gtcal.results.effect_finding import EffectFinding
from gtcal.uncertainty.coverage import coverage

if TYPE_CHECKING:
    from gtcal.simulation import GroundTruth

_COVARIANCES = {
    NAIVE: "from pixel noise alone, the mocap taken as exact: too small where the mocap is noisy",
    CLUSTERED: "by how much whole frames are seen to scatter (cluster-robust), the mocap's errors included",
    ERRORS_IN_VARIABLES: "from pixel noise and the mocap's noise (errors in variables)",
}


_PLATFORM_REF = "ref: the tracked body that carries the cameras"
_FRAMES = {
    Capture.FIXED_CAMERAS: "ref: the mocap's world; body: the tracked body that carries the board",
    Capture.TRACKED_PLATFORM: f"{_PLATFORM_REF}; body: the one that carries the board",
    Capture.STANDING_BOARD: f"{_PLATFORM_REF}; body: the mocap's world, in which the board stands",
}
"""What the frames are called in which poses are given."""


def print_calibration(calibration: Calibration, *, notes: Sequence[str] = (), verbose: bool = False) -> None:
    """Print fit, poses and warnings; ``verbose`` as for ``calibration_parts``."""
    Terminal().print(Group(*calibration_parts(calibration, notes=notes, verbose=verbose)))


def calibration_parts(
    calibration: Calibration, *, notes: Sequence[str] = (), verbose: bool = False
) -> list[RenderableType]:
    """Fit, poses and warnings; ``verbose`` adds the distortion, the stages, what was left out and why, and the effects
    that the data do not want."""
    parts: list[RenderableType] = [
        fit_table(calibration),
        pose_table(calibration),
        *lens_tables(calibration, verbose=verbose),
    ]
    parts += [shape_table(calibration.board_shape)] if calibration.board_shape is not None else []
    if verbose:
        parts += [stage_table(calibration.stages), *_dropped_lines(calibration), *_lacking_lines(calibration)]
    shown = [finding for finding in calibration.effects if finding.significant or verbose]
    parts += [effect_table(shown)] if shown else []
    if calibration.mocap_noise is not None:
        parts.append(Text(f"stage {calibration.mocap_noise.stage} taken: {calibration.mocap_noise.reason}"))
    if calibration.carried_over is not None:
        parts.append(Text(calibration.carried_over.statement))
        parts += [Text(f"since then: {line}", style="yellow") for line in calibration.carried_over.moved]
    if calibration.clock is not None and calibration.clock.corrected:
        parts.append(Text(f"clock: {calibration.clock.statement} added to the cameras' stamps"))
        parts += [Text(f"clock: {line}") for line in calibration.clock.readout_statements]
    parts += [Text(f"note: {note}", style="cyan") for note in notes]
    return parts + [Text(f"warning: {warning}", style="yellow") for warning in calibration.warnings]


def fit_table(calibration: Calibration) -> Table:
    """A row per camera: how well it fits, and from how much."""
    table = new_table("reprojection residuals, px")
    for heading in ("RMSE", "median", "95 %", "worst", "views", "corners", "left out"):
        table.add_column(heading, justify="right")
    for name, camera in calibration.cameras.items():
        fit = camera.residuals
        lengths = (f"{length:.3f}" for length in (fit.rmse_px, fit.median_px, fit.p95_px, fit.worst_px))
        table.add_row(name, *lengths, str(fit.n_views), str(fit.n_corners), _left_out(calibration, name))
    return table


def pose_table(calibration: Calibration) -> Table:
    """A row per camera and one for the board: where it is, and how sure that is."""
    table = new_table(
        "where they are",
        caption=f"1-sigma: {_COVARIANCES[calibration.covariance_kind]}\n{_FRAMES[calibration.capture]}",
    )
    for heading in ("position, mm", "in", "1-sigma, mm", "deg"):
        table.add_column(heading, justify="left" if heading == "in" else "right")
    for name, camera in calibration.cameras.items():
        pose = camera.camera_T_ref
        sigmas = _largest(pose.position_of_a_in_b_sigma_mm, 3), _largest(pose.rotation_sigma_deg, 4)
        table.add_row(name, vector(1e3 * pose.position_of_a_in_b_m), "ref", *sigmas)
    pose = calibration.body_T_board
    sigmas = _largest(pose.position_of_b_in_a_sigma_mm, 3), _largest(pose.rotation_sigma_deg, 4)
    table.add_row("board", vector(1e3 * pose.a_T_b[:3, 3]), "body", *sigmas)
    for board in calibration.other_boards:
        pose = board.body_T_board
        sigmas = _largest(pose.position_of_b_in_a_sigma_mm, 3), _largest(pose.rotation_sigma_deg, 4)
        where = "mocap's world" if board.capture is Capture.STANDING_BOARD else "its body"
        table.add_row(f"board {board.name}", vector(1e3 * pose.a_T_b[:3, 3]), where, *sigmas)
    return table


def lens_tables(calibration: Calibration, *, verbose: bool = False) -> list[Table]:
    """A row per camera whose intrinsics were solved for, ``verbose`` with a second table of its distortion; no table
    where none were."""
    found = {name: camera for name, camera in calibration.cameras.items() if camera.theta_covariance is not None}
    if not found:
        return []
    table = new_table(
        "intrinsics that were solved for",
        caption="moved: from what was stated, or found first where nothing was, by the group of intrinsics that moved "
        "most (f focal length, c principal point, d distortion), in sigmas of what was known; px, mm: the most that a "
        "pixel of the image and the camera moved by one group",
    )
    for heading in ("fx", "fy", "± px", "cx", "cy", "± px", "moved", "px", "mm"):
        table.add_column(heading, justify="right")
    for name, camera in found.items():
        theta, sigmas = camera.camera.theta, camera.camera_with_sigmas.theta_sigmas
        assert sigmas is not None  # solved for
        numbers = (*theta[:2], sigmas[:2].max(), *theta[2:4], sigmas[2:4].max())
        table.add_row(name, *(f"{number:.2f}" for number in numbers), *_moved(camera))
    return [table, *([distortion_table(found)] if verbose else [])]


def distortion_table(found: Mapping[str, CameraCalibration]) -> Table:
    """A row per camera: its distortion coefficients, each with its 1-sigma."""
    table = new_table("distortion that was solved for, ± 1-sigma")
    names = list(dict.fromkeys(name for c in found.values() for name in c.camera.model.parameter_names[4:]))
    for name in names:
        table.add_column(name, justify="right")
    for name, camera in found.items():
        with_sigmas = camera.camera_with_sigmas
        assert with_sigmas.theta_sigmas is not None  # solved for
        pairs = zip(with_sigmas.theta.tolist(), with_sigmas.theta_sigmas.tolist(), strict=True)
        of_this = dict(zip(camera.camera.model.parameter_names, pairs, strict=True))
        table.add_row(name, *(_with_sigma(*of_this[each]) if each in of_this else "" for each in names))
    return table


def _with_sigma(value: float, sigma: float) -> str:
    """To the second digit of the sigma."""
    digits = 4 if not 0.0 < sigma < np.inf else int(np.clip(1 - np.floor(np.log10(sigma)), 2, 9))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


_GROUP_LETTERS = {"focal length": "f", "principal point": "c", "distortion": "d"}


def _moved(camera: CameraCalibration) -> tuple[str, str, str]:
    moves = camera.lens_moves
    if not moves:
        return "-", "-", "-"
    far = max(moves, key=lambda move: move.sigmas)
    largest_px, largest_mm = max(move.largest_px for move in moves), max(move.camera_mm for move in moves)
    return f"{_GROUP_LETTERS[far.group]} {far.sigmas:.1f}", f"{largest_px:.2f}", f"{largest_mm:.2f}"


def shape_table(found: BoardShape) -> Table:
    """A row per number of the board's shape."""
    table = new_table("the board's shape", caption="expected: 1-sigma of what was known before, with 0 as the middle")
    for heading in ("found", "1-sigma", "expected", "unit"):
        table.add_column(heading, justify="left" if heading == "unit" else "right")
    for part in found.parts:
        numbers = f"{part.value:+.3f}", f"{part.sigma:.3f}", f"{part.stated_sigma:.2g}"
        table.add_row(part.what, *numbers, part.unit)
    return table


def effect_table(findings: Sequence[EffectFinding], unit: str = "px") -> Table:
    """A row per effect that the model leaves out, those that move a camera most first. unit: of hold-out errors."""
    table = new_table(
        "what else the data want",
        caption="chance: allowing for all that was tried; hold-out: by how much the error of unseen frames falls; "
        "cameras: how far they would move, at most",
    )
    for heading in ("size", "when, s", "chance", f"hold-out, {unit}", "cameras, mm", "deg"):
        table.add_column(heading, justify="left" if heading == "size" else "right")
    for finding in findings:
        table.add_row(
            finding.name,
            finding.size,
            f"{finding.moment.at_s:.2f}" if finding.moment else "",
            f"{finding.p_value:.1g}",
            f"{finding.hold_out_drop_px:+.4f}",
            f"{finding.largest_move_mm:.3f}",
            f"{finding.largest_move_deg:.4f}",
        )
    return table


def new_table(title: str, *, caption: str | None = None) -> Table:
    """An empty table in the house's style; its first column is for the rows' names."""
    table = FoldedTable(title, caption=caption)
    table.add_column("", no_wrap=True)
    return table


def _left_out(calibration: Calibration, camera: str) -> str:
    dropped = [entry for entry in calibration.dropped if entry.camera == camera]
    views, corners = sum(entry.n_views for entry in dropped), sum(entry.n_corners for entry in dropped)
    if not corners:
        return "-"
    return f"{_count(views, 'view')}, {_count(corners, 'corner')}" if views else _count(corners, "corner")


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def stage_table(stages: Sequence[StageReport]) -> Table:
    """A row per stage."""
    table = new_table("stages")
    for heading in ("steps", "error", "after"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for heading in ("median px", "s"):
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


def _lacking_lines(calibration: Calibration) -> list[Text]:
    """What the recording does not show enough of."""
    return [Text(f"not covered: {line}") for line in coverage(calibration).missing] if calibration.solution else []


def detection_table(recording: Recording) -> Table:
    """A row per camera: how much of the board its images show."""
    table = new_table("the board in the images")
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


def detection_document(recording: Recording) -> dict[str, Any]:
    """The same for ``--json``."""
    cameras = {
        name: {
            "n_images": len(recording.images[name]) if name in recording.images else None,
            "n_views": found.n_views,
            "n_corners": found.n_corners,
            "median_corners_per_view": float(np.median(np.diff(found.view_start))) if found.n_views else 0.0,
        }
        for name, found in recording.detections.items()
    }
    return {"gtcal_detection": 1, "corners_of_board": recording.board.n_corners, "cameras": cameras}


def vector(components: FloatArray) -> str:
    """As people read it."""
    return ", ".join(f"{component:.2f}" for component in components)


def _largest(sigmas: FloatArray | None, digits: int) -> str:
    return "-" if sigmas is None else f"{sigmas.max():.{digits}f}"


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3g}"


def print_errors(calibration: Calibration, truth: GroundTruth) -> None:
    """Print how far a calibration of a simulated recording is from the truth."""
    table = new_table("difference from the truth")
    for heading in ("position, mm", "rotation, deg"):
        table.add_column(heading, justify="right")
    for what, position_mm, rotation_deg in errors(calibration, truth):
        table.add_row(what, f"{position_mm:.3f}", f"{rotation_deg:.4f}")
    Terminal().print(table)


def errors(calibration: Calibration, truth: GroundTruth) -> Iterator[tuple[str, float, float]]:
    """Of each camera and the board how far they are from the truth, in mm and deg."""
    for name, camera in calibration.cameras.items():
        found, true = inverse(camera.camera_T_ref.a_T_b), inverse(truth.camera_T_ref[name])
        yield name, *pose_difference(found, true)
    yield "board", *pose_difference(calibration.body_T_board.a_T_b, truth.body_T_board)
