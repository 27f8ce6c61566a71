"""Stage 4: the same pixels with the mocap's noise modelled, each frame's ref_T_body a variable under its prior.

Stage 3 takes the mocap as exact, as the paper does. But its noise moves all corners of a frame together, in all
cameras; freeing every A_t under a prior of the mocap's own noise (errors in variables) makes the estimate more accurate
and its covariance true. The noise is given, or estimated from the recording (``gtcal.estimation.mocap_noise``).

Systematic error is no noise: a variance estimated from it runs away. So the two estimates are compared by their
hold-out error, and the noise model by the whiteness of what it leaves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors import AnyKernel
from factors.board_shape import N_SHAPE
from factors.frames import CameraFrames, FramesReprojection
from factors.marginal_frames import MarginalFramesFactor
from factors.mocap_noise import CorrelatedNoiseFactor
from gtcal.camera import BoolArray, FloatArray
from gtcal.estimation.adjustment import Adjusted, add_user_priors, intrinsics_priors, shape_sigmas
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.frame_statistics import FrameMoments, frame_moments, frames_of, in_parts
from gtcal.estimation.graph import (
    BOARD_SHAPE,
    BODY_T_BOARD,
    camera_T_ref_key,
    minimise,
    shape_prior,
    theta_key,
    to_values,
    updated,
)
from gtcal.estimation.hold_out import HoldOut, hold_out
from gtcal.estimation.mocap_noise import (
    MocapNoiseModel,
    SharedStep,
    Whiteness,
    estimate_noise,
    gross_frames,
    innovations,
    lower_factors,
    shared_step,
    spread_blocks,
)
from gtcal.estimation.observations import Dropped, Views
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.estimation.residuals import corner_views, select_views
from gtcal.estimation.screening import screen
from gtcal.estimation.thinning import is_long, thinned
from gtcal.progress import Progress, silent
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray


def ref_T_body_key(frame_index: int) -> int:
    """Key of A_t, frames counted as in ``Views.frame_index``."""
    key: int = gtsam.symbol("a", frame_index)
    return key


@dataclass(frozen=True)
class MocapNoiseFit:
    """What stage 4 takes for the noise.

    hold_out: sums for the hold-out errors of stages 3 and 4. dropped: views of frames that noise does not explain.
    gross_share: how many these are, as a share of all views."""

    noise: MocapNoiseModel
    sigma_px: float
    hold_out: HoldOut
    dropped: tuple[Dropped, ...]
    gross_share: float = 0.0


def model_mocap_noise(
    adjusted: Adjusted, motion: RefMotion, options: CalibrationOptions, progress: Progress = silent
) -> tuple[Adjusted, MocapNoiseFit] | None:
    """Stage 4 from stage 3's solution, and the noise that it models; None as of ``fit_mocap_noise``.

    Free intrinsics are bent by stage 3 to fit the mocap's noise, which hides some of it: they are solved for twice, the
    second time with the noise that the first solution shows."""
    found: tuple[Adjusted, MocapNoiseFit] | None = None
    passes = 2 if options.refine_intrinsics else 1
    for done in range(passes):
        fitted = fit_mocap_noise(found[0] if found else adjusted, motion, options, of_stage_3=adjusted)
        if fitted is None:
            break
        progress("stage 4: mocap noise", done, passes)
        screened, fit = fitted
        first_of_long = done + 1 < passes and is_long(screened.screened.views)
        solve = _from_some_frames if first_of_long else adjust_with_mocap_noise
        freed = solve(screened, fit, motion, options)
        before = found[1].dropped if found else ()
        found = freed, replace(fit, dropped=before + fit.dropped)
    if found:
        progress("stage 4: mocap noise", passes, passes)
    return found


def fit_mocap_noise(
    adjusted: Adjusted, motion: RefMotion, options: CalibrationOptions, *, of_stage_3: Adjusted | None = None
) -> tuple[Adjusted, MocapNoiseFit] | None:
    """The noise of mocap and pixels at an estimate, and the views and corners less those of gross frames; the hold-out
    error is that of an estimate as stage 3 (this one, unless it is given) weighs what it knows.

    None where the frames are too few to estimate it from, or where gross views, corners or frames are to stay: noise
    does not explain them."""
    views, of_stage_3 = adjusted.screened.views, of_stage_3 or adjusted
    if not options.screen and screen(views, adjusted.estimate).dropped(views):
        return None
    information = prior_information(views, adjusted.estimate, options)
    chosen = spread_blocks(frames_of(views))
    sample = moments_of(views, adjusted.estimate, options, options.sigma_px or 1.0, chosen)
    sample = sample.whitened_by(options.sigma_px or max(sample.pixel_sigma_px, 1e-6))
    if isinstance(options.mocap, MocapSigmas):
        noise = MocapNoiseModel(dict.fromkeys(motion.trajectories, options.mocap))
    else:
        found = estimate_noise(sample, motion, information)
        if found is None:
            return None
        noise = found
    gross = _gross_views(adjusted, noise, motion, options, sample, information)
    if gross and not options.screen:
        return None
    gross_share = float(np.mean(np.concatenate(list(gross.values())))) if gross else 0.0
    adjusted, dropped = _without(adjusted, gross)
    held_out = hold_out(
        adjusted.screened.views,
        adjusted.estimate,
        noise,
        motion,
        sigma_px=sample.sigma_px,
        free_theta=options.refine_intrinsics,
        free_shape=options.solves_board_shape,
        information=information,
        exact_information=prior_information(
            views, adjusted.estimate, options, of_stage_3.lens_weight * (of_stage_3.sigma_px / sample.sigma_px) ** 2
        ),
    )
    return adjusted, MocapNoiseFit(noise, sample.sigma_px, held_out, dropped, gross_share)


def moments_of(
    views: Mapping[str, Views], estimate: Estimate, options: CalibrationOptions, sigma_px: float, frames: IntArray
) -> FrameMoments:
    """Of these frames, with what the options solve for."""
    return frame_moments(
        views,
        estimate,
        sigma_px=sigma_px,
        free_theta=options.refine_intrinsics,
        free_shape=options.solves_board_shape,
        frames=frames,
    )


def _gross_views(
    adjusted: Adjusted,
    noise: MocapNoiseModel,
    motion: RefMotion,
    options: CalibrationOptions,
    sample: FrameMoments,
    information: FloatArray,
) -> dict[str, BoolArray]:
    """By camera, the views of frames that the noise does not explain; empty where there are none."""
    step = _step(sample, noise, motion, information)
    views = adjusted.screened.views
    frames = frames_of(views)
    parts = in_parts(
        views,
        adjusted.estimate,
        frames,
        sigma_px=sample.sigma_px,
        free_theta=options.refine_intrinsics,
        free_shape=options.solves_board_shape,
    )
    gross = np.concatenate([gross_frames(part, noise.covariance(motion, part.stamps_ns), step=step) for part in parts])
    if not gross.any():
        return {}
    return {name: np.isin(of_camera.frame_index, frames[gross]) for name, of_camera in views.items()}


def _step(
    sample: FrameMoments, noise: MocapNoiseModel, motion: RefMotion, information: FloatArray
) -> SharedStep | None:
    """What the frames ask for that are not gross beyond doubt; None where these leave an unknown open."""
    doubtful = gross_frames(sample, noise.covariance(motion, sample.stamps_ns), _BEYOND_DOUBT)
    try:
        return shared_step(sample.take(np.flatnonzero(~doubtful)), noise, motion, information)
    except np.linalg.LinAlgError:
        return None


def _without(adjusted: Adjusted, gross: Mapping[str, BoolArray]) -> tuple[Adjusted, tuple[Dropped, ...]]:
    """The adjusted views less the gross ones; all of them where those are most: then it is the noise that is wrong."""
    views = adjusted.screened.views
    if not gross or any(mask.mean() > _MOST_GROSS for mask in gross.values()):
        return adjusted, ()
    dropped = tuple(
        Dropped(name, GROSS, int(mask.sum()), _n_corners(views[name], mask))
        for name, mask in gross.items()
        if mask.any()
    )
    kept = {name: select_views(views[name], np.flatnonzero(~mask)) for name, mask in gross.items()}
    screened = replace(adjusted.screened, views=kept).under(adjusted.estimate)
    return replace(adjusted, screened=screened), dropped


_BEYOND_DOUBT = 10.0  # times the noise's covariance
_MOST_GROSS = 0.5  # of a camera's views: half of them stay, as in ``screen``
GROSS = "mocap pose is an outlier, far beyond its noise"


def _n_corners(views: Views, mask: BoolArray) -> int:
    return int(np.diff(views.view_start)[mask].sum())


def adjust_with_mocap_noise(
    adjusted: Adjusted,
    fit: MocapNoiseFit,
    motion: RefMotion,
    options: CalibrationOptions,
) -> Adjusted:
    """Go on from stage 3 with every A_t free, on the views and corners that it used."""
    estimate = adjusted.estimate
    graph = gtsam.NonlinearFactorGraph()
    graph.add(marginal_factor(adjusted, fit, motion, options))
    graph.push_back(priors_graph(adjusted.screened.views, options))
    values = to_values(estimate, with_theta=options.refine_intrinsics, with_shape=options.solves_board_shape)
    found = minimise(graph, values, eps=options.eps, max_iterations=options.max_iterations)
    estimate = updated(estimate, found.values)
    return Adjusted(estimate, fit.sigma_px, adjusted.screened.under(estimate), graph, found.values, found.errors)


def _from_some_frames(
    adjusted: Adjusted, fit: MocapNoiseFit, motion: RefMotion, options: CalibrationOptions
) -> Adjusted:
    """What ``adjust_with_mocap_noise`` finds from a part of the views, for all of them."""
    some = replace(adjusted.screened, views=thinned(adjusted.screened.views)).under(adjusted.estimate)
    found = adjust_with_mocap_noise(replace(adjusted, screened=some), fit, motion, options).estimate
    return replace(adjusted, estimate=found, screened=adjusted.screened.under(found))


def shared_keys(views: Mapping[str, Views], options: CalibrationOptions) -> dict[int, int]:
    """Of what is not a single frame's, and the size of each."""
    shared = dict.fromkeys((BODY_T_BOARD, *map(camera_T_ref_key, range(len(views)))), 6)
    if options.refine_intrinsics:
        shared |= {theta_key(c): of_camera.camera.model.n_parameters for c, of_camera in enumerate(views.values())}
    return shared | ({BOARD_SHAPE: N_SHAPE} if options.solves_board_shape else {})


def whiteness(freed: Adjusted, fit: MocapNoiseFit, motion: RefMotion, options: CalibrationOptions) -> Whiteness:
    """Whether the noise model explains the frames, at stage 4's estimate."""
    views = freed.screened.views
    chosen = spread_blocks(frames_of(views))
    moments = moments_of(views, freed.estimate, options, fit.sigma_px, chosen)
    return Whiteness.of(innovations(moments, fit.noise, motion))


@dataclass(frozen=True)
class _Frames:
    """What stage 4 sums: the frames that any camera saw. measured: (F, 4, 4) the mocap's poses."""

    index: IntArray
    stamps_ns: IntArray
    measured: FloatArray
    cameras: list[CameraFrames]
    shape: int | FloatArray
    robust: AnyKernel

    @staticmethod
    def of(views: Mapping[str, Views], estimate: Estimate, fit: MocapNoiseFit, options: CalibrationOptions) -> _Frames:
        index, first = np.unique(np.concatenate([v.frame_index for v in views.values()]), return_index=True)
        cameras = [
            CameraFrames(
                corner_views(of_camera, fit.sigma_px),
                np.searchsorted(index, of_camera.frame_index),
                of_camera.camera.model,
                camera_T_ref_key(c),
                theta_key(c) if options.refine_intrinsics else estimate.theta[name],
            )
            for c, (name, of_camera) in enumerate(views.items())
        ]
        return _Frames(
            index,
            np.concatenate([v.stamps_ns for v in views.values()])[first],
            np.concatenate([v.ref_T_body for v in views.values()])[first],
            cameras,
            BOARD_SHAPE if options.solves_board_shape else estimate.board_shape,
            options.robust,
        )


def marginal_factor(
    adjusted: Adjusted, fit: MocapNoiseFit, motion: RefMotion, options: CalibrationOptions
) -> MarginalFramesFactor:
    """The corners of all frames under the noise, the A_t eliminated inside; it tells them too."""
    frames = _Frames.of(adjusted.screened.views, adjusted.estimate, fit, options)
    return MarginalFramesFactor(
        frames.cameras,
        measured_ref_T_body=frames.measured,
        noise=lower_factors(fit.noise.covariance(motion, frames.stamps_ns)),
        correlation=fit.noise.correlations(frames.stamps_ns),
        body_T_board=BODY_T_BOARD,
        shape=frames.shape,
        robust=frames.robust,
    )


def graph_of_frames(
    adjusted: Adjusted, fit: MocapNoiseFit, motion: RefMotion, options: CalibrationOptions
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """What ``marginal_factor`` and the other priors stand for, with a variable, a factor and a prior per frame: the
    reference, and for research on single frames. The values are those of ``adjusted``, A_t as the mocap has it."""
    frames = _Frames.of(adjusted.screened.views, adjusted.estimate, fit, options)
    keys = [ref_T_body_key(int(frame)) for frame in frames.index]
    values = to_values(adjusted.estimate, with_theta=options.refine_intrinsics, with_shape=options.solves_board_shape)
    for key, pose in zip(keys, frames.measured, strict=True):
        values.insert(key, gtsam.Pose3(pose))
    graph = gtsam.NonlinearFactorGraph()
    reprojection = FramesReprojection(
        frames.cameras, ref_T_body=keys, body_T_board=BODY_T_BOARD, shape=frames.shape, robust=frames.robust
    )
    for factor in reprojection.factors:
        graph.add(factor)
    covariance, rho = fit.noise.covariance(motion, frames.stamps_ns), fit.noise.correlations(frames.stamps_ns)
    _add_mocap(graph, keys, frames.measured, covariance, rho)
    graph.push_back(priors_graph(adjusted.screened.views, options))
    return graph, values


def _add_mocap(
    graph: gtsam.NonlinearFactorGraph, keys: list[int], measured: FloatArray, covariance: FloatArray, rho: FloatArray
) -> None:
    """Each A_t near the mocap's pose; the noise of neighbours alike where it is correlated."""
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    for f, key in enumerate(keys):
        if f == 0 or rho[f - 1] == 0.0:
            noise = gtsam.noiseModel.Gaussian.Covariance(covariance[f])
            graph.add(gtsam.PriorFactorPose3(key, gtsam.Pose3(measured[f]), noise))
        else:
            pair = slice(f - 1, f + 1)
            graph.add(
                CorrelatedNoiseFactor((keys[f - 1], key), tuple(measured[pair]), tuple(whitening[pair]), rho[f - 1])
            )


def priors_graph(
    views: Mapping[str, Views], options: CalibrationOptions, lens_weight: float = 1.0
) -> gtsam.NonlinearFactorGraph:
    """A factor for each thing that is known beforehand."""
    graph = gtsam.NonlinearFactorGraph()
    if options.refine_intrinsics:
        for index, (name, prior) in enumerate(intrinsics_priors(views, options, lens_weight).items()):
            graph.add(prior.factor(theta_key(index), views[name].camera))
    sigmas = shape_sigmas(views, options, lens_weight)
    if sigmas is not None:
        graph.add(shape_prior(sigmas))
    add_user_priors(graph, views, options, lens_weight)
    return graph


def prior_information(
    views: Mapping[str, Views], estimate: Estimate, options: CalibrationOptions, lens_weight: float = 1.0
) -> FloatArray:
    """(P + 1, P + 1) [J r]^T [J r] of the priors at the estimate; columns X, Y_c, theta_c, the board's shape, and the
    residual. Those of stated intrinsics and of the shape count ``lens_weight`` times."""
    values = to_values(estimate, with_theta=options.refine_intrinsics, with_shape=options.solves_board_shape)
    priors = priors_graph(views, options, lens_weight)
    linear = priors.linearize(values)
    cameras = range(len(views))
    keys = [BODY_T_BOARD, *map(camera_T_ref_key, cameras)]
    keys += [theta_key(index) for index in cameras if options.refine_intrinsics]
    keys += [BOARD_SHAPE] if options.solves_board_shape else []
    sizes = shared_keys(views, options)
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
        size = sizes[key]
        linear.add(gtsam.JacobianFactor(key, np.zeros((1, size)), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    hessian, descent = linear.hessian(ordering)
    square = np.array([[2.0 * priors.error(values)]])
    return np.block([[hessian, -descent[:, None]], [-descent[None], square]])
