"""The part of the report on how sure a calibration is, as text and numbers ready for the page."""

from __future__ import annotations

from dataclasses import dataclass

from gtcal.report.evidence import Evidence
from gtcal.report.pictures import Picture
from gtcal.report.uncertainty_figures import image_picture, volume_picture
from gtcal.results.calibration import Calibration, MocapNoise, PoseEstimate
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE, JointCovariance
from gtcal.uncertainty.coverage import coverage, coverage_of_views
from gtcal.uncertainty.weak_directions import Grade, least_sure

DISTANCE_M = 1.0
"""At which the maps over the images are drawn."""

KIND_NAMES = {
    NAIVE: "naive (corners independent, mocap exact)",
    CLUSTERED: "frame-clustered (by how whole frames scatter, of stage 3)",
    ERRORS_IN_VARIABLES: "errors in variables (of stage 4)",
}


@dataclass(frozen=True)
class SigmaRow:
    """Largest 1-sigma of a camera's or the board's pose under each kind of covariance, as 'mm, deg'."""

    name: str
    cells: tuple[str, ...]


@dataclass(frozen=True)
class DirectionRow:
    """A least sure direction in words."""

    grade: str
    sentence: str


@dataclass(frozen=True)
class UncertaintyPart:
    """All that the page says of it. kinds: headings of the sigmas, the one that is taken marked."""

    kinds: tuple[str, ...]
    rows: tuple[SigmaRow, ...]
    noise: tuple[str, ...]
    directions: tuple[DirectionRow, ...]
    missing: tuple[str, ...]
    pictures: tuple[Picture, ...]


def uncertainty_part(
    calibration: Calibration, evidence: Evidence | None, *, cameras: list[str]
) -> UncertaintyPart | None:
    """None for a calibration without a covariance. evidence: of a recording, for what it lacks. cameras: those that get
    maps over their images."""
    if calibration.covariance is None:
        return None
    kinds = [kind for kind in KIND_NAMES if kind in calibration.covariances]
    return UncertaintyPart(
        kinds=tuple(KIND_NAMES[kind] + (", taken" if kind == calibration.covariance_kind else "") for kind in kinds),
        rows=tuple(sigma_rows(calibration)),
        noise=noise_lines(calibration.mocap_noise),
        directions=tuple(
            DirectionRow("" if found.grade is Grade.FINE else str(found.grade), found.sentence)
            for found in least_sure(calibration)
        ),
        missing=_missing(calibration, evidence),
        pictures=(*(image_picture(calibration, name, DISTANCE_M) for name in cameras), volume_picture(calibration)),
    )


def _missing(calibration: Calibration, evidence: Evidence | None) -> tuple[str, ...]:
    if calibration.solution is not None:
        return coverage(calibration).missing
    if evidence is None:
        return ()
    views = {name: seen.views for name, seen in evidence.cameras.items()}
    return coverage_of_views(views, calibration.estimate, calibration.capture).missing


def sigma_rows(calibration: Calibration) -> list[SigmaRow]:
    """A row per camera and one for the board, a cell per kind of covariance."""
    joints = [calibration.covariances[kind] for kind in KIND_NAMES if kind in calibration.covariances]
    rows = [
        SigmaRow(name, tuple(_sigmas(PoseEstimate(camera.camera_T_ref.a_T_b, j.camera_T_ref(name))) for j in joints))
        for name, camera in calibration.cameras.items()
    ]
    return [*rows, SigmaRow("board", tuple(_of_board(calibration, joint) for joint in joints))]


def noise_lines(noise: MocapNoise | None) -> tuple[str, ...]:
    """What the mocap's noise was found to be, and which stage was taken and why."""
    if noise is None:
        return ("The mocap's noise was not modelled: its poses were taken as exact, or the frames are too few.",)
    bodies = "; ".join(
        f"{name.replace('_', ' ')} {mm:.2g} mm, {noise.rotation_sigma_deg[name]:.2g} deg"
        for name, mm in noise.translation_sigma_mm.items()
    )
    how = "estimated from the recording" if noise.estimated else "as given"
    return (
        f"Mocap noise, {how}, 1-sigma along and about each axis: {bodies}; correlated over "
        f"{1e3 * noise.correlation_s:.2g} ms; jitter of its stamps {1e3 * noise.jitter_s:.2g} ms.",
        f"Stage {noise.stage} was taken: {noise.reason}. What the noise model does not foresee has a variance of "
        f"{noise.innovation_variance:.2f} (1 where it is right) and a correlation of {noise.lag_1:+.2f} from frame to "
        f"frame (0, give or take {noise.lag_1_sigma:.2f}).",
    )


def _sigmas(pose: PoseEstimate) -> str:
    mm, deg = pose.position_of_a_in_b_sigma_mm, pose.rotation_sigma_deg
    assert mm is not None
    assert deg is not None
    return f"{mm.max():.3f} mm, {deg.max():.4f} deg"


def _of_board(calibration: Calibration, joint: JointCovariance) -> str:
    pose = PoseEstimate(calibration.body_T_board.a_T_b, joint.body_T_board)
    mm, deg = pose.position_of_b_in_a_sigma_mm, pose.rotation_sigma_deg
    assert mm is not None
    assert deg is not None
    return f"{mm.max():.3f} mm, {deg.max():.4f} deg"
