"""verification.json: a verification on disk, read back without loss but for what has a row per frame.

The single sightings have a CSV of their own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from gtcal.files import InputFile, write_aside, write_text
from gtcal.names import named
from gtcal.plain import csv_cell
from gtcal.results.calibration import Provenance
from gtcal.results.result_file import read_result
from gtcal.verification.lollypop import Lollypop, device_from_manifest
from gtcal.verification.verification import (
    Bias,
    CameraVerification,
    ErrorCurve,
    ErrorStatistics,
    ExpectedError,
    Fault,
    HeatMap,
    LeftOut,
    PoseCheck,
    TriangulationCheck,
    Verdict,
    Verification,
    VerificationOptions,
)

SCHEMA_VERSION = 1

CONVENTIONS = (
    "Errors are image centre less mocap centre. e_2D in px, e_3D in mm: the image centre back-projected to the depth "
    "of the mocap centre. rmse_low and rmse_high are one-sided bounds at options.confidence. A fault's correction C: "
    "markers_moved: camera_T_ref * C is better; camera_moved: C * camera_T_ref is. null stands for 'nothing measured'."
)
NOT_WRITTEN: dict[type, tuple[str, ...]] = {
    Verification: ("sightings", "calibration", "recording"),
    TriangulationCheck: ("stamps_ns", "seen_by", "parallax_deg", "errors_in_ref_mm", "depth_mm", "across_mm"),
    PoseCheck: ("stamps_ns", "errors", "depth_mm", "across_mm", "rotation_deg"),
}
"""What has a row per frame: it would make the file as large as the recording."""


def write_verification(path: Path, verification: Verification) -> None:
    """Write verification.json, whole or not at all. Raises GtcalError where it can't be written."""
    write_text(path, json.dumps(verification_document(verification), indent=1, allow_nan=False) + "\n")


def verification_document(verification: Verification) -> dict[str, Any]:
    """As it stands in verification.json."""
    return {"gtcal_verification": SCHEMA_VERSION, "conventions": CONVENTIONS, **_plain(verification)}


def read_verification(path: Path) -> Verification:
    """Read what ``write_verification`` wrote; the sightings, the calibration and the recording are not in it.

    Raises GtcalError for a file that is missing, no JSON, of a newer schema, or lacks a field."""
    return read_result(path, "verification", SCHEMA_VERSION, _verification)


_SIGHTING_COLUMNS = (
    "timestamp_ns,camera,face,image_x_px,image_y_px,mocap_x_px,mocap_y_px,e_2d_px,e_3d_mm,distance_m,"
    "viewing_angle_deg,field_angle_deg"
)


def write_sightings(path: Path, verification: Verification) -> None:
    """Write the single sightings of all cameras as CSV, whole or not at all.

    Raises GtcalError where it can't be written."""
    with write_aside(path) as file:
        file.write(_SIGHTING_COLUMNS + "\n")
        for name, seen in verification.sightings.items():
            numbers = np.column_stack(
                [
                    seen.image_centre_px,
                    seen.mocap_centre_px,
                    seen.e_2d_px,
                    seen.e_3d_mm,
                    seen.distance_m,
                    np.rad2deg(seen.viewing_angle_rad),
                    np.rad2deg(seen.field_angle_rad),
                ]
            ).tolist()
            camera = csv_cell(name)
            rows = zip(seen.stamps_ns.tolist(), seen.face_index.tolist(), numbers, strict=True)
            file.writelines(f"{t},{camera},{face},{','.join(f'{x:.6f}' for x in row)}\n" for t, face, row in rows)


def _plain(value: Any) -> Any:
    """As JSON knows it; NaN is null."""
    if isinstance(value, Lollypop):
        return value.to_manifest()
    if is_dataclass(value):
        left_out = NOT_WRITTEN.get(type(value), ())
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value) if f.name not in left_out}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, Enum | Path):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _verification(document: Mapping[str, Any]) -> Verification:
    return Verification(
        verdict=Verdict(document["verdict"]),
        reasons=tuple(document["reasons"]),
        cameras={named(name): _camera(block) for name, block in document["cameras"].items()},
        pooled_px=_statistics(document["pooled_px"]),
        pooled_mm=_statistics(document["pooled_mm"]),
        triangulation=_triangulation(document["triangulation"]),
        pose_checks=tuple(_pose_check(block) for block in document["pose_checks"]),
        faults=tuple(_fault(block) for block in document["faults"]),
        left_out=tuple(LeftOut(**block) for block in document["left_out"]),
        warnings=tuple(document["warnings"]),
        clock_offset_s=None if document["clock_offset_s"] is None else tuple(document["clock_offset_s"]),
        device=device_from_manifest(document["device"]),
        options=VerificationOptions(**document["options"]),
        provenance=_provenance(document["provenance"]),
        first_stamp_ns=document["first_stamp_ns"],
        last_stamp_ns=document["last_stamp_ns"],
    )


def _camera(block: Mapping[str, Any]) -> CameraVerification:
    return CameraVerification(
        **{
            **block,
            "verdict": Verdict(block["verdict"]),
            "reasons": tuple(block["reasons"]),
            "px": _statistics(block["px"]),
            "mm": _statistics(block["mm"]),
            "bias": Bias(**{name: _numbers(value) for name, value in block["bias"].items()}),
            "curves": tuple(_curve(curve) for curve in block["curves"]),
            "heat_map": _heat_map(block["heat_map"]),
            "expected": None if block.get("expected") is None else ExpectedError(**block["expected"]),
        }
    )


def _statistics(block: Mapping[str, Any]) -> ErrorStatistics:
    given: dict[str, Any] = {name: float("nan") if value is None else value for name, value in block.items()}
    return ErrorStatistics(**given)


def _numbers(value: Any) -> Any:
    """A number, or an array of them; null is NaN."""
    array = np.array(value, dtype=np.float64)
    return array if array.ndim else float(array)


def _integers(value: Any) -> Any:
    return np.array(value, dtype=np.int64)


def _curve(block: Mapping[str, Any]) -> ErrorCurve:
    arrays = {name: _numbers(block[name]) for name in ("edges", "rmse_px", "median_px", "rmse_mm")}
    return ErrorCurve(quantity=block["quantity"], count=_integers(block["count"]), **arrays)


def _heat_map(block: Mapping[str, Any]) -> HeatMap:
    count = _integers(block["count"])
    mean = np.array(block["mean_error_px"], dtype=np.float64).reshape(*count.shape, 2)
    edges = {name: _numbers(block[name]) for name in ("x_edges_px", "y_edges_px", "rmse_px")}
    return HeatMap(count=count, mean_error_px=mean, **edges)


def _triangulation(block: Mapping[str, Any]) -> TriangulationCheck:
    cameras = tuple(block["cameras"])
    return TriangulationCheck(
        cameras=cameras,
        stamps_ns=np.empty(0, dtype=np.int64),
        seen_by=np.empty((0, len(cameras)), dtype=np.bool_),
        parallax_deg=np.empty(0),
        errors_in_ref_mm=np.empty((0, 3)),
        depth_mm=np.empty(0),
        across_mm=np.empty(0),
        statistics=None if block["statistics"] is None else _statistics(block["statistics"]),
        **{name: _numbers(block[name]) for name in ("depth_rmse_mm", "depth_bias_mm", "across_rmse_mm")},
    )


def _pose_check(block: Mapping[str, Any]) -> PoseCheck:
    return PoseCheck(
        camera=block["camera"],
        stamps_ns=np.empty(0, dtype=np.int64),
        errors=np.empty((0, 6)),
        depth_mm=np.empty(0),
        across_mm=np.empty(0),
        rotation_deg=np.empty(0),
        count=block["count"],
        **{name: _numbers(block[name]) for name in ("depth_rmse_mm", "across_rmse_mm", "rotation_rmse_deg")},
    )


def _fault(block: Mapping[str, Any]) -> Fault:
    return Fault(
        **{
            **block,
            "correction": np.array(block["correction"], dtype=np.float64),
            "also_possible": tuple(block["also_possible"]),
        }
    )


def _provenance(block: Mapping[str, Any]) -> Provenance:
    inputs = tuple(InputFile(Path(entry["path"]), entry["sha256"]) for entry in block["inputs"])
    return Provenance(**{**block, "inputs": inputs, "command_line": tuple(block["command_line"])})
