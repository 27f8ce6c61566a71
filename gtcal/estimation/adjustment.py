"""Stage 3: the reprojection error of all corners over all Y_c, X and, where asked, theta_c; and its covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors import RobustKernel
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import (
    BOARD_SHAPE,
    BODY_T_BOARD,
    IntrinsicsPrior,
    camera_T_ref_key,
    finished,
    minimise,
    optimum_nearby,
    reprojection_graph,
    theta_key,
    to_values,
    updated,
)
from gtcal.estimation.lens_sigmas import lens_sigmas
from gtcal.estimation.marginals import covariance_of, joint_information
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.priors import prior_factors
from gtcal.estimation.screening import Screened, keep_all, screen
from gtcal.progress import Progress, silent
from gtcal.results.covariance import JointCovariance

MAX_ROUNDS = 6
"""Of screening and solving; two do unless the first estimate was poor."""

NARROWING = 1.4
"""A kernel's width from step to step of graduated non-convexity: as in Yang et al. (2020)."""

KNOWN_OTHERWISE = 1e3
"""What an earlier calibration knows holds what was known before it: that counts by so many times its sigma, and no
second time."""

MEDIAN_LENGTH = float(np.sqrt(2.0 * np.log(2.0)))
"""Median length of a 2-D Gaussian vector with unit sigma in each coordinate (Rayleigh)."""


@dataclass(frozen=True)
class Adjusted:
    """Where stage 3 ended.

    graph, values: of the last round, with the final sigma. errors: the graph's error from round to round, times the
        square of the round's sigma so that they compare: px^2, halved.
    screened: the views and corners that were used.
    lens_weight: how many times their information the priors of stated intrinsics count (``weight_of_lenses``)."""

    estimate: Estimate
    sigma_px: float
    screened: Screened
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    errors: tuple[float, ...]
    lens_weight: float = 1.0


def adjust(
    views: Mapping[str, Views],
    start: Estimate,
    options: CalibrationOptions,
    progress: Progress = silent,
    *,
    lens_weight: float = 1.0,
) -> Adjusted:
    """Screen and solve in turns, until the same corners stay; then the last steps to their optimum. lens_weight: see
    ``Adjusted``."""
    screened = _screened(views, start, options)
    estimate = _graduated(screened, start, options) if options.graduated else start
    sigma_px = _sigma_px(screened.under(estimate), options)
    errors: tuple[float, ...] = ()
    for done in range(MAX_ROUNDS):
        progress("stage 3: pixels", done, MAX_ROUNDS)
        near = _optimum_nearby(screened, estimate, sigma_px, options, lens_weight) if done else None
        if near is None:
            estimate, found = minimised(screened, estimate, sigma_px, options, lens_weight, finish=False)
            errors += tuple(sigma_px**2 * error for error in (found[1:] if errors else found))
        else:
            estimate = near
        before = screened, sigma_px
        screened = _screened(views, estimate, options)
        sigma_px = _sigma_px(screened, options)
        if screened.same_as(before[0]) and _settled(before[1], sigma_px, options):
            break
    progress("stage 3: pixels", MAX_ROUNDS, MAX_ROUNDS)
    return _finished(_adjusted(screened, estimate, sigma_px, options, errors, lens_weight))


def _finished(adjusted: Adjusted) -> Adjusted:
    """At the optimum of its graph."""
    values, error = finished(adjusted.graph, adjusted.values, adjusted.graph.error(adjusted.values))
    estimate = updated(adjusted.estimate, values)
    errors = (*adjusted.errors[:-1], adjusted.sigma_px**2 * error)
    return replace(
        adjusted, estimate=estimate, screened=adjusted.screened.under(estimate), values=values, errors=errors
    )


def _graduated(screened: Screened, start: Estimate, options: CalibrationOptions) -> Estimate:
    """Where ever narrower kernels lead, from one that takes nothing for an outlier to ``options.robust``."""
    estimate, widest_px = start, _longest_px(screened)
    sigma_px = _sigma_px(screened, options)
    while widest_px > options.robust.parameter * sigma_px:
        kernel = RobustKernel(options.robust.name, widest_px / sigma_px)
        wider = replace(options, robust=kernel, graduated=False)
        estimate, _ = minimised(screened, estimate, sigma_px, wider, finish=False)
        sigma_px = _sigma_px(screened.under(estimate), options)
        widest_px /= NARROWING
    return estimate


def _longest_px(screened: Screened) -> float:
    lengths = np.concatenate(list(screened.lengths_px.values()))
    return float(lengths[np.isfinite(lengths)].max())


def not_adjusted(views: Mapping[str, Views], start: Estimate, options: CalibrationOptions) -> Adjusted:
    """The ablation without stage 3: the start, screened, with the graph that stage 3 would have minimised."""
    screened = _screened(views, start, options)
    return _adjusted(screened, start, _sigma_px(screened, options), options, ())


def _adjusted(
    screened: Screened,
    estimate: Estimate,
    sigma_px: float,
    options: CalibrationOptions,
    errors: tuple[float, ...],
    lens_weight: float = 1.0,
) -> Adjusted:
    graph = _graph(screened, estimate, sigma_px, options, lens_weight)
    values = _values(estimate, options)
    return Adjusted(estimate, sigma_px, screened, graph, values, errors, lens_weight)


def _screened(views: Mapping[str, Views], estimate: Estimate, options: CalibrationOptions) -> Screened:
    return screen(views, estimate) if options.screen else keep_all(views, estimate)


def minimised(
    screened: Screened,
    estimate: Estimate,
    sigma_px: float,
    options: CalibrationOptions,
    lens_weight: float = 1.0,
    *,
    finish: bool = True,
) -> tuple[Estimate, tuple[float, ...]]:
    """Where the corners' reprojection error is least, from an estimate, and the graph's error at the start and after
    each iteration."""
    found = minimise(
        _graph(screened, estimate, sigma_px, options, lens_weight),
        _values(estimate, options),
        eps=options.eps,
        max_iterations=options.max_iterations,
        finish=finish,
    )
    return updated(estimate, found.values), found.errors


def _optimum_nearby(
    screened: Screened, estimate: Estimate, sigma_px: float, options: CalibrationOptions, lens_weight: float
) -> Estimate | None:
    """What ``minimised`` would find, where one step leads there: after a few corners came or went."""
    graph = _graph(screened, estimate, sigma_px, options, lens_weight)
    values = optimum_nearby(graph, _values(estimate, options))
    return None if values is None else updated(estimate, values)


def _values(estimate: Estimate, options: CalibrationOptions) -> gtsam.Values:
    return to_values(estimate, with_theta=options.refine_intrinsics, with_shape=options.solves_board_shape)


def _graph(
    screened: Screened, estimate: Estimate, sigma_px: float, options: CalibrationOptions, lens_weight: float
) -> gtsam.NonlinearFactorGraph:
    priors = intrinsics_priors(screened.views, options, lens_weight) if options.refine_intrinsics else None
    graph = reprojection_graph(
        screened.views,
        estimate,
        sigma_px=sigma_px,
        robust=options.robust,
        intrinsics_priors=priors,
        shape_sigmas=shape_sigmas(screened.views, options, lens_weight),
    )
    add_user_priors(graph, screened.views, options, lens_weight)
    return graph


def add_user_priors(
    graph: gtsam.NonlinearFactorGraph, views: Mapping[str, Views], options: CalibrationOptions, lens_weight: float = 1.0
) -> None:
    """A factor for each of the options' priors; of what an earlier calibration knows, ``lens_weight`` times."""
    cameras = {name: of_camera.camera for name, of_camera in views.items()}
    for _, factor in prior_factors(options.priors, cameras, free_theta=options.refine_intrinsics, weight=lens_weight):
        graph.add(factor)


def intrinsics_priors(
    views: Mapping[str, Views], options: CalibrationOptions, lens_weight: float = 1.0
) -> dict[str, IntrinsicsPrior]:
    """What the options say of each camera's intrinsics; of stated ones ``lens_weight`` times their information."""
    return {name: _prior(of_camera, options, lens_weight) for name, of_camera in views.items()}


def shape_sigmas(
    views: Mapping[str, Views], options: CalibrationOptions, lens_weight: float = 1.0
) -> FloatArray | None:
    """(5,) of the board's shape, with ``lens_weight`` times their information; None where it is not solved for."""
    if not options.solves_board_shape:
        return None
    earlier = options.priors.earlier
    known = earlier is not None and earlier.board_shape is not None
    sigmas = next(iter(views.values())).shape_sigmas * (KNOWN_OTHERWISE if known else 1.0)
    return np.asarray(sigmas / np.sqrt(lens_weight))


def _prior(views: Views, options: CalibrationOptions, lens_weight: float) -> IntrinsicsPrior:
    if not options.trusts_stated_intrinsics:
        return IntrinsicsPrior(None)
    earlier = options.priors.earlier
    known = earlier is not None and views.camera.name in earlier.theta
    sigmas = lens_sigmas(views.camera, options) * (KNOWN_OTHERWISE if known else 1.0)
    return IntrinsicsPrior(sigmas / np.sqrt(lens_weight))


def _sigma_px(screened: Screened, options: CalibrationOptions) -> float:
    """Standard deviation of a pixel coordinate: as given; or from the residuals, by their median length under a robust
    kernel, else by their mean square over the degrees of freedom."""
    if options.sigma_px is not None:
        return options.sigma_px
    lengths = np.concatenate(list(screened.lengths_px.values()))
    if options.robust != RobustKernel():
        return max(float(np.median(lengths)) / MEDIAN_LENGTH, 1e-6)
    finite = lengths[np.isfinite(lengths)]
    models = [views.camera.model for views in screened.views.values()]
    unknowns = 6 + sum(6 + model.n_parameters * options.refine_intrinsics for model in models)
    return max(float(np.sqrt((finite**2).sum() / max(2 * len(finite) - unknowns, 1))), 1e-6)


def _settled(before_px: float, after_px: float, options: CalibrationOptions) -> bool:
    """Whether another round would change the optimum: plain least squares does not depend on sigma."""
    independent = options.robust == RobustKernel() and not options.refine_intrinsics and not options.priors
    return independent or abs(after_px - before_px) < 0.02 * before_px


def joint_covariance(adjusted: Adjusted, kind: str) -> JointCovariance | None:
    """The marginal covariance at the solution, which is of this kind; None where the data leave a direction open."""
    keys = [*joint_keys(adjusted), *([BOARD_SHAPE] if adjusted.values.exists(BOARD_SHAPE) else [])]
    try:
        information = joint_information(adjusted.graph, adjusted.values, keys)
    except GtcalError:
        return None
    covariance = covariance_of(information)
    return None if covariance is None else JointCovariance.of(kind, theta_sizes(adjusted), covariance)


def theta_sizes(adjusted: Adjusted) -> dict[str, int]:
    """By camera the number of intrinsics that were solved for, or 0."""
    cameras = {name: views.camera for name, views in adjusted.screened.views.items()}
    free = [adjusted.values.exists(theta_key(index)) for index in range(len(cameras))]
    return {
        name: camera.model.n_parameters * is_free for (name, camera), is_free in zip(cameras.items(), free, strict=True)
    }


def joint_keys(adjusted: Adjusted) -> list[int]:
    """Of X, every Y_c and every theta_c that was solved for, in the order of a ``JointCovariance``."""
    sizes = list(theta_sizes(adjusted).values())
    thetas = [theta_key(index) for index, size in enumerate(sizes) if size]
    return [BODY_T_BOARD, *map(camera_T_ref_key, range(len(sizes))), *thetas]
