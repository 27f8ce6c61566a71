"""Types of a command's options as tyro checks them by itself.

Whether a default is of its type tyro asks typeguard for ``X | None`` and for tuples, and the import of that is a third
of the time until a command's help is there. A typing.Union it takes apart by itself, and ends at the first type that
fits; a tuple it takes for any object, told how to read it.
"""

from __future__ import annotations

from collections.abc import Callable
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from tyro.constructors import ConstructorRegistry, PrimitiveTypeInfo


def lightly_typed(function: Callable[..., object]) -> Callable[..., object]:
    """The function, its options of types that need no typeguard."""
    hints = get_type_hints(function, include_extras=True)
    function.__annotations__ = {name: _light(hint) for name, hint in hints.items()}
    return function


def _light(hint: Any) -> Any:
    if get_origin(hint) is Annotated:
        return Annotated[(_light(hint.__origin__), *hint.__metadata__)]
    if get_origin(hint) in (Union, UnionType) and NoneType in get_args(hint):
        return Union[(None, *(one for one in get_args(hint) if one is not NoneType))]
    if get_origin(hint) is tuple:
        return Annotated[object, ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(hint, set()))]
    return hint
