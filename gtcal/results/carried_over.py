"""What a calibration took from an earlier one of the same rig."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CarriedOver:
    """source: what it was taken from, in words. days: between them. kept: what is known from the earlier one, in words;
    moved: a sentence on each thing that is not as it was, and was found anew. alone: whether the recording determines a
    calibration without it."""

    source: str
    days: float
    kept: tuple[str, ...]
    moved: tuple[str, ...]
    alone: bool

    @property
    def statement(self) -> str:
        """In a line."""
        kept = f"known from {self.source}: {', '.join(self.kept) or 'nothing'}"
        return kept if self.alone else f"{kept}; without it, the recording determines no calibration"
