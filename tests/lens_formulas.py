"""Lenses by the formulas of their papers, apart from gtcal's kernels: points (N, 3) to (u, v) / (x, y), (N,)."""

import numpy as np


def double_sphere_m(points: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Usenko, Demmel and Cremers 2018, equations 40 to 42."""
    xi, alpha = theta[4:]
    d1 = np.linalg.norm(points, axis=1)
    d2 = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + (xi * d1 + points[:, 2]) ** 2)
    return 1.0 / (alpha * d2 + (1 - alpha) * (xi * d1 + points[:, 2]))


def extended_unified_m(points: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Khomutenko, Garcia and Martinet 2016, equation 12."""
    alpha, beta = theta[4:]
    d = np.sqrt(beta * (points[:, 0] ** 2 + points[:, 1] ** 2) + points[:, 2] ** 2)
    return 1.0 / (alpha * d + (1 - alpha) * points[:, 2])
