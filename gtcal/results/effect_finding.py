"""An effect that the model leaves out: what the data say of it, and what it does to the result."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A number with its 1-sigma, in ``unit``."""

    name: str
    value: float
    sigma: float
    unit: str

    @property
    def text(self) -> str:
        """For people: two digits of the sigma."""
        digits = f".{_decimals(self.sigma)}f"
        return f"{self.value:{digits}} {self.unit} ± {self.sigma:{digits}}"


def _decimals(sigma: float) -> int:
    """So many that the sigma shows two digits, of 0 to 6."""
    exponent = int(f"{sigma:e}".split("e")[1]) if 0.0 < sigma < float("inf") else 0
    return min(max(1 - exponent, 0), 6)


@dataclass(frozen=True)
class Moment:
    """When something changed, in s from the recording's first image: the likeliest time and the ends of its interval,
    the last image surely before and the first surely after."""

    at_s: float
    after_s: float
    before_s: float

    @property
    def text(self) -> str:
        return f"at {self.at_s:.2f} s (between {self.after_s:.2f} and {self.before_s:.2f} s)"


@dataclass(frozen=True)
class EffectFinding:
    """One effect that was looked for.

    name: what it is called, as 'clock offset'. what: in words, as a clause.
    estimate: its size, if it were let in.
    p_value: of chance, corrected for all that was tried; significant: whether it is small enough to say so.
    hold_out_drop_px: by how much the RMSE of blocks of time that the estimate has not seen falls with it.
    moves_mm, moves_deg: by camera, how far its position in ref and its attitude would move if it were let in.
    advice: what to do about it. moment: of a change, when. hold_out_px: that RMSE without it, of all views that are
        looked at; None where the file is of an older version."""

    name: str
    what: str
    estimate: tuple[Quantity, ...]
    p_value: float
    significant: bool
    hold_out_drop_px: float
    moves_mm: dict[str, float]
    moves_deg: dict[str, float]
    advice: str
    moment: Moment | None = None
    hold_out_px: float | None = None

    @property
    def largest_move_mm(self) -> float:
        """Of any camera."""
        return max(self.moves_mm.values(), default=0.0)

    @property
    def largest_move_deg(self) -> float:
        """Of any camera."""
        return max(self.moves_deg.values(), default=0.0)

    @property
    def is_finite(self) -> bool:
        """Whether the data tell it at all."""
        numbers = [number for quantity in self.estimate for number in (quantity.value, quantity.sigma)]
        numbers += [self.p_value, self.hold_out_drop_px, *self.moves_mm.values(), *self.moves_deg.values()]
        return all(map(math.isfinite, numbers))

    @property
    def size(self) -> str:
        """For people."""
        return ", ".join(f"{quantity.name} {quantity.text}".strip() for quantity in self.estimate)

    @property
    def statement(self) -> str:
        """The effect in a line: what, when, how large, what it does, and what to do."""
        when = f" {self.moment.text}" if self.moment else ""
        moved = f"{self.largest_move_mm:.2g} mm and {self.largest_move_deg:.2g} deg"
        return f"{self.what}{when}: {self.size}; it moves the cameras by up to {moved}: {self.advice}"
