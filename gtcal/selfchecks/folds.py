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
    block. by_camera_px, by_block_px: the same by camera, and by block. spread_mm: by camera, the standard deviation of
    its position in ref over the folds, pooled over the axes."""

    stage: int
    rmse_px: float
    by_camera_px: dict[str, float]
    by_block_px: dict[int, float]
    spread_mm: dict[str, float]


def hold_out(folds: Mapping[int, Calibration], blocks: IntArray, views: Mapping[str, Views]) -> tuple[HoldOut, ...]:
    """``folds[k]`` was calibrated without block k of ``blocks`` (F,); blocks without a fold are left aside. views: by
    camera, what they are held against, gross ones left out."""
    stages = sorted(set.intersection(*(set(fold.estimates) for fold in folds.values())))
    by_stage = [(stage, {k: fold.estimates[stage] for k, fold in folds.items()}) for stage in stages]
    by_default = {k: taken(fold) for k, fold in folds.items()}
    return tuple(_hold_out(stage, estimates, blocks, views) for stage, estimates in ((DEFAULT, by_default), *by_stage))


def _hold_out(stage: int, estimates: Mapping[int, Estimate], blocks: IntArray, views: Mapping[str, Views]) -> HoldOut:
    residuals = {
        (name, k): chain_residuals_px(block, estimate)
        for name, of_camera in views.items()
        for k, estimate in estimates.items()
        if (block := views_in(of_camera, blocks == k)) is not None
    }
    positions = {name: [inverse(estimate.camera_T_ref[name]) for estimate in estimates.values()] for name in views}
    return HoldOut(
        stage,
        _pooled_rms(list(residuals.values())),
        {name: _pooled_rms([part for (other, _), part in residuals.items() if other == name]) for name in views},
        {block: _pooled_rms([part for (_, k), part in residuals.items() if k == block]) for block in estimates},
        {name: _spread_mm(poses) for name, poses in positions.items()},
    )


def typical_px(estimate: Estimate, blocks: IntArray, views: Mapping[str, Views], block: int) -> float:
    """What an estimate fits or predicts a block of time to: the median length of all its residuals, so that views that
    are gross to some estimate count neither more nor less."""
    parts = [
        chain_residuals_px(of_block, estimate)
        for of_camera in views.values()
        if (of_block := views_in(of_camera, blocks == block)) is not None
    ]
    return float(np.nanmedian(np.linalg.norm(np.concatenate(parts), axis=1)))


def taken(calibration: Calibration) -> Estimate:
    """The estimate that a calibration took."""
    noise = calibration.mocap_noise
    return calibration.estimates[noise.stage if noise else max(calibration.estimates)]


def rms_length(residuals_px: FloatArray) -> float:
    """Root of the mean squared length of residuals (N, 2), those without a pixel left aside; NaN of none."""
    finite = residuals_px[np.isfinite(residuals_px).all(axis=1)]
    return float(np.sqrt((finite**2).sum(axis=1).mean())) if len(finite) else float("nan")


def _pooled_rms(residuals_px: Sequence[FloatArray]) -> float:
    return rms_length(np.concatenate([np.empty((0, 2)), *residuals_px]))


def _spread_mm(ref_T_camera: Sequence[FloatArray]) -> float:
    positions_m = np.stack([pose[:3, 3] for pose in ref_T_camera])
    return 1e3 * float(np.sqrt(positions_m.var(axis=0, ddof=1).mean()))
