"""A camera model of one's own, from its formula to a calibration: the field-of-view model.

Devernay and Faugeras, Straight lines have to be straight, 2001: a point at the angle a off the axis is
m = atan(2 tan a tan(w / 2)) / w from the centre, in focal lengths. That and its derivatives is all that is written
here; projection with Jacobians, the way back, factors, the search for intrinsics and the simulation follow from it.

    python scripts/example_own_camera_model.py
"""

from __future__ import annotations

import math

import gtcal
from factors import CameraModel, register_camera_model
from factors.camera_models.parts import Spread
from factors.kernel import inlined
from gtcal.recordings.capture import Capture
from gtcal.simulation import SimulationOptions, fixed_cameras_rig, simulate

W = 4  # the column of w in theta: fx fy cx cy w


@inlined
def spread(theta, angle):
    """m, and its slope by the angle."""
    w, s, c = theta[W], math.sin(angle), math.cos(angle)
    stretch = 2.0 * math.tan(0.5 * w)
    return math.atan2(stretch * s, c) / w, stretch / (w * (c * c + stretch * stretch * s * s))


@inlined
def spread_by_theta(theta, angle, J_theta, along_u, along_v):
    """dm/dw, times along_u and along_v."""
    w, s, c = theta[W], math.sin(angle), math.cos(angle)
    stretch, half = 2.0 * math.tan(0.5 * w), math.cos(0.5 * w)
    by_w = (s * c / (half * half * (c * c + stretch * stretch * s * s)) - math.atan2(stretch * s, c) / w) / w
    J_theta[0, W], J_theta[1, W] = along_u * by_w, along_v * by_w


FIELD_OF_VIEW = CameraModel(
    "field_of_view",
    ("fx", "fy", "cx", "cy", "w"),
    spread=Spread(spread, spread_by_theta),
    usual=(560.0, 0.95),
    start=(0.7,),
)


def main() -> gtcal.Calibration:
    register_camera_model(FIELD_OF_VIEW)  # from here on a manifest may say "model: field_of_view"
    rig = fixed_cameras_rig(2, models=(FIELD_OF_VIEW.name,))
    options = SimulationOptions(rig=rig, capture=Capture.FIXED_CAMERAS, n_frames=60, intrinsics="none")
    simulation = simulate(options, seed=0)
    calibration = gtcal.calibrate(simulation.recording, gtcal.CalibrationOptions(intrinsics="calibrate+refine"))
    for name, camera in calibration.cameras.items():
        truth = simulation.truth.cameras[name].camera
        fit_px = camera.residuals.rmse_px
        print(f"{name}: w = {camera.camera.theta[W]:.4f}, true {truth.theta[W]:.4f}; fits to {fit_px:.3f} px")
    return calibration


if __name__ == "__main__":
    main()
