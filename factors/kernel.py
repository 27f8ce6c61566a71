"""The one way this package compiles its scalar kernels."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile ``function`` with numba: cached on disk, without the GIL, IEEE division, fused multiply-add."""
    jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
    return cast(F, jit(function))


def reordered(function: F) -> F:
    """Like ``kernel``, with sums in any order: for long sums of products, which vectors of the processor then take
    several terms of at a time."""
    jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
    return cast(F, jit(function))


def inlined(function: F) -> F:
    """Like ``kernel``, and pasted into its callers: for the innermost functions, where a call with array
    arguments would cost more than the arithmetic."""
    return cast(F, numba.njit(inline="always", error_model="numpy", fastmath={"contract"})(function))
