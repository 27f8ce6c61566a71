"""What an operator should hear of a solution, a line each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gtcal.errors import GtcalError
from gtcal.estimation.adjustment import Adjusted, joint_keys, theta_sizes
from gtcal.estimation.errors_in_variables import GROSS
from gtcal.estimation.motion import check_turning, turning
from gtcal.estimation.observations import Dropped, Observations, Views, pooled
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.priors import contradictions
from gtcal.recordings.detections import IntArray
from gtcal.recordings.numbering import listed_numbers, numbers_of
from gtcal.results.calibration import (
    MocapNoise,
    StageReport,
)
from gtcal.results.covariance import JointCovariance
from gtcal.uncertainty.placement import Placement
from gtcal.uncertainty.weak_directions import directions_of_covariance, directions_of_graph, weakness_warnings

LOOSE, LOOSE_PX = 5.0, 1.0
"""How many times worse the corners fit in the chain than with a pose of each view's own, and how badly, to warn of."""

PLAIN_NOISE_MM, PLAIN_NOISE_DEG = 2.0, 0.3
"""What a mocap or an arm may err by, at random, without something being wrong with the recording."""

MANY_DROPPED, SOME_DROPPED = 0.15, 0.05
"""Shares of gross views that an operator should hear of: that contradict the chain, and that noise does not explain.
The second by two sigma of the count, and by more than two views."""

_MOMENTS_SHOWN = 6


def motion_warnings(views: Mapping[str, Views], options: CalibrationOptions) -> tuple[str, ...]:
    """Of turns that tell little. Raises GtcalError where they leave something open, unless the options allow that."""
    try:
        warning = check_turning(turning(of_camera.ref_T_body for of_camera in views.values()))
    except GtcalError as error:
        if not (options.allow_degenerate or options.priors.of_poses):
            raise
        warning = str(error)
    return () if warning is None else (warning,)


def prior_warnings(adjusted: Adjusted, options: CalibrationOptions) -> tuple[str, ...]:
    """Of priors that the data contradict."""
    cameras = {name: views.camera for name, views in adjusted.screened.views.items()}
    return contradictions(options.priors, cameras, adjusted.values, free_theta=options.refine_intrinsics)


def fit_warnings(
    reports: Sequence[StageReport], noise: MocapNoise | None, *, numbered: bool = False
) -> tuple[str, ...]:
    """By themselves the views fit as well as lens and detector are; what the chain adds is the mocap's. The reports
    begin with PnP's; the stage that was taken is the one that counts."""
    alone, stage = reports[0], noise.stage if noise is not None else 3
    taken = next((report for report in reports if report.stage == stage), None)
    if taken is None or not taken.median_px > max(LOOSE * alone.median_px, LOOSE_PX) or _is_plain_noise(noise):
        return ()
    return (
        f"corners lie {taken.median_px:.2g} px off, typically, but {alone.median_px:.2g} px where each view has a "
        "board pose of its own: the mocap's poses do not go with the images; look for "
        + ("loose markers or an arm that errs" if numbered else "a clock offset or for loose markers"),
    )


def _is_plain_noise(noise: MocapNoise | None) -> bool:
    """Whether the mocap's poses scatter as noise does, and by no more than a mocap's or an arm's."""
    if noise is None or noise.stage != 4:
        return False
    sigmas_mm, sigmas_deg = noise.translation_sigma_mm.values(), noise.rotation_sigma_deg.values()
    return max(sigmas_mm) < PLAIN_NOISE_MM and max(sigmas_deg) < PLAIN_NOISE_DEG


def weak_direction_warnings(
    observations: Observations, adjusted: Adjusted, sigmas: JointCovariance | None, options: CalibrationOptions
) -> tuple[str, ...]:
    """Of directions that are weak. Raises GtcalError where one is refused, unless the options allow that."""
    estimate = adjusted.estimate
    placement = Placement(
        capture=observations.capture,
        board_centre_m=observations.board.corners_m.mean(axis=0),
        body_T_board=estimate.body_T_board,
        cameras={
            name: replace(views.camera, parameters=estimate.theta[name]) for name, views in observations.views.items()
        },
        camera_T_ref=estimate.camera_T_ref,
        theta_sizes=theta_sizes(adjusted),
    )
    found = (
        directions_of_graph(adjusted.graph, adjusted.values, joint_keys(adjusted), placement)
        if sigmas is None
        else directions_of_covariance(sigmas, placement)
    )
    return weakness_warnings(found, allow_degenerate=options.allow_degenerate)


def gross_warnings(dropped: tuple[Dropped, ...], observations: Observations) -> tuple[str, ...]:
    """Stage 4 may leave views out, but not in silence."""
    counts = {
        drop.camera: (drop.n_views, observations.views[drop.camera].n_views)
        for drop in pooled(dropped)
        if drop.reason == GROSS
    }
    return tuple(
        f"camera {name!r}: {n_gross / n:.0%} of its views were left out, off by more than the noise of the mocap "
        "explains; a body that slips or is mistaken looks like that"
        for name, (n_gross, n) in counts.items()
        if n_gross > max(SOME_DROPPED * n + 2.0 * np.sqrt(SOME_DROPPED * n), 2.0)
    )


def screening_warnings(adjusted: Adjusted, observations: Observations) -> tuple[str, ...]:
    """Of cameras many of whose views contradict the others."""
    views, numbered = observations.views, observations.motion.numbered
    cause = "a body that slips or is mistaken" if numbered else "a mocap body that swaps, or a clock that drifts,"
    start_ns = min(int(of_camera.stamps_ns[0]) for of_camera in views.values())
    return tuple(
        f"camera {name!r}: {np.mean(~keep):.0%} of its views contradict the chain and were left out "
        f"({_shown(views[name].stamps_ns[~keep], start_ns, numbered)}); {cause} looks like that"
        for name, keep in adjusted.screened.keep_view.items()
        if np.mean(~keep) > MANY_DROPPED
    )


def _shown(stamps_ns: IntArray, start_ns: int, numbered: bool) -> str:
    """When, or of a numbered recording which."""
    if numbered:
        return f"images {listed_numbers(numbers_of(stamps_ns), _MOMENTS_SHOWN)}"
    return _moments(stamps_ns - start_ns)


def _moments(since_start_ns: IntArray) -> str:
    """When, since the first image."""
    shown = ", ".join(f"{1e-9 * moment:.2f}" for moment in since_start_ns[:_MOMENTS_SHOWN])
    n_more = len(since_start_ns) - _MOMENTS_SHOWN
    return f"at {shown} s" + (f" and {n_more} more" if n_more > 0 else "")
