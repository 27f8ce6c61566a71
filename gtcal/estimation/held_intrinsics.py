"""What intrinsics that are held fixed add to the covariance: they are not known exactly (a consider covariance: Schmidt
1966, Tapley, Schutz and Born 2004, section 6).

To first order the other unknowns follow the held ones by S = -H_xx^-1 H_xtheta, so that their errors add S Q S^T to the
covariance, Q that of the intrinsics as they are stated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtcal.camera import FloatArray
from gtcal.estimation.adjustment import Adjusted
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.frame_statistics import eliminate_noise, frames_of, in_parts
from gtcal.estimation.lens_sigmas import lens_sigmas
from gtcal.estimation.linear import scaled_inverse
from gtcal.estimation.mocap_noise import MocapNoiseModel, lower_factors
from gtcal.estimation.options import CalibrationOptions
from gtcal.recordings.capture import RefMotion
from gtcal.results.covariance import JointCovariance


def with_held_intrinsics(
    covariance: JointCovariance,
    adjusted: Adjusted,
    options: CalibrationOptions,
    motion: RefMotion,
    noise: MocapNoiseModel | None,
) -> JointCovariance:
    """The covariance of X and every Y_c at ``adjusted``, with the share of the intrinsics that were held at the stated
    values. noise: that the estimate models; None where it takes the mocap as exact.

    Raises numpy.linalg.LinAlgError where the data leave a direction open."""
    S = _follow(adjusted, options, motion, noise)
    stated = [lens_sigmas(views.camera, options) for views in adjusted.screened.views.values()]
    variances = np.concatenate(stated) ** 2
    return replace(covariance, matrix=covariance.matrix + S * variances @ S.T)


def _follow(
    adjusted: Adjusted, options: CalibrationOptions, motion: RefMotion, noise: MocapNoiseModel | None
) -> FloatArray:
    """(P, K) by how much X and every Y_c move where the intrinsics of all cameras move by a unit."""
    views, estimate = adjusted.screened.views, adjusted.estimate
    n = 6 + 6 * len(views)
    total = np.zeros((0, 0))
    for part in in_parts(
        views, estimate, frames_of(views), sigma_px=adjusted.sigma_px, free_theta=True, robust=options.robust
    ):
        if not total.size:
            total = np.zeros(part.exact.shape[1:])
        if noise is None:
            total += np.triu(part.exact.sum(axis=0))
            continue
        L = lower_factors(noise.covariance(motion, part.stamps_ns))
        eliminate_noise(part.moments, L, noise.correlations(part.stamps_ns), total)
    H = np.triu(total) + np.triu(total, 1).T
    known = prior_information(views, estimate, options)[:-1, :-1]
    return -scaled_inverse(H[:n, :n] + known) @ H[:n, n:-1]
