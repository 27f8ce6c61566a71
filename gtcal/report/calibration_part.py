"""The calibration half of the report: what is shown of a calibration, as text and numbers ready for the page."""

from __future__ import annotations

from dataclasses import dataclass

from gtcal.board import board_from_manifest
from gtcal.camera import FloatArray
from gtcal.progress import Progress, silent
from gtcal.recordings.trajectory import quaternions_from_poses
from gtcal.report.evidence import Evidence
from gtcal.report.pictures import CAMERA_COLOURS, Picture
from gtcal.report.residual_figures import covered_share, residual_pictures
from gtcal.report.scene import BODY_NAMES, REF_NAMES, Scene, build_scene
from gtcal.report.shape_figures import effect_picture, shape_picture
from gtcal.report.uncertainty_part import UncertaintyPart, uncertainty_part
from gtcal.results.calibration import Calibration, CameraCalibration, PoseEstimate, Segment
from gtcal.results.carried_over import CarriedOver
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE
from gtcal.results.effect_finding import EffectFinding
from gtcal.verification.verification import Verification

MOST_DETAILED_CAMERAS = 12
"""Cameras with figures of their own: those that fit worst. More would make the page heavy and nobody would read it."""

COVARIANCE_MEANINGS = {
    NAIVE: "The covariance takes the mocap as exact and the corners as independent. Mocap noise moves all corners of "
    "a frame together, so these figures are a lower bound: the true error is often several times larger.",
    CLUSTERED: "The covariance is by how much whole frames are seen to scatter (cluster-robust, a cluster per "
    "frame): it includes the mocap's errors.",
    ERRORS_IN_VARIABLES: "The covariance holds pixel noise and the mocap's noise.",
}


@dataclass(frozen=True)
class Tile:
    """A figure of the headline: what it is, the figure, and what it means."""

    name: str
    value: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class CameraRow:
    """A camera in the table, each cell as text. ``recomputed_px``: RMSE on the report's recording where that is another
    one than the calibration's, else empty."""

    name: str
    colour: str
    rmse_px: str
    median_px: str
    p95_px: str
    recomputed_px: str
    n_views: str
    n_corners: str
    left_out: str
    covered: str
    position_mm: str
    sigma_mm: str
    sigma_deg: str


@dataclass(frozen=True)
class PoseText:
    """A transform and its 1-sigma, written out."""

    name: str
    meaning: str
    translation_mm: str
    quat_wxyz: str
    sigma_mm: str
    sigma_deg: str


@dataclass(frozen=True)
class ParameterText:
    name: str
    value: str
    sigma: str


@dataclass(frozen=True)
class LensMoveText:
    """How far a group of intrinsics moved from what was known beforehand, each cell as text."""

    group: str
    sigmas: str
    px: str
    mm: str


@dataclass(frozen=True)
class CameraDetails:
    """One camera in full. ``moves``: of intrinsics that were solved for near what was known. ``pictures`` is empty
    without a recording, or where it is not among the worst."""

    row: CameraRow
    model: str
    image_size: str
    pose: PoseText
    parameters: tuple[ParameterText, ...]
    moves: tuple[LensMoveText, ...]
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class EffectRow:
    """An effect that the model leaves out, each cell as text. moves: of each camera. significant: no chance."""

    name: str
    size: str
    when_s: str
    chance: str
    hold_out_px: str
    moves: str
    significant: bool


@dataclass(frozen=True)
class SegmentRow:
    """A stretch between changes, each cell as text."""

    seconds: str
    moved: str
    board_mm: str
    cameras_mm: str


@dataclass(frozen=True)
class CalibrationPart:
    """All that the page says of a calibration."""

    title: str
    lead: str
    tiles: tuple[Tile, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    rows: tuple[CameraRow, ...]
    details: tuple[CameraDetails, ...]
    board: str
    board_pose: PoseText
    other_boards: tuple[PoseText, ...]
    board_shape: Picture | None
    carried_over: tuple[str, ...]
    covariance_meaning: str
    ref: str
    scene: Scene
    uncertainty: UncertaintyPart | None
    effects: tuple[EffectRow, ...]
    effect_pictures: tuple[Picture, ...]
    segments: tuple[SegmentRow, ...]


def calibration_part(
    calibration: Calibration,
    evidence: Evidence | None,
    verification: Verification | None = None,
    *,
    progress: Progress = silent,
) -> CalibrationPart:
    """Prepare a calibration for the page; figures need the ``evidence`` of a recording. The ``verification`` that
    stands on the same page is seen in the 3-D view."""
    names = list(calibration.cameras)
    colours = {name: CAMERA_COLOURS[index % len(CAMERA_COLOURS)] for index, name in enumerate(names)}
    rows = {name: _row(calibration, evidence, name, colours[name]) for name in names}
    pictures = _pictures(calibration, evidence, progress)
    return CalibrationPart(
        title=_title(calibration, evidence),
        lead=_lead(calibration, verified=verification is not None),
        tiles=_tiles(calibration),
        warnings=calibration.warnings,
        notes=_notes(calibration, evidence),
        rows=tuple(rows.values()),
        details=tuple(
            _details(camera, rows[name], pictures.get(name, ())) for name, camera in calibration.cameras.items()
        ),
        board=board_from_manifest(calibration.board).describe(),
        board_pose=_board_pose(calibration),
        other_boards=tuple(
            pose_text(
                f"body_T_{board.name}",
                f"where {board.name} sits in the {BODY_NAMES[board.capture]}",
                board.body_T_board,
                board.body_T_board.position_of_b_in_a_sigma_mm,
            )
            for board in calibration.other_boards
        ),
        board_shape=shape_picture(calibration),
        carried_over=_carried_over(calibration.carried_over),
        covariance_meaning=covariance_meaning(calibration),
        ref=REF_NAMES[calibration.capture],
        scene=build_scene(calibration, evidence, colours, verification),
        uncertainty=uncertainty_part(calibration, evidence, cameras=_worst(calibration)),
        effects=tuple(effect_row(finding) for finding in calibration.effects),
        effect_pictures=tuple(effect_picture(finding) for finding in calibration.effects if finding.significant),
        segments=tuple(_segment(segment) for segment in calibration.segments),
    )


def _carried_over(found: CarriedOver | None) -> tuple[str, ...]:
    """What is known from an earlier calibration, and what has moved since, a line each."""
    return () if found is None else (f"{found.statement}.", *(f"Since then: {line}." for line in found.moved))


def effect_row(finding: EffectFinding) -> EffectRow:
    """What the table of effects says of one."""
    moves = (f"{name} {mm:.3f} mm, {finding.moves_deg[name]:.4f}°" for name, mm in finding.moves_mm.items())
    return EffectRow(
        name=finding.name,
        size=finding.size,
        when_s=finding.moment.text if finding.moment else "",
        chance=f"{finding.p_value:.1g}",
        hold_out_px=f"{finding.hold_out_drop_px:+.4f}",
        moves="; ".join(moves),
        significant=finding.significant,
    )


def _segment(segment: Segment) -> SegmentRow:
    cameras = (
        f"{name} {vector_text(1e3 * pose.position_of_a_in_b_m, 2)}" for name, pose in segment.camera_T_ref.items()
    )
    return SegmentRow(
        seconds=f"{segment.start_s:.2f} to {segment.end_s:.2f}",
        moved=segment.moved,
        board_mm=vector_text(1e3 * segment.body_T_board.a_T_b[:3, 3], 2),
        cameras_mm="; ".join(cameras),
    )


def covariance_meaning(calibration: Calibration) -> str:
    """What to think of the 1-sigma figures."""
    kind = calibration.covariance_kind
    return COVARIANCE_MEANINGS.get(kind, f"Covariance: {kind}.")


def _pictures(
    calibration: Calibration, evidence: Evidence | None, progress: Progress
) -> dict[str, tuple[Picture, ...]]:
    if evidence is None:
        return {}
    pictures = {}
    worst = _worst(calibration)
    for done, name in enumerate(worst):
        progress("figures", done, len(worst))
        pictures[name] = residual_pictures(evidence.cameras[name])
    progress("figures", len(worst), len(worst))
    return pictures


def _worst(calibration: Calibration) -> list[str]:
    """The cameras that get figures."""
    cameras = calibration.cameras
    by_rmse = sorted(cameras, key=lambda name: -cameras[name].residuals.rmse_px)
    return by_rmse[:MOST_DETAILED_CAMERAS]


def _title(calibration: Calibration, evidence: Evidence | None) -> str:
    manifests = [evidence.recording] if evidence is not None else []
    manifests += [entry.path for entry in calibration.provenance.inputs]
    folder = next((path.parent.resolve().name for path in manifests if path is not None), "")
    return (
        f"{folder}: {_count(len(calibration.cameras), 'camera')}"
        if folder
        else _count(len(calibration.cameras), "camera")
    )


def _lead(calibration: Calibration, *, verified: bool) -> str:
    """The page in one or two sentences."""
    warned = "with warnings, below" if calibration.warnings else "without warnings"
    rest = (
        ""
        if verified
        else (
            " A small residual says that the data agree with themselves; whether the calibration is true, an "
            "independent recording has to show."
        )
    )
    return f"Calibrated {warned}.{rest}"


def _tiles(calibration: Calibration) -> tuple[Tile, ...]:
    cameras = calibration.cameras
    worst = max(cameras, key=lambda name: cameras[name].residuals.rmse_px)
    n_views = sum(camera.residuals.n_views for camera in cameras.values())
    n_corners = sum(camera.residuals.n_corners for camera in cameras.values())
    left_out = sum(entry.n_views for entry in calibration.dropped)
    share_out = left_out / max(n_views + left_out, 1)
    return (
        Tile(
            "Fit",
            f"{calibration.rmse_px:.3f}",
            "px RMSE",
            f"over {_count(len(cameras), 'camera')}; worst {worst}, {cameras[worst].residuals.rmse_px:.3f} px",
        ),
        _sigma_tile(calibration),
        Tile(
            "Data",
            f"{n_views:,}",
            "view" if n_views == 1 else "views",
            f"with {n_corners:,} corners; {_count(left_out, 'view')} left out ({share_out:.1%})",
        ),
    )


def _sigma_tile(calibration: Calibration) -> Tile:
    sigmas = {
        name: (
            largest(camera.camera_T_ref.position_of_a_in_b_sigma_mm),
            largest(camera.camera_T_ref.rotation_sigma_deg),
        )
        for name, camera in calibration.cameras.items()
    }
    known = {name: (mm, deg) for name, (mm, deg) in sigmas.items() if mm is not None and deg is not None}
    if not known:
        return Tile("Uncertainty", "unknown", "", "no covariance was computed: stage 3 was left out")
    worst = max(known, key=lambda name: known[name][0])
    deg = max(deg for _, deg in known.values())
    return Tile(
        "Uncertainty, 1-sigma",
        f"{known[worst][0]:.3f}",
        "mm",
        f"and {deg:.4f} deg at most; largest for {worst}; {calibration.covariance_kind} covariance",
    )


def _notes(calibration: Calibration, evidence: Evidence | None) -> tuple[str, ...]:
    """What the reader must know to read the page right."""
    if evidence is None:
        return (
            "No recording was given, so this report has no residual figures, no coverage, no board poses in the 3-D "
            "view and nothing over time: make it again with --recording.",
        )
    notes = []
    if evidence.is_hold_out:
        files = ", ".join(path.name for path in (evidence.changed_inputs or ()))
        notes.append(
            f"The figures show another recording than the calibration's ({files} differ), so their residuals are "
            "hold-out errors; those of the calibration's own data are in the table under 'RMSE'."
        )
    if len(calibration.cameras) > MOST_DETAILED_CAMERAS:
        notes.append(
            f"Figures are given for the {MOST_DETAILED_CAMERAS} of {len(calibration.cameras)} cameras that fit worst."
        )
    return tuple(notes)


def _row(calibration: Calibration, evidence: Evidence | None, name: str, colour: str) -> CameraRow:
    calibrated = calibration.cameras[name]
    residuals, pose = calibrated.residuals, calibrated.camera_T_ref
    seen = evidence.cameras[name] if evidence is not None else None
    hold_out = evidence is not None and evidence.is_hold_out
    return CameraRow(
        name=name,
        colour=colour,
        rmse_px=f"{residuals.rmse_px:.3f}",
        median_px=f"{residuals.median_px:.3f}",
        p95_px=f"{residuals.p95_px:.3f}",
        recomputed_px=f"{seen.statistics.rmse_px:.3f}" if seen is not None and hold_out else "",
        n_views=f"{residuals.n_views:,}",
        n_corners=f"{residuals.n_corners:,}",
        left_out=_left_out(calibration, name),
        covered=f"{covered_share(seen):.0%}" if seen is not None else "",
        position_mm=vector_text(1e3 * pose.position_of_a_in_b_m, 2),
        sigma_mm=vector_text(pose.position_of_a_in_b_sigma_mm, 3),
        sigma_deg=vector_text(pose.rotation_sigma_deg, 4),
    )


def _left_out(calibration: Calibration, name: str) -> str:
    """Views, and the corners left out of views that stay."""
    dropped = [entry for entry in calibration.dropped if entry.camera == name]
    views = sum(entry.n_views for entry in dropped)
    single = sum(entry.n_corners for entry in dropped if not entry.n_views)
    counts = [_count(n, what) for n, what in ((views, "view"), (single, "corner")) if n]
    return ", ".join(counts) or "none"


def _details(calibrated: CameraCalibration, row: CameraRow, pictures: tuple[Picture, ...]) -> CameraDetails:
    camera = calibrated.camera
    pose = calibrated.camera_T_ref
    return CameraDetails(
        row=row,
        model=camera.model.name,
        image_size=f"{camera.image_width_px} × {camera.image_height_px} px",
        pose=pose_text(
            "camera_T_ref", "takes coordinates in ref to the camera", pose, pose.position_of_a_in_b_sigma_mm
        ),
        parameters=_parameters(calibrated),
        moves=tuple(
            LensMoveText(move.group, f"{move.sigmas:.1f}", f"{move.largest_px:.2f}", f"{move.camera_mm:.3f}")
            for move in calibrated.lens_moves
        ),
        pictures=pictures,
    )


def _parameters(calibrated: CameraCalibration) -> tuple[ParameterText, ...]:
    covariance = calibrated.theta_covariance
    camera = calibrated.camera
    return tuple(
        ParameterText(name, f"{value:.7g}", "" if covariance is None else f"{covariance[index, index] ** 0.5:.2g}")
        for index, (name, value) in enumerate(zip(camera.model.parameter_names, camera.theta, strict=True))
    )


def _board_pose(calibration: Calibration) -> PoseText:
    pose = calibration.body_T_board
    meaning = f"where the board sits in the {BODY_NAMES[calibration.capture]}"
    return pose_text("body_T_board", meaning, pose, pose.position_of_b_in_a_sigma_mm)


def camera_pose_text(pose: PoseEstimate) -> PoseText:
    """... of a camera_T_ref."""
    return pose_text("camera_T_ref", "takes coordinates in ref to the camera", pose, pose.position_of_a_in_b_sigma_mm)


def pose_text(name: str, meaning: str, pose: PoseEstimate, sigma_mm: FloatArray | None) -> PoseText:
    """A transform for people."""
    quat = quaternions_from_poses(pose.a_T_b[None], "wxyz")[0]
    return PoseText(
        name=name,
        meaning=meaning,
        translation_mm=vector_text(1e3 * pose.a_T_b[:3, 3], 3),
        quat_wxyz=vector_text(quat, 6),
        sigma_mm=vector_text(sigma_mm, 3),
        sigma_deg=vector_text(pose.rotation_sigma_deg, 4),
    )


def vector_text(values: FloatArray | None, digits: int) -> str:
    """Its components; nothing for a vector that there isn't."""
    return "" if values is None else "  ".join(f"{value + 0.0:.{digits}f}" for value in values)


def largest(values: FloatArray | None) -> float | None:
    """... of the axes."""
    return None if values is None else float(values.max())


def _count(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"
