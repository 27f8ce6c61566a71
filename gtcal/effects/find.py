"""What else the data want: all effects looked for in a calibration's frames, with what each would do to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from factors.board_shape import N_SHAPE
from gtcal.camera import FloatArray
from gtcal.effects.board import BoardShapePart
from gtcal.effects.change_points import ChangePoint, LensAfter, find_changes, others_of
from gtcal.effects.effect import Effect
from gtcal.effects.evidence import Evidence, Sums
from gtcal.effects.frames import Frames, lag_of
from gtcal.effects.lenses import lens_effects
from gtcal.effects.timing import BodyLag, ClockDrift, ClockOffset, moves
from gtcal.effects.turned import turned_views
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.mocap_noise import MocapNoiseModel, Whiteness
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.results.calibration import Calibration, MocapNoise, pose_moved
from gtcal.results.effect_finding import EffectFinding

FALSE_ALARMS = 0.01
"""How often a clean recording may be said to show any effect at all; half for changes, half for the others."""

TESTED_ELSEWHERE = "clock offset"
"""The clock's own test warns of it, and finds it without linearising."""


def with_effects(calibration: Calibration, observations: Observations, options: CalibrationOptions) -> Calibration:
    """The calibration with what else the data want, as ``with_found``, and a warning where a body was mistaken.

    observations: those that it was computed from. Where the mocap was taken as exact, or its noise could not be told,
    nothing is looked for: significance needs a noise."""
    found = with_found(calibration, find_effects(calibration, observations, options))
    if calibration.solution is None:
        return found
    turned = turned_views(observations, calibration.estimate, calibration.solution.views)
    return found if turned is None else replace(found, warnings=(*found.warnings, turned.statement))


def with_found(calibration: Calibration, found: FoundEffects) -> Calibration:
    """The calibration with these effects, and a warning for each that is no chance; by how much the estimate would move
    if these were let in is in its covariance, for so far is it off. A change that is named explains what else would
    look like errors that are smooth in time."""
    with_doubt = calibration
    if calibration.covariance is not None and len(found.left_out):
        joint = calibration.covariance
        shifts = found.left_out[:, : len(joint.matrix)]
        with_doubt = calibration.with_covariance(replace(joint, matrix=joint.matrix + shifts.T @ shifts))
    named = calibration.mocap_noise.warnings if calibration.mocap_noise and found.changes else ()
    warnings = (*(line for line in calibration.warnings if line not in named), *effect_warnings(found.effects))
    return replace(with_doubt, effects=found.effects, warnings=warnings)


@dataclass(frozen=True)
class FoundEffects:
    """effects: those that move a camera most first. changes: among them, in order of time. left_out: (s, P) by how much
    the unknowns (those of a ``JointCovariance`` first) would move with each of the s effects that are no chance."""

    effects: tuple[EffectFinding, ...]
    changes: tuple[ChangePoint, ...]
    left_out: FloatArray


def effect_warnings(found: Sequence[EffectFinding]) -> tuple[str, ...]:
    """Each change in a line, and one line for all else that the same cure helps."""
    lines: list[str] = []
    by_advice: dict[str, list[EffectFinding]] = {}
    for finding in found:
        if finding.significant and finding.moment:
            lines.append(finding.statement)
        elif finding.significant and finding.name != TESTED_ELSEWHERE:
            by_advice.setdefault(finding.advice, []).append(finding)
    for first, *others in by_advice.values():
        also = f" (also: {', '.join(other.name for other in others)})" if others else ""
        lines.append(f"{first.statement}{also}")
    return tuple(lines)


def find_effects(
    calibration: Calibration,
    observations: Observations,
    options: CalibrationOptions,
    *,
    more: Sequence[Effect] = (),
) -> FoundEffects:
    """All effects; ``more``: the caller's own."""
    nothing = FoundEffects((), (), np.zeros((0, 0)))
    try:
        frames = frames_of(calibration, observations, options)
        return nothing if frames is None else effects_in(frames, (*lasting_effects(frames, options), *more))
    except np.linalg.LinAlgError:  # a direction that the data leave open, which other warnings name
        return nothing


def effects_in(frames: Frames, lasting: Sequence[Effect]) -> FoundEffects:
    """What moved at some time, and these effects that hold all the time.

    Raises numpy.linalg.LinAlgError where the frames leave a direction open."""
    changes: tuple[ChangePoint, ...] = ()
    if not frames.motion.numbered:  # else there is no time at which something could have changed
        frames, changes = find_changes(frames, level=0.5 * FALSE_ALARMS)
    effects: list[Effect] = [*changes, *map(LensAfter, changes), *lasting]
    tests = {index: 2.0 * change.tests for index, change in enumerate(changes)}
    tests |= {index: 2.0 * len(lasting) for index in range(2 * len(changes), len(effects))}
    sums = Sums.of(frames, effects)
    let_in = _let_in(sums, tests, range(2 * len(changes)))
    found, left_out = [], []
    for index, count in tests.items():
        is_change = index < len(changes)
        given = others_of(index, len(changes)) if is_change else [other for other in let_in if other != index]
        evidence = sums.evidence(index, given, from_stated=is_change)
        finding = _finding(effects[index], evidence, frames.estimate, count)
        if finding.is_finite:
            found.append(finding)
            left_out += [evidence.shift] if finding.significant else []
    found.sort(key=lambda finding: (not finding.significant, -finding.largest_move_mm))
    return FoundEffects(tuple(found), changes, np.array(left_out).reshape(len(left_out), len(frames.free)))


def frames_of(calibration: Calibration, observations: Observations, options: CalibrationOptions) -> Frames | None:
    """What effects are looked for in; None where the mocap's noise is not known, or the frames are too few."""
    if calibration.mocap_noise is None:
        return None
    noise = calibration.mocap_noise
    lag_1 = lag_of(Whiteness(noise.innovation_variance, noise.lag_1, noise.lag_1_sigma))
    return Frames.of(observations, calibration.estimate, noise_model(noise), options, lag_1)


def _let_in(sums: Sums, tests: Mapping[int, float], given: Sequence[int]) -> list[int]:
    """Those given, and one at a time the effect that explains most, while it is significant: a wrong focal length, let
    in, no longer looks like a wrong distortion."""
    chosen = list(given)
    while True:
        tried = {index: sums.evidence(index, chosen) for index in tests if index not in chosen}
        tried = {index: found for index, found in tried.items() if _significant(found, tests[index])}
        if not tried:
            return chosen
        chosen.append(max(tried, key=lambda index: tried[index].worth))


def _significant(evidence: Evidence, tests: float) -> bool:
    return evidence.p_value * tests < FALSE_ALARMS and evidence.hold_out_drop_px > 0.0


def noise_model(noise: MocapNoise) -> MocapNoiseModel:
    """What a calibration took for the mocap's noise."""
    bodies = {
        name: MocapSigmas(sigma_mm, noise.rotation_sigma_deg[name])
        for name, sigma_mm in noise.translation_sigma_mm.items()
    }
    return MocapNoiseModel(bodies, noise.correlation_s, noise.jitter_s, noise.estimated)


def lasting_effects(frames: Frames, options: CalibrationOptions) -> list[Effect]:
    """Those that hold all the time and that the options leave out."""
    effects: list[Effect] = [] if options.solves_board_shape else [BoardShapePart(index) for index in range(N_SHAPE)]
    if moves(frames):
        effects += [] if options.clock in ("estimate", "per_camera") else [ClockOffset()]
        effects += [] if options.clock_drift else [ClockDrift()]
        effects += [BodyLag()] if BodyLag.possible(frames) else []
    return effects if options.refine_intrinsics else [*effects, *lens_effects(frames)]


def _finding(effect: Effect, evidence: Evidence, estimate: Estimate, tests: float) -> EffectFinding:
    p_value = min(tests * evidence.p_value, 1.0)
    moved = {name: pose_moved(estimate.camera_T_ref[name], xi) for name, xi in evidence.moves.items()}
    return EffectFinding(
        name=effect.name,
        what=effect.what,
        estimate=effect.quantities(evidence.estimate, evidence.covariance),
        p_value=p_value,
        significant=_significant(evidence, tests),
        hold_out_px=evidence.hold_out_px,
        hold_out_drop_px=evidence.hold_out_drop_px,
        moves_mm={name: mm for name, (mm, _) in moved.items()},
        moves_deg={name: deg for name, (_, deg) in moved.items()},
        advice=effect.advice,
        moment=effect.moment,
    )
