"""Results as text, HTML, tables of pandas, and figures: what ``gtcal.results.presented`` asks for."""

from __future__ import annotations

import html as escaping
import io
from collections.abc import Sequence
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.text import Text

from gtcal.baselines.compare import Comparison
from gtcal.baselines.compare_file import comparison_document
from gtcal.cli.compare import comparison_parts
from gtcal.cli.diff import difference_table
from gtcal.cli.doctor import diagnosis_parts
from gtcal.cli.pose_tables import place_table, pose_calibration_parts
from gtcal.cli.selfcheck import selfcheck_tables
from gtcal.cli.tables import calibration_parts
from gtcal.cli.terminal import Terminal
from gtcal.cli.verification_tables import drift_parts, verification_parts
from gtcal.differences.difference import Difference
from gtcal.differences.difference_file import difference_document
from gtcal.doctor.diagnosis_file import diagnosis_document
from gtcal.doctor.findings import Diagnosis
from gtcal.errors import GtcalError
from gtcal.estimation.pose_level import PoseLevel
from gtcal.estimation.residuals import chain_residuals_px
from gtcal.overview.result_figures import calibration_figure, verification_figure
from gtcal.pose_recordings.calibration import PoseCalibration
from gtcal.pose_recordings.calibration_file import pose_calibration_document
from gtcal.report import residual_figures, uncertainty_figures, verification_figures
from gtcal.report.evidence import CameraEvidence
from gtcal.report.page import render
from gtcal.report.pictures import Picture
from gtcal.results.calibration import Calibration, PoseEstimate
from gtcal.results.calibration_file import calibration_document, pose_document
from gtcal.selfchecks.selfcheck import SelfCheck
from gtcal.selfchecks.selfcheck_file import selfcheck_document
from gtcal.verification.drift import Drift
from gtcal.verification.verification import ErrorStatistics, Verification
from gtcal.verification.verification_file import verification_document

if TYPE_CHECKING:
    import pandas

_WIDTH = 120
_PAGE = '<iframe srcdoc="{}" style="width: 100%; height: 640px; border: 1px solid #d5dae0"></iframe>'

Row = dict[str, object]


# Text


@singledispatch
def _parts(result: object) -> Sequence[RenderableType]:
    """What the terminal shows of a result."""
    raise TypeError(f"{type(result)} is no result")


@_parts.register
def _(result: Calibration) -> Sequence[RenderableType]:
    return calibration_parts(result)


@_parts.register
def _(result: Verification) -> Sequence[RenderableType]:
    return verification_parts(result)


@_parts.register
def _(result: Drift) -> Sequence[RenderableType]:
    return drift_parts(result)


@_parts.register
def _(result: Difference) -> Sequence[RenderableType]:
    return [difference_table(result), *map(Text, result.statements)]


@_parts.register
def _(result: SelfCheck) -> Sequence[RenderableType]:
    return [*selfcheck_tables(result), *map(Text, result.statements)]


@_parts.register
def _(result: Diagnosis) -> Sequence[RenderableType]:
    return diagnosis_parts(result)


@_parts.register
def _(result: Comparison) -> Sequence[RenderableType]:
    return comparison_parts(result)


@_parts.register
def _(result: PoseCalibration) -> Sequence[RenderableType]:
    return pose_calibration_parts(result)


@_parts.register
def _(result: PoseLevel) -> Sequence[RenderableType]:
    camera_T_ref, body_T_board = result.poses
    return [place_table({"camera": camera_T_ref}, body_T_board)]


def text(result: object) -> str:
    """The command line's tables."""
    file = io.StringIO()
    Terminal(file=file, width=_WIDTH).print(Group(*_parts(result)))
    return "\n".join(line.rstrip() for line in file.getvalue().splitlines())


# HTML


@singledispatch
def html(result: object) -> str:
    """For a notebook: the report's page where there is one, else the tables."""
    return f"<pre>{escaping.escape(text(result))}</pre>"


@html.register
def _(result: Calibration) -> str:
    return _PAGE.format(escaping.escape(render(result)))


@html.register
def _(result: Verification) -> str:
    if result.calibration is None:
        return f"<pre>{escaping.escape(text(result))}</pre>"
    return _PAGE.format(escaping.escape(render(result.calibration, verification=result)))


# Documents


@singledispatch
def document(result: object) -> dict[str, Any]:
    """As it stands in its file."""
    raise TypeError(f"{type(result)} is no result")


@document.register
def _(result: Calibration) -> dict[str, Any]:
    return calibration_document(result)


@document.register
def _(result: Verification) -> dict[str, Any]:
    return verification_document(result)


@document.register
def _(result: Difference) -> dict[str, Any]:
    return difference_document(result)


@document.register
def _(result: SelfCheck) -> dict[str, Any]:
    return selfcheck_document(result)


@document.register
def _(result: Drift) -> dict[str, Any]:
    named = zip(result.names, result.verifications, strict=True)
    return {"recordings": [{"recording": name} | verification_document(found) for name, found in named]}


@document.register
def _(result: Diagnosis) -> dict[str, Any]:
    return diagnosis_document(result)


@document.register
def _(result: Comparison) -> dict[str, Any]:
    return comparison_document(result)


@document.register
def _(result: PoseCalibration) -> dict[str, Any]:
    return pose_calibration_document(result)


@document.register
def _(result: PoseLevel) -> dict[str, Any]:
    names = ("camera_T_ref", "body_T_board")
    return {name: pose_document(pose) for name, pose in zip(names, result.poses, strict=True)}


# pandas


def frame(result: object) -> pandas.DataFrame:
    """The rows of a result."""
    try:
        import pandas
    except ImportError:
        raise GtcalError("to_pandas needs the library pandas: pip install 'gtcal[pandas]'") from None
    rows = _rows(result)
    return pandas.DataFrame(rows).set_index(next(iter(rows[0]))) if rows else pandas.DataFrame()


@singledispatch
def _rows(result: object) -> list[Row]:
    """The first column is the index."""
    raise TypeError(f"{type(result)} is no result")


@_rows.register
def _(result: Calibration) -> list[Row]:
    return [_camera_row(result, name) for name in result.cameras]


def _camera_row(calibration: Calibration, name: str) -> Row:
    camera = calibration.cameras[name]
    row = _place(name, camera.camera_T_ref) | vars(camera.residuals)
    lens = zip(camera.camera.model.parameter_names, camera.camera.theta.tolist(), strict=True)
    return row | {"model": camera.camera.model.name} | dict(lens)


def _place(camera: str, camera_T_ref: PoseEstimate) -> Row:
    mm, deg = camera_T_ref.position_of_a_in_b_sigma_mm, camera_T_ref.rotation_sigma_deg
    row: Row = {"camera": camera, **_vector("{}_mm", 1e3 * camera_T_ref.position_of_a_in_b_m)}
    row |= {} if mm is None else _vector("{}_sigma_mm", mm)
    return row | ({} if deg is None else _vector("r{}_sigma_deg", deg))


def _vector(name: str, values: Any) -> Row:
    return {name.format(axis): float(value) for axis, value in zip("xyz", values, strict=True)}


@_rows.register
def _(result: Verification) -> list[Row]:
    return [
        {"camera": name, "verdict": str(camera.verdict), **_errors(camera.px, "px"), **_errors(camera.mm, "mm")}
        for name, camera in result.cameras.items()
    ]


def _errors(found: ErrorStatistics, unit: str) -> Row:
    return {f"{name}_{unit}": value for name, value in vars(found).items()}


@_rows.register
def _(result: Drift) -> list[Row]:
    named = zip(result.names, result.verifications, strict=True)
    return [{"recording": name} | row for name, verification in named for row in _rows(verification)]


@_rows.register
def _(result: Difference) -> list[Row]:
    return [vars(change) | {"verdict": str(change.verdict(result.options))} for change in result.changes]


@_rows.register
def _(result: SelfCheck) -> list[Row]:
    return [vars(camera) for camera in result.cameras]


@_rows.register
def _(result: Diagnosis) -> list[Row]:
    return [vars(finding) | {"evidence": finding.evidence} for finding in result.findings]


@_rows.register
def _(result: Comparison) -> list[Row]:
    return [{name: value for name, value in vars(row).items() if name != "calibration"} for row in result]


@_rows.register
def _(result: PoseCalibration) -> list[Row]:
    return [_place(name, one.camera_T_ref) | vars(one.statistics) for name, one in result.cameras.items()]


@_rows.register
def _(result: PoseLevel) -> list[Row]:
    return [_place("camera", result.poses[0])]


# Figures


def cameras_figure(calibration: Calibration) -> Figure:
    return calibration_figure(calibration)


def residuals_figure(calibration: Calibration, camera: str) -> Figure:
    return _of(residual_figures.field(_evidence(calibration, camera)))


def residuals_over_time_figure(calibration: Calibration, camera: str) -> Figure:
    return _of(residual_figures.over_time(_evidence(calibration, camera)))


def uncertainty_figure(calibration: Calibration, camera: str, distance_m: float) -> Figure:
    _check(camera, list(_with_covariance(calibration).cameras))
    return _of(uncertainty_figures.image_picture(calibration, camera, distance_m))


def volume_figure(calibration: Calibration) -> Figure:
    return _of(uncertainty_figures.volume_picture(_with_covariance(calibration)))


def heat_maps_figure(verification: Verification) -> Figure:
    return verification_figure(verification)


def errors_over_time_figure(verification: Verification, camera: str) -> Figure:
    if not verification.sightings:
        raise GtcalError("this verification was read from a file, which holds no single sightings: verify again")
    _check(camera, list(verification.sightings))
    return _of(verification_figures.over_time(verification.sightings[camera], verification.options))


def _of(picture: Picture) -> Figure:
    assert picture.figure is not None
    return picture.figure


def _with_covariance(calibration: Calibration) -> Calibration:
    if calibration.covariance is None:
        raise GtcalError("this calibration has no covariance: calibrate with all the stages")
    return calibration


def _check(camera: str, cameras: list[str]) -> None:
    if camera not in cameras:
        raise GtcalError(f"there is no camera {camera!r}; cameras: {', '.join(cameras)}")


def _evidence(calibration: Calibration, camera: str) -> CameraEvidence:
    """Of the views and corners that the solution kept."""
    solution = calibration.solution
    _check(camera, list(calibration.cameras))
    if solution is None:
        raise GtcalError("this calibration was read from a file, which holds no residuals: see gtcal.report")
    views = solution.views[camera]
    residuals_px = chain_residuals_px(views, calibration.estimate)
    kept = np.ones(views.n_views, dtype=bool), np.ones(views.n_corners, dtype=bool)
    return CameraEvidence(calibration.cameras[camera].camera, views, residuals_px, *kept)
