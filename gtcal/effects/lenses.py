"""Each camera's intrinsics, where they are taken as stated: focal length, principal point, distortion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.effects.effect import length, single
from gtcal.effects.frames import Frames
from gtcal.results.effect_finding import Moment, Quantity


@dataclass(frozen=True)
class FocalLength:
    """Both focal lengths of a camera, by a share."""

    camera: str
    moment: Moment | None = None
    advice: str = "--refine-intrinsics solves for the intrinsics too"

    @property
    def name(self) -> str:
        return f"focal length of {self.camera}"

    @property
    def what(self) -> str:
        return f"the focal length of camera {self.camera!r} is another than stated"

    def columns(self, frames: Frames) -> FloatArray:
        columns = np.zeros((len(frames.stamps_ns), frames.n_columns, 1))
        start = frames.columns_of_theta(self.camera).start
        columns[:, start : start + 2, 0] = frames.estimate.theta[self.camera][:2]
        return columns

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 100.0, "%")


@dataclass(frozen=True)
class PrincipalPoint:
    """Of a camera."""

    camera: str
    moment: Moment | None = None
    advice: str = "--refine-intrinsics solves for the intrinsics too"

    @property
    def name(self) -> str:
        return f"centre of {self.camera}"

    @property
    def what(self) -> str:
        return f"the principal point of camera {self.camera!r} is another than stated"

    def columns(self, frames: Frames) -> FloatArray:
        start = frames.columns_of_theta(self.camera).start + 2
        return _picked(frames, np.arange(start, start + 2))

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return (length("", estimate, covariance, 1.0, "px"),)


@dataclass(frozen=True)
class Distortion:
    """All coefficients of a camera. root: (k, k), the columns of which are scaled to move its corners by 1 px rms."""

    camera: str
    stated: bool
    root: FloatArray
    moment: Moment | None = None
    advice: str = "--refine-intrinsics solves for the intrinsics too"

    @property
    def name(self) -> str:
        return f"distortion of {self.camera}"

    @property
    def what(self) -> str:
        if not self.stated:
            return f"the lens of camera {self.camera!r} is given without distortion, but has some"
        return f"the distortion of camera {self.camera!r} is another than stated"

    def columns(self, frames: Frames) -> FloatArray:
        return _picked(frames, _coefficients(frames, self.camera)) @ self.root

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return (length("corners move by", estimate, covariance, 1.0, "px rms"),)


def _picked(frames: Frames, tangents: FloatArray) -> FloatArray:
    columns = np.zeros((len(frames.stamps_ns), frames.n_columns, len(tangents)))
    columns[:, tangents, np.arange(len(tangents))] = 1.0
    return columns


def _coefficients(frames: Frames, camera: str) -> FloatArray:
    of_theta = frames.columns_of_theta(camera)
    return np.arange(of_theta.start + 4, of_theta.stop)


def _to_px(frames: Frames, camera: str) -> FloatArray:
    """(k, k) root with root root^T the inverse of the mean square that the coefficients move the camera's corners by;
    combinations that move none are left out."""
    tangents = _coefficients(frames, camera)
    views = frames.views[camera]
    square = frames.moments[:, tangents[:, None], tangents].sum(axis=0) * frames.sigma_px**2 / views.n_corners
    scale = 1.0 / np.sqrt(np.where(np.diag(square) > 0.0, np.diag(square), 1.0))
    values, vectors = np.linalg.eigh(square * np.outer(scale, scale))
    kept = values > 1e-6 * values[-1]
    return np.asarray(scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))


def lens_effects(frames: Frames) -> Iterator[FocalLength | PrincipalPoint | Distortion]:
    """Of all cameras."""
    for name in frames.cameras:
        yield FocalLength(name)
        yield PrincipalPoint(name)
        root = _to_px(frames, name)
        if root.shape[1]:
            yield Distortion(name, bool(frames.estimate.theta[name][4:].any()), root)
