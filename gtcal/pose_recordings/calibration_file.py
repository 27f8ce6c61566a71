"""pose_calibration.json: a calibration from poses on disk, readable back without loss."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gtcal.documents import read_text
from gtcal.estimation.observations import Dropped
from gtcal.files import write_text
from gtcal.names import named
from gtcal.pose_recordings.calibration import ClosedForm, PoseCalibration, PoseCamera, PoseStatistics
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Clock, PoseEstimate
from gtcal.results.calibration_file import (
    finding_of,
    pose_document,
    pose_of,
    provenance_document,
    provenance_of,
    stage_of,
    without_nan,
)
from gtcal.results.effect_finding import EffectFinding
from gtcal.results.result_file import read_result

SCHEMA_VERSION = 1
_FIELD, _HEAD = "gtcal_pose_calibration", 200  # the first of its fields

CONVENTIONS = (
    "a_T_b takes coordinates in frame b to coordinates in frame a, in m. A covariance is that of xi in "
    "a_T_b * Exp(xi), the tangent of GTSAM's Pose3: rotation first (rad), then translation (m), along the axes of b; "
    "the joint one is of body_T_board, then of each camera_T_ref in the order of the cameras. Camera frame: x right, "
    "y down, z forward."
)


def write_pose_calibration(path: Path | str, calibration: PoseCalibration) -> None:
    """Write it, whole or not at all. Raises GtcalError where it can't be written."""
    write_text(Path(path), json.dumps(pose_calibration_document(calibration), indent=1, allow_nan=False) + "\n")


def read_pose_calibration(path: Path | str) -> PoseCalibration:
    """Read what ``write_pose_calibration`` wrote.

    Raises GtcalError for a file that is missing, no JSON, of a newer schema, or lacks a field."""
    return read_result(Path(path), "pose_calibration", SCHEMA_VERSION, _calibration)


def is_pose_calibration(path: Path | str) -> bool:
    """Whether a file says that it is one. Raises GtcalError where it can't be read."""
    return f'"{_FIELD}"' in read_text(Path(path))[:_HEAD]


def pose_calibration_document(calibration: PoseCalibration) -> dict[str, Any]:
    """As it stands in the file."""
    return {
        _FIELD: SCHEMA_VERSION,
        "conventions": CONVENTIONS,
        "capture": calibration.capture.value,
        "numbered": calibration.numbered,
        "warnings": list(calibration.warnings),
        "cameras": {name: _camera_document(camera) for name, camera in calibration.cameras.items()},
        "body_T_board": pose_document(calibration.body_T_board),
        "covariance": calibration.covariance.tolist(),
        "mocap_noise_deg": calibration.mocap_noise_deg,
        "mocap_noise_mm": calibration.mocap_noise_mm,
        "closed_forms": [without_nan(asdict(form)) for form in calibration.closed_forms],
        "stages": [without_nan(asdict(stage)) for stage in calibration.stages],
        "clock": asdict(calibration.clock) if calibration.clock else None,
        "effects": [_effect_document(finding) for finding in calibration.effects],
        "dropped": [asdict(dropped) for dropped in calibration.dropped],
        "provenance": provenance_document(calibration.provenance),
    }


def pose_comparison_document(forms: Sequence[ClosedForm]) -> dict[str, Any]:
    """The closed forms alone, for ``--json``."""
    return {"gtcal_pose_comparison": SCHEMA_VERSION, "closed_forms": [without_nan(asdict(form)) for form in forms]}


def _camera_document(camera: PoseCamera) -> dict[str, Any]:
    return {
        "camera_T_ref": pose_document(camera.camera_T_ref),
        "position_of_camera_in_ref_m": camera.camera_T_ref.position_of_a_in_b_m.tolist(),
        "residuals": asdict(camera.statistics),
        "noise_deg": camera.noise_deg,
        "noise_mm": camera.noise_mm,
        "noise_in_units_of_what_was_stated": camera.stated,
        "students_t_degrees_of_freedom": None if np.isinf(camera.tail) else camera.tail,
    }


def _calibration(document: Mapping[str, Any]) -> PoseCalibration:
    n = 6 + 6 * len(document["cameras"])
    return PoseCalibration(
        capture=Capture(document["capture"]),
        cameras={named(name): _camera(block) for name, block in document["cameras"].items()},
        body_T_board=pose_of(document["body_T_board"]),
        covariance=np.array(document["covariance"], dtype=np.float64).reshape(n, n),
        mocap_noise_deg=_numbers(document["mocap_noise_deg"]),
        mocap_noise_mm=_numbers(document["mocap_noise_mm"]),
        closed_forms=tuple(_closed_form(block) for block in document["closed_forms"]),
        stages=tuple(stage_of(block) for block in document["stages"]),
        dropped=tuple(Dropped(**block) for block in document["dropped"]),
        warnings=tuple(document["warnings"]),
        provenance=provenance_of(document["provenance"]),
        clock=None if document.get("clock") is None else Clock(**document["clock"]),
        effects=tuple(_effect(block) for block in document.get("effects", ())),
        numbered=bool(document.get("numbered", False)),
    )


_HOLD_OUT, _IN_SIGMAS = "hold_out_drop_px", "hold_out_drop_sigmas"


def _effect_document(finding: EffectFinding) -> dict[str, Any]:
    fields = asdict(finding)
    return {_IN_SIGMAS if key == _HOLD_OUT else key: value for key, value in fields.items()}


def _effect(block: Mapping[str, Any]) -> EffectFinding:
    return finding_of({_HOLD_OUT if key == _IN_SIGMAS else key: value for key, value in block.items()})


def _camera(block: Mapping[str, Any]) -> PoseCamera:
    tail = block["students_t_degrees_of_freedom"]
    estimate: PoseEstimate = pose_of(block["camera_T_ref"])
    return PoseCamera(
        estimate,
        PoseStatistics(**block["residuals"]),
        tuple(map(float, block["noise_deg"])),
        tuple(map(float, block["noise_mm"])),
        bool(block["noise_in_units_of_what_was_stated"]),
        float("inf") if tail is None else float(tail),
    )


def _closed_form(block: Mapping[str, Any]) -> ClosedForm:
    given: dict[str, Any] = {key: float("nan") if value is None else value for key, value in block.items()}
    return ClosedForm(**given)


def _numbers(values: Any) -> tuple[float, ...] | None:
    return None if values is None else tuple(map(float, values))
