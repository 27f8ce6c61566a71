"""The report of a calibration from poses: one HTML file, residuals in mm and deg. Loads matplotlib; import it late."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.pose_joint import PoseViews
from gtcal.estimation.pose_noise import weights_of
from gtcal.files import write_text
from gtcal.pose_recordings.calibration import GROSS_WEIGHT, PoseCalibration, PoseCamera
from gtcal.pose_recordings.clock import shifted_poses
from gtcal.pose_recordings.recording import PoseRecording
from gtcal.recordings.numbering import numbers_of
from gtcal.report.calibration_part import (
    EffectRow,
    PoseText,
    Tile,
    camera_pose_text,
    effect_row,
    pose_text,
    vector_text,
)
from gtcal.report.page import page_of
from gtcal.report.pictures import BLUE, CAMERA_COLOURS, INK, VERMILION, Picture, picture, styled_figure
from gtcal.report.plots import evenly, in_readable_unit
from gtcal.report.scene import BODY_NAMES, REF_NAMES
from gtcal.report.shape_figures import effect_picture

_MOST_DOTS = 1500
_PARTS = (("shift, mm", slice(3, 6), 1e3), ("rotation, deg", slice(0, 3), float(np.rad2deg(1.0))))


@dataclass(frozen=True)
class PoseEvidence:
    """One camera's residuals (V, 6), rad and m, at times (V,) in s since the first pose of all, or by number.
    distance_m: (V,) of the board. gross: (V,) whether they hardly count."""

    at: FloatArray
    numbered: bool
    residuals: FloatArray
    distance_m: FloatArray
    gross: BoolArray


@dataclass(frozen=True)
class PoseRow:
    """A camera, each cell as text; ``pictures`` is empty without its poses."""

    name: str
    colour: str
    rms_mm: str
    rms_deg: str
    noise_mm: str
    noise_deg: str
    n_views: str
    n_gross: str
    position_mm: str
    sigma_mm: str
    sigma_deg: str
    pose: PoseText
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class PosePart:
    """All that the page says."""

    title: str
    lead: str
    tiles: tuple[Tile, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    carried_over: tuple[str, ...]
    rows: tuple[PoseRow, ...]
    board: PoseText
    noise: str
    ref: str
    clock: str
    effects: tuple[EffectRow, ...]
    effect_pictures: tuple[Picture, ...]
    segments: tuple[()] = ()


def write_pose_report(path: Path, calibration: PoseCalibration, recording: PoseRecording | None = None) -> None:
    """Write the report; its figures are of ``recording``, or of the poses that the calibration was just computed from.

    Raises GtcalError where the file can't be written, or the recording lacks a camera."""
    write_text(path, render_poses(calibration, recording))


def render_poses(calibration: PoseCalibration, recording: PoseRecording | None = None) -> str:
    """The page as text. Raises as ``write_pose_report``."""
    evidence = gather_pose_evidence(calibration, recording)
    return page_of("poses.html.j2", calibration=calibration, part=_part(calibration, evidence))


def gather_pose_evidence(calibration: PoseCalibration, recording: PoseRecording | None) -> dict[str, PoseEvidence]:
    """Of the calibration's cameras; empty without their poses."""
    views, numbered = calibration.views, calibration.numbered
    if recording is not None:
        missing = [name for name in calibration.cameras if name not in recording.views]
        if missing:
            raise GtcalError(f"{recording.path}: lacks camera {missing[0]!r} of the calibration")
        views = {name: recording.views[name] for name in calibration.cameras}
        if calibration.clock is not None and calibration.clock.corrected:
            views, _ = shifted_poses(views, recording.motion, calibration.clock)
    if views is None:
        return {}
    start_ns = min(int(v.stamps_ns[0]) for v in views.values())
    residuals = calibration.chain.residuals(views)
    return {
        name: PoseEvidence(
            np.asarray(numbers_of(v.stamps_ns) if numbered else 1e-9 * (v.stamps_ns - start_ns), dtype=np.float64),
            numbered,
            residuals[name],
            np.asarray(np.linalg.norm(v.camera_T_board[:, :3, 3], axis=1), dtype=np.float64),
            _gross(name, v, calibration),
        )
        for name, v in views.items()
    }


def _gross(name: str, v: PoseViews, calibration: PoseCalibration) -> BoolArray:
    """By the noise that was found of the camera."""
    camera = calibration.cameras[name]
    r, _ = v.residuals(calibration.chain.camera_T_ref[name], calibration.chain.body_T_board)
    units = (1.0, 1.0) if camera.stated else (np.deg2rad(1.0), 1e-3)
    variances = np.concatenate(
        [(unit * np.array(part)) ** 2 for unit, part in zip(units, (camera.noise_deg, camera.noise_mm), strict=True)]
    )
    return weights_of(r, np.diag(variances), camera.tail) < GROSS_WEIGHT


def _part(calibration: PoseCalibration, evidence: Mapping[str, PoseEvidence]) -> PosePart:
    cameras = calibration.cameras
    colours = {name: CAMERA_COLOURS[index % len(CAMERA_COLOURS)] for index, name in enumerate(cameras)}
    board, clock = calibration.body_T_board, calibration.clock
    warned = "with warnings, below" if calibration.warnings else "without warnings"
    where = f"where the board sits in the {BODY_NAMES[calibration.capture]}"
    stated = any(camera.stated for camera in cameras.values())
    folder = next((entry.path.parent.resolve().name for entry in calibration.provenance.inputs), "")
    counted = f"{len(cameras)} camera{'' if len(cameras) == 1 else 's'}"
    return PosePart(
        title=f"{folder}: {counted}, from poses" if folder else f"{counted}, from poses",
        lead=f"Calibrated from poses of the board, {warned}. A small residual says that the poses agree with "
        "themselves; whether the calibration is true, an independent recording has to show.",
        tiles=_tiles(calibration),
        warnings=calibration.warnings,
        notes=()
        if evidence
        else ("No recording was given, so this report has no residual figures: make it again with --recording.",),
        carried_over=(),
        rows=tuple(_row(name, camera, colours[name], evidence.get(name)) for name, camera in cameras.items()),
        board=pose_text("body_T_board", where, board, board.position_of_b_in_a_sigma_mm),
        noise="of each camera's poses, in mm and deg" + ("; of stated covariances in units of these" if stated else ""),
        ref=REF_NAMES[calibration.capture],
        clock="" if clock is None else clock.statement + (", corrected" if clock.corrected else ", wanted by the data"),
        effects=tuple(effect_row(finding) for finding in calibration.effects),
        effect_pictures=tuple(effect_picture(finding) for finding in calibration.effects if finding.significant),
    )


def _tiles(calibration: PoseCalibration) -> tuple[Tile, ...]:
    cameras = calibration.cameras
    fits = [camera.statistics for camera in cameras.values()]
    n = sum(fit.n_views for fit in fits)
    mm, deg = (
        float(np.sqrt(sum(getattr(fit, what) ** 2 * fit.n_views for fit in fits) / n))
        for what in ("shift_rms_mm", "rotation_rms_deg")
    )
    sigmas = {name: _largest(camera) for name, camera in cameras.items()}
    worst = max(sigmas, key=lambda name: sigmas[name][0])
    n_gross = sum(fit.n_gross for fit in fits)
    return (
        Tile("Fit", f"{mm:.3f}", "mm rms", f"and {deg:.4f} deg, chain against measured poses"),
        Tile(
            "Uncertainty, 1-sigma",
            f"{sigmas[worst][0]:.3f}",
            "mm",
            f"and {max(deg for _, deg in sigmas.values()):.4f} deg at most; largest for {worst}",
        ),
        Tile("Data", f"{n:,}", "poses", f"of {len(cameras)} cameras; {n_gross} of them gross, which hardly count"),
    )


def _largest(camera: PoseCamera) -> tuple[float, float]:
    pose = camera.camera_T_ref
    mm, deg = pose.position_of_a_in_b_sigma_mm, pose.rotation_sigma_deg
    return (np.nan, np.nan) if mm is None or deg is None else (float(mm.max()), float(deg.max()))


def _row(name: str, camera: PoseCamera, colour: str, evidence: PoseEvidence | None) -> PoseRow:
    fit, pose = camera.statistics, camera.camera_T_ref
    return PoseRow(
        name=name,
        colour=colour,
        rms_mm=f"{fit.shift_rms_mm:.3f}",
        rms_deg=f"{fit.rotation_rms_deg:.4f}",
        noise_mm=vector_text(np.array(camera.noise_mm), 3),
        noise_deg=vector_text(np.array(camera.noise_deg), 4),
        n_views=f"{fit.n_views:,}",
        n_gross=str(fit.n_gross or "none"),
        position_mm=vector_text(1e3 * pose.position_of_a_in_b_m, 2),
        sigma_mm=vector_text(pose.position_of_a_in_b_sigma_mm, 3),
        sigma_deg=vector_text(pose.rotation_sigma_deg, 4),
        pose=camera_pose_text(pose),
        pictures=() if evidence is None else (over_time(evidence), by_axis(evidence), over_distance(evidence)),
    )


def over_time(evidence: PoseEvidence) -> Picture:
    """Lengths of shift and rotation: a body or a camera that moved is a step, a flipped board a cross far up."""
    at, unit = (evidence.at, "") if evidence.numbered else in_readable_unit(evidence.at)
    over = "number of the image" if evidence.numbered else f"time since the first pose, {unit}"
    with styled_figure() as figure:
        for axes, (label, part, scale) in zip(figure.subplots(2, 1, sharex=True), _PARTS, strict=True):
            _dots(axes, at, scale * np.linalg.norm(evidence.residuals[:, part], axis=1), evidence.gross)
            axes.set(ylabel=label)
        axes.set_xlabel(over)
        figure.align_ylabels()
        return picture(
            figure, "Residual over time", "A dot is a pose; crosses: gross ones, those off the scale at the top."
        )


def over_distance(evidence: PoseEvidence) -> Picture:
    """Lengths against the board's distance: noise of a detector grows with it, a wrong scale too."""
    with styled_figure() as figure:
        for axes, (label, part, scale) in zip(figure.subplots(2, 1, sharex=True), _PARTS, strict=True):
            _dots(
                axes, evidence.distance_m, scale * np.linalg.norm(evidence.residuals[:, part], axis=1), evidence.gross
            )
            axes.set(ylabel=label)
        axes.set_xlabel("distance of the board, m")
        figure.align_ylabels()
        return picture(
            figure,
            "Residual against distance",
            "A detector's noise grows with the distance; what grows with it evenly in one direction is a wrong scale.",
        )


def by_axis(evidence: PoseEvidence) -> Picture:
    """Components of the residuals: those of a true chain lie about zero."""
    kept = evidence.residuals[~evidence.gross] if (~evidence.gross).any() else evidence.residuals
    with styled_figure() as figure:
        for axes, (label, part, scale) in zip(figure.subplots(1, 2), _PARTS, strict=True):
            axes.boxplot(
                scale * kept[:, part],
                whis=(2.5, 97.5),
                showfliers=False,
                boxprops={"color": BLUE},
                medianprops={"color": VERMILION},
            )
            axes.axhline(0.0, color=INK, linewidth=0.7)
            axes.set_xticks([1, 2, 3], ["x", "y", "z"])
            axes.set(ylabel=label)
        return picture(
            figure,
            "Residual by axis",
            "Shift along the camera's axes, rotation about the board's: quartiles, and whiskers that hold 95 %.",
        )


def _dots(axes: Axes, at: FloatArray, lengths: FloatArray, gross: BoolArray) -> None:
    kept = lengths[~gross] if (~gross).any() else lengths
    top = max(1.25 * float(np.quantile(kept, 0.999)), 1e-9)
    for rows, style, colour in ((~gross, ".", BLUE), (gross, "x", VERMILION)):
        pick = np.flatnonzero(rows)[evenly(int(rows.sum()), _MOST_DOTS)]
        axes.plot(at[pick], np.minimum(lengths[pick], 0.97 * top), style, color=colour, markersize=4, alpha=0.7)
    axes.set(ylim=(0.0, top))
