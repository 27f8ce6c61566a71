"""Hold-out error: how well frames that an estimate has not seen fit it.

The frames are cut into blocks of time; each block is predicted from the others, and its corners' residuals are pooled.
To first order that takes no new solution: the sums of the frames are added up without the block and solved.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.frame_statistics import eliminate_noise, frames_of, in_parts, n_corners_of
from gtcal.estimation.mocap_noise import MocapNoiseModel, lower_factors
from gtcal.estimation.observations import Views
from gtcal.recordings.capture import RefMotion

FOLDS = 10

MOST_IN_FOLD = 400
"""Frames, in a row: more make a long recording's hold-out error no surer than it need be."""


@dataclass(frozen=True)
class _Block:
    """Sums (P + 1, P + 1) of a block of frames: with the mocap exact, and with its noise integrated out."""

    exact: FloatArray
    noisy: FloatArray


@dataclass(frozen=True)
class HoldOut:
    """Sums of blocks of time, from which each block's error is predicted.

    n_corners: of all blocks. sigma_px: that the sums are whitened by. exact_information, noisy_information:
        (P + 1, P + 1) of the priors, as each estimate weighs them."""

    blocks: tuple[_Block, ...]
    n_corners: int
    sigma_px: float
    exact_information: FloatArray
    noisy_information: FloatArray

    @property
    def exact_rmse_px(self) -> float:
        """Pooled hold-out RMSE of an estimate that takes the mocap as exact."""
        return self._rmse_px(self._exact_squares)

    @property
    def noisy_rmse_px(self) -> float:
        """... of an estimate that models its noise; the frame that is predicted has the mocap's pose all the same."""
        return self._rmse_px(self._noisy_squares)

    @property
    def noisy_worse_by_sigmas(self) -> float:
        """By how many standard errors, over the blocks, the modelled noise makes the prediction worse."""
        difference = self._noisy_squares - self._exact_squares
        spread = float(difference.std(ddof=1)) / np.sqrt(len(difference))
        return float(difference.mean()) / spread if spread > 0.0 else 0.0

    @cached_property
    def _exact_squares(self) -> FloatArray:
        return self._squares([block.exact for block in self.blocks], self.exact_information)

    @cached_property
    def _noisy_squares(self) -> FloatArray:
        return self._squares([block.noisy for block in self.blocks], self.noisy_information)

    def _squares(self, learnt: list[FloatArray], information: FloatArray) -> FloatArray:
        """(k,) summed squares of each block, predicted by what the others taught."""
        total = information + np.sum(learnt, axis=0)
        squares = []
        for block, own in zip(self.blocks, learnt, strict=True):
            others = total - own
            change = np.append(-np.linalg.lstsq(others[:-1, :-1], others[:-1, -1], rcond=1e-12)[0], 1.0)
            squares.append(float(change @ block.exact @ change))
        return np.array(squares)

    def _rmse_px(self, squares: FloatArray) -> float:
        return self.sigma_px * float(np.sqrt(squares.sum() / self.n_corners))


def hold_out(
    views: Mapping[str, Views],
    estimate: Estimate,
    noise: MocapNoiseModel,
    motion: RefMotion,
    *,
    sigma_px: float,
    free_theta: bool,
    free_shape: bool = False,
    information: FloatArray,
    exact_information: FloatArray,
) -> HoldOut:
    """The sums of ``FOLDS`` blocks of time round an estimate, of each at most ``MOST_IN_FOLD`` frames; of as many
    blocks as there are frames, where these are fewer.
    information, exact_information: of the priors, as an estimate weighs them that models the mocap's noise, and one
    that does not."""
    frames = frames_of(views)
    folds = [fold[:MOST_IN_FOLD] for fold in np.array_split(frames, min(FOLDS, len(frames)))]
    blocks = []
    for block in folds:
        exact, noisy = np.zeros_like(information), np.zeros_like(information)
        for moments in in_parts(
            views, estimate, block, sigma_px=sigma_px, free_theta=free_theta, free_shape=free_shape
        ):
            covariance = noise.covariance(motion, moments.stamps_ns)
            rho = noise.correlations(moments.stamps_ns)
            eliminate_noise(moments.moments, lower_factors(covariance), rho, noisy)
            exact += moments.exact.sum(axis=0)
        blocks.append(_Block(exact, np.triu(noisy) + np.triu(noisy, 1).T))
    n_corners = n_corners_of(views, np.concatenate(folds))
    return HoldOut(tuple(blocks), n_corners, sigma_px, exact_information, information)
