"""Two cameras that stand where the other one should: their images are swapped.

Of cameras with like lenses one recording can't tell that; what is known of the rig beforehand, from an earlier
calibration or from priors, can."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.alignment import guides_of, stage_1
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.priors import Priors
from gtcal.results.calibration import pose_difference

Pairs = Mapping[tuple[str, str], FloatArray]
"""By (a, b), a_T_b (4, 4) of two cameras."""

_LEVER_M = 0.3
_LEAST_MM = 5.0
"""As named, they are off by this at least: a camera that was bumped is no other one."""

_CLEARLY = 0.2
"""Exchanged, they are off by no more than this share of it."""


@dataclass(frozen=True)
class Exchanged:
    """cameras: the two. as_named_mm, exchanged_mm: by how much points 0.3 m from a camera are off, seen from another
    one, RMS: as the cameras are named, and with these two exchanged."""

    cameras: tuple[str, str]
    as_named_mm: float
    exchanged_mm: float

    @property
    def statement(self) -> str:
        """As 'cameras 'a' and 'b' stand where the other one should: ...'."""
        a, b = map(repr, self.cameras)
        return (
            f"cameras {a} and {b} stand where the other one should, to {self.exchanged_mm:.2g} mm (as they are named: "
            f"{self.as_named_mm:,.0f} mm off): their images are swapped; exchange them in the manifest, unless the "
            "cameras themselves were"
        )


def known_pairs(camera_T_ref: Mapping[str, FloatArray]) -> Pairs:
    """Of every two cameras whose places in one ref are known."""
    return {(a, b): camera_T_ref[a] @ inverse(camera_T_ref[b]) for a, b in combinations(camera_T_ref, 2)}


def pairs_of_priors(priors: Priors) -> Pairs:
    """What priors say of two cameras, by themselves or in ref; nothing where they say a part of a pose only."""
    whole = {name: inverse(prior.a_T_b) for name, prior in priors.ref_T_camera.items() if prior.weights.all()}
    between = {pair: prior.a_T_b for pair, prior in priors.camera_a_T_camera_b.items() if prior.weights.all()}
    return {**known_pairs(whole), **between}


def exchanged_cameras(camera_T_ref: Mapping[str, FloatArray], known: Pairs) -> Exchanged | None:
    """The two cameras that fit what is known far better in each other's place; None where no two do.

    camera_T_ref: (4, 4) by camera, as found."""
    here = {pair: pose for pair, pose in known.items() if set(pair) <= set(camera_T_ref)}
    names = sorted({name for pair in here for name in pair})
    found = [_exchanged(camera_T_ref, here, pair) for pair in combinations(names, 2)]
    best = min(found, key=lambda one: one.exchanged_mm, default=None)
    if best is None or best.as_named_mm < _LEAST_MM or best.exchanged_mm > _CLEARLY * best.as_named_mm:
        return None
    return best


def check_rig(observations: Observations, options: CalibrationOptions) -> None:
    """Raises GtcalError where the priors say where cameras are, and two of them stand in each other's place: no
    solution between the two would be one."""
    known = pairs_of_priors(options.priors)
    if not known:
        return
    guides = guides_of(observations.views, options.pnp_views)
    if not all(len(guide.corner_moments) for guide in guides.values()):
        return  # what PnP can't solve is told later
    estimate = stage_1(guides, np.random.default_rng(options.seed)).estimate
    found = exchanged_cameras(estimate.camera_T_ref, known)
    if found is not None:
        raise GtcalError(f"by the priors, {found.statement}")


def _exchanged(camera_T_ref: Mapping[str, FloatArray], known: Pairs, cameras: tuple[str, str]) -> Exchanged:
    a, b = cameras
    other = {**camera_T_ref, a: camera_T_ref[b], b: camera_T_ref[a]}
    return Exchanged(cameras, _off_mm(camera_T_ref, known), _off_mm(other, known))


def _off_mm(camera_T_ref: Mapping[str, FloatArray], known: Pairs) -> float:
    """RMS over the pairs."""
    apart = [pose_difference(camera_T_ref[a] @ inverse(camera_T_ref[b]), a_T_b) for (a, b), a_T_b in known.items()]
    return float(np.sqrt(np.mean([mm**2 + (1e3 * _LEVER_M * np.deg2rad(deg)) ** 2 for mm, deg in apart])))
