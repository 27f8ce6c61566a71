"""What the terminal shows of a calibration from poses: mm and deg in place of pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gtcal.cli.tables import effect_table, new_table, stage_table, vector
from gtcal.cli.terminal import Terminal
from gtcal.pose_recordings.calibration import ClosedForm, PoseCalibration
from gtcal.results.calibration import PoseEstimate


def print_pose_calibration(calibration: PoseCalibration, *, notes: Sequence[str] = (), verbose: bool = False) -> None:
    """Print fit, poses, closed forms, effects and warnings; ``verbose`` adds the stages, what was left out, and the
    effects that the poses do not want."""
    Terminal().print(Group(*pose_calibration_parts(calibration, notes=notes, verbose=verbose)))


def pose_calibration_parts(
    calibration: PoseCalibration, *, notes: Sequence[str] = (), verbose: bool = False
) -> list[RenderableType]:
    parts: list[RenderableType] = [_fit_table(calibration), _pose_table(calibration)]
    parts += [closed_form_table(calibration.closed_forms)]
    if verbose:
        parts.append(stage_table(calibration.stages))
        parts += [Text(f"left out of {d.camera}: {d.n_views} views: {d.reason}") for d in calibration.dropped]
    shown = [finding for finding in calibration.effects if finding.significant or verbose]
    parts += [effect_table(shown, "sigmas")] if shown else []
    if calibration.clock is not None and calibration.clock.corrected:
        parts.append(Text(f"clock: {calibration.clock.statement} added to the cameras' stamps"))
    parts += [Text(f"note: {note}", style="cyan") for note in notes]
    return [*parts, *(Text(f"warning: {warning}", style="yellow") for warning in calibration.warnings)]


def _fit_table(calibration: PoseCalibration) -> Table:
    stated = any(camera.stated for camera in calibration.cameras.values())
    table = new_table(
        "chain against the measured poses",
        caption="noise: 1-sigma per axis of what is left (root of the mean of the variances)"
        + ("; of stated covariances in units of these" if stated else ""),
    )
    for heading in ("rms, mm", "deg", "worst, mm", "deg", "noise, mm", "deg", "views", "gross"):
        table.add_column(heading, justify="right")
    for name, camera in calibration.cameras.items():
        fit = camera.statistics
        numbers = (f"{fit.shift_rms_mm:.3f}", f"{fit.rotation_rms_deg:.4f}")
        worst = (f"{fit.shift_worst_mm:.3f}", f"{fit.rotation_worst_deg:.4f}")
        table.add_row(
            name,
            *numbers,
            *worst,
            *_noise(camera.noise_mm, camera.noise_deg),
            str(fit.n_views),
            str(fit.n_gross or "-"),
        )
    if calibration.mocap_noise_mm is not None and calibration.mocap_noise_deg is not None:
        noise = _noise(calibration.mocap_noise_mm, calibration.mocap_noise_deg)
        table.add_row("mocap, at the board", "", "", "", "", *noise, "", "")
    return table


def _noise(mm: Sequence[float], deg: Sequence[float]) -> tuple[str, str]:
    return tuple(f"{np.sqrt(np.mean(np.square(part))):.{digits}f}" for part, digits in ((mm, 3), (deg, 4)))  # type: ignore[return-value]


def _pose_table(calibration: PoseCalibration) -> Table:
    cameras = {name: camera.camera_T_ref for name, camera in calibration.cameras.items()}
    return place_table(cameras, calibration.body_T_board)


def place_table(cameras: Mapping[str, PoseEstimate], body_T_board: PoseEstimate) -> Table:
    """Where each camera is in ref, and the board in its body, with 1-sigma."""
    table = new_table("where they are", caption="1-sigma: of the noise of cameras and mocap that was found")
    for heading in ("position, mm", "in", "1-sigma, mm", "deg"):
        table.add_column(heading, justify="left" if heading == "in" else "right")
    for name, pose in cameras.items():
        sigmas = _sigmas(pose, pose.position_of_a_in_b_sigma_mm)
        table.add_row(name, vector(1e3 * pose.position_of_a_in_b_m), "ref", *sigmas)
    sigmas = _sigmas(body_T_board, body_T_board.position_of_b_in_a_sigma_mm)
    table.add_row("board", vector(1e3 * body_T_board.a_T_b[:3, 3]), "body", *sigmas)
    return table


def _sigmas(pose: PoseEstimate, mm: np.ndarray | None) -> tuple[str, str]:
    deg = pose.rotation_sigma_deg
    return "-" if mm is None else f"{mm.max():.3f}", "-" if deg is None else f"{deg.max():.4f}"


def closed_form_table(forms: Sequence[ClosedForm]) -> Table:
    """A row per method."""
    table = new_table(
        "closed forms on the same poses, from the joint estimate",
        caption="cameras: the one that differs most; sigmas: of all unknowns, in units of the joint estimate's own",
    )
    for heading in ("cameras, mm", "deg", "board, mm", "deg", "sigmas"):
        table.add_column(heading, justify="right")
    for form in forms:
        if form.failure:
            table.add_row(form.method, form.failure)
            continue
        numbers = ((form.difference_mm, 3), (form.difference_deg, 4), (form.board_mm, 3), (form.board_deg, 4))
        table.add_row(form.method, *(f"{value:.{digits}f}" for value, digits in numbers), f"{form.sigmas:.2f}")
    return table
