"""What the data leave weak or open, each direction told in words with the motion that would fix it.

The joint covariance (or information) of X, every Y_c and theta_c is taken in the measures of
``gtcal.uncertainty.placement``, in which mm, deg and px compare. Its eigenvectors span what is weak, but where
eigenvalues are near each other they mix what has nothing to do with each other (the depths of two cameras into their
sum and their difference). So the directions are taken one at a time: the board or the camera that is least sure, along
its own least sure eigenvector, and with it what moves along in everything else; then the same of what is left once that
direction is known. Where one eigenvalue stands out, as when all turns share an axis, this is its eigenvector.

What the data leave open is the null space of the information, which has no covariance; it is named in the same way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import gtsam
import numpy as np

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.marginals import joint_information
from gtcal.results.calibration import Calibration
from gtcal.results.covariance import JointCovariance
from gtcal.uncertainty.direction_words import described, in_detail, shifts_all
from gtcal.uncertainty.motions import BoardMotion, CameraMotion, motions
from gtcal.uncertainty.placement import UNIT_DEG, UNIT_MM, Placement

WEAK = 1.0
"""From here on, in the units of ``placement``, a direction is warned of: 2 mm, 0.2 deg or 1 px, 1-sigma."""

REFUSED = 5.0
"""From here on the board's or a camera's place is refused: 10 mm or 1 deg."""

OPEN = 500.0
"""A 1-sigma from here on (1 m, 100 deg) is none: the direction is open."""

MOST = 6
"""Directions that are told of what is not weak."""

_ROUNDING = 1e-13


class Grade(StrEnum):
    """What to think of a direction."""

    FINE = "fine"
    WEAK = "weak"
    REFUSED = "refused"
    OPEN = "open"


@dataclass(frozen=True)
class WeakDirection:
    """A way in which the whole result can move at once, as far as its 1-sigma lets it.

    weakness: the largest motion of the board or a camera in it, in the units of ``placement``; infinite where open.
    board, cameras: by how much each moves; of an open direction, for a motion of 2 mm or 0.2 deg or 1 px.
    what, size, fix: in words. moves_places: whether the board or a camera moves, not only a lens."""

    weakness: float
    board: BoardMotion
    cameras: Mapping[str, CameraMotion]
    what: str
    size: str
    fix: str
    moves_places: bool

    @property
    def grade(self) -> Grade:
        if not np.isfinite(self.weakness):
            return Grade.OPEN
        if self.weakness >= REFUSED and self.moves_places:
            return Grade.REFUSED
        return Grade.WEAK if self.weakness >= WEAK else Grade.FINE

    @property
    def sentence(self) -> str:
        """As 'X: the board's translation along the body's z axis, ...: 14 mm 1-sigma; turn the board ...'."""
        return f"{self.what}: {self.size}; {self.fix}"


def weak_directions(calibration: Calibration) -> tuple[WeakDirection, ...]:
    """Those that a calibration should be warned of, the weakest first; none where all of it is well determined, or
    where no covariance was computed."""
    return tuple(found for found in least_sure(calibration) if found.grade is not Grade.FINE)


def least_sure(calibration: Calibration, *, most: int = MOST) -> tuple[WeakDirection, ...]:
    """The least sure directions, weak or not, the weakest first: all that are weak, and up to ``most`` of the others.

    Empty where no covariance was computed."""
    joint = calibration.covariance
    return () if joint is None else directions_of_covariance(joint, Placement.of(calibration), most=most)


def directions_of_covariance(
    joint: JointCovariance, placement: Placement, *, most: int = 0
) -> tuple[WeakDirection, ...]:
    """The weak directions of a covariance, and up to ``most`` in all of those that are not."""
    L = placement.measures
    return _directions([], _finite(L @ joint.matrix @ L.T, placement, most), placement)


def directions_of_information(
    information: FloatArray, placement: Placement, *, most: int = 0
) -> tuple[WeakDirection, ...]:
    """The open and the weak directions of the joint information (P, P) of X, every Y_c and theta_c, in the order of
    ``JointCovariance``; it may be singular. ``most`` as in ``directions_of_covariance``."""
    inverse_L = np.linalg.inv(placement.measures)
    values, vectors = np.linalg.eigh(inverse_L.T @ information @ inverse_L)
    is_open = values < max(1.0 / OPEN**2, _ROUNDING * values[-1])
    null, rest = vectors[:, is_open], vectors[:, ~is_open]
    open_motions = _taken(null @ null.T, placement, 0.0, null.shape[1])
    motions_left = _finite(rest / values[~is_open] @ rest.T, placement, most)
    return _directions(open_motions, motions_left, placement)


def directions_of_graph(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: list[int], placement: Placement
) -> tuple[WeakDirection, ...]:
    """The open and the weak directions of a graph at its solution. keys: of X, every Y_c and the theta_c that are
    variables, in this order; all other variables are eliminated.

    Raises GtcalError where these others are open by themselves."""
    return directions_of_information(joint_information(graph, values, keys), placement)


def weakness_warnings(found: tuple[WeakDirection, ...], *, allow_degenerate: bool) -> tuple[str, ...]:
    """A line for each direction that is weak.

    Raises GtcalError where one is refused or open, unless ``allow_degenerate``."""
    refused = [one for one in found if one.grade in (Grade.REFUSED, Grade.OPEN)]
    if refused and not allow_degenerate:
        more = f" (and {len(refused) - 1} more directions like it)" if len(refused) > 1 else ""
        limit = f"{REFUSED * UNIT_MM:g} mm or {REFUSED * UNIT_DEG:g} deg"
        raise GtcalError(
            f"the data do not determine the result: {refused[0].sentence}{more}; a 1-sigma over {limit} is refused "
            "unless degenerate data are allowed"
        )
    return tuple(f"weakly determined: {one.sentence}" for one in found if one.grade is not Grade.FINE)


def _finite(covariance: FloatArray, placement: Placement, most: int) -> list[FloatArray]:
    """Motions of all that are weak, and others to make ``most``."""
    taken = _taken(covariance, placement, WEAK, len(covariance))
    return taken if len(taken) >= most else _taken(covariance, placement, 0.0, most)


def _taken(covariance: FloatArray, placement: Placement, least: float, most: int) -> list[FloatArray]:
    """The 1-sigma motions (P,) of the directions, the least sure first, while the board or a camera has a 1-sigma of
    ``least`` or more in what is left. Their outer products sum up to what they take of the covariance."""
    left = covariance.copy()
    found: list[FloatArray] = []
    while len(found) < most:
        spectra = [np.linalg.eigh(left[np.ix_(block, block)]) for block in placement.blocks]
        index = int(np.argmax([values[-1] for values, _ in spectra]))
        values, vectors = spectra[index]
        if not values[-1] > max(least**2, _ROUNDING * np.trace(covariance)):
            break
        motion = left[:, placement.blocks[index]] @ vectors[:, -1] / np.sqrt(values[-1])
        motion *= np.sign(motion[np.argmax(np.abs(motion))])
        found.append(motion)
        left -= np.outer(motion, motion)
    return found


def _directions(
    open_motions: list[FloatArray], finite_motions: list[FloatArray], placement: Placement
) -> tuple[WeakDirection, ...]:
    """The weakest first."""
    weaknesses = [np.inf] * len(open_motions) + [_size(motion, placement) for motion in finite_motions]
    scaled = [motion / _size(motion, placement) for motion in open_motions] + finite_motions
    told = [motions(motion, placement) for motion in scaled]
    n_shifts = sum(shifts_all(*motion) for motion, size in zip(told, weaknesses, strict=True) if size >= WEAK)
    found = [
        _direction(size, *motion, placement, nothing_turned=n_shifts > 1)
        for size, motion in zip(weaknesses, told, strict=True)
    ]
    return _told_apart(sorted(found, key=lambda one: -one.weakness))


def _told_apart(found: list[WeakDirection]) -> tuple[WeakDirection, ...]:
    """Of those whose words are alike, with what they differ in."""
    count = Counter(one.what for one in found)
    return tuple(
        replace(one, what=f"{one.what} [{in_detail(one.board, one.cameras)}]") if count[one.what] > 1 else one
        for one in found
    )


def _size(motion: FloatArray, placement: Placement) -> float:
    """Of the largest motion of the board or of a camera."""
    return max(float(np.linalg.norm(motion[block])) for block in placement.blocks)


def _direction(
    weakness: float,
    board: BoardMotion,
    cameras: Mapping[str, CameraMotion],
    placement: Placement,
    *,
    nothing_turned: bool,
) -> WeakDirection:
    words = described(board, cameras, placement, nothing_turned=nothing_turned)
    return WeakDirection(
        weakness=weakness,
        board=board,
        cameras=cameras,
        what=words.what,
        size=f"{words.size} 1-sigma" if np.isfinite(weakness) else "open",
        fix=words.fix,
        moves_places=words.moves_places,
    )
