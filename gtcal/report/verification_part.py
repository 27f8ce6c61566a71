"""The verification half of the report: verdict, findings and errors, ready for the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gtcal.report.calibration_part import MOST_DETAILED_CAMERAS, Tile, largest
from gtcal.report.overlay import overlays
from gtcal.report.pictures import Picture
from gtcal.report.verification_figures import triangulation, verification_pictures
from gtcal.results.calibration import Calibration
from gtcal.verification.verification import (
    CameraVerification,
    ErrorStatistics,
    Fault,
    Verdict,
    Verification,
    VerificationOptions,
)

_VERDICT_WORDS = {
    Verdict.PASS: ("✓", "Pass", "The calibration holds."),
    Verdict.FAIL: ("✕", "Fail", "The calibration does not hold."),
    Verdict.INCONCLUSIVE: ("?", "Inconclusive", "The recording can't decide whether the calibration holds."),
}


@dataclass(frozen=True)
class VerdictText:
    """``kind``: the verdict's name, for the style. ``sign`` says the same to those who see no colours."""

    kind: str
    sign: str
    word: str
    meaning: str


@dataclass(frozen=True)
class ErrorText:
    """``bounds``: of the RMSE."""

    rmse: str
    bounds: str
    median: str
    p95: str
    worst: str


@dataclass(frozen=True)
class VerifiedRow:
    """A camera in the table, each cell as text."""

    name: str
    verdict: VerdictText
    reasons: tuple[str, ...]
    px: ErrorText
    mm: ErrorText
    bias_px: tuple[str, ...]
    n_sightings: str
    coverage: str
    sigma: str
    finding: str


@dataclass(frozen=True)
class VerifiedCamera:
    row: VerifiedRow
    radial: str
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class PoseRow:
    """The full pose error of one camera, for a device with several faces."""

    name: str
    count: str
    depth_mm: str
    across_mm: str
    rotation_deg: str


@dataclass(frozen=True)
class VerificationPart:
    """All that the page says of a verification."""

    verdict: VerdictText
    reasons: tuple[str, ...]
    findings: tuple[str, ...]
    tiles: tuple[Tile, ...]
    notes: tuple[str, ...]
    rows: tuple[VerifiedRow, ...]
    details: tuple[VerifiedCamera, ...]
    overlays: tuple[Picture, ...]
    triangulation: tuple[Picture, ...]
    triangulation_text: str
    poses: tuple[PoseRow, ...]
    device: str
    duration: str
    bounds: str
    tolerances: str


def verification_part(verification: Verification, calibration: Calibration) -> VerificationPart:
    """Prepare a verification of ``calibration`` for the page.

    Raises GtcalError where an image of the recording can't be read."""
    rows = {name: _row(verification, calibration, found) for name, found in verification.cameras.items()}
    worst_frames = overlays(verification)
    check = verification.triangulation
    options = verification.options
    return VerificationPart(
        verdict=_verdict(verification.verdict),
        reasons=verification.reasons,
        findings=tuple(_finding(fault) for fault in verification.faults),
        tiles=_tiles(verification),
        notes=verification.warnings + verification.clock_lines + _missing(verification, worst_frames),
        rows=tuple(rows.values()),
        details=tuple(_details(verification, calibration, rows[name]) for name in _detailed(verification)),
        overlays=worst_frames,
        triangulation=(triangulation(check),) if len(check.stamps_ns) else (),
        triangulation_text=_triangulation_text(verification),
        poses=tuple(
            PoseRow(
                check.camera,
                f"{check.count:,}",
                f"{check.depth_rmse_mm:.3f}",
                f"{check.across_rmse_mm:.3f}",
                f"{check.rotation_rmse_deg:.4f}",
            )
            for check in verification.pose_checks
            if check.count
        ),
        device=verification.device.describe(),
        duration=f"{verification.duration_s:.0f} s",
        bounds=_bounds_name(options),
        tolerances=f"RMSE of e_2D up to {options.max_rmse_px:g} px and of e_3D up to {options.max_rmse_mm:g} mm, at "
        f"{options.confidence:.0%} confidence, {options.min_sightings} sightings and {options.min_coverage:.0%} of the "
        f"image at least; up to {options.max_viewing_angle_deg:g} deg from the face's normal",
    )


def _verdict(verdict: Verdict) -> VerdictText:
    return VerdictText(verdict.value, *_VERDICT_WORDS[verdict])


def _tiles(verification: Verification) -> tuple[Tile, ...]:
    px, mm, options = verification.pooled_px, verification.pooled_mm, verification.options
    return (
        Tile("Lollypop, in the image (e_2D)", f"{px.rmse:.3f}", "px RMSE", _bounds(px, options, options.max_rmse_px)),
        Tile("Lollypop, in space (e_3D)", f"{mm.rmse:.3f}", "mm RMSE", _bounds(mm, options, options.max_rmse_mm)),
    )


def _bounds(errors: ErrorStatistics, options: VerificationOptions, limit: float) -> str:
    named = _bounds_name(options)
    bounds = "" if np.isnan(errors.rmse_low) else f"{named} {errors.rmse_low:.3f} to {errors.rmse_high:.3f}; "
    return f"{bounds}limit {limit:g} {errors.unit} per camera; median {errors.median:.3f}, 95 % {errors.p95:.3f}"


def _bounds_name(options: VerificationOptions) -> str:
    return f"{options.confidence:.0%} bounds"


def _row(verification: Verification, calibration: Calibration, found: CameraVerification) -> VerifiedRow:
    faults = [fault for fault in verification.faults if fault.camera in (None, found.camera)]
    xy, width = found.bias.xy_px, found.bias.xy_half_width_px
    return VerifiedRow(
        name=found.camera,
        verdict=_verdict(found.verdict),
        reasons=found.reasons,
        px=_errors(found.px),
        mm=_errors(found.mm),
        bias_px=tuple(f"{value:+.3f} ± {half:.3f}" for value, half in zip(xy, width, strict=True)),
        n_sightings=f"{found.n_sightings:,} of {found.n_frames:,}",
        coverage=f"{found.coverage:.0%}",
        sigma=_sigma(calibration, found.camera),
        finding=" ".join(fault.sentence for fault in faults) or "no significant correction",
    )


def _errors(found: ErrorStatistics) -> ErrorText:
    digits = 3 if found.unit == "px" else 2
    numbers = [f"{value:.{digits}f}" for value in (found.rmse, found.median, found.p95, found.worst)]
    bounds = "" if np.isnan(found.rmse_low) else f"{found.rmse_low:.{digits}f} – {found.rmse_high:.{digits}f}"
    return ErrorText(numbers[0], bounds, *numbers[1:])


def _sigma(calibration: Calibration, name: str) -> str:
    pose = calibration.cameras[name].camera_T_ref
    mm, deg = largest(pose.position_of_a_in_b_sigma_mm), largest(pose.rotation_sigma_deg)
    return "unknown" if mm is None or deg is None else f"{mm:.3f} mm, {deg:.4f} deg"


def _detailed(verification: Verification) -> list[str]:
    """The cameras that get figures, in their order: those with the largest errors; those without any come last."""
    cameras = verification.cameras
    by_rmse = sorted(cameras, key=lambda name: -np.nan_to_num(cameras[name].px.rmse, nan=-1.0))
    worst = set(by_rmse[:MOST_DETAILED_CAMERAS])
    return [name for name in cameras if name in worst]


def _details(verification: Verification, calibration: Calibration, row: VerifiedRow) -> VerifiedCamera:
    found = verification.cameras[row.name]
    camera = calibration.cameras[row.name].camera
    sightings = verification.sightings.get(row.name)
    bias = found.bias
    return VerifiedCamera(
        row,
        f"radial bias {bias.radial_px:+.3f} ± {bias.radial_half_width_px:.3f} px, tangential "
        f"{bias.tangential_px:+.3f} ± {bias.tangential_half_width_px:.3f} px",
        verification_pictures(found, camera, sightings, verification.options) if found.n_sightings else (),
    )


def _finding(fault: Fault) -> str:
    text = f"{fault.sentence}. With that corrected, the RMSE falls from {fault.rmse_before_px:.3f} to "
    text += f"{fault.rmse_after_px:.3f} px"
    if fault.caveat:
        text += f"; {fault.caveat}"
    if fault.also_possible:
        text += f"; also possible: {'; '.join(fault.also_possible)}"
    return text + "."


def _missing(verification: Verification, worst_frames: tuple[Picture, ...]) -> tuple[str, ...]:
    notes = []
    if not verification.sightings:
        notes.append(
            "This verification was read from a file, which keeps its statistics: it has no figures of single sightings "
            "and no worst frames. Make the report with --lollypop to see them."
        )
    elif not worst_frames:
        notes.append("The Lollypop's recording has no images, so the worst frames can't be shown.")
    if len(verification.cameras) > MOST_DETAILED_CAMERAS:
        notes.append(
            f"Figures are given for the {MOST_DETAILED_CAMERAS} of {len(verification.cameras)} verified cameras with "
            "the largest errors."
        )
    return tuple(notes)


def _triangulation_text(verification: Verification) -> str:
    check = verification.triangulation
    if check.statistics is None:
        return "No two cameras saw the device at once under enough parallax, so depth is untested."
    found = check.statistics
    text = f"Two or more cameras at once: {found.count:,} times, RMSE {found.rmse:.2f} mm, median {found.median:.2f} mm"
    return (
        f"{text}; depth {check.depth_rmse_mm:.2f} mm RMS (mean {check.depth_bias_mm:+.2f} mm), across the line "
        f"of sight {check.across_rmse_mm:.2f} mm RMS."
    )
