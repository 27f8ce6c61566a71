"""The ground truth on disk: ground_truth.json beside a simulated recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from factors import CAMERA_MODELS
from gtcal.camera import Camera
from gtcal.documents import read_text
from gtcal.errors import GtcalError
from gtcal.files import is_there, write_text
from gtcal.simulation.truth import CameraTruth, GroundTruth

GROUND_TRUTH_NAME = "ground_truth.json"
_VERSION = 1


def write_ground_truth(truth: GroundTruth, folder: Path) -> Path:
    """Write ``folder/ground_truth.json``, every digit, and return its path. Transforms are rows of 4 x 4 matrices.

    Raises GtcalError where the folder can't be written."""
    any_camera = next(iter(truth.cameras.values()))
    document = {
        "gtcal_ground_truth": _VERSION,
        "body_T_board": truth.body_T_board.tolist(),
        "cameras": {name: _camera_block(camera) for name, camera in truth.cameras.items()},
        "ref_T_body": any_camera.ref_T_body.tolist(),
    }
    path = folder / GROUND_TRUTH_NAME
    write_text(path, json.dumps(document, indent=None, separators=(",", ":")) + "\n")
    return path


def _camera_block(truth: CameraTruth) -> dict[str, Any]:
    camera = truth.camera
    return {
        "model": camera.model.name,
        "image_size_px": [camera.image_width_px, camera.image_height_px],
        "parameters": dict(zip(camera.model.parameter_names, camera.theta.tolist(), strict=True)),
        "camera_T_ref": truth.camera_T_ref.tolist(),
        "clock_offset_s": truth.clock_offset_s,
        "stamps_ns": truth.stamps_ns.tolist(),
        "swapped_frames": np.flatnonzero(truth.swapped).tolist(),
        "n_corners": len(truth.wrong_corners),
        "wrong_corners": np.flatnonzero(truth.wrong_corners).tolist(),
    }


def read_ground_truth(folder: Path | str) -> GroundTruth:
    """Read the ground truth of the simulated recording in ``folder``.

    Raises GtcalError where there is none, or it is not of this version."""
    path = Path(folder) / GROUND_TRUTH_NAME
    if not is_there(path):
        raise GtcalError(f"{path}: can't be read: No such file or directory; only simulated recordings have one")
    try:
        document = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise GtcalError(f"{path}: is not valid JSON: {error}") from error
    if not isinstance(document, dict) or document.get("gtcal_ground_truth") != _VERSION:
        raise GtcalError(f"{path}: is no ground truth of version {_VERSION}; simulate the recording again")
    try:
        ref_T_body = np.array(document["ref_T_body"])
        cameras = {name: _camera_truth(name, block, ref_T_body) for name, block in document["cameras"].items()}
        return GroundTruth(cameras, np.array(document["body_T_board"]))
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError, ArithmeticError) as error:
        raise GtcalError(f"{path}: is damaged ({error}); simulate the recording again") from error


def _camera_truth(name: str, block: dict[str, Any], ref_T_body: np.ndarray) -> CameraTruth:
    model = CAMERA_MODELS[block["model"]]
    theta = np.array([block["parameters"][parameter] for parameter in model.parameter_names])
    swapped = np.zeros(len(block["stamps_ns"]), dtype=np.bool_)
    swapped[block["swapped_frames"]] = True
    wrong_corners = np.zeros(block["n_corners"], dtype=np.bool_)
    wrong_corners[block["wrong_corners"]] = True
    return CameraTruth(
        camera=Camera(name, model, theta, *block["image_size_px"]),
        camera_T_ref=np.array(block["camera_T_ref"]),
        clock_offset_s=block["clock_offset_s"],
        stamps_ns=np.array(block["stamps_ns"], dtype=np.int64),
        ref_T_body=ref_T_body,
        swapped=swapped,
        wrong_corners=wrong_corners,
    )
