"""What the data say of an effect: its size, whether it is chance, what it does to the result and to unseen frames.

From sums of stretches of time, of the calibration's unknowns, of all effects' columns and of the residual, every effect
is solved for with what it may be taken for. Its probability of chance is the larger of two: by the model of the noise,
and by how the stretches really scatter (a sandwich; Hotelling's T^2), which needs no model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy import special

from gtcal.camera import FloatArray
from gtcal.effects.effect import Effect
from gtcal.effects.frames import Frames
from gtcal.estimation.linear import summed_by_run
from gtcal.recordings.detections import IntArray

FOLDS = 10

_OPEN = 1e-9
_LARGEST_LEVERAGE = 0.999


@dataclass(frozen=True)
class Evidence:
    """Of one effect with k parameters. estimate: (k,). covariance: (k, k), the model's, or as much larger as the
    stretches scatter by. p_value: not corrected. worth: by how much the weighted squares fall, less a charge for its k
    parameters (BIC). hold_out_px: RMSE of unseen blocks without it; hold_out_drop_px: by how much it falls. shift: (F,)
    by how much the unknowns change if the effect is let in; moves: by camera, (6,) of these."""

    estimate: FloatArray
    covariance: FloatArray
    p_value: float
    worth: float
    hold_out_px: float
    hold_out_drop_px: float
    shift: FloatArray
    moves: dict[str, FloatArray]


@dataclass(frozen=True)
class Sums:
    """noisy, exact: (G, m + 1, m + 1) of stretches of time, with the mocap's noise integrated out and without; columns
    the F unknowns, those of each effect, the residual. columns: of each effect. information: (m + 1, m + 1)."""

    frames: Frames
    noisy: FloatArray
    exact: FloatArray
    columns: tuple[IntArray, ...]
    information: FloatArray
    known: dict[tuple[int, ...], tuple[FloatArray, float]] = field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def of(frames: Frames, effects: Sequence[Effect]) -> Sums:
        images = [effect.columns(frames) for effect in effects]
        image = np.concatenate(images, axis=2) if images else np.zeros((len(frames.stamps_ns), frames.n_columns, 0))
        edges = len(frames.free) + np.concatenate([[0], np.cumsum([part.shape[2] for part in images])]).astype(np.int64)
        information = np.zeros((int(edges[-1]) + 1,) * 2)
        kept = np.concatenate([np.arange(len(frames.free)), [int(edges[-1])]])
        information[np.ix_(kept, kept)] = frames.information
        return Sums(
            frames,
            _summed(frames, frames.marginal, image),
            _summed(frames, frames.moments, image),
            tuple(np.arange(a, b) for a, b in pairwise(edges)),
            information,
        )

    def evidence(self, effect: int, given: Sequence[int] = (), *, from_stated: bool = False) -> Evidence:
        """Of an effect, with those ``given`` let in too. from_stated: the moves are those from the calibration's own
        estimate, which screened views, and not from what these frames say without the effect."""
        base = np.concatenate([np.arange(len(self.frames.free)), *(self.columns[g] for g in given)])
        chosen = np.concatenate([base, self.columns[effect]])
        k = len(self.columns[effect])
        without, hold_out_px = self._without(tuple(base))
        solved, model, sandwich = self.solution(chosen)
        estimate, model, sandwich = solved[-k:], model[-k:, -k:], sandwich[-k:, -k:]
        p_value = max(_p_of_model(estimate, model), _p_of_scatter(estimate, sandwich, len(self.noisy)))
        moved = solved - (0.0 if from_stated else np.pad(without, (0, k)))
        return Evidence(
            estimate,
            _larger(model, sandwich),
            p_value,
            _square(estimate, model) - k * float(np.log(len(self.frames.stamps_ns))),
            hold_out_px,
            hold_out_px - self._hold_out_px(chosen),
            moved[: len(self.frames.free)],
            {name: moved[6 + 6 * c : 12 + 6 * c] for c, name in enumerate(self.frames.cameras)},
        )

    def _without(self, base: tuple[int, ...]) -> tuple[FloatArray, float]:
        """The unknowns ``base`` and their hold-out error: once for all effects that are tried on top of them."""
        if base not in self.known:
            chosen = np.array(base, dtype=np.int64)
            parts, prior = self.noisy[:, chosen].sum(axis=0), self.information[chosen]
            covariance = _inverse(parts[:, chosen] + prior[:, chosen])
            self.known[base] = -covariance @ (parts[:, -1] + prior[:, -1]), self._hold_out_px(chosen)
        return self.known[base]

    def solution(self, chosen: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The unknowns ``chosen`` (u,), with their covariances (u, u) by the model and by the scatter."""
        noisy, prior = self.noisy[:, chosen], self.information[chosen]
        parts, gradients = noisy[:, :, chosen], noisy[:, :, -1]
        H = parts.sum(axis=0) + prior[:, chosen]
        covariance = _inverse(H)
        solved = -covariance @ (gradients.sum(axis=0) + prior[:, -1])
        scores = _corrected(covariance, parts, gradients + parts @ solved)
        scatter = scores.T @ scores + covariance @ prior[:, chosen] @ covariance
        return solved, covariance, scatter

    def _hold_out_px(self, chosen: IntArray) -> float:
        """RMSE of blocks of time that the others predict, as in ``gtcal.estimation.hold_out``."""
        kept = np.append(chosen, self.noisy.shape[1] - 1)
        fold = np.arange(len(self.noisy)) * FOLDS // len(self.noisy)
        total = (self.noisy.sum(axis=0) + self.information)[np.ix_(kept, kept)]
        square = 0.0
        for block in range(FOLDS):
            rows = fold == block
            others = total - self.noisy[rows].sum(axis=0)[np.ix_(kept, kept)]
            change = np.append(-np.linalg.lstsq(*_scaled(others), rcond=1e-12)[0] * _scale(others), 1.0)
            square += float(change @ self.exact[rows].sum(axis=0)[np.ix_(kept, kept)] @ change)
        return self.frames.sigma_px * float(np.sqrt(max(square, 0.0) / self.frames.n_corners))


def _summed(frames: Frames, moments: FloatArray, image: FloatArray) -> FloatArray:
    """(G, m + 1, m + 1) of the stretches."""
    kept = np.append(frames.free, frames.n_columns)
    crossed = moments[:, :, :-1] @ image
    F, K = len(frames.free), image.shape[2]
    whole = np.empty((len(moments), F + K + 1, F + K + 1))
    order = np.append(np.arange(F), F + K)
    whole[:, order[:, None], order] = moments[:, kept[:, None], kept]
    whole[:, order, F : F + K] = crossed[:, kept]
    whole[:, F : F + K, order] = np.swapaxes(crossed[:, kept], 1, 2)
    whole[:, F : F + K, F : F + K] = np.swapaxes(image, 1, 2) @ crossed[:, :-1]
    return summed_by_run(whole, frames.cluster)


def _corrected(covariance: FloatArray, parts: FloatArray, gradients: FloatArray) -> FloatArray:
    """(G, u) what each stretch's gradient at the solution moves the solution by, amplified by what the solution was
    fitted to it (CR2, as in ``gtcal.estimation.clustered``): a stretch that alone determines an effect tells nothing of
    how well it fits."""
    scale = np.sqrt(np.diag(covariance))
    root = scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale))
    leverage, axes = np.linalg.eigh(root.T @ parts @ root)
    amplified = 1.0 / np.sqrt(1.0 - np.clip(leverage, 0.0, _LARGEST_LEVERAGE))
    in_axes = amplified * np.einsum("gpk,gp->gk", axes, gradients @ root)
    return np.einsum("gpk,gk->gp", axes, in_axes) @ root.T


def _scale(square: FloatArray) -> FloatArray:
    """(u,) that brings an information's diagonal to one."""
    diagonal = np.diag(square)[:-1]
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def _scaled(square: FloatArray) -> tuple[FloatArray, FloatArray]:
    scale = _scale(square)
    return square[:-1, :-1] * np.outer(scale, scale), square[:-1, -1] * scale


def _inverse(H: FloatArray) -> FloatArray:
    """Of an information that may leave directions open: these get a huge variance."""
    scale = 1.0 / np.sqrt(np.where(np.diag(H) > 0.0, np.diag(H), 1.0))
    unit = H * np.outer(scale, scale) + _OPEN * np.eye(len(H))
    return np.asarray(np.linalg.inv(unit) * np.outer(scale, scale))


def _p_of_model(estimate: FloatArray, covariance: FloatArray) -> float:
    return float(special.chdtrc(len(estimate), _square(estimate, covariance)))


def _p_of_scatter(estimate: FloatArray, covariance: FloatArray, count: int) -> float:
    """Of Hotelling's T^2 over ``count`` stretches."""
    k = len(estimate)
    if count <= k + 1:
        return 1.0
    return float(special.fdtrc(k, count - k, _square(estimate, covariance) * (count - k) / (k * (count - 1.0))))


def _square(estimate: FloatArray, covariance: FloatArray) -> float:
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return float(
        (estimate * scale) @ np.linalg.lstsq(covariance * np.outer(scale, scale), estimate * scale, rcond=1e-12)[0]
    )


def _larger(model: FloatArray, scatter: FloatArray) -> FloatArray:
    """The model's covariance, or where the stretches scatter by more, as much more."""
    root = np.sqrt(np.outer(np.diag(model), np.diag(model)))
    ratio = np.trace(np.linalg.lstsq(model / root, scatter / root, rcond=1e-12)[0]) / len(model)
    return max(float(ratio), 1.0) * model
