"""The one way this package compiles its scalar kernels."""

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile ``function`` with numba: cached on disk, without the GIL, IEEE division, fused multiply-add."""
    return _compiled(function, cache=True)


def reordered(function: F) -> F:
    """Like ``kernel``, with sums in any order: for long sums of products, which vectors of the processor then take
    several terms of at a time."""
    jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
    return cast(F, jit(function))


def inlined(function: F) -> F:
    """Like ``kernel``, and pasted into its callers: for the innermost functions, where a call with array
    arguments would cost more than the arithmetic."""
    return cast(F, numba.njit(inline="always", error_model="numpy", fastmath={"contract"})(function))


def kernel_with(function: F, name: str, parts: Mapping[str, Any], *, cache: bool) -> F:
    """A ``kernel`` of its own in which the global names of ``parts`` are these. name: tells it from others of the same
    function in the cache on disk, which knows nothing of the parts: no two of one name may differ."""
    return _compiled(_bound(function, name, parts), cache=cache)


def inlined_with(function: F, name: str, parts: Mapping[str, Any]) -> F:
    """The same, ``inlined``."""
    return inlined(_bound(function, name, parts))


def unbound(*arguments: Any) -> Any:
    """What a template's name stands for until it is bound."""
    raise NotImplementedError("a template is not called: bind its names by kernel_with")


def _compiled(function: F, *, cache: bool) -> F:
    return cast(F, numba.njit(cache=cache, nogil=True, error_model="numpy", fastmath={"contract"})(function))


def _bound(function: F, name: str, parts: Mapping[str, Any]) -> F:
    plain = cast(FunctionType, function)
    bound = FunctionType(plain.__code__, {**plain.__globals__, **parts}, plain.__name__)
    bound.__qualname__, bound.__module__ = f"{plain.__qualname__}_{name}", plain.__module__
    return cast(F, bound)
