"""The frame-clustered covariance of stage 3: a sandwich, H^-1 (sum g g^T + P) H^-1, over frames rather than corners,
P the information of priors.

What moves all the corners of a frame together (the mocap's noise, above all) makes their residuals alike. The gradients
g of whole frames scatter by it as they do, and no model of it is needed. Where noise is correlated in time, frames that
share it make one cluster. Few clusters fit their own estimate too well; the correction is CR2 of Bell and McCaffrey
(2002), g -> (I - H_g H^-1)^-1/2 g, or for many clusters the factor G / (G - 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gtcal.camera import FloatArray
from gtcal.estimation.adjustment import Adjusted
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.frame_statistics import FrameMoments, evenly, frame_moments, frames_of, in_parts
from gtcal.estimation.linear import scaled_inverse, scaled_root, summed_by_run
from gtcal.estimation.mocap_noise import MocapNoiseModel, lower_factors
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray
from gtcal.results.covariance import CLUSTERED, JointCovariance

MOST_CORRECTED = 300
"""Clusters up to which each is corrected by its own leverage; beyond, that no longer matters."""

MOST_WEIGHED = 2_000
"""Frames from which the weight of the lenses is found."""

_CORRELATION_TIMES = 3.0
_WEIGHT_ROUNDS, _SAME_WEIGHT = 4, 0.1
_LARGEST_LEVERAGE = 0.99


def clustered(
    adjusted: Adjusted, options: CalibrationOptions, correlation_s: float, *, sizes: dict[str, int]
) -> dict[str, JointCovariance]:
    """The covariance of stage 3's estimate, by its kind; none where the clusters are fewer than the unknowns need.

    sizes: by camera, the number of its intrinsics that were solved for."""
    priors = Priors.of(adjusted, options)
    if clusters(stamps_of(adjusted.screened.views), correlation_s)[-1] <= len(priors.information):
        return {}
    matrix = clustered_covariance(_parts(adjusted, options), priors, correlation_s)
    return {CLUSTERED: JointCovariance.of(CLUSTERED, sizes, matrix)}


def by_one_factor(
    adjusted: Adjusted, options: CalibrationOptions, correlation_s: float, *, sizes: dict[str, int]
) -> JointCovariance:
    """The covariance of stage 3's estimate where the clusters are too few to show how each unknown scatters: all of the
    corners' information is too large by one factor, that of all unknowns together (the magnitude adjustment of
    ``lens_weight``)."""
    sums = ClusterSums.of(_parts(adjusted, options), correlation_s)
    root, gradients = sums.white_gradients(Priors.of(adjusted, options))
    factor = max(1.0, float(np.sum(gradients**2) / np.trace(root @ sums.information @ root.T)))
    known = Priors.of(adjusted, options, 1.0).information
    return JointCovariance.of(CLUSTERED, sizes, scaled_inverse(sums.information / factor + known))


@dataclass(frozen=True)
class Priors:
    """What is known beforehand. information: (P, P) as the estimate weighs it; scatter: (P, P) of its gradients, by
    what is truly known: of the weight w that ``weight_of_lenses`` gives the stated intrinsics, w and w^2 times
    theirs."""

    information: FloatArray
    scatter: FloatArray

    @staticmethod
    def of(adjusted: Adjusted, options: CalibrationOptions, lens_weight: float | None = None) -> Priors:
        """Weighed as ``adjusted`` does, or by another weight."""
        weight = adjusted.lens_weight if lens_weight is None else lens_weight
        found = (
            prior_information(adjusted.screened.views, adjusted.estimate, options, w)[:-1, :-1]
            for w in (weight, weight**2)
        )
        return Priors(*found)


def _parts(adjusted: Adjusted, options: CalibrationOptions, frames: IntArray | None = None) -> Iterator[FrameMoments]:
    """Of all frames, or of these."""
    views = adjusted.screened.views
    return in_parts(
        views,
        adjusted.estimate,
        frames_of(views) if frames is None else frames,
        sigma_px=adjusted.sigma_px,
        free_theta=options.refine_intrinsics,
        free_shape=options.solves_board_shape,
        robust=options.robust,
    )


def weight_of_lenses(adjusted: Adjusted, options: CalibrationOptions, n_frames: int) -> float:
    """By how much the priors of stated intrinsics must count more in stage 3 than alone, at least 1.

    Stage 3 takes all corners for independent; those of a frame are not, so that it believes too much in what they say
    of a lens, and too little in what is stated. The corners' information is too large by the factor by which the
    variance that frames show of the intrinsics exceeds what the corners claim: the magnitude adjustment of a composite
    likelihood (Pauli, Racugno and Ventura 2011; Ribatet, Cooley and Davison 2012). Variances are summed in units of the
    priors', so that what the data determine better than they need not be told counts little. As the weight sets what
    the data have to determine, it is found in turns.

    n_frames: of the recording, of which ``adjusted`` may know a part. Of many frames some speak for all."""
    frames = evenly(frames_of(adjusted.screened.views), MOST_WEIGHED)
    sums = ClusterSums.of(_parts(adjusted, options, frames), 0.0).times(n_frames / len(frames))
    first = 6 + 6 * len(adjusted.screened.views)
    lens_information = Priors.of(adjusted, options, 2.0).information - Priors.of(adjusted, options, 1.0).information
    weight = adjusted.lens_weight
    for _ in range(_WEIGHT_ROUNDS):
        before, priors = weight, Priors.of(adjusted, options, weight)
        root, gradients = sums.white_gradients(priors)
        to_lens = root[:, first:]
        shown = gradients @ to_lens
        claimed = to_lens.T @ (root @ sums.information @ root.T) @ to_lens
        unit = lens_information[first:, first:]
        weight = max(1.0, float(np.sum(unit * (shown.T @ shown)) / np.sum(unit * claimed)))
        if abs(np.log(weight / before)) < _SAME_WEIGHT:
            break
    return weight


def by_noise_model(
    adjusted: Adjusted, options: CalibrationOptions, noise: MocapNoiseModel, motion: RefMotion, *, sizes: dict[str, int]
) -> JointCovariance:
    """The covariance of stage 3's estimate where the frames are too few to show by themselves how they scatter: they
    scatter as the mocap's noise, estimated from the same frames, says."""
    views, estimate = adjusted.screened.views, adjusted.estimate
    moments = frame_moments(
        views,
        estimate,
        sigma_px=adjusted.sigma_px,
        free_theta=options.refine_intrinsics,
        free_shape=options.solves_board_shape,
        robust=options.robust,
    )
    priors = Priors.of(adjusted, options)
    of_data = moments.exact[:, :-1, :-1].sum(axis=0)
    inverse = scaled_inverse(of_data + priors.information)
    L = lower_factors(noise.covariance(motion, moments.stamps_ns))
    by_frame = np.swapaxes(L, 1, 2) @ moments.moments[:, :6, 6:-1]  # gradient of a unit of each frame's noise
    scatter = of_data + priors.scatter + _correlated_scatter(by_frame, noise.correlations(moments.stamps_ns))
    matrix = noise.small_sample_factor * inverse @ scatter @ inverse
    return JointCovariance.of(CLUSTERED, sizes, 0.5 * (matrix + matrix.T))


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


def clustered_covariance(parts: Iterable[FrameMoments], priors: Priors, correlation_s: float) -> FloatArray:
    """(P, P) covariance of stage 3's unknowns, from the moments of all frames there, in parts one after the other.

    Raises numpy.linalg.LinAlgError where the frames leave a direction open."""
    return ClusterSums.of(parts, correlation_s).covariance(priors)


@dataclass(frozen=True)
class ClusterSums:
    """What the clusters say: information (P, P) of all, gradients (G, P) of each; and the information of each,
    (G, P, P), where they are few."""

    information: FloatArray
    gradients: FloatArray
    of_each: FloatArray | None

    def times(self, n: float) -> ClusterSums:
        """Of n times as many clusters, of which these tell as much of all as they would."""
        return replace(self, information=n * self.information, gradients=np.sqrt(n) * self.gradients)

    def covariance(self, priors: Priors) -> FloatArray:
        """(P, P) of the estimate. Raises numpy.linalg.LinAlgError where the frames leave a direction open."""
        root, gradients = self.white_gradients(priors)
        half = gradients @ root
        return np.asarray(half.T @ half + root.T @ root @ priors.scatter @ root.T @ root)

    @staticmethod
    def of(parts: Iterable[FrameMoments], correlation_s: float) -> ClusterSums:
        information: list[FloatArray] = []
        gradients: list[FloatArray] = []
        of_each: list[FloatArray] = []
        n_clusters = 0
        for part in parts:
            sums = _of_clusters(part, correlation_s)
            n_clusters += len(sums)
            information.append(sums[:, :-1, :-1].sum(axis=0))
            gradients.append(sums[:, :-1, -1].copy())
            of_each = [*of_each, sums[:, :-1, :-1]] if n_clusters <= MOST_CORRECTED else []
        each = np.concatenate(of_each) if n_clusters <= MOST_CORRECTED else None
        return ClusterSums(np.sum(information, axis=0), np.concatenate(gradients), each)

    def white_gradients(self, priors: Priors) -> tuple[FloatArray, FloatArray]:
        """R with R H R^T = I, H with the priors, and R g (G, P) of each cluster, corrected for how well it fits
        itself.

        Raises numpy.linalg.LinAlgError where the frames leave a direction open."""
        root = scaled_root(self.information + priors.information)
        gradients = self.gradients @ root.T
        if self.of_each is not None:
            return root, _corrected(root @ self.of_each @ root.T, gradients)
        return root, gradients * np.sqrt(len(gradients) / (len(gradients) - 1))


def _of_clusters(frames: FrameMoments, correlation_s: float) -> FloatArray:
    """(G, P + 1, P + 1) sums."""
    return summed_by_run(frames.exact, clusters(frames.stamps_ns, correlation_s))


def _corrected(leverage: FloatArray, gradients: FloatArray) -> FloatArray:
    """(I - leverage)^-1/2 gradient of each cluster: (G, P, P) and (G, P)."""
    values, vectors = np.linalg.eigh(leverage)
    amplified = 1.0 / np.sqrt(1.0 - np.clip(values, 0.0, _LARGEST_LEVERAGE))
    in_axes = amplified * np.einsum("gpk,gp->gk", vectors, gradients)
    return np.einsum("gpk,gk->gp", vectors, in_axes)
