"""What the terminal shows of a verification, and of several."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gtcal.cli.folded_table import FoldedTable
from gtcal.cli.terminal import Terminal
from gtcal.verification.drift import Drift
from gtcal.verification.verification import CameraVerification, Verdict, Verification

_STYLES = {Verdict.PASS: "bold green", Verdict.FAIL: "bold red", Verdict.INCONCLUSIVE: "bold yellow"}
_WORDS = {
    Verdict.PASS: "PASS: the calibration holds",
    Verdict.FAIL: "FAIL: the calibration does not hold",
    Verdict.INCONCLUSIVE: "INCONCLUSIVE: the recording can't tell",
}


def print_verification(verification: Verification, *, notes: Sequence[str] = (), verbose: bool = False) -> None:
    """Print the verdict, a table per camera and the findings; ``verbose`` as for ``verification_parts``."""
    Terminal().print(Group(*verification_parts(verification, notes=notes, verbose=verbose)))


def verification_parts(
    verification: Verification, *, notes: Sequence[str] = (), verbose: bool = False
) -> list[RenderableType]:
    """The verdict, a table per camera and the findings; ``verbose`` adds what was left out and why."""
    parts: list[RenderableType] = [Text(_WORDS[verification.verdict], style=_STYLES[verification.verdict])]
    parts += [Text(f"  {reason}") for reason in verification.reasons]
    parts += [_table(verification), *_findings(verification), *_expected_lines(verification)]
    parts += _depth_lines(verification)
    parts += [Text(line) for line in verification.clock_lines]
    if verbose:
        parts += [_bias_line(camera) for camera in verification.cameras.values()]
        parts += [Text(f"left out of {left.camera}: {left.count}: {left.reason}") for left in verification.left_out]
    parts += [Text(f"note: {note}", style="cyan") for note in notes]
    return parts + [Text(f"warning: {warning}", style="yellow") for warning in verification.warnings]


def _table(verification: Verification) -> Table:
    options = verification.options
    table = FoldedTable(
        padding=(0, 1, 0, 0),
        caption=f"bounds of the RMSE at {100 * options.confidence:g} % each; n sightings in so much of the image. "
        f"Tolerances: {options.max_rmse_px:g} px, {options.max_rmse_mm:g} mm RMSE",
    )
    table.add_column("camera", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for heading in ("RMSE px", "bounds", "95 %", "worst", "RMSE mm", "n", "image"):
        table.add_column(heading, justify="right")
    for camera in verification.cameras.values():
        table.add_row(*_row(camera))
    return table


def _row(camera: CameraVerification) -> tuple[str | Text, ...]:
    px, mm = camera.px, camera.mm
    return (
        camera.camera,
        Text(str(camera.verdict), style=_STYLES[camera.verdict]),
        f"{px.rmse:.3f}",
        f"{px.rmse_low:.2f}-{px.rmse_high:.2f}",
        f"{px.p95:.2f}",
        f"{px.worst:.2f}",
        f"{mm.rmse:.2f}",
        str(camera.n_sightings),
        f"{100 * camera.coverage:.0f} %",
    )


def _bias_line(camera: CameraVerification) -> Text:
    bias = camera.bias
    (x, y), (dx, dy) = bias.xy_px, bias.xy_half_width_px
    return Text(
        f"bias of {camera.camera}, px: x {x:+.3f} ± {dx:.3f}, y {y:+.3f} ± {dy:.3f}, outwards {bias.radial_px:+.3f} ± "
        f"{bias.radial_half_width_px:.3f}, around {bias.tangential_px:+.3f} ± {bias.tangential_half_width_px:.3f}"
    )


def _expected_lines(verification: Verification) -> list[Text]:
    return [
        Text(f"{name}: {camera.expected.statement}", style="" if camera.expected.agrees else "yellow")
        for name, camera in verification.cameras.items()
        if camera.expected is not None
    ]


def _findings(verification: Verification) -> list[Text]:
    if not verification.faults:
        return [Text("The errors look like noise: no camera, marker set or lens that moved explains them.")]
    lines = []
    for fault in verification.faults:
        gain = f"e_2D RMSE {fault.rmse_before_px:.3f} px, {fault.rmse_after_px:.3f} px when corrected"
        lines.append(Text(f"It looks as if {fault.sentence}: {gain}.", style="bold"))
        lines += [Text(f"  But {fault.caveat}.")] if fault.caveat else []
        lines += [Text(f"  As possible: {other}.") for other in fault.also_possible]
    return lines


def _depth_lines(verification: Verification) -> list[Text]:
    lines, check = [], verification.triangulation
    if check.statistics is not None:
        lines.append(
            Text(
                f"Triangulated from two cameras or more, {check.statistics.count} times: RMSE "
                f"{check.depth_rmse_mm:.2f} mm in depth (mean {check.depth_bias_mm:+.2f}), "
                f"{check.across_rmse_mm:.2f} mm across."
            )
        )
    lines += [
        Text(
            f"Pose of the device in {pose.camera}, {pose.count} times: RMSE {pose.depth_rmse_mm:.2f} mm in depth, "
            f"{pose.across_rmse_mm:.2f} mm across, {pose.rotation_rmse_deg:.3f} deg."
        )
        for pose in verification.pose_checks
        if pose.count
    ]
    return lines


def print_drift(found: Drift) -> None:
    """Print a row per recording, the first failure and the trends."""
    Terminal().print(Group(*drift_parts(found)))


def drift_parts(found: Drift) -> list[RenderableType]:
    """A row per recording, the first failure and the trends."""
    return [_drift_table(found), *_first_failure(found), *_trends(found)]


def _first_failure(found: Drift) -> list[Text]:
    if found.first_failing is None:
        return [Text("No recording fails.")]
    faults = found.verifications[found.first_failing].faults
    return [
        Text(f"The first to fail is {found.names[found.first_failing]}.", style="bold red"),
        *(
            Text(f"It looks as if {fault.sentence}" + (f", but {fault.caveat}." if fault.caveat else "."))
            for fault in faults
        ),
    ]


def _trends(found: Drift) -> list[Text]:
    lines = [
        Text(
            f"Trend: the RMSE of {trend.camera} {'grows' if trend.slope_per_recording > 0 else 'falls'} by "
            f"{abs(trend.slope_per_recording):.3f} ± {trend.slope_sigma_per_recording:.3f} {trend.unit} per recording "
            f"(p = {trend.p_value:.1g})."
        )
        for trend in found.trends
        if trend.significant
    ]
    if not any(math.isfinite(trend.slope_per_recording) for trend in found.trends):
        return [Text("Too few recordings to tell a trend.")]
    return lines or [Text("No trend that chance doesn't explain.")]


def _drift_table(found: Drift) -> Table:
    table = FoldedTable(
        caption=f"RMSE in px; tolerances {found.options.max_rmse_px:g} px, {found.options.max_rmse_mm:g} mm",
    )
    table.add_column("recording")
    table.add_column("verdict", no_wrap=True)
    for camera in found.cameras:
        table.add_column(camera, justify="right")
    table.add_column("all, mm", justify="right")
    for name, verification in zip(found.names, found.verifications, strict=True):
        cameras = (verification.cameras.get(camera) for camera in found.cameras)
        errors = ["-" if camera is None else f"{camera.px.rmse:.3f}" for camera in cameras]
        table.add_row(name, str(verification.verdict), *errors, f"{verification.pooled_mm.rmse:.3f}")
    return table
