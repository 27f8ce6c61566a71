"""selfcheck.json: the outcome of the self-checks on disk."""

from __future__ import annotations

import json
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from gtcal.files import write_text
from gtcal.results.calibration_file import provenance_document
from gtcal.selfchecks.folds import DEFAULT, HoldOut
from gtcal.selfchecks.halves import Difference
from gtcal.selfchecks.selfcheck import SelfCheck

SCHEMA_VERSION = 1


def write_selfcheck(path: Path | str, found: SelfCheck) -> None:
    """Write selfcheck.json, whole or not at all. Raises GtcalError where it can't be written."""
    write_text(Path(path), json.dumps(selfcheck_document(found), indent=1, allow_nan=False) + "\n")


def selfcheck_document(found: SelfCheck) -> dict[str, Any]:
    """As it stands in selfcheck.json."""
    halves = found.halves
    return {
        "gtcal_selfcheck": SCHEMA_VERSION,
        "statements": list(found.statements),
        "notes": list(found.notes),
        "split_half": None
        if halves is None
        else {
            "agrees": halves.agrees,
            "overall": _difference(halves.overall),
            "by_unknown": [_difference(difference) for difference in halves.by_unknown],
        },
        "n_folds": found.n_folds,
        "hold_out": [_hold_out(hold_out) for hold_out in found.hold_outs],
        "chain_and_pnp": [
            asdict(camera) | {"mocap_px": camera.mocap_px, "calibration_px": camera.calibration_px}
            for camera in found.cameras
        ],
        "provenance": provenance_document(found.provenance),
    }


def _difference(difference: Difference) -> dict[str, Any]:
    of_pose = {} if difference.dof != _POSE or difference.what == "all" else _pose(difference)
    return {
        "what": difference.what,
        "per_dof": difference.per_dof,
        "dof": difference.dof,
        "probability": difference.probability,
    } | of_pose


_POSE = 6


def _pose(difference: Difference) -> dict[str, float]:
    return {"position_mm": difference.position_mm, "angle_deg": difference.angle_deg}


def _number(value: float) -> float | None:
    return value if isfinite(value) else None


def _hold_out(hold_out: HoldOut) -> dict[str, Any]:
    return {
        "estimate": "as taken" if hold_out.stage == DEFAULT else f"stage {hold_out.stage}",
        "rmse_px": hold_out.rmse_px,
        "rmse_by_camera_px": {name: _number(rmse_px) for name, rmse_px in hold_out.by_camera_px.items()},
        "rmse_by_block_px": {f"{k + 1}": _number(rmse_px) for k, rmse_px in hold_out.by_block_px.items()},
        "position_spread_mm": hold_out.spread_mm,
    }
