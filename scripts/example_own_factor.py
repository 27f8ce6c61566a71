"""One's own factor in a calibration's graph: a laser has measured how far apart two cameras are.

python scripts/example_own_factor.py
"""

from __future__ import annotations

import gtsam
import numpy as np

import gtcal
from factors.rigid import inverse
from gtcal.estimation.solve_again import camera_key, solve_again
from gtcal.simulation import MocapNoise, SimulationOptions, simulate


def distance_factor(key_a: int, key_b: int, distance_m: float, sigma_m: float) -> gtsam.CustomFactor:
    """|position of a - position of b| - distance_m, of two cameras' camera_T_ref."""

    def residual(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        a, b = values.atPose3(key_a), values.atPose3(key_b)
        between = a.inverse().translation() - b.inverse().translation()
        length = float(np.linalg.norm(between))
        if jacobians is not None:
            direction = between / length  # camera_T_ref * Exp(xi) moves the camera in ref by -(xi_r x p + xi_t)
            for i, (pose, sign) in enumerate(((a, -1.0), (b, 1.0))):
                position = pose.inverse().translation()
                jacobians[i] = sign * np.hstack([np.cross(position, direction), direction])[None]
        return np.array([length - distance_m])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma_m), [key_a, key_b], residual)


def main() -> None:
    noise = MocapNoise(translation_mm=0.5, rotation_deg=0.05)
    simulation = simulate(SimulationOptions(n_frames=30, mocap=noise), seed=0)
    calibration = gtcal.calibrate(simulation.recording)
    pair = ("side_left", "side_right")
    true_m = [inverse(simulation.truth.camera_T_ref[name])[:3, 3] for name in pair]
    measured_m = float(np.linalg.norm(true_m[0] - true_m[1])) + 1e-6  # the laser errs by 1 um

    keys = [camera_key(calibration, name) for name in pair]
    again = solve_again(calibration, [distance_factor(*keys, measured_m, sigma_m=2e-6)])

    for what, found in (("before", calibration), ("with the laser", again)):
        positions_m = [found.cameras[name].camera_T_ref.position_of_a_in_b_m for name in pair]
        error_mm = 1e3 * (np.linalg.norm(positions_m[0] - positions_m[1]) - np.linalg.norm(true_m[0] - true_m[1]))
        print(f"{what}: the cameras' distance is off by {error_mm:+.4f} mm; RMSE {found.rmse_px:.3f} px")


if __name__ == "__main__":
    main()
