"""What the doctor found, and how he says it."""

from __future__ import annotations

from dataclasses import dataclass

from gtcal.results.presented import Presented

MISFIT = "median misfit of mocap and images"
ALONE = "distance that four fifths of the corners keep, each view with a board pose of its own"
POSED = "views that the mocap has a pose for"
SEEN = "views in which the board is found"
BACKS = "views that see the board from behind"
HELD_OUT = "a calibration's error of views that it has not seen"
LEFT_OUT = "share of views that contradict a calibration of the others, once they are left out,"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    fault: its kind, as 'quaternion order'.
    says: what is wrong, in a sentence.
    lines: what to write in the manifest, as 'platform.quaternion: wxyz'; advice: what else to do.
    measure: what tells; before, after: its value in ``unit`` as the recording says (None where it can't be read as it
        stands), and with this put right (None where nothing more can be told).
    alternatives: other changes that explain the data as well."""

    fault: str
    says: str
    lines: tuple[str, ...]
    advice: tuple[str, ...]
    measure: str
    before: float | None
    after: float | None
    unit: str
    alternatives: tuple[str, ...] = ()

    @property
    def evidence(self) -> str:
        """As 'median misfit of mocap and images falls from 312 to 0.31 mm'."""
        if self.after is None:
            return "refused as it stands, read with this"
        if self.before is None:
            return f"refused as it stands; then the {self.measure} is {_number(self.after)} {self.unit}"
        moves = "falls" if self.after < self.before else "rises"
        before = _number(self.before) if self.before < float("inf") else "no fit at all"
        return f"{self.measure} {moves} from {before} to {_number(self.after)} {self.unit}"

    @property
    def fixes(self) -> tuple[str, ...]:
        """What to do: the manifest's lines, then the advice."""
        return (*self.lines, *self.advice)


@dataclass(frozen=True, repr=False)
class Diagnosis(Presented):
    """What is wrong with a recording.

    findings: in the order in which they were found; a later one takes the earlier ones as put right.
    unexplained: what is wrong that no other reading explains: it can't be read, or does not agree with itself.
    notes: what could not be told, and why.
    misfit_mm, misfit_deg: how far mocap and images are apart, typically, with all put right; None where unknown."""

    findings: tuple[Finding, ...]
    unexplained: str | None
    notes: tuple[str, ...]
    misfit_mm: float | None
    misfit_deg: float | None

    @property
    def healthy(self) -> bool:
        """Whether nothing wrong was found."""
        return not self.findings and self.unexplained is None

    @property
    def lines(self) -> tuple[str, ...]:
        """All that is to be written in the manifest."""
        return tuple(line for finding in self.findings for line in finding.lines)

    @property
    def statement(self) -> str:
        """The outcome in one sentence."""
        agree = "" if self.misfit_mm is None else f"mocap and images agree to {_number(self.misfit_mm)} mm, typically"
        n = len(self.findings)
        told = f"{n} thing{'s' * (n > 1)} wrong: {', '.join(finding.fault for finding in self.findings)}" if n else ""
        if self.unexplained is not None:
            return (
                f"{told}; and unexplained: {self.unexplained}"
                if told
                else f"wrong, but unexplained: {self.unexplained}"
            )
        if told:
            return told + (f"; read so, {agree}" if agree else "")
        return "nothing wrong found" + (f"; {agree}" if agree else "")


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
