"""Products of quaternions (wxyz) as matrices."""

from __future__ import annotations

import numpy as np

from gtcal.camera import FloatArray


def left_product(quats: FloatArray) -> FloatArray:
    """(..., 4, 4) L with L(p) q = p q, of p (..., 4)."""
    w, x, y, z = np.moveaxis(quats, -1, 0)
    return np.stack(
        [
            np.stack([w, -x, -y, -z], axis=-1),
            np.stack([x, w, -z, y], axis=-1),
            np.stack([y, z, w, -x], axis=-1),
            np.stack([z, -y, x, w], axis=-1),
        ],
        axis=-2,
    )


def right_product(quats: FloatArray) -> FloatArray:
    """(..., 4, 4) R with R(q) p = p q, of q (..., 4)."""
    w, x, y, z = np.moveaxis(quats, -1, 0)
    return np.stack(
        [
            np.stack([w, -x, -y, -z], axis=-1),
            np.stack([x, w, z, -y], axis=-1),
            np.stack([y, -z, w, x], axis=-1),
            np.stack([z, y, -x, w], axis=-1),
        ],
        axis=-2,
    )
