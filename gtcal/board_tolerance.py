"""How near a board is to what is stated of it, as far as anybody knows before calibrating."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError

PRINTED_SCALE = 1e-3
"""1-sigma of the size of a printed board that was measured with a ruler, and of one axis against the other: half a
millimetre on half a metre."""

PRINTED_FLATNESS = 1e-3
"""1-sigma of a bow or twist of a board that was glued to a plate, as a share of its side."""


@dataclass(frozen=True)
class BoardTolerance:
    """scale_sigma: 1-sigma of the board's size, as a share of it, and of one axis against the other. flatness_mm:
    1-sigma of its bow along each axis and of its twist. None for those of a board that was printed and glued.

    Raises GtcalError for a number that is not positive."""

    scale_sigma: float | None = None
    flatness_mm: float | None = None

    def __post_init__(self) -> None:
        for name in ("scale_sigma", "flatness_mm"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise GtcalError(f"board.{name}: {value} is not a positive number")

    def shape_sigmas(self, outline_m: FloatArray) -> FloatArray:
        """(5,) of the shape (``factors.board_shape``) of a board with this outline (4,)."""
        scale = PRINTED_SCALE if self.scale_sigma is None else self.scale_sigma
        sides_m = 2.0 * outline_m[2:]
        bows_m = PRINTED_FLATNESS * np.append(sides_m, sides_m.max())
        if self.flatness_mm is not None:
            bows_m = np.full(3, 1e-3 * self.flatness_mm)
        return np.concatenate([[scale, scale], bows_m])


def tolerance_of(block: Mapping[str, Any]) -> tuple[dict[str, Any], BoardTolerance]:
    """A manifest's ``board`` block without its tolerance, and that.

    Raises GtcalError for a number that is none, or not positive."""
    rest, given = dict(block), {}
    for field in fields(BoardTolerance):
        if field.name not in rest:
            continue
        value = rest.pop(field.name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise GtcalError(f"board.{field.name}: {value!r} is not a positive number")
        given[field.name] = float(value)
    return rest, BoardTolerance(**given)


def with_tolerance_schema(schema: dict[str, Any]) -> dict[str, Any]:
    """The JSON schema of a ``board`` block that may state a tolerance too."""
    positive = {"type": "number", "exclusiveMinimum": 0.0}
    more = {field.name: positive for field in fields(BoardTolerance)}
    return {"oneOf": [{**one, "properties": {**one["properties"], **more}} for one in schema["oneOf"]]}
