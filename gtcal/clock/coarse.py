"""A first guess at the clock offset, from rotations alone: no calibration is needed.

Between two images the board turns by the same angle in the camera as the body does in ref, whatever X and Y_c are. So
the angles between successive PnP poses are matched with the mocap's, shifted in time.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.pnp import solve_pnp
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

REACH_S = 0.5
"""Offsets are looked for up to this, either way."""

_STEP_S = 0.005
_MOST_VIEWS = 300
_FEWEST_PAIRS = 8
_POSES_AT_ONCE = 20_000
_CAP = 4.0  # of the typical misfit at its best: more is an outlier


Turns = tuple[IntArray, IntArray, FloatArray]
"""Of successive views: the stamps of both, and the angle in rad that the board turned by."""


def coarse_offset_s(observations: Observations, cameras: Iterable[str] | None = None) -> float:
    """The offset that these cameras (all of them by default) share: stamp + offset is the mocap's time.

    Raises GtcalError where the images have too few successive views, or the board did not turn."""
    names = list(observations.views if cameras is None else cameras)
    return offset_of_turns_s([_turns(observations.views[name]) for name in names], observations.motion)


def offset_of_turns_s(
    turns: Iterable[Turns],
    motion: RefMotion,
    *,
    about_s: float = 0.0,
    reach_s: float = REACH_S,
    step_s: float = _STEP_S,
    share: float = 0.0,
) -> float:
    """``coarse_offset_s`` from the turns of each camera, looked for within ``reach_s`` of ``about_s`` where the mocap
    has this share of them or more."""
    parts = list(turns)
    if sum(len(angle_rad) for _, _, angle_rad in parts) < _FEWEST_PAIRS:
        raise GtcalError("too few views to find the clock offset from: film more, or synchronise the clocks")
    first_ns, second_ns = (np.concatenate([part[i] for part in parts]) for i in range(2))
    angle_rad = np.concatenate([part[2] for part in parts])
    if np.median(angle_rad) < np.deg2rad(0.1):
        raise GtcalError("the board hardly turned between images, so its turns do not tell the clock offset")
    shifts_s = np.arange(about_s - reach_s, about_s + reach_s + step_s, step_s)
    at_once = max(1, _POSES_AT_ONCE // len(angle_rad))
    misfits = [
        misfit
        for some in np.array_split(shifts_s, -(-len(shifts_s) // at_once))
        for misfit in _misfits(motion, first_ns, second_ns, angle_rad, some)
    ]
    fewest = max(_FEWEST_PAIRS, share * len(angle_rad))
    medians = np.array([np.median(misfit) if len(misfit) >= fewest else np.inf for misfit in misfits])
    if not np.isfinite(medians).any():
        raise GtcalError(f"cameras and mocap share no time, whatever the clock offset within {reach_s:g} s")
    cap = _CAP * medians.min()
    costs = np.array(
        [
            np.minimum(misfit, cap).mean() if np.isfinite(m) else np.inf
            for misfit, m in zip(misfits, medians, strict=True)
        ]
    )
    best = int(np.argmin(costs))
    return float(shifts_s[best] + step_s * _parabola(costs[max(best - 1, 0) : best + 2]))


def _turns(views: Views) -> Turns:
    found = solve_pnp(views, max_views=_MOST_VIEWS)
    return turns_between(views.stamps_ns[found.view_index], found.camera_T_board[:, 0])


def turns_between(view_stamps_ns: IntArray, camera_T_board: FloatArray) -> Turns:
    """Between views in the order of time, from their stamps (V,) and PnP poses (V, 4, 4)."""
    order = np.argsort(view_stamps_ns)
    stamps_ns, poses = view_stamps_ns[order], camera_T_board[order]
    angle_rad = Rotation.from_matrix((inverse(poses[:-1]) @ poses[1:])[:, :3, :3]).magnitude()
    return stamps_ns[:-1], stamps_ns[1:], angle_rad


def _misfits(
    motion: RefMotion, first_ns: IntArray, second_ns: IntArray, angle_rad: FloatArray, shifts_s: FloatArray
) -> list[FloatArray]:
    """At each of these shifts the differences of the angles, of the pairs that the mocap has."""
    shifts_ns = np.array([round(1e9 * shift_s) for shift_s in shifts_s], dtype=np.int64)[:, None]
    first, second = (motion.at((stamps_ns + shifts_ns).ravel()) for stamps_ns in (first_ns, second_ns))
    known = first.ok & second.ok
    turned = inverse(first.ref_T_body[known]) @ second.ref_T_body[known]
    expected_rad = np.tile(angle_rad, len(shifts_s))[known]
    misfit_rad = np.abs(Rotation.from_matrix(turned[:, :3, :3]).magnitude() - expected_rad)
    return np.split(misfit_rad, np.cumsum(known.reshape(len(shifts_s), -1).sum(axis=1))[:-1])


def _parabola(costs: FloatArray) -> float:
    """Where the smallest of three values would lie, in steps from the middle one."""
    if len(costs) < 3 or not np.isfinite(costs).all():
        return 0.0
    before, middle, after = costs
    curvature = before - 2.0 * middle + after
    return float(0.5 * (before - after) / curvature) if curvature > 0.0 else 0.0
