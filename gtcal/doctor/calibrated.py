"""What a calibration of the recording still warns of once it is read rightly: changes and other effects, lenses and
boards that are not as stated, poses that contradict the rest. What 'gtcal calibrate' warns of is explained here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtcal.doctor.chain_search import CONVINCING_NUMBER
from gtcal.doctor.findings import HELD_OUT, LEFT_OUT, Finding
from gtcal.effects.find import TESTED_ELSEWHERE
from gtcal.effects.turned import TurnedViews, turned_views
from gtcal.estimation.lens_moves import lens_warnings
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver_warnings import MANY_DROPPED
from gtcal.progress import Progress
from gtcal.recordings.detections import IntArray
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration
from gtcal.results.effect_finding import EffectFinding
from gtcal.workflow import calibrate

INTRINSICS, BOARD_SHAPE = NOT_AS_STATED = "intrinsics", "board shape"

CERTAIN = 1e-5
"""Effects that are likelier than this to be chance are notes: of a thousand clean recordings not one has a finding."""


@dataclass(frozen=True)
class Calibrated:
    """findings, notes: what the calibration tells. used_ns: by camera, the stamps of the views that it used."""

    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    used_ns: dict[str, IntArray]


def look_at_calibration(recording: Recording, progress: Progress) -> Calibrated:
    """Calibrate with the defaults, and tell of all that stands out.

    Raises GtcalError where there is no calibration."""
    recording = replace(recording, path=None)  # whose hint would be to ask the doctor
    calibration = calibrate(recording, progress=progress)
    assert calibration.solution is not None
    used_ns = {name: views.stamps_ns for name, views in calibration.solution.views.items()}
    lenses = {name: camera.camera for name, camera in calibration.cameras.items()}
    observations = synchronise(replace(recording, cameras=lenses))
    turned = turned_views(observations, calibration.estimate, calibration.solution.views)
    stated, unconvincing = _not_as_stated(recording, calibration)
    findings = [
        *_left_out(calibration, {name: views.n_views for name, views in observations.views.items()}, turned),
        *_effects(calibration),
        *stated,
    ]
    return Calibrated(tuple(findings), (*unconvincing, *_unlikely(calibration)), used_ns)


def _left_out(calibration: Calibration, n_views: dict[str, int], turned: TurnedViews | None) -> Iterator[Finding]:
    assert calibration.solution is not None
    used = {name: views.n_views for name, views in calibration.solution.views.items()}
    all_views, left = sum(n_views.values()), sum(n_views.values()) - sum(used.values())
    if turned is None and left <= MANY_DROPPED * all_views:
        return
    by_camera = ", ".join(f"{name} {n - used[name]} of {n}" for name, n in n_views.items() if n > used[name])
    says = f"{left} of {all_views} views contradict the others, which agree among themselves ({by_camera})"
    advice = "look at the mocap at these times for bodies that swap or slip; gtcal leaves such views out"
    if turned is not None:
        says, advice = turned.statement.rsplit("; ", 1)
    fault = "mistaken body" if turned else "gross views"
    yield Finding(fault, says, (), (advice,), LEFT_OUT, 100.0 * left / all_views, 0.0, "%")


def _effects(calibration: Calibration) -> Iterator[Finding]:
    """One finding for each change; the others that the same advice helps are told together, the first at length."""
    advised: set[str] = set()
    for effect in _certain(calibration):
        if effect.moment is None and effect.advice in advised:
            continue
        advised |= set() if effect.moment else {effect.advice}
        before = effect.hold_out_px
        assert before is not None  # of a calibration of this version
        yield Finding(
            effect.name,
            effect.statement.removesuffix(f": {effect.advice}"),
            (),
            (effect.advice,),
            HELD_OUT,
            before,
            before - effect.hold_out_drop_px,
            "px",
        )


def _certain(calibration: Calibration) -> list[EffectFinding]:
    return [
        effect
        for effect in calibration.effects
        if effect.significant and effect.p_value < CERTAIN and effect.name != TESTED_ELSEWHERE
    ]


def _not_as_stated(recording: Recording, calibration: Calibration) -> tuple[list[Finding], list[str]]:
    """Lenses and a board that moved further from what is stated than its sigmas allow: findings where unseen views fit
    clearly better than with these held, else notes."""
    findings, notes = [], []
    stated = {name: camera for name, camera in recording.cameras.items() if camera.parameters is not None}
    moves = {name: calibration.cameras[name].lens_moves for name in stated}
    shape = calibration.board_shape
    held = replace(recording, cameras={name: camera.camera for name, camera in calibration.cameras.items()} | stated)
    told = [
        (INTRINSICS, lens_warnings(stated, moves), CalibrationOptions(intrinsics="exact", effects=False)),
        (BOARD_SHAPE, shape.warnings if shape else (), CalibrationOptions(board="exact", effects=False)),
    ]
    for fault, warnings, options in told:
        for line in warnings:
            says, _, advice = line.partition(": " if fault == INTRINSICS else "; ")
            before = _held_out_px(calibrate(held, options))
            after = _held_out_px(calibration)
            if after <= CONVINCING_NUMBER * before:
                findings.append(Finding(fault, says, (), (advice,), HELD_OUT, before, after, "px"))
            else:
                notes.append(f"{line} (unseen views fit about as well with what is stated)")
    return findings, notes


def _unlikely(calibration: Calibration) -> Iterator[str]:
    """What may be chance still."""
    certain = _certain(calibration)
    for effect in calibration.effects:
        if effect.significant and effect not in certain:
            yield f"perhaps, by {effect.p_value:.1g} to be chance: {effect.statement}"


def _held_out_px(calibration: Calibration) -> float:
    """Of the stage that was taken; of corners that were seen where none were held out."""
    noise = calibration.mocap_noise
    if noise is not None:
        return float(noise.hold_out_px[noise.stage])
    return float(np.sqrt(np.mean([camera.residuals.rmse_px**2 for camera in calibration.cameras.values()])))
