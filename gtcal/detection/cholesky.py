"""Small symmetric systems of equations inside kernels, where a call of LAPACK takes longer than the arithmetic."""

from __future__ import annotations

import math

from factors.kernel import kernel


@kernel
def solve_in_place(matrix, vector):  # type: ignore[no-untyped-def]
    """Solve in place by Cholesky on the lower triangle. False where the matrix isn't positive definite."""
    n = len(vector)
    for j in range(n):
        for i in range(j, n):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = rest / matrix[j, j]
            elif not rest > 0.0:
                return False
            else:
                matrix[j, j] = math.sqrt(rest)
    for i in range(n):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]
    return True
