"""Rigid transforms as (..., 4, 4) arrays."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import FloatArray


def transform(rotation: Rotation, translation_m: FloatArray) -> FloatArray:
    """(4, 4) of one rotation and translation (3,), or (N, 4, 4) of N of them."""
    matrices = np.broadcast_to(np.eye(4), (*np.shape(translation_m)[:-1], 4, 4)).copy()
    matrices[..., :3, :3] = rotation.as_matrix()
    matrices[..., :3, 3] = translation_m
    return matrices


def apply(a_T_b: FloatArray, points_in_b: FloatArray) -> FloatArray:
    """Points (P, 3) in frame b through transforms (..., 4, 4): (..., P, 3) in frame a."""
    return points_in_b @ np.swapaxes(a_T_b[..., :3, :3], -1, -2) + a_T_b[..., None, :3, 3]


def random_transform(rng: np.random.Generator, shift_m: float) -> FloatArray:
    """(4, 4) of a rotation that is uniform over all rotations, and a translation of length ``shift_m``."""
    direction = rng.standard_normal(3)
    return transform(Rotation.random(rng=rng), shift_m * direction / np.linalg.norm(direction))
