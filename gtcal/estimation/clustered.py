"""The frame-clustered covariance of stage 3: a sandwich, H^-1 (sum g g^T + P) H^-1, over frames rather than corners,
P the information of priors.

What moves all the corners of a frame together (the mocap's noise, above all) makes their residuals alike. The gradients
g of whole frames scatter by it as they do, and no model of it is needed. Where noise is correlated in time, frames that
share it make one cluster. Few clusters fit their own estimate too well; the correction is CR2 of Bell and McCaffrey
(2002), g -> (I - H_g H^-1)^-1/2 g, or for many clusters the factor G / (G - 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from gtcal.camera import FloatArray
from gtcal.estimation.adjustment import Adjusted
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.frame_statistics import FrameMoments, frame_moments, frames_of, in_parts
from gtcal.estimation.linear import scaled_inverse, scaled_root
from gtcal.estimation.mocap_noise import MocapNoiseModel, lower_factors
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray
from gtcal.results.covariance import CLUSTERED, JointCovariance

MOST_CORRECTED = 300
"""Clusters up to which each is corrected by its own leverage; beyond, that no longer matters."""

_CORRELATION_TIMES = 3.0
_LARGEST_LEVERAGE = 0.99


def clustered(
    adjusted: Adjusted, options: CalibrationOptions, correlation_s: float, *, sizes: dict[str, int]
) -> dict[str, JointCovariance]:
    """The covariance of stage 3's estimate, by its kind; none where the clusters are fewer than the unknowns need.

    sizes: by camera, the number of its intrinsics that were solved for."""
    views, estimate = adjusted.screened.views, adjusted.estimate
    frames = frames_of(views)
    information = prior_information(views, estimate, options)
    parts = in_parts(
        views,
        estimate,
        frames,
        sigma_px=adjusted.sigma_px,
        free_theta=options.refine_intrinsics,
        robust=options.robust,
    )
    if clusters(stamps_of(views), correlation_s)[-1] < len(information):
        return {}
    matrix = clustered_covariance(parts, information, correlation_s)
    return {CLUSTERED: JointCovariance(CLUSTERED, sizes, matrix)}


def by_noise_model(
    adjusted: Adjusted, options: CalibrationOptions, noise: MocapNoiseModel, motion: RefMotion, *, sizes: dict[str, int]
) -> JointCovariance:
    """The covariance of stage 3's estimate where the frames are too few to show by themselves how they scatter: they
    scatter as the mocap's noise, estimated from the same frames, says."""
    views, estimate = adjusted.screened.views, adjusted.estimate
    moments = frame_moments(
        views, estimate, sigma_px=adjusted.sigma_px, free_theta=options.refine_intrinsics, robust=options.robust
    )
    information = prior_information(views, estimate, options)[:-1, :-1]
    H = moments.exact[:, :-1, :-1].sum(axis=0) + information
    inverse = scaled_inverse(H)
    L = lower_factors(noise.covariance(motion, moments.stamps_ns))
    by_frame = np.swapaxes(L, 1, 2) @ moments.moments[:, :6, 6:-1]  # gradient of a unit of each frame's noise
    scatter = H + _correlated_scatter(by_frame, noise.correlations(moments.stamps_ns))
    matrix = noise.small_sample_factor * inverse @ scatter @ inverse
    return JointCovariance(CLUSTERED, sizes, 0.5 * (matrix + matrix.T))


def _correlated_scatter(by_frame: FloatArray, rho: FloatArray) -> FloatArray:
    """(P, P) of sum_f by_frame_f^T z_f, from (n, 6, P), for z of unit covariance, correlated by rho (n,) from each
    frame to the next."""
    total = np.einsum("nia,nib->ab", by_frame, by_frame)
    carried = np.zeros_like(by_frame[0])
    for f in range(1, len(by_frame)):
        carried = rho[f - 1] * (carried + by_frame[f - 1])
        both = carried.T @ by_frame[f]
        total += both + both.T
    return np.asarray(total)


def stamps_of(views: Mapping[str, Views]) -> IntArray:
    """(n,) of the frames that any camera saw, increasing."""
    return np.unique(np.concatenate([of_camera.stamps_ns for of_camera in views.values()]))


def clusters(stamps_ns: IntArray, correlation_s: float) -> IntArray:
    """(n,) the cluster of each frame: spans of three correlation times, or single frames where those are shorter."""
    if correlation_s <= 0.0:
        return np.arange(len(stamps_ns))
    span = np.floor(1e-9 * (stamps_ns - stamps_ns[0]) / (_CORRELATION_TIMES * correlation_s))
    return np.unique(span, return_inverse=True)[1]


def clustered_covariance(parts: Iterable[FrameMoments], information: FloatArray, correlation_s: float) -> FloatArray:
    """(P, P) covariance of stage 3's estimate, from the moments of all frames there, in parts one after the other.
    information: (P + 1, P + 1) of the priors.

    Raises numpy.linalg.LinAlgError where the frames leave a direction open."""
    sums = [_of_clusters(part, correlation_s) for part in parts]
    H = np.sum([part[:, :-1, :-1].sum(axis=0) for part in sums], axis=0) + information[:-1, :-1]
    gradients = np.concatenate([part[:, :-1, -1] for part in sums])
    root = scaled_root(H)
    gradients = gradients @ root.T
    if len(gradients) <= MOST_CORRECTED:
        leverage = np.concatenate([part[:, :-1, :-1] for part in sums])
        gradients = _corrected(root @ leverage @ root.T, gradients)
    else:
        gradients *= np.sqrt(len(gradients) / (len(gradients) - 1))
    half = gradients @ root
    by_priors = root.T @ root @ information[:-1, :-1] @ root.T @ root
    return half.T @ half + by_priors


def _of_clusters(frames: FrameMoments, correlation_s: float) -> FloatArray:
    """(G, P + 1, P + 1) sums."""
    of_frame = clusters(frames.stamps_ns, correlation_s)
    sums = np.zeros((int(of_frame[-1]) + 1, *frames.exact.shape[1:]))
    np.add.at(sums, of_frame, frames.exact)
    return sums


def _corrected(leverage: FloatArray, gradients: FloatArray) -> FloatArray:
    """(I - leverage)^-1/2 gradient of each cluster: (G, P, P) and (G, P)."""
    values, vectors = np.linalg.eigh(leverage)
    amplified = 1.0 / np.sqrt(1.0 - np.clip(values, 0.0, _LARGEST_LEVERAGE))
    in_axes = amplified * np.einsum("gpk,gp->gk", vectors, gradients)
    return np.einsum("gpk,gk->gp", vectors, in_axes)
