"""gtcal: where each camera sits relative to the mocap system, how sure that is, and whether it still holds.

import gtcal
recording = gtcal.load_recording("my_recording")
calibration = gtcal.calibrate(recording)
gtcal.write_calibration("calibration.json", calibration)
verification = gtcal.verify(gtcal.load_lollypop_recording("my_lollypop"), calibration)

Recordings      load_recording, Recording, write_recording, detected, some_of, board_from_manifest, PRESETS
Calibrate       calibrate, CalibrationOptions, calibrate_jointly, EarlierCalibration, Growth; step by step: synchronise,
                calibrate_observations; on poses alone: calibrate_poses, PoseLevel
Result          Calibration, read_calibration, write_calibration
Verify          load_lollypop_recording, LollypopRecording, write_lollypop_recording, verify, VerificationOptions,
                Verification, read_verification, write_verification; over time: verify_series, Drift
Compare, check  difference, Difference, DifferenceOptions, selfcheck, SelfCheck, write_selfcheck; with other methods:
                compare, Comparison, write_comparison
What is wrong   diagnose, Diagnosis, Finding, write_diagnosis, GtcalError (all that gtcal raises of what it is given)

Results print as the command line's tables and show in a notebook as the report; to_dict(), to_pandas() and plot_...()
hand on their numbers and figures. Poses are named a_T_b, coordinates in b to coordinates in a, in m.
Worked examples: scripts/example_*.py.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gtcal.baselines.compare import Comparison as Comparison
    from gtcal.baselines.compare import compare as compare
    from gtcal.baselines.compare_file import write_comparison as write_comparison
    from gtcal.board import PRESETS as PRESETS
    from gtcal.board import board_from_manifest as board_from_manifest
    from gtcal.differences.carried_over import EarlierCalibration as EarlierCalibration
    from gtcal.differences.difference import Difference as Difference
    from gtcal.differences.difference import DifferenceOptions as DifferenceOptions
    from gtcal.differences.difference import difference as difference
    from gtcal.doctor.diagnose import diagnose as diagnose
    from gtcal.doctor.diagnosis_file import write_diagnosis as write_diagnosis
    from gtcal.doctor.findings import Diagnosis as Diagnosis
    from gtcal.doctor.findings import Finding as Finding
    from gtcal.errors import GtcalError as GtcalError
    from gtcal.estimation.earlier import Growth as Growth
    from gtcal.estimation.observations import synchronise as synchronise
    from gtcal.estimation.options import CalibrationOptions as CalibrationOptions
    from gtcal.estimation.pose_level import PoseLevel as PoseLevel
    from gtcal.estimation.pose_level import calibrate_poses as calibrate_poses
    from gtcal.estimation.solver import calibrate_observations as calibrate_observations
    from gtcal.recordings.recording import Recording as Recording
    from gtcal.recordings.recording import load_recording as load_recording
    from gtcal.recordings.recording import write_recording as write_recording
    from gtcal.recordings.some_images import some_of as some_of
    from gtcal.results.calibration import Calibration as Calibration
    from gtcal.results.calibration_file import read_calibration as read_calibration
    from gtcal.results.calibration_file import write_calibration as write_calibration
    from gtcal.selfchecks.selfcheck import SelfCheck as SelfCheck
    from gtcal.selfchecks.selfcheck import selfcheck as selfcheck
    from gtcal.selfchecks.selfcheck_file import write_selfcheck as write_selfcheck
    from gtcal.verification.drift import Drift as Drift
    from gtcal.verification.drift import verify_series as verify_series
    from gtcal.verification.lollypop_recording import LollypopRecording as LollypopRecording
    from gtcal.verification.lollypop_recording import load_lollypop_recording as load_lollypop_recording
    from gtcal.verification.lollypop_recording import write_lollypop_recording as write_lollypop_recording
    from gtcal.verification.verification import Verification as Verification
    from gtcal.verification.verification import VerificationOptions as VerificationOptions
    from gtcal.verification.verification_file import read_verification as read_verification
    from gtcal.verification.verification_file import write_verification as write_verification
    from gtcal.verification.workflow import verify as verify
    from gtcal.workflow import calibrate as calibrate
    from gtcal.workflow import calibrate_jointly as calibrate_jointly
    from gtcal.workflow import detected as detected

_HOMES = {
    "Comparison": "baselines.compare",
    "compare": "baselines.compare",
    "write_comparison": "baselines.compare_file",
    "PRESETS": "board",
    "board_from_manifest": "board",
    "calibrate_observations": "estimation.solver",
    "Calibration": "results.calibration",
    "read_calibration": "results.calibration_file",
    "write_calibration": "results.calibration_file",
    "Diagnosis": "doctor.findings",
    "Finding": "doctor.findings",
    "diagnose": "doctor.diagnose",
    "write_diagnosis": "doctor.diagnosis_file",
    "GtcalError": "errors",
    "Drift": "verification.drift",
    "verify_series": "verification.drift",
    "LollypopRecording": "verification.lollypop_recording",
    "load_lollypop_recording": "verification.lollypop_recording",
    "write_lollypop_recording": "verification.lollypop_recording",
    "Verification": "verification.verification",
    "VerificationOptions": "verification.verification",
    "read_verification": "verification.verification_file",
    "write_verification": "verification.verification_file",
    "verify": "verification.workflow",
    "synchronise": "estimation.observations",
    "CalibrationOptions": "estimation.options",
    "Recording": "recordings.recording",
    "load_recording": "recordings.recording",
    "some_of": "recordings.some_images",
    "write_recording": "recordings.recording",
    "SelfCheck": "selfchecks.selfcheck",
    "selfcheck": "selfchecks.selfcheck",
    "write_selfcheck": "selfchecks.selfcheck_file",
    "EarlierCalibration": "differences.carried_over",
    "Difference": "differences.difference",
    "DifferenceOptions": "differences.difference",
    "difference": "differences.difference",
    "Growth": "estimation.earlier",
    "PoseLevel": "estimation.pose_level",
    "calibrate_poses": "estimation.pose_level",
    "calibrate": "workflow",
    "calibrate_jointly": "workflow",
    "detected": "workflow",
}

__all__ = list(_HOMES)


def __dir__() -> list[str]:
    """What a tab key finds."""
    return sorted({*globals(), *_HOMES})


def __getattr__(name: str) -> Any:
    """Public names load their modules when first used: the command line must not wait for GTSAM to print its help."""
    if name not in _HOMES:
        raise AttributeError(f"module 'gtcal' has no attribute {name!r}")
    return getattr(import_module(f"gtcal.{_HOMES[name]}"), name)
