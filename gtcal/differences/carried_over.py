"""A calibration that goes on from an earlier one of the same rig: what has not moved is known already.

The recording is calibrated by itself first, and held against the earlier calibration, less sure by the days between
them. What surely moved is found anew; all else of the earlier calibration is a prior, jointly, and the recording is
calibrated again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from gtcal.camera import Camera
from gtcal.differences.difference import ALL, TO_EACH_OTHER, Difference, difference, measured
from gtcal.errors import GtcalError
from gtcal.estimation.earlier import BOARD, SHAPE, Earlier, Growth, grown, intrinsics_of
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import DisagreementError
from gtcal.files import InputFile
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration
from gtcal.results.carried_over import CarriedOver

Solve = Callable[[Observations, CalibrationOptions], Calibration]
Part = Literal["lenses", "board", "rig"]
PARTS: tuple[Part, ...] = get_args(Part)


@dataclass(frozen=True)
class EarlierCalibration:
    """A calibration to go on from. growth: by how much less is known by now. parts: which of it to take. source: what
    it is, in words. inputs: the files that it rests on.

    Raises GtcalError for a part that is none."""

    calibration: Calibration
    growth: Growth = field(default_factory=Growth)
    parts: tuple[Part, ...] = PARTS
    source: str = ""
    inputs: tuple[InputFile, ...] = ()

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in PARTS:
                raise GtcalError(f"parts: {part!r} is none of {', '.join(PARTS)}")

    @property
    def in_words(self) -> str:
        if self.source:
            return self.source
        days = self.growth.days
        return f"the earlier calibration ({days:.3g} day{'' if days == 1.0 else 's'} ago)"


def check_independent(earlier: EarlierCalibration, inputs: tuple[InputFile, ...]) -> None:
    """Raises GtcalError where the earlier calibration rests on some of the same measurements: they would count twice,
    and the result would claim to be surer than it is."""
    if shared := measured(inputs) & measured(earlier.calibration.provenance.inputs):
        file = next(entry.path for entry in inputs if entry.sha256 in shared)
        raise GtcalError(f"{file}: the earlier calibration rests on it already; give another recording of the rig")


def with_earlier_lenses(cameras: dict[str, Camera], earlier: EarlierCalibration) -> dict[str, Camera]:
    """Cameras without intrinsics as the earlier calibration has them."""
    return {
        name: replace(camera, parameters=earlier.calibration.cameras[name].camera.theta)
        if camera.parameters is None and _same_lens(camera, earlier.calibration)
        else camera
        for name, camera in cameras.items()
    }


def known_from(
    earlier: EarlierCalibration, observations: Observations, options: CalibrationOptions, solve: Solve
) -> tuple[Observations, CalibrationOptions, CarriedOver]:
    """The observations and options with what has not moved since the earlier calibration known.

    Raises GtcalError as ``gtcal.calibrate``, where the captures differ, or the options hold intrinsics as they are:
    what is known is known of poses and intrinsics together."""
    if not options.trusts_stated_intrinsics:
        raise GtcalError(
            f"what an earlier calibration knows is of poses and intrinsics together, but intrinsics are "
            f"{options.intrinsics!r} here: use 'auto'"
        )
    if earlier.calibration.capture is not observations.capture:
        raise GtcalError(
            f"the earlier calibration's capture is {earlier.calibration.capture.value}, the recording's "
            f"{observations.capture.value}: they have no pose in common"
        )
    before = grown(earlier.calibration, earlier.growth)
    known = Earlier.of(before).only(lambda what: _is_wanted(what, earlier, observations, options))
    alone = _by_itself(observations, options, solve)
    moved: tuple[str, ...] = ()
    if alone is not None:
        found = difference(before, alone)
        known = _unmoved(known, found)
        changes = [change for change in found.changes if _is_of(change.what, earlier, observations)]
        moved = replace(found, changes=tuple(changes)).moved_statements
    with_priors = replace(options, priors=replace(options.priors, earlier=known))
    taken = CarriedOver(earlier.in_words, earlier.growth.days, known.kept, moved, alone is not None)
    return _with_known_lenses(observations, known), with_priors, taken


def _by_itself(observations: Observations, options: CalibrationOptions, solve: Solve) -> Calibration | None:
    """None where the observations alone determine no calibration, or leave a direction open.

    Raises DisagreementError where no chain fits them: no earlier calibration mends that."""
    try:
        found = solve(observations, options)
    except DisagreementError:
        raise
    except GtcalError:
        return None
    return found if found.covariance is not None else None


def _is_wanted(what: str, earlier: EarlierCalibration, observations: Observations, options: CalibrationOptions) -> bool:
    """Whether something of the earlier calibration is of this rig, and to be taken."""
    if what == SHAPE and not options.solves_board_shape:
        return False
    return _part_of(what) in earlier.parts and _is_of(what, earlier, observations)


def _part_of(what: str) -> Part:
    if what in (BOARD, SHAPE):
        return "board"
    return "lenses" if what.startswith(intrinsics_of("")) else "rig"


def _is_of(what: str, earlier: EarlierCalibration, observations: Observations) -> bool:
    """Whether it is a thing that this recording has too, and that stays where it is between recordings."""
    if what in (BOARD, SHAPE):
        same = earlier.calibration.board == observations.board.to_manifest()
        return same and (what == SHAPE or observations.capture is not Capture.STANDING_BOARD)
    if what in (ALL, TO_EACH_OTHER):
        return True
    camera = what.removeprefix(intrinsics_of(""))
    if camera not in observations.views:
        return False
    return camera == what or _same_lens(observations.views[camera].camera, earlier.calibration)


def _same_lens(camera: Camera, calibration: Calibration) -> bool:
    if camera.name not in calibration.cameras:
        return False
    before = calibration.cameras[camera.name].camera
    sizes = [(found.model, found.image_width_px, found.image_height_px) for found in (camera, before)]
    return sizes[0] == sizes[1]


def _unmoved(known: Earlier, found: Difference) -> Earlier:
    """What is known of the things that have not moved; of the cameras, in the new ref."""
    moved = {change.what for change in found.changes if change.moved}
    if TO_EACH_OTHER in moved and not moved & set(known.camera_T_ref):
        moved |= set(known.camera_T_ref)  # some of them did, and nobody can tell which
    kept = known.only(lambda what: what not in moved)
    return kept if found.aligned is None else kept.in_another_ref(found.aligned)


def _with_known_lenses(observations: Observations, known: Earlier) -> Observations:
    views = {
        name: replace(
            of_camera,
            camera=replace(of_camera.camera, parameters=known.theta[name], theta_sigmas=known.theta_sigmas(name)),
        )
        if name in known.theta
        else of_camera
        for name, of_camera in observations.views.items()
    }
    return replace(observations, views=views)
