"""Views that were left out and that all go with the rest if a body is turned: markers that look the same after half a
turn or a quarter, which the mocap mistook, or a board that was put back the other way round.

Each view left out says, by PnP, where the board was; by that its body was turned from where the mocap had it. Gross
errors of other kinds scatter; a body that was mistaken is off by the same turn each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import select_views
from gtcal.recordings.detections import IntArray
from gtcal.recordings.numbering import listed_numbers, numbers_of

TURNS_DEG = (60.0, 72.0, 90.0, 120.0, 144.0, 180.0)
"""After which a rigid body of a few markers may look the same."""

SAME_DEG = 3.0
"""By how much turns may differ that are the same one."""

FEWEST_MOMENTS, LEAST_SHARE = 3, 0.5
"""At so many moments views, and such a share of those left out, are off by one turn: no accident. At one moment all
cameras' views are off by one turn, whatever went wrong."""

_MOST_VIEWS = 100
_MOST_MOMENTS = 6


@dataclass(frozen=True)
class TurnedViews:
    """Views of one body that was mistaken.

    body: 'board_body' or 'platform'. turn_deg, axis: (3,) in the body's own frame. stamps_ns: by camera, of the views.
    start_ns: the first image. numbered: whether the stamps are numbers of images."""

    body: str
    turn_deg: float
    axis: FloatArray
    stamps_ns: dict[str, IntArray]
    start_ns: int
    numbered: bool

    @property
    def n_views(self) -> int:
        return sum(map(len, self.stamps_ns.values()))

    @property
    def statement(self) -> str:
        """What, when, and what to do, in a line."""
        axis = ", ".join(f"{component + 0.0:.2f}" for component in np.round(self.axis, 2))
        return (
            f"{self.n_views} of the views left out go with the rest if {self.body} is turned by {self.turn_deg:.0f} "
            f"deg about its axis ({axis}), {self._when}: its markers, or the board on it, look the same so turned, and "
            "were mistaken; make them asymmetric, or correct these poses"
        )

    @property
    def _when(self) -> str:
        stamps_ns = np.unique(np.concatenate(list(self.stamps_ns.values())))
        if self.numbered:
            return f"images {listed_numbers(numbers_of(stamps_ns), _MOST_MOMENTS)}"
        seconds = 1e-9 * (stamps_ns - self.start_ns)
        return f"from {seconds[0]:.2f} to {seconds[-1]:.2f} s"


def turned_views(observations: Observations, estimate: Estimate, used: Mapping[str, Views]) -> TurnedViews | None:
    """The body of which most views that are not ``used`` are off by one turn; None where they scatter, or are few."""
    left_out = {name: _left_out(views, used[name]) for name, views in observations.views.items()}
    left_out = {name: views for name, views in left_out.items() if views.n_views}
    if sum(views.n_views for views in left_out.values()) < FEWEST_MOMENTS:
        return None
    stamps_ns, offs = _body_offs(left_out, estimate)
    found = [
        (body, *_agreeing(off)) for body, off in offs.items() if body in observations.motion.trajectories and len(off)
    ]
    body, turn, agree = max(found, key=lambda one: int(one[2].sum()))
    angle_deg = float(np.rad2deg(turn.magnitude()))
    nearest_deg = min(TURNS_DEG, key=lambda known: abs(known - angle_deg))
    names = np.repeat(list(stamps_ns), [len(of_camera) for of_camera in stamps_ns.values()])
    all_ns = np.concatenate(list(stamps_ns.values()))
    few = len(np.unique(all_ns[agree])) < FEWEST_MOMENTS or agree.mean() < LEAST_SHARE
    if few or abs(nearest_deg - angle_deg) > SAME_DEG:
        return None
    return TurnedViews(
        body=body,
        turn_deg=nearest_deg,
        axis=_axis(turn, nearest_deg),
        stamps_ns={str(name): all_ns[agree & (names == name)] for name in np.unique(names[agree])},
        start_ns=min(int(views.stamps_ns[0]) for views in observations.views.values()),
        numbered=observations.motion.numbered,
    )


def _axis(turn: Rotation, turn_deg: float) -> FloatArray:
    """(3,), of half a turn, which is the same about both, the one whose largest component is positive."""
    axis = turn.as_rotvec() / turn.magnitude()
    return np.asarray(-axis if turn_deg == 180.0 and axis[np.argmax(np.abs(axis))] < 0.0 else axis)


def _left_out(views: Views, used: Views) -> Views:
    return select_views(views, np.flatnonzero(~np.isin(views.stamps_ns, used.stamps_ns)))


def _body_offs(left_out: Mapping[str, Views], estimate: Estimate) -> tuple[dict[str, IntArray], dict[str, FloatArray]]:
    """By camera the stamps of the views that PnP solves; by body the turns (W, 3, 3) that it wants of all of them, in
    the body's frame: of the board's body, and of the platform."""
    stamps_ns, of_board_body, of_platform = {}, [], []
    X = estimate.body_T_board
    for name, views in left_out.items():
        solved = solve_pnp(views, max_views=_MOST_VIEWS)
        chosen = select_views(views, solved.view_index)
        ref_T_board = inverse(estimate.camera_T_ref[name]) @ solved.camera_T_board[:, 0]
        stamps_ns[name] = chosen.stamps_ns
        of_board_body.append((inverse(chosen.ref_T_body) @ ref_T_board @ inverse(X))[:, :3, :3])
        of_platform.append((chosen.ref_T_body @ X @ inverse(ref_T_board))[:, :3, :3])
    return stamps_ns, {"board_body": np.concatenate(of_board_body), "platform": np.concatenate(of_platform)}


def _agreeing(turns: FloatArray) -> tuple[Rotation, np.ndarray]:
    """The turn with which most agree, as their mean, and which (W,) these are."""
    apart_rad = np.arccos(np.clip(0.5 * (np.einsum("iab,jab->ij", turns, turns) - 1.0), -1.0, 1.0))
    same = apart_rad < np.deg2rad(SAME_DEG)
    agree = same[int(same.sum(axis=1).argmax())]
    return Rotation.from_matrix(turns[agree]).mean(), agree
