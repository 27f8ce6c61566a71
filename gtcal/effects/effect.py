"""What an effect is: a few columns that are linear images of the frames' tangents."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from gtcal.camera import FloatArray
from gtcal.effects.frames import Frames
from gtcal.results.effect_finding import Moment, Quantity


class Effect(Protocol):
    """An effect with k parameters. To add one: say how it moves the tangents, and what its parameters are in words.

    name, what, advice: as of an ``EffectFinding``."""

    @property
    def name(self) -> str: ...

    @property
    def what(self) -> str: ...

    @property
    def advice(self) -> str: ...

    @property
    def moment(self) -> Moment | None: ...

    def columns(self, frames: Frames) -> FloatArray:
        """(n, D - 1, k) by how much a unit of each parameter moves the tangents of each frame."""
        ...

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        """The parameters (k,) with their covariance (k, k), for people."""
        ...


def length(name: str, components: FloatArray, covariance: FloatArray, scale: float, unit: str) -> Quantity:
    """The norm of components with its 1-sigma along them."""
    norm = float(np.linalg.norm(components))
    along = components / norm if norm > 0.0 else np.full(len(components), len(components) ** -0.5)
    return Quantity(name, scale * norm, scale * float(np.sqrt(max(float(along @ covariance @ along), 0.0))), unit)


def single(estimate: FloatArray, covariance: FloatArray, scale: float, unit: str) -> tuple[Quantity, ...]:
    """An effect of one parameter."""
    return (Quantity("", scale * float(estimate[0]), scale * float(np.sqrt(covariance[0, 0])), unit),)
