"""The cameras of a calibration as a rig."""

from __future__ import annotations

from gtcal.camera_files.rig import Rig, RigCamera
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration

# By capture: the frame's name for other tools, and what it is.
_REFS = {
    Capture.FIXED_CAMERAS: ("mocap_world", "the mocap world"),
    Capture.TRACKED_PLATFORM: ("platform", "the tracked platform's body, as the mocap defines it"),
    Capture.STANDING_BOARD: ("platform", "the tracked platform's body, as the mocap defines it"),
}


def calibration_rig(calibration: Calibration) -> Rig:
    """The cameras of a calibration, in ref."""
    cameras = [RigCamera(c.camera_with_sigmas, c.camera_T_ref.a_T_b) for c in calibration.cameras.values()]
    return Rig(
        tuple(cameras),
        *_REFS[calibration.capture],
        body_T_board=calibration.body_T_board.a_T_b,
        other_boards={board.name: board.body_T_board.a_T_b for board in calibration.other_boards},
    )
