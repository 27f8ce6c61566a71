"""k-fold hold-out: every block of time predicted by a calibration that has not seen it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.residuals import chain_residuals_px
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration
from gtcal.selfchecks.time_blocks import views_in

DEFAULT = 0
"""Stands for the stage that each calibration took by itself."""


@dataclass(frozen=True)
class HoldOut:
    """Of one way to estimate.

    stage: 3, 4, or DEFAULT. rmse_px: pooled over all the held-out corners, each predicted by a calibration without its
    block. by_camera_px: the same by camera. spread_mm: by camera, the standard deviation of its position in ref over
    the folds, pooled over the axes."""

    stage: int
    rmse_px: float
    by_camera_px: dict[str, float]
    spread_mm: dict[str, float]


def hold_out(folds: Sequence[Calibration], blocks: IntArray, views: Mapping[str, Views]) -> tuple[HoldOut, ...]:
    """``folds[k]`` was calibrated without block k of ``blocks`` (F,). views: by camera, what they are held against,
    gross ones left out."""
    stages = sorted(set.intersection(*(set(fold.estimates) for fold in folds)))
    by_stage = [(stage, [fold.estimates[stage] for fold in folds]) for stage in stages]
    taken = [fold.estimates[fold.mocap_noise.stage if fold.mocap_noise else max(fold.estimates)] for fold in folds]
    return tuple(_hold_out(stage, estimates, blocks, views) for stage, estimates in ((DEFAULT, taken), *by_stage))


def _hold_out(stage: int, estimates: Sequence[Estimate], blocks: IntArray, views: Mapping[str, Views]) -> HoldOut:
    residuals = {name: _predicted(estimates, blocks, of_camera) for name, of_camera in views.items()}
    return HoldOut(
        stage,
        rms_length(np.concatenate(list(residuals.values()))),
        {name: rms_length(found) for name, found in residuals.items()},
        {name: _spread_mm([inverse(estimate.camera_T_ref[name]) for estimate in estimates]) for name in views},
    )


def _predicted(estimates: Sequence[Estimate], blocks: IntArray, views: Views) -> FloatArray:
    """(N, 2) residuals of the views' corners, each block's by the estimate that has not seen it."""
    parts = [
        chain_residuals_px(block, estimate)
        for k, estimate in enumerate(estimates)
        if (block := views_in(views, blocks == k)) is not None
    ]
    return np.concatenate(parts)


def rms_length(residuals_px: FloatArray) -> float:
    """Root of the mean squared length of residuals (N, 2), those without a pixel left aside."""
    finite = residuals_px[np.isfinite(residuals_px).all(axis=1)]
    return float(np.sqrt((finite**2).sum(axis=1).mean()))


def _spread_mm(ref_T_camera: Sequence[FloatArray]) -> float:
    positions_m = np.stack([pose[:3, 3] for pose in ref_T_camera])
    return 1e3 * float(np.sqrt(positions_m.var(axis=0, ddof=1).mean()))
