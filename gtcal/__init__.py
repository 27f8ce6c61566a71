"""gtcal: where each camera sits relative to the mocap system, how sure that is, and whether it still holds.

import gtcal
recording = gtcal.load_recording("my_recording")
calibration = gtcal.calibrate(recording)
gtcal.write_calibration("calibration.json", calibration)
verification = gtcal.verify(gtcal.load_lollypop_recording("my_lollypop"), calibration)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gtcal.board import PRESETS as PRESETS
    from gtcal.board import board_from_manifest as board_from_manifest
    from gtcal.calibration import Calibration as Calibration
    from gtcal.calibration_file import read_calibration as read_calibration
    from gtcal.calibration_file import write_calibration as write_calibration
    from gtcal.drift import Drift as Drift
    from gtcal.drift import verify_series as verify_series
    from gtcal.errors import GtcalError as GtcalError
    from gtcal.lollypop_recording import LollypopRecording as LollypopRecording
    from gtcal.lollypop_recording import load_lollypop_recording as load_lollypop_recording
    from gtcal.lollypop_recording import write_lollypop_recording as write_lollypop_recording
    from gtcal.observations import synchronise as synchronise
    from gtcal.options import CalibrationOptions as CalibrationOptions
    from gtcal.recording import Recording as Recording
    from gtcal.recording import load_recording as load_recording
    from gtcal.recording import write_recording as write_recording
    from gtcal.solver import calibrate_observations as calibrate_observations
    from gtcal.verification import Verification as Verification
    from gtcal.verification import VerificationOptions as VerificationOptions
    from gtcal.verification_file import read_verification as read_verification
    from gtcal.verification_file import write_verification as write_verification
    from gtcal.verification_workflow import verify as verify
    from gtcal.workflow import calibrate as calibrate
    from gtcal.workflow import detected as detected

_HOMES = {
    "PRESETS": "board",
    "board_from_manifest": "board",
    "calibrate_observations": "solver",
    "Calibration": "calibration",
    "read_calibration": "calibration_file",
    "write_calibration": "calibration_file",
    "GtcalError": "errors",
    "Drift": "drift",
    "verify_series": "drift",
    "LollypopRecording": "lollypop_recording",
    "load_lollypop_recording": "lollypop_recording",
    "write_lollypop_recording": "lollypop_recording",
    "Verification": "verification",
    "VerificationOptions": "verification",
    "read_verification": "verification_file",
    "write_verification": "verification_file",
    "verify": "verification_workflow",
    "synchronise": "observations",
    "CalibrationOptions": "options",
    "Recording": "recording",
    "load_recording": "recording",
    "write_recording": "recording",
    "calibrate": "workflow",
    "detected": "workflow",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    """Public names load their modules when first used: the command line must not wait for GTSAM to print its help."""
    if name not in _HOMES:
        raise AttributeError(f"module 'gtcal' has no attribute {name!r}")
    return getattr(import_module(f"gtcal.{_HOMES[name]}"), name)
