"""Is the error that a Lollypop recording shows no larger than the calibration's own covariance lets expect?

An error of the extrinsic is the same for all sightings, so it is looked for as one: the small motion of the camera that
explains the errors best. Its distance from zero is measured in the sum of two covariances: what the calibration claims,
and what the recording itself leaves open, which accounts for the mocap's noise and its correlation in time.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.results.calibration import Calibration
from gtcal.uncertainty.projected import camera_covariance, pixel_jacobians
from gtcal.verification.blocks import fit_covariance
from gtcal.verification.verification import ExpectedError, Sightings

UNLIKELY = 0.01
"""An error as large as this by chance in one camera in a hundred is larger than expected."""

_HUBER = 1.5
_STEPS = 4
_FEWEST_DEGREES = 8.0


def expected_error(name: str, seen: Sightings, calibration: Calibration) -> ExpectedError | None:
    """None for a calibration without a covariance, or too few sightings to tell."""
    joint = calibration.covariance
    if joint is None or len(seen) == 0:
        return None
    in_ref_m = _in_ref(seen)
    _, valid, J = pixel_jacobians(seen.camera, seen.camera_T_ref, in_ref_m)
    claimed = camera_covariance(joint, name)
    J_claimed, J, errors_px = J[valid][:, :, : len(claimed)], J[valid][:, :, :6], seen.errors_px[valid]
    weights = np.ones(len(errors_px))
    scale = 1.0 / np.sqrt((J**2).sum(axis=(0, 1)))  # so that the ridge is small beside every direction
    J_scaled, ridge = J * scale, 1e-9 * np.eye(6)
    xi = np.zeros(6)
    for _ in range(_STEPS):
        information = np.einsum("s,sik,sil->skl", weights, J_scaled, J_scaled)
        right = np.einsum("s,sik,si->k", weights, J_scaled, errors_px)
        xi = np.linalg.solve(information.sum(axis=0) + ridge, right)
        rest_px = errors_px - J_scaled @ xi
        lengths = np.linalg.norm(rest_px, axis=1)
        weights = np.minimum(1.0, _HUBER * np.median(lengths) / np.maximum(lengths, 1e-12))
    scores = np.einsum("s,sik,si->sk", weights, J_scaled, rest_px)
    information = np.einsum("s,sik,sil->skl", weights, J_scaled, J_scaled)
    measured = fit_covariance(scores, information, ridge, seen.frame_index[valid])
    if measured is None or measured.degrees_of_freedom < _FEWEST_DEGREES:
        return None
    both = measured.covariance + claimed[:6, :6] / np.outer(scale, scale)
    units = 1.0 / np.sqrt(np.diag(both))
    distance2 = float((units * xi) @ np.linalg.solve(both * np.outer(units, units), units * xi))
    p_value = _p_value(distance2, measured.degrees_of_freedom)
    return ExpectedError(
        predicted_px=_rms_px(J_claimed, claimed),
        observed_px=_rms_px(J_scaled, np.outer(xi, xi)),
        observed_sigma_px=_rms_px(J_scaled, measured.covariance),
        normalised=float(np.sqrt(distance2 / 6.0)),
        p_value=p_value,
        agrees=p_value >= UNLIKELY,
    )


def _in_ref(seen: Sightings) -> FloatArray:
    ref_T_camera = inverse(seen.camera_T_ref)
    return seen.mocap_centre_in_camera_m @ ref_T_camera[:3, :3].T + ref_T_camera[:3, 3]


def _p_value(distance2: float, degrees_of_freedom: float) -> float:
    """Of Hotelling's test that there is no such error."""
    n, k = max(degrees_of_freedom, 6.0 + 1e-6), 6.0
    return float(special.fdtrc(k, n - k + 1.0, distance2 * (n - k + 1.0) / (n * k)))


def _rms_px(J: FloatArray, covariance: FloatArray) -> float:
    """Root mean square length in px of what has this covariance (K, K), over the sightings (S, 2, K)."""
    return float(np.sqrt(np.einsum("sik,kl,sil->s", J, covariance, J).mean()))
