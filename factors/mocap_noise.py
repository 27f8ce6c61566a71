"""The prior of neighbouring frames whose mocap noise is correlated in time.

The noise of frame f is xi_f = Log(M_f^-1 A_f), M_f the mocap's pose; whitened, z_f = W_f xi_f. As a first-order
(Gauss-Markov) process z_g - rho z_f has the variance 1 - rho^2.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np

from factors.reprojection import Jacobians
from factors.reprojection_kernels import FloatArray


class CorrelatedNoiseFactor(gtsam.CustomFactor):
    """(W_g Log(M_g^-1 A_g) - rho W_f Log(M_f^-1 A_f)) / sqrt(1 - rho^2), six rows of unit variance.

    keys: of the Pose3 variables A_f and A_g, the earlier one first. measured: M_f, M_g, (4, 4) each. whitening: W_f,
    W_g, (6, 6) each. rho: their correlation, 0 <= rho < 1.

    Raises ValueError for another rho."""

    def __init__(
        self,
        keys: tuple[int, int],
        measured: tuple[FloatArray, FloatArray],
        whitening: tuple[FloatArray, FloatArray],
        rho: float,
    ) -> None:
        if not 0.0 <= rho < 1.0:
            raise ValueError(f"{rho=}, expected 0 <= rho < 1")
        scale = 1.0 / math.sqrt(1.0 - rho * rho)
        weights = -rho * scale * whitening[0], scale * whitening[1]
        inverses = [gtsam.Pose3(pose).inverse() for pose in measured]

        def residual(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Jacobians) -> FloatArray:
            total = np.zeros(6)
            for i, key in enumerate(keys):
                xi = gtsam.Pose3.Logmap(inverses[i].compose(values.atPose3(key)))
                total += weights[i] @ xi
                if jacobians is not None:
                    jacobians[i] = np.asfortranarray(weights[i] @ gtsam.Pose3.LogmapDerivative(xi))
            return total

        super().__init__(None, list(keys), residual)  # type: ignore[call-overload]
