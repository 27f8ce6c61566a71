"""From observations to a calibration: PnP, the three stages, marginal covariances."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from factors import GAUSSIAN
from gtcal.blas import on_one_blas_thread
from gtcal.errors import GtcalError
from gtcal.estimation.adjustment import Adjusted, adjust, joint_covariance, not_adjusted
from gtcal.estimation.alignment import GuideViews, fitting_views, stage_1, stage_2, without_stage_1
from gtcal.estimation.choice import choose
from gtcal.estimation.clustered import by_noise_model, by_one_factor, clustered, weight_of_lenses
from gtcal.estimation.errors_in_variables import MocapNoiseFit, model_mocap_noise, whiteness
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.field_edge import without_edge
from gtcal.estimation.frame_statistics import frames_of
from gtcal.estimation.held_intrinsics import with_held_intrinsics
from gtcal.estimation.lens_moves import lens_moves, lens_warnings
from gtcal.estimation.mocap_noise import MocapNoiseModel
from gtcal.estimation.observations import Dropped, Observations, Views, pooled
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import chain_residuals_px, median_by_view, norms
from gtcal.estimation.smooth_errors import (
    MOST_FRAMES,
    adjust_with_smooth_errors,
    covariance_under,
    find_smooth_errors,
)
from gtcal.estimation.solver_warnings import (
    fit_warnings,
    gross_warnings,
    motion_warnings,
    prior_warnings,
    screening_warnings,
    weak_direction_warnings,
)
from gtcal.estimation.thinning import is_long, thinned
from gtcal.files import InputFile
from gtcal.progress import Progress, silent
from gtcal.results.board_shape import BoardShape
from gtcal.results.calibration import (
    Calibration,
    CameraCalibration,
    MocapNoise,
    PoseEstimate,
    ResidualStatistics,
    Solution,
    StageReport,
)
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE, JointCovariance
from gtcal.results.lens_move import LensMove
from gtcal.results.provenance import provenance

DISAGREEMENT_RAD = np.deg2rad(3.0)
"""A typical residual of this angle after alignment is no noise: the files contradict each other."""


REFUTED_SIGMAS = 3.0
"""By so many standard errors of the hold-out error the noise model is wrong, and not only not better."""

REFUTED_FIT = 1.2
"""Smooth errors are refuted where the estimate under them fits what it has seen worse, by so many times, than the one
that takes the mocap as exact predicts what it has not."""

_MIN_VIEWS = 3
_WEIGHINGS, _SAME_WEIGHT = 2, np.log(1.5)


class DisagreementError(GtcalError):
    """No chain fits the data. ``angle_deg``: the typical residual of the best one. ``hint``: the likely mistake.
    ``doctor``: the command that looks for it."""

    def __init__(self, angle_deg: float, hint: str = "", doctor: str = "'gtcal doctor RECORDING'") -> None:
        self.angle_deg = angle_deg
        causes = "quaternion order, inverse poses, units, swapped bodies or clocks, or the board's geometry"
        advice = f"{hint}; {doctor} tells more" if hint else f"check {causes}, or let {doctor} try them"
        super().__init__(
            f"no calibration fits: after alignment the corners still lie {angle_deg:.1f} deg off, typically, so the "
            f"board's views and the mocap contradict each other; {advice}"
        )


@on_one_blas_thread
def calibrate_observations(
    observations: Observations,
    options: CalibrationOptions | None = None,
    *,
    progress: Progress = silent,
    inputs: tuple[InputFile, ...] = (),
    earlier: tuple[StageReport, ...] = (),
) -> Calibration:
    """Calibrate from synchronised views. ``inputs`` and reports of ``earlier`` work are kept with the result.

    Raises GtcalError where there are fewer views than unknowns or the motion is degenerate, and DisagreementError
    where no chain fits."""
    started = time.perf_counter()
    options = options or CalibrationOptions()
    observations = without_edge(observations) if options.screen else observations
    views = observations.views
    _check_enough(views, options)
    motion_warnings(views, options)
    estimate, reports = _align(views, options, progress)
    adjusted, later = _stage_3(views, estimate, options, progress)
    found = (
        _Found(adjusted, {}, {}, None, ())
        if 3 not in options.stages
        else _with_mocap_noise(adjusted, observations, options, progress)
    )
    if options.intrinsics == "fixed":
        found = _with_held_intrinsics(found, adjusted, observations, options)
    adjusted, sigmas = found.adjusted, found.covariances.get(found.kind)
    later += found.reports
    final = adjusted.estimate
    moved = _lens_moves(observations, final, sigmas, options)
    shape = _board_shape(views, final, sigmas)
    return Calibration(
        capture=observations.capture,
        cameras={name: _camera(of_camera, adjusted, sigmas, moved.get(name, ())) for name, of_camera in views.items()},
        body_T_board=PoseEstimate(final.body_T_board, sigmas.body_T_board if sigmas else None),
        board=observations.board.to_manifest(),
        board_shape=shape,
        sigma_px=adjusted.sigma_px,
        covariance_kind=found.kind,
        covariances=found.covariances,
        estimates=found.estimates,
        mocap_noise=found.noise,
        stages=(*earlier, *reports, *later),
        dropped=pooled(observations.dropped + found.dropped),
        warnings=(
            *_warnings(observations, found, options),
            *lens_warnings({name: of_camera.camera for name, of_camera in views.items()}, moved),
            *(shape.warnings if shape is not None else ()),
            *gross_warnings(found.dropped, observations),
            *fit_warnings((*reports, *later), found.noise, numbered=observations.motion.numbered),
            *(found.noise.warnings if found.noise is not None else ()),
        ),
        provenance=provenance(options, inputs, time.perf_counter() - started),
        solution=Solution(
            adjusted.graph,
            adjusted.values,
            final,
            adjusted.screened.views,
            found.covariance_factor,
            adjusted.lens_weight,
        ),
    )


def _check_enough(views: Mapping[str, Views], options: CalibrationOptions) -> None:
    for name, of_camera in views.items():
        if of_camera.n_views < _MIN_VIEWS:
            raise GtcalError(
                f"camera {name!r} has {of_camera.n_views} usable view(s); at least {_MIN_VIEWS} are needed for its "
                "extrinsic, and 20 or more for a good one: record longer, or leave the camera out"
            )
        unknowns = 12
        if options.refine_intrinsics and not options.trusts_stated_intrinsics:
            unknowns += of_camera.camera.model.n_parameters
        if 2 * of_camera.n_corners < unknowns:
            raise GtcalError(
                f"camera {name!r} has {2 * of_camera.n_corners} measured coordinates for {unknowns} unknowns: "
                "record more views of the board"
            )


def _warnings(observations: Observations, found: _Found, options: CalibrationOptions) -> tuple[str, ...]:
    """The motion is looked at again without the gross views, whose wrong poses would pass for turns. Data that
    determine the result but for the mocap's smooth errors are weak, and not degenerate."""
    adjusted, sigmas = found.adjusted, found.covariances.get(found.kind)
    motion = motion_warnings(adjusted.screened.views, options)
    weak: tuple[str, ...] = ()
    if 3 in options.stages:
        if found.of_noise_alone is not None:
            weak_direction_warnings(observations, adjusted, found.of_noise_alone, options)
            options = replace(options, allow_degenerate=True)
        weak = weak_direction_warnings(observations, adjusted, sigmas, options)
    return (*motion, *screening_warnings(adjusted, observations), *weak, *prior_warnings(adjusted, options))


def _align(
    views: Mapping[str, Views], options: CalibrationOptions, progress: Progress
) -> tuple[Estimate, list[StageReport]]:
    """PnP, stage 1 and stage 2, as far as the options want them."""
    started = time.perf_counter()
    guides = _guides(views, options, progress)
    alone_px = float(np.median(np.concatenate([guide.pnp_median_px for guide in guides.values()])))
    reports = [replace(_report(0, "PnP", started), median_px=alone_px)]
    started = time.perf_counter()
    if 1 in options.stages:
        progress("stage 1: Procrustes sweep", 0, 1)
        aligned = stage_1(guides, np.random.default_rng(options.seed), method=options.sweep)
        estimate, fitting = aligned.estimate, aligned.views
        worst, best = aligned.sweep.rmse_of_starts_m.max(), aligned.sweep.rmse_m
        found = _report(1, "Procrustes sweep", started, (worst, best), "m rmse")
        reports.append(replace(found, iterations=aligned.sweep.n_steps, median_px=_median_px(views, estimate)))
        progress("stage 1: Procrustes sweep", 1, 1)
    else:
        estimate = without_stage_1(guides)
        fitting = fitting_views(guides, estimate)
    started = time.perf_counter()
    if 2 in options.stages:
        progress("stage 2: 3-D alignment", 0, 1)
        estimate, minimised = stage_2(fitting, estimate, eps=options.eps, max_iterations=options.max_iterations)
        found = _report(2, "3-D alignment", started, minimised.errors, "m^2/2")
        reports.append(replace(found, median_px=_median_px(views, estimate)))
        progress("stage 2: 3-D alignment", 1, 1)
    if 1 in options.stages and not options.allow_degenerate:
        _check_agreement(views, estimate)
    return estimate, reports


def _stage_3(
    views: Mapping[str, Views], estimate: Estimate, options: CalibrationOptions, progress: Progress
) -> tuple[Adjusted, tuple[StageReport, ...]]:
    if 3 not in options.stages:
        return not_adjusted(views, estimate, options), ()
    started = time.perf_counter()
    weight, n_frames = 1.0, len(frames_of(views))
    if is_long(views):
        first = _weighed(thinned(views), estimate, options, silent, n_frames)
        estimate, weight, options = first.estimate, first.lens_weight, replace(options, graduated=False)
    adjusted = _weighed(views, estimate, options, progress, n_frames, lens_weight=weight)
    report = _report(3, "pixels", started, adjusted.errors, "px^2/2")
    return adjusted, (replace(report, median_px=_median_px(views, adjusted.estimate)),)


def _weighed(
    views: Mapping[str, Views],
    start: Estimate,
    options: CalibrationOptions,
    progress: Progress,
    n_frames: int,
    *,
    lens_weight: float = 1.0,
) -> Adjusted:
    """Stage 3 with what is stated of the lenses counted as it should be beside corners that err together, frame by
    frame, of a recording of so many frames: by ``lens_weight`` at first."""
    adjusted = adjust(views, start, options, progress, lens_weight=lens_weight)
    for _ in range(_WEIGHINGS if options.trusts_stated_intrinsics else 0):
        try:
            weight = weight_of_lenses(adjusted, options, n_frames)
        except np.linalg.LinAlgError:
            break  # a direction is open, and named later
        if abs(np.log(weight / adjusted.lens_weight)) < _SAME_WEIGHT:
            break
        again = adjust(views, adjusted.estimate, options, lens_weight=weight)
        adjusted = replace(again, errors=(*adjusted.errors, *again.errors[1:]))
    return adjusted


@dataclass(frozen=True)
class _Found:
    """The estimate that was taken, what it was chosen from, and what was left out for it. freed, modelled: stage 4's
    solution and noise, where it was run. of_noise_alone: the covariance that the motion would allow, had the mocap no
    smooth errors; None where it has none."""

    adjusted: Adjusted
    estimates: dict[int, Estimate]
    covariances: dict[str, JointCovariance]
    noise: MocapNoise | None
    dropped: tuple[Dropped, ...]
    reports: tuple[StageReport, ...] = ()
    freed: Adjusted | None = None
    modelled: MocapNoiseModel | None = None
    of_noise_alone: JointCovariance | None = None

    @property
    def covariance_factor(self) -> float:
        """By how much the covariance that the estimate carries is larger than its graph's."""
        taken = self.modelled if self.kind == ERRORS_IN_VARIABLES else None
        return taken.small_sample_factor if taken is not None else 1.0

    @property
    def kind(self) -> str:
        """Of the covariance that the estimate carries."""
        if self.noise is not None and self.noise.stage == 4:
            return ERRORS_IN_VARIABLES
        return CLUSTERED if CLUSTERED in self.covariances else NAIVE


def _with_mocap_noise(
    adjusted: Adjusted, observations: Observations, options: CalibrationOptions, progress: Progress
) -> _Found:
    """Stage 3's covariances; and stage 4 with its own, where it can be run, if it earns its place. Where the data leave
    a direction open, neither."""
    views, motion = observations.views, observations.motion
    dropped = adjusted.screened.dropped(views)
    naive = joint_covariance(adjusted, NAIVE)
    if naive is None:
        return _Found(adjusted, {3: adjusted.estimate}, {}, None, dropped)
    covariances = {NAIVE: naive}
    started = time.perf_counter()
    modelled = None if options.mocap == "exact" else model_mocap_noise(adjusted, motion, options, progress)
    correlation_s = modelled[1].noise.correlation_s if modelled else 0.0
    covariances |= clustered(adjusted, options, correlation_s, sizes=naive.theta_sizes)
    if modelled is None:
        return _Found(adjusted, {3: adjusted.estimate}, covariances, None, dropped)
    freed, noise = modelled
    of_freed = joint_covariance(freed, ERRORS_IN_VARIABLES)
    if of_freed is not None:
        covariances[ERRORS_IN_VARIABLES] = of_freed.times(noise.noise.small_sample_factor)
    report = _report(4, "mocap noise", started, freed.errors, "whitened")
    report = replace(report, median_px=_median_px(views, freed.estimate))
    chosen = choose(noise, whiteness(freed, noise, motion, options))
    if CLUSTERED not in covariances:
        covariances[CLUSTERED] = (
            by_one_factor(adjusted, options, correlation_s, sizes=naive.theta_sizes)
            if noise.hold_out.noisy_worse_by_sigmas > REFUTED_SIGMAS
            else by_noise_model(adjusted, options, noise.noise, motion, sizes=naive.theta_sizes)
        )
    estimates = {3: adjusted.estimate, 4: freed.estimate}
    if chosen.stage == 4:
        dropped += noise.dropped
    taken = adjusted if chosen.stage == 3 else freed
    found = _Found(taken, estimates, covariances, chosen, dropped, (report,), freed, noise.noise)
    return _with_smooth_errors(found, noise, observations, options)


def _with_smooth_errors(
    found: _Found, fit: MocapNoiseFit, observations: Observations, options: CalibrationOptions
) -> _Found:
    """With what the mocap errs by beside noise in the estimate, where the frames are few, else in its covariance."""
    smooth = find_smooth_errors(found.adjusted, fit, observations.motion, options)
    if smooth is None or found.noise is None:
        return found
    noise, joint = replace(found.noise, smooth=smooth.told(fit.noise)), found.covariances.get(found.kind)
    if len(frames_of(found.adjusted.screened.views)) > MOST_FRAMES or options.robust != GAUSSIAN:
        matrix = covariance_under(
            found.adjusted, fit, smooth, observations.motion, options, models_noise=noise.stage == 4
        )
        sizes = found.covariances[NAIVE].theta_sizes
        covariances = {**found.covariances, found.kind: JointCovariance.of(found.kind, sizes, matrix)}
        return replace(found, noise=noise, covariances=covariances, of_noise_alone=joint)
    settled = adjust_with_smooth_errors(found.adjusted, fit, smooth, observations.motion, options)
    under = joint_covariance(settled, ERRORS_IN_VARIABLES)
    if under is None or settled.screened.rms_px > REFUTED_FIT * noise.hold_out_px[3]:
        return found
    return replace(
        found,
        adjusted=settled,
        freed=settled,
        estimates={**found.estimates, 4: settled.estimate},
        covariances={**found.covariances, ERRORS_IN_VARIABLES: under.times(fit.noise.small_sample_factor)},
        noise=replace(noise, stage=4, reason=f"{noise.reason}; smooth errors modelled too"),
        of_noise_alone=joint,
    )


def _with_held_intrinsics(
    found: _Found, of_stage_3: Adjusted, observations: Observations, options: CalibrationOptions
) -> _Found:
    """Its covariances with what the held intrinsics' own sigmas add; the naive one stays what the paper's is."""
    covariances = dict(found.covariances)
    for kind, adjusted, noise in (
        (CLUSTERED, of_stage_3, None),
        (ERRORS_IN_VARIABLES, found.freed, found.modelled),
    ):
        if kind in covariances and adjusted is not None:
            covariances[kind] = with_held_intrinsics(covariances[kind], adjusted, options, observations.motion, noise)
    return replace(found, covariances=covariances)


def _guides(views: Mapping[str, Views], options: CalibrationOptions, progress: Progress) -> dict[str, GuideViews]:
    guides = {}
    for done, (name, of_camera) in enumerate(views.items()):
        progress("PnP", done, len(views))
        guides[name] = GuideViews.of(of_camera, solve_pnp(of_camera, max_views=options.pnp_views))
        n_solved = guides[name].views.n_views
        if n_solved < _MIN_VIEWS:
            raise GtcalError(
                f"camera {name!r}: PnP solves {n_solved} of its {of_camera.n_views} views; do the intrinsics fit the "
                "image, and the board the recording?"
            )
    progress("PnP", len(views), len(views))
    return guides


def _report(stage: int, name: str, started_s: float, errors: tuple[float, ...] = (), unit: str = "") -> StageReport:
    before, after = (errors[0], errors[-1]) if errors else (float("nan"), float("nan"))
    seconds = time.perf_counter() - started_s
    return StageReport(stage, name, max(len(errors) - 1, 0), before, after, unit, float("nan"), seconds)


def _median_px(views: Mapping[str, Views], estimate: Estimate) -> float:
    """Median over the views of all cameras of the median residual of their corners; NaN where most of them have no
    pixel under the estimate. Of many frames some speak for all."""
    views = thinned(views) if is_long(views) else views
    medians = [
        median_by_view(of_camera, norms(chain_residuals_px(of_camera, estimate))) for of_camera in views.values()
    ]
    median_px = float(np.median(np.concatenate(medians)))
    return median_px if np.isfinite(median_px) else float("nan")


def _check_agreement(views: Mapping[str, Views], estimate: Estimate) -> None:
    focal_px = float(np.mean([theta[0] for theta in estimate.theta.values()]))
    angle_rad = np.arctan(np.nan_to_num(_median_px(views, estimate), nan=np.inf) / focal_px)
    if angle_rad > DISAGREEMENT_RAD:
        raise DisagreementError(float(np.rad2deg(angle_rad)))


def _lens_moves(
    observations: Observations, estimate: Estimate, sigmas: JointCovariance | None, options: CalibrationOptions
) -> dict[str, tuple[LensMove, ...]]:
    """Of intrinsics that were solved for near what is stated; none where a direction is open, and named elsewhere."""
    if sigmas is None or not options.trusts_stated_intrinsics:
        return {}
    cameras = {name: views.camera for name, views in observations.views.items()}
    try:
        return lens_moves(cameras, estimate, sigmas, options)
    except np.linalg.LinAlgError:
        return {}


def _board_shape(views: Mapping[str, Views], estimate: Estimate, sigmas: JointCovariance | None) -> BoardShape | None:
    if sigmas is None or sigmas.board_shape is None:
        return None
    return BoardShape(estimate.board_shape, sigmas.board_shape, next(iter(views.values())).shape_sigmas)


def _camera(
    views: Views, adjusted: Adjusted, sigmas: JointCovariance | None, moved: tuple[LensMove, ...]
) -> CameraCalibration:
    name = views.camera.name
    used, estimate = adjusted.screened.views[name], adjusted.estimate
    lengths_px = adjusted.screened.lengths_px[name]
    if not np.isfinite(lengths_px).any():
        raise GtcalError(
            f"camera {name!r}: the solution puts none of its corners in the lens's field of view; "
            "run all the stages, and look whether its views and the mocap belong together"
        )
    return CameraCalibration(
        camera=replace(views.camera, parameters=estimate.theta[name], theta_sigmas=None),
        camera_T_ref=PoseEstimate(estimate.camera_T_ref[name], sigmas.camera_T_ref(name) if sigmas else None),
        theta_covariance=sigmas.theta(name) if sigmas else None,
        residuals=ResidualStatistics.of(lengths_px, used.n_views),
        lens_moves=moved,
    )
