"""calibration.json: a calibration on disk, readable back without loss.

Matrices are row-major lists of rows. Next to each transform stand its quaternion and translation for people and other
programs; reading takes the matrix. Files from before effects were looked for have neither these nor segments, older
ones no lens_moves either.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from factors import CAMERA_MODELS
from factors.board_shape import FLAT, N_SHAPE, SHAPE_NAMES
from gtcal.bounds import LARGEST_LENS, LARGEST_SIDE_PX
from gtcal.camera import Camera, FloatArray, RollingShutter
from gtcal.files import InputFile, write_text
from gtcal.names import named
from gtcal.observed.estimate import Estimate
from gtcal.observed.views import Dropped
from gtcal.recordings.capture import Capture
from gtcal.recordings.trajectory import quaternions_from_poses
from gtcal.results.board_shape import BoardShape
from gtcal.results.calibration import (
    Calibration,
    CameraCalibration,
    Clock,
    MocapNoise,
    PoseEstimate,
    Provenance,
    ResidualStatistics,
    Segment,
    SmoothError,
    StageReport,
)
from gtcal.results.carried_over import CarriedOver
from gtcal.results.covariance import JointCovariance
from gtcal.results.effect_finding import EffectFinding, Moment, Quantity
from gtcal.results.lens_move import LensMove
from gtcal.results.other_board import OtherBoard
from gtcal.results.result_file import read_result

SCHEMA_VERSION = 1

_Made = TypeVar("_Made")

CONVENTIONS = (
    "a_T_b takes coordinates in frame b to coordinates in frame a, in m. A covariance is that of xi in "
    "a_T_b * Exp(xi), the tangent of GTSAM's Pose3: rotation first (rad), then translation (m), along the axes of b. "
    "Camera frame: x right, y down, z forward. Pixels: integer coordinates are pixel centres. "
    "rmse_px is pooled per corner, the root of the mean squared norm."
)


def write_calibration(path: Path | str, calibration: Calibration) -> None:
    """Write calibration.json, whole or not at all. Raises GtcalError where it can't be written."""
    write_text(Path(path), json.dumps(calibration_document(calibration), indent=1, allow_nan=False) + "\n")


def read_calibration(path: Path | str) -> Calibration:
    """Read what ``write_calibration`` wrote.

    Raises GtcalError for a file that is missing, no JSON, of a newer schema, or lacks a field."""
    return read_result(Path(path), "calibration", SCHEMA_VERSION, _calibration)


def calibration_document(calibration: Calibration) -> dict[str, Any]:
    """As it stands in calibration.json."""
    return {
        "gtcal_calibration": SCHEMA_VERSION,
        "conventions": CONVENTIONS,
        "capture": calibration.capture.value,
        "board": calibration.board,
        "board_shape": _shape_document(calibration.board_shape),
        "rmse_px": calibration.rmse_px,
        "sigma_px": calibration.sigma_px,
        "covariance_kind": calibration.covariance_kind,
        "warnings": list(calibration.warnings),
        "cameras": {name: _camera_document(camera) for name, camera in calibration.cameras.items()},
        "body_T_board": _board_document(calibration.body_T_board),
        "covariances": {kind: _covariance_document(joint) for kind, joint in calibration.covariances.items()},
        "estimates": {str(stage): _estimate_document(found) for stage, found in calibration.estimates.items()},
        "mocap_noise": _mocap_noise_document(calibration.mocap_noise),
        "clock": asdict(calibration.clock) if calibration.clock else None,
        "effects": [asdict(finding) for finding in calibration.effects],
        "carried_over": asdict(calibration.carried_over) if calibration.carried_over else None,
        **_other_boards_document(calibration.other_boards),
        "segments": [_segment_document(segment) for segment in calibration.segments],
        "stages": [without_nan(asdict(stage)) for stage in calibration.stages],
        "dropped": [asdict(dropped) for dropped in calibration.dropped],
        "provenance": provenance_document(calibration.provenance),
    }


def _camera_document(calibrated: CameraCalibration) -> dict[str, Any]:
    camera, pose, covariance = calibrated.camera, calibrated.camera_T_ref, calibrated.theta_covariance
    names = camera.model.parameter_names
    return {
        "model": camera.model.name,
        "image_size_px": [camera.image_width_px, camera.image_height_px],
        "parameters": dict(zip(names, camera.theta.tolist(), strict=True)),
        "rolling_shutter": None if camera.rolling_shutter is None else asdict(camera.rolling_shutter),
        "parameter_sigmas": None
        if covariance is None
        else dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        "parameter_covariance": _list(covariance),
        "camera_T_ref": pose_document(pose)
        | {
            "position_of_camera_in_ref_m": pose.position_of_a_in_b_m.tolist(),
            "position_of_camera_in_ref_sigma_mm": _list(pose.position_of_a_in_b_sigma_mm),
        },
        "residuals": asdict(calibrated.residuals),
        "lens_moves": [asdict(move) for move in calibrated.lens_moves],
    }


def _board_document(pose: PoseEstimate) -> dict[str, Any]:
    return pose_document(pose) | {"position_of_board_in_body_sigma_mm": _list(pose.position_of_b_in_a_sigma_mm)}


def _shape_document(found: BoardShape | None) -> dict[str, Any] | None:
    if found is None:
        return None
    sigmas = np.sqrt(np.diag(found.covariance))
    return {
        "shape": dict(zip(SHAPE_NAMES, found.shape.tolist(), strict=True)),
        "sigmas": dict(zip(SHAPE_NAMES, sigmas.tolist(), strict=True)),
        "stated_sigmas": dict(zip(SHAPE_NAMES, found.stated_sigmas.tolist(), strict=True)),
        "covariance": found.covariance.tolist(),
    }


def pose_document(pose: PoseEstimate) -> dict[str, Any]:
    """A transform, with what people and other programs read beside the matrix."""
    quat_wxyz = quaternions_from_poses(pose.a_T_b[None], "wxyz")[0]
    return {
        "matrix": pose.a_T_b.tolist(),
        "quat_wxyz": quat_wxyz.tolist(),
        "t_m": pose.a_T_b[:3, 3].tolist(),
        "rotation_sigma_deg": _list(pose.rotation_sigma_deg),
        "covariance": _list(pose.covariance),
    }


def provenance_document(provenance: Provenance) -> dict[str, Any]:
    inputs = [{"path": str(entry.path), "sha256": entry.sha256} for entry in provenance.inputs]
    return asdict(provenance) | {"inputs": inputs, "command_line": list(provenance.command_line)}


def _carried_over(block: dict[str, Any] | None) -> CarriedOver | None:
    if block is None:
        return None
    kept, moved = tuple(map(str, block["kept"])), tuple(map(str, block["moved"]))
    return CarriedOver(str(block["source"]), float(block["days"]), kept, moved, bool(block["alone"]))


def _covariance_document(joint: JointCovariance) -> dict[str, Any]:
    """Of X, each Y_c, then each theta_c that was solved for."""
    return {
        "theta_sizes": joint.theta_sizes,
        "matrix": joint.matrix.tolist(),
        "board_shape": _list(joint.board_shape),
    }


def _other_boards_document(boards: tuple[OtherBoard, ...]) -> dict[str, Any]:
    """Nothing of a recording of one board."""
    blocks = [
        {
            "name": board.name,
            "board": board.board,
            "capture": board.capture.value,
            "body_T_board": _board_document(board.body_T_board),
            "residuals": {camera: asdict(of_camera) for camera, of_camera in board.residuals.items()},
        }
        for board in boards
    ]
    return {"other_boards": blocks} if blocks else {}


def _other_board(block: Mapping[str, Any]) -> OtherBoard:
    residuals = {named(name): _made(ResidualStatistics, of) for name, of in block["residuals"].items()}
    pose = pose_of(block["body_T_board"])
    return OtherBoard(named(block["name"]), block["board"], Capture(block["capture"]), pose, residuals)


def _segment_document(segment: Segment) -> dict[str, Any]:
    return {
        "start_s": segment.start_s,
        "end_s": segment.end_s,
        "moved": segment.moved,
        "body_T_board": _board_document(segment.body_T_board),
        "camera_T_ref": {name: pose_document(pose) for name, pose in segment.camera_T_ref.items()},
    }


def _estimate_document(estimate: Estimate) -> dict[str, Any]:
    cameras = {
        name: {"camera_T_ref": pose.tolist(), "theta": estimate.theta[name].tolist()}
        for name, pose in estimate.camera_T_ref.items()
    }
    return {
        "body_T_board": estimate.body_T_board.tolist(),
        "cameras": cameras,
        "board_shape": estimate.board_shape.tolist(),
    }


def _mocap_noise_document(noise: MocapNoise | None) -> dict[str, Any] | None:
    if noise is None:
        return None
    return asdict(noise) | {"hold_out_px": {str(stage): rmse for stage, rmse in noise.hold_out_px.items()}}


def _list(array: FloatArray | None) -> list[Any] | None:
    return None if array is None else array.tolist()


def without_nan(fields: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN: what a stage has no number for is null."""
    return {key: None if value != value else value for key, value in fields.items()}


def _calibration(document: Mapping[str, Any]) -> Calibration:
    return Calibration(
        capture=Capture(document["capture"]),
        cameras={named(name): _camera(name, block) for name, block in document["cameras"].items()},
        body_T_board=pose_of(document["body_T_board"]),
        board=document["board"],
        board_shape=_shape(document.get("board_shape")),
        sigma_px=float(document["sigma_px"]),
        covariance_kind=document["covariance_kind"],
        covariances={kind: _joint_covariance(kind, block) for kind, block in document["covariances"].items()},
        estimates={int(stage): _estimate(block) for stage, block in document["estimates"].items()},
        mocap_noise=_mocap_noise(document["mocap_noise"]),
        clock=None if document["clock"] is None else Clock(**document["clock"]),
        effects=tuple(finding_of(block) for block in document.get("effects", ())),
        carried_over=_carried_over(document.get("carried_over")),
        other_boards=tuple(_other_board(block) for block in document.get("other_boards", ())),
        segments=tuple(_segment(block) for block in document.get("segments", ())),
        stages=tuple(stage_of(block) for block in document["stages"]),
        dropped=tuple(_made(Dropped, block) for block in document["dropped"]),
        warnings=tuple(document["warnings"]),
        provenance=provenance_of(document["provenance"]),
    )


def _camera(name: str, block: Mapping[str, Any]) -> CameraCalibration:
    if block["model"] not in CAMERA_MODELS:
        raise ValueError(f"cameras.{name}.model {block['model']!r}; choose from {', '.join(CAMERA_MODELS)}")
    model, (width_px, height_px) = CAMERA_MODELS[block["model"]], block["image_size_px"]
    theta = np.array([block["parameters"][parameter] for parameter in model.parameter_names], dtype=np.float64)
    if not all(isinstance(side, int) and 0 < side <= LARGEST_SIDE_PX for side in (width_px, height_px)):
        raise ValueError(f"cameras.{name}.image_size_px {block['image_size_px']!r}")
    if not (np.abs(theta) <= LARGEST_LENS).all():
        raise ValueError(f"cameras.{name}.parameters hold a number beyond any lens, or none")
    return CameraCalibration(
        camera=Camera(name, model, theta, width_px, height_px, _shutter(block["rolling_shutter"])),
        camera_T_ref=pose_of(block["camera_T_ref"]),
        theta_covariance=_array(block["parameter_covariance"], (len(theta), len(theta))),
        residuals=_made(ResidualStatistics, block["residuals"]),
        lens_moves=tuple(_made(LensMove, move) for move in block.get("lens_moves", ())),
    )


def _shutter(block: Mapping[str, Any] | None) -> RollingShutter | None:
    return None if block is None else _made(RollingShutter, block)


def pose_of(block: Mapping[str, Any]) -> PoseEstimate:
    """What ``pose_document`` wrote."""
    matrix = _array(block["matrix"], (4, 4))
    if matrix is None:
        raise ValueError("matrix is null")
    return PoseEstimate(matrix, _array(block["covariance"], (6, 6)))


def _shape(block: Mapping[str, Any] | None) -> BoardShape | None:
    if block is None:
        return None
    covariance = _array(block["covariance"], (N_SHAPE, N_SHAPE))
    if covariance is None:
        raise ValueError("board_shape.covariance is null")
    shape, stated = (np.array([float(block[key][name]) for name in SHAPE_NAMES]) for key in ("shape", "stated_sigmas"))
    return BoardShape(shape, covariance, stated)


def _estimate(block: Mapping[str, Any]) -> Estimate:
    cameras = block["cameras"]
    shape = _array(block.get("board_shape"), (N_SHAPE,))
    return Estimate(
        np.array(block["body_T_board"], dtype=np.float64),
        {name: np.array(camera["camera_T_ref"], dtype=np.float64) for name, camera in cameras.items()},
        {name: np.array(camera["theta"], dtype=np.float64) for name, camera in cameras.items()},
        FLAT if shape is None else shape,
    )


def _mocap_noise(block: Mapping[str, Any] | None) -> MocapNoise | None:
    if block is None:
        return None
    hold_out_px = {int(stage): float(rmse) for stage, rmse in block["hold_out_px"].items()}
    smooth = tuple(_made(SmoothError, part) for part in block.get("smooth", ()))
    return _made(MocapNoise, {**block, "hold_out_px": hold_out_px, "smooth": smooth})


def finding_of(block: Mapping[str, Any]) -> EffectFinding:
    """An effect as it was written."""
    quantities = tuple(_made(Quantity, quantity) for quantity in block["estimate"])
    moment = None if block["moment"] is None else _made(Moment, block["moment"])
    return _made(EffectFinding, {"hold_out_px": None, **block, "estimate": quantities, "moment": moment})


def _segment(block: Mapping[str, Any]) -> Segment:
    cameras = {name: pose_of(pose) for name, pose in block["camera_T_ref"].items()}
    return _made(Segment, {**block, "body_T_board": pose_of(block["body_T_board"]), "camera_T_ref": cameras})


def _joint_covariance(kind: str, block: Mapping[str, Any]) -> JointCovariance:
    matrix, shape = np.array(block["matrix"], dtype=np.float64), block.get("board_shape")
    return JointCovariance(kind, dict(block["theta_sizes"]), matrix, _array(shape, (N_SHAPE, N_SHAPE)))


def _array(rows: Any, shape: tuple[int, ...]) -> FloatArray | None:
    if rows is None:
        return None
    array = np.array(rows, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"a matrix of shape {array.shape}, expected {shape}")
    return array


def stage_of(block: Mapping[str, Any]) -> StageReport:
    """A stage as it was written."""
    given: dict[str, Any] = {key: float("nan") if value is None else value for key, value in block.items()}
    return _made(StageReport, given)


def provenance_of(block: Mapping[str, Any]) -> Provenance:
    """What ``provenance_document`` wrote."""
    inputs = tuple(InputFile(Path(entry["path"]), entry["sha256"]) for entry in block["inputs"])
    return _made(Provenance, {**block, "inputs": inputs, "command_line": tuple(block["command_line"])})


def _made(kind: type[_Made], block: Mapping[str, Any]) -> _Made:
    """A dataclass from its fields; KeyError for the first that is missing."""
    return kind(**{field.name: block[field.name] for field in fields(kind)})  # type: ignore[arg-type]
