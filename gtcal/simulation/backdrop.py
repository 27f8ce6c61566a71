"""The room behind the board: a smooth pattern on the sphere of directions, seen as the camera turns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel
from gtcal.camera import FloatArray

GreyPicture = npt.NDArray[np.float32]

_SIDE = 512  # texels along the side of the picture: a third of a degree each
_WAVES_PER_SCALE, _SCALES = 16, (2.0, 5.0, 12.0, 30.0)  # radians of phase per radian of direction


def room(rng: np.random.Generator) -> GreyPicture:
    """A picture of the room in shares of white, over the octahedral map of all directions: patches large and
    small, some with crisp borders, none as sharp or as bright as the print."""
    directions = _octahedral_directions()
    brightness = np.zeros(len(directions), dtype=np.float32)
    for scale in _SCALES:
        waves = scale * rng.standard_normal((_WAVES_PER_SCALE, 3))
        phases = rng.uniform(-np.pi, np.pi, _WAVES_PER_SCALE)
        weight = 1.0 / (np.sqrt(_WAVES_PER_SCALE) * np.sqrt(scale))
        brightness += weight * np.cos((directions @ waves.T + phases).astype(np.float32)).sum(axis=1)
    crisp = np.tanh(4.0 * brightness)
    return (0.36 + 0.1 * crisp + 0.12 * brightness).clip(0.05, 0.8).reshape(_SIDE, _SIDE).astype(np.float32)


def _octahedral_directions() -> FloatArray:
    """(N, 3) the direction of each texel."""
    u, v = np.meshgrid(*[(np.arange(_SIDE) + 0.5) / _SIDE * 2.0 - 1.0] * 2)
    z = 1.0 - np.abs(u) - np.abs(v)
    folded = np.maximum(-z, 0.0)
    directions = np.stack([u - np.sign(u) * folded, v - np.sign(v) * folded, z], axis=-1).reshape(-1, 3)
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


@kernel
def brightness_towards(picture: GreyPicture, x: float, y: float, z: float) -> float:
    """The room's brightness in a direction of the world, of any length but 0."""
    total = abs(x) + abs(y) + abs(z)
    u, v = x / total, y / total
    if z < 0.0:
        folded_u = (1.0 - abs(v)) * (1.0 if u >= 0.0 else -1.0)
        folded_v = (1.0 - abs(u)) * (1.0 if v >= 0.0 else -1.0)
        u, v = folded_u, folded_v
    side = len(picture)
    column = min(max((0.5 * u + 0.5) * side - 0.5, 0.0), side - 1.001)
    row = min(max((0.5 * v + 0.5) * side - 0.5, 0.0), side - 1.001)
    i, j = int(column), int(row)
    across, down = column - i, row - j
    upper = picture[j, i] * (1.0 - across) + picture[j, i + 1] * across
    lower = picture[j + 1, i] * (1.0 - across) + picture[j + 1, i + 1] * across
    return upper * (1.0 - down) + lower * down
