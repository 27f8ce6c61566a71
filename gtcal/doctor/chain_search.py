"""What would make mocap and images agree: each reading tried by the alignment of stage 1, which costs the same for any
number of views; a factor on the board's size and an offset of the clocks are searched for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from gtcal.clock.coarse import offset_of_turns_s, turns_between
from gtcal.doctor.fit import ChainFit, fit_chain, turn_misfit_rad
from gtcal.doctor.mocap_readings import MocapReading, mocap_readings
from gtcal.errors import GtcalError
from gtcal.estimation.alignment import GuideViews
from gtcal.estimation.solver import DISAGREEMENT_RAD
from gtcal.recordings.capture import RefMotion

CONVINCING = 0.25
"""Another reading of the files is the likely truth where it leaves a quarter of the angle between mocap and images, or
less: noise doesn't fall by that, and a wrong reading of right data makes it worse."""

CONVINCING_NUMBER = 0.7
"""... and a number that the data choose (a factor, an offset) where it leaves seven tenths: one number more than the
truth has takes a few hundredths away."""

AS_GOOD = 1.5
"""A reading that leaves no more than this many times the best one's angle explains the data as well."""

HOPELESS_RAD = 0.01
"""A typical angle from which two faults together are looked for."""

FEWEST_VIEWS = 8
"""With fewer, a chain fits about anything."""

_HOPELESS = 4.0
"""A reading that starts out so many times further off than the stated one will not end at a quarter of it: what is left
to do is to leave views out, and that of a minority."""

LEAST_SHIFT_S, LEAST_SCALE = 2e-3, 2e-3
"""Less than this is no fault: two milliseconds, two parts in a thousand of a board."""

_WIDE_SCALES = np.geomspace(0.5, 2.0, 8)
_NEAR_SCALE = 1.12
_NEAR_SHIFT_S = 0.01
_TURN_FACTOR, _TURN_FLOOR_RAD = 3.0, np.deg2rad(0.5)
_MOST_PAIRED = 80
_MOST_NUMBERED = 4
_MOST_STEPS = 5000
_FAR_S = 10.0


@dataclass(frozen=True)
class Explained:
    """A change that explains the data: the readings in turn, then the factor on the board and what the cameras' stamps
    are put later by (1 and 0 for none). others: readings that do as well."""

    fit: ChainFit
    readings: tuple[MocapReading, ...] = ()
    board_scale: float = 1.0
    shift_s: float = 0.0
    others: tuple[MocapReading, ...] = ()


@dataclass(frozen=True)
class ChainSearch:
    """Searches over readings of one recording. guides: its views with their PnP poses, by camera."""

    guides: Mapping[str, GuideViews]
    seed: int = 0

    def fit(
        self, motion: RefMotion, *, shift_s: float = 0.0, board_scale: float = 1.0, hopeless_rad: float = np.inf
    ) -> ChainFit:
        """The chain under this motion."""
        return fit_chain(
            self.guides, motion, shift_s=shift_s, board_scale=board_scale, seed=self.seed, hopeless_rad=hopeless_rad
        )

    def explain(self, motion: RefMotion, stated: ChainFit) -> Explained | None:
        """The change that makes mocap and images agree; None where none is convincing."""
        if stated.n_views < FEWEST_VIEWS:
            return None
        tried = self._tried(motion, stated)
        if found := _best(tried, stated, CONVINCING):
            return found
        hopeless = stated.angle_rad > HOPELESS_RAD
        if found := _best(self._numbers(motion, stated), stated, CONVINCING if hopeless else CONVINCING_NUMBER):
            return found
        if not hopeless:
            return None
        shift_s = self.far_shift_s(motion, 0.0, _FAR_S)
        far = [] if shift_s is None else [Explained(self.fit(motion, shift_s=shift_s), shift_s=shift_s)]
        return _best(far, stated, CONVINCING) or self._two_faults(motion, stated, tried)

    def one_reading(self, motion: RefMotion, stated: ChainFit) -> Explained | None:
        """The one reading of the trajectories that makes mocap and images agree: the cheap part of ``explain``."""
        return _best(self._tried(motion, stated), stated, CONVINCING)

    def _tried(self, motion: RefMotion, stated: ChainFit) -> list[Explained]:
        """The chain under each reading by which the board turns about as much for the mocap as for PnP."""
        readings = list(mocap_readings(motion))
        turns_rad = [turn_misfit_rad(self.guides, reading.reread(motion)) for reading in readings]
        most_rad = _TURN_FACTOR * min(turns_rad, default=0.0) + _TURN_FLOOR_RAD
        hopeful = [reading for reading, turn_rad in zip(readings, turns_rad, strict=True) if turn_rad <= most_rad]
        hopeless_rad = _HOPELESS * stated.angle_rad
        found = [
            Explained(self.fit(reading.reread(motion), hopeless_rad=hopeless_rad), (reading,)) for reading in hopeful
        ]
        return [change for change in found if _keeps_views(change.fit, stated)]

    def _numbers(self, motion: RefMotion, stated: ChainFit) -> list[Explained]:
        """The factor on the board's size, and the shift of the clocks, that fit best."""
        return [self._scale(motion, stated), self.shifted(motion, stated)]

    def _scale(self, motion: RefMotion, stated: ChainFit) -> Explained:
        def angle(log_scale: float) -> float:
            return self.fit(motion, board_scale=float(np.exp(log_scale))).angle_rad

        hopeless = stated.angle_rad > HOPELESS_RAD
        if not hopeless and not any(angle(side * 2.0 * LEAST_SCALE) < stated.angle_rad for side in (1, -1)):
            return Explained(stated)  # the best lies nearer than what counts
        wide = np.log(_WIDE_SCALES) if hopeless else np.zeros(1)
        best = _narrowed(angle, wide, float(np.log(_NEAR_SCALE)))
        if abs(best) < LEAST_SCALE:
            return Explained(stated)
        scale = float(np.exp(best))
        return Explained(self.fit(motion, board_scale=scale), board_scale=scale)

    def shifted(self, motion: RefMotion, stated: ChainFit) -> Explained:
        """The shift of the clocks that fits best: by the turns alone to some ms, then by the chain."""
        try:
            about_s = offset_of_turns_s(self.turns(), motion)
        except GtcalError:
            return Explained(stated)
        places_s = (about_s, 2.0 * LEAST_SHIFT_S, -2.0 * LEAST_SHIFT_S)
        if not any(self.fit(motion, shift_s=place_s).angle_rad < stated.angle_rad for place_s in places_s):
            return Explained(stated)
        shift_s = self._near_shift_s(motion, np.array([about_s, 0.0]))
        if abs(shift_s) < LEAST_SHIFT_S:
            return Explained(stated)
        shifted = Explained(self.fit(motion, shift_s=shift_s), shift_s=shift_s)
        return shifted if _keeps_views(shifted.fit, stated) else Explained(stated)

    def far_shift_s(self, motion: RefMotion, about_s: float, reach_s: float) -> float | None:
        """The shift within ``reach_s`` of ``about_s`` at which half of the turns or more agree best; None where the
        turns tell none."""
        steps = ((reach_s, max(0.02, reach_s / _MOST_STEPS)), (0.2, 0.005))
        try:
            for within_s, step_s in steps:
                about_s = offset_of_turns_s(
                    self.turns(), motion, about_s=about_s, reach_s=within_s, step_s=step_s, share=0.5
                )
        except GtcalError:
            return None
        return self._near_shift_s(motion, np.array([about_s]))

    def _near_shift_s(self, motion: RefMotion, shifts_s: np.ndarray) -> float:
        angles = [self.fit(motion, shift_s=float(shift_s)).angle_rad for shift_s in shifts_s]
        best_s = float(shifts_s[int(np.argmin(angles))])  # may be years: what is searched is the rest
        return best_s + _narrowed(
            lambda rest_s: self.fit(motion, shift_s=best_s + rest_s).angle_rad, np.zeros(1), _NEAR_SHIFT_S
        )

    def turns(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """What the board turned by between the views of each camera."""
        return [turns_between(guide.views.stamps_ns, guide.pnp_camera_T_board[:, 0]) for guide in self.guides.values()]

    def _two_faults(self, motion: RefMotion, stated: ChainFit, tried: list[Explained]) -> Explained | None:
        """Two readings together, or one with a number: those first by which the board turns alike for mocap and PnP."""
        by_turns = sorted(
            _pairs(motion), key=lambda pair: turn_misfit_rad(self.guides, pair[1].reread(pair[0].reread(motion)))
        )
        pairs = [
            Explained(self.fit(second.reread(first.reread(motion))), (first, second))
            for first, second in by_turns[:_MOST_PAIRED]
        ]
        if found := _best([pair for pair in pairs if _keeps_views(pair.fit, stated)], stated, CONVINCING):
            return found
        hopeful = sorted(tried, key=lambda change: change.fit.angle_rad)[:_MOST_NUMBERED]
        numbered = [
            Explained(number.fit, change.readings, number.board_scale, number.shift_s)
            for change in hopeful
            for number in self._numbers(change.readings[0].reread(motion), change.fit)
        ]
        return _best(numbered, stated, CONVINCING)


def _pairs(motion: RefMotion) -> Iterator[tuple[MocapReading, MocapReading]]:
    """Pairs of readings of different kinds (two of one kind are tried as one reading of both bodies), of those that a
    manifest mends or that exchange the bodies."""
    readings = [reading for reading in mocap_readings(motion) if reading.lines or reading.fault == "swapped bodies"]
    for i, first in enumerate(readings):
        for second in readings[i + 1 :]:
            if first.fault != second.fault or not set(first.bodies) & set(second.bodies):
                yield first, second


def _keeps_views(fit: ChainFit, stated: ChainFit) -> bool:
    return fit.n_views >= max(0.7 * stated.n_views, FEWEST_VIEWS)


def _best(tried: list[Explained], stated: ChainFit, convincing: float) -> Explained | None:
    """The first of those that leave about the smallest angle, where it is small enough."""
    if not tried:
        return None
    least = min(change.fit.angle_rad for change in tried)
    if not least <= min(convincing * stated.angle_rad, DISAGREEMENT_RAD):
        return None
    first, *others = [change for change in tried if change.fit.angle_rad <= AS_GOOD * least]
    bodies = set(first.readings[0].bodies) if first.readings else set()
    # a body that stands still may be read in any way, together with the first too: that is no other explanation
    told = tuple(
        other.readings[0] for other in others if len(other.readings) == 1 and not set(other.readings[0].bodies) > bodies
    )
    return Explained(first.fit, first.readings, first.board_scale, first.shift_s, told)


def _narrowed(angle_rad: Callable[[float], float], coarse: np.ndarray, half_width: float) -> float:
    """Where the angle is least: of the coarse places, then near it."""

    def finite(x: float) -> float:
        return min(angle_rad(x), np.pi)

    values = [finite(float(x)) for x in coarse]
    best = float(coarse[int(np.argmin(values))])
    found = minimize_scalar(
        finite, bounds=(best - half_width, best + half_width), method="bounded", options={"xatol": 3e-4}
    )
    return float(found.x) if found.fun < min(values) else best
