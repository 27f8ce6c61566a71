"""Residuals of which only their sums are known: what is left when other unknowns are integrated out of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import gtsam
import numpy as np

from factors.moments import FloatArray, triangular_factor
from factors.reprojection import Jacobians


class MarginalFactor(gtsam.CustomFactor):
    """Many residuals as one factor, by the sums [J r]^T [J r] that ``moments`` gives of values.

    keys: of the variables; sizes: of their tangents. moments: (D + 1, D + 1), columns those tangents in the order of
    the keys, then the residual. The Jacobian handed to GTSAM is its triangular factor; a value-only call returns one
    entry, the root of the summed square."""

    def __init__(
        self, keys: Sequence[int], sizes: Sequence[int], moments: Callable[[gtsam.Values], FloatArray]
    ) -> None:
        edges = np.concatenate([[0], np.cumsum(sizes)])

        def residual(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
            sums = moments(values)
            if jacobians is None:
                return np.array([math.sqrt(max(sums[-1, -1], 0.0))])
            triangle = triangular_factor(sums)
            for i in range(len(keys)):
                jacobians[i] = np.asfortranarray(triangle[:, edges[i] : edges[i + 1]])
            return triangle[:, -1]

        super().__init__(None, list(keys), residual)  # type: ignore[call-overload]
