"""The noise of successive poses, integrated out of the sums of what the poses were seen to do.

The noise of frame f is xi_f = L_f z_f with z_f of unit covariance, correlated from frame to frame as a first-order
(Gauss-Markov) process: z_{f+1} = rho_f z_f + sqrt(1 - rho_f^2) w. Eliminating the z_f in order of time (an information
filter) leaves the sums of the other unknowns, and the determinant that a likelihood needs; going back through the
frames gives the z_f of any values of the other unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.kernel import kernel

FloatArray = npt.NDArray[np.float64]


@kernel
def _factorise(A: FloatArray) -> float:
    """Replace the upper triangle of A = R^T R by R; returns log det A."""
    log_determinant = 0.0
    for i in range(len(A)):
        for j in range(i, len(A)):
            value = A[i, j]
            for k in range(i):
                value -= A[k, i] * A[k, j]
            A[i, j] = math.sqrt(value) if i == j else value / A[i, i]
        log_determinant += 2.0 * math.log(A[i, i])
    return log_determinant


@kernel
def _solve_transposed(R: FloatArray, B: FloatArray) -> None:
    """B = R^-T B."""
    for i in range(len(R)):
        for k in range(i):
            for j in range(B.shape[1]):
                B[i, j] -= R[k, i] * B[k, j]
        for j in range(B.shape[1]):
            B[i, j] /= R[i, i]


@kernel
def _solve(R: FloatArray, B: FloatArray) -> None:
    """B = R^-1 B."""
    for i in range(len(R) - 1, -1, -1):
        for k in range(i + 1, len(R)):
            for j in range(B.shape[1]):
                B[i, j] -= R[i, k] * B[k, j]
        for j in range(B.shape[1]):
            B[i, j] /= R[i, i]


@kernel
def _to_noise(M: FloatArray, L: FloatArray, A: FloatArray, B: FloatArray) -> None:
    """Add a frame's moments in z, where its noise is xi = L z: L^T M_xx L to A, L^T M_x,rest to B."""
    for i in range(6):
        for j in range(6):
            value = 0.0
            for k in range(i, 6):
                for m in range(j, 6):
                    value += L[k, i] * M[k, m] * L[m, j]
            A[i, j] += value
        for k in range(i, 6):
            for j in range(B.shape[1]):
                B[i, j] += L[k, i] * M[k, 6 + j]


@kernel
def _eliminate(
    moments: FloatArray,
    L: FloatArray,
    rho: FloatArray,
    prior: FloatArray,
    carried: FloatArray,
    known: FloatArray,
    triangles: FloatArray,
) -> float:
    """Fill known (n, 6, D - 6) with R^-T B of each frame and triangles (n, 6, 6) with R, where [R^T R, B] are the
    moments of its noise in z, and of what the chain before it says of it, with the rest: the squares of known are what
    integrating it out takes away. prior (6, 6) and carried (6, D - 6): what the chain says of the first frame's z, and
    after, of the one that follows the last. Returns the log determinant."""
    A, inverse, unit = np.empty((6, 6)), np.empty((6, 6)), np.eye(6)
    log_determinant = 0.0
    for f in range(len(moments)):
        innovation = 1.0 - rho[f] * rho[f]
        forward = rho[f] / innovation
        B = known[f]
        A[:], B[:] = prior, carried
        _to_noise(moments[f], L[f], A, B)
        for i in range(6):
            A[i, i] += rho[f] * forward
        log_determinant += _factorise(A) + 6.0 * math.log(innovation)
        _solve_transposed(A, B)
        triangles[f] = A
        prior[:], carried[:] = unit, 0.0
        if forward > 0.0:
            carried[:] = B
            _solve(A, carried)
            carried *= forward
            inverse[:] = unit
            _solve_transposed(A, inverse)
            _solve(A, inverse)
            prior[:] = unit / innovation - forward * forward * inverse
    return log_determinant


@kernel
def _substitute(
    triangles: FloatArray, known: FloatArray, rho: FloatArray, rest: FloatArray, following: FloatArray, z: FloatArray
) -> None:
    """Fill z (n, 6) with the frames' noise where the other unknowns and the residual are ``rest`` (D - 6,); following:
    (6,) the z of the frame after the last, and after, of the first."""
    right = np.empty((6, 1))
    for f in range(len(known) - 1, -1, -1):
        forward = rho[f] / (1.0 - rho[f] * rho[f])
        for i in range(6):
            right[i, 0] = forward * following[i]
        _solve_transposed(triangles[f], right)
        for i in range(6):
            for j in range(len(rest)):
                right[i, 0] -= known[f, i, j] * rest[j]
        _solve(triangles[f], right)
        following[:] = z[f] = right[:, 0]


@dataclass
class NoiseChain:
    """Frames in order of time whose noise is being eliminated, some hundreds at a call.

    known: (n, 6, K) and triangles: (n, 6, 6) of the frames eliminated so far, K unknowns and the residual beside the
    noise; n_frames: how many. prior (6, 6), carried (6, K): what these say of the next frame's z."""

    known: FloatArray
    triangles: FloatArray
    prior: FloatArray
    carried: FloatArray
    n_frames: int = 0

    @staticmethod
    def starting(n_frames: int, n_rest: int) -> NoiseChain:
        """With room for so many frames, and so many unknowns with the residual."""
        return NoiseChain(np.empty((n_frames, 6, n_rest)), np.empty((n_frames, 6, 6)), np.eye(6), np.zeros((6, n_rest)))

    def eliminate(self, moments: FloatArray, L: FloatArray, rho: FloatArray) -> float:
        """Take in the next frames. moments: (m, 6 + K, 6 + K) [J r]^T [J r], the columns of their poses first. L:
        (m, 6, 6) lower factor of each frame's noise covariance. rho: (m,) correlation of a frame's noise with the next
        one's; 0 cuts the chain. Returns the log determinant of what was integrated out, relative to the noise's own."""
        rows = slice(self.n_frames, self.n_frames + len(moments))
        self.n_frames = rows.stop
        found: float = _eliminate(moments, L, rho, self.prior, self.carried, self.known[rows], self.triangles[rows])
        return found

    @property
    def known_square(self) -> FloatArray:
        """(K, K): what integrating the noise out takes from the sums of the rest."""
        known = self.known[: self.n_frames].reshape(-1, self.known.shape[2])
        return np.asarray(known.T @ known)

    def noise_at(self, rho: FloatArray, rest: FloatArray) -> FloatArray:
        """(n, 6) the z of all frames where the other unknowns are as in ``rest`` (K,), whose last is 1."""
        z = np.empty((self.n_frames, 6))
        _substitute(self.triangles, self.known, rho, rest, np.zeros(6), z)
        return z
