"""An effect of one's own: is the board creeping on its body, along an axis, evenly over the recording?

gtcal asks a recording for what its model leaves out, each effect as a few columns: by how much a unit of its parameters
moves the tangents of every frame. Here a glue that gives way moves the board by a steady rate, which gtcal does not
look for; the question takes fifteen lines.

    python scripts/example_own_effect.py
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import gtcal
from gtcal.camera import FloatArray
from gtcal.effects.effect import single
from gtcal.effects.find import find_effects
from gtcal.effects.frames import Frames
from gtcal.recordings.recording import Recording
from gtcal.results.effect_finding import EffectFinding, Moment, Quantity
from gtcal.simulation import SimulationOptions, simulate

OPTIONS = gtcal.CalibrationOptions()
X_TRANSLATION = 9  # the tangents of a frame: its pose (6), then X (rotation, translation), the cameras, the lenses


@dataclass(frozen=True)
class BoardCreep:
    """X moves along an axis of the board, in m/s; half way it is as calibrated."""

    axis: int
    moment: Moment | None = None
    advice: str = "glue the board again"

    @property
    def name(self) -> str:
        return f"creep of the board along its {'xyz'[self.axis]} axis"

    @property
    def what(self) -> str:
        return f"the board creeps along its {'xyz'[self.axis]} axis"

    def columns(self, frames: Frames) -> FloatArray:
        seconds = frames.seconds(frames.stamps_ns)
        columns = np.zeros((len(seconds), frames.n_columns, 1))
        columns[:, X_TRANSLATION + self.axis, 0] = seconds - seconds.mean()
        return columns

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return single(estimate, covariance, 60e3, "mm/min")


def creeping(recording: Recording, mm_per_min: float, axis: int) -> Recording:
    """The recording with a mocap body that stays behind: the board moves on it along an axis of the body."""
    body = recording.board_body
    assert body is not None
    moved = body.world_T_body.copy()
    minutes = (body.stamps_ns - body.stamps_ns.mean()) / 60e9
    moved[:, :3, 3] -= 1e-3 * mm_per_min * minutes[:, None] * moved[:, :3, axis]
    return replace(recording, board_body=replace(body, world_T_body=moved))


def main(n_frames: int = 300, mm_per_min: float = 1.0) -> dict[str, EffectFinding]:
    simulation = simulate(SimulationOptions(n_frames=n_frames, duration_s=60.0), seed=0)
    found = {}
    for what, recording in (
        ("as it is", simulation.recording),
        (f"creeping by {mm_per_min:g} mm/min", creeping(simulation.recording, mm_per_min, axis=0)),
    ):
        calibration = gtcal.calibrate(recording, OPTIONS)
        observations = gtcal.synchronise(recording)
        own = [BoardCreep(axis) for axis in range(3)]
        effects = find_effects(calibration, observations, OPTIONS, more=own).effects
        mine = [effect for effect in effects if effect.name.startswith("creep of the board")]
        found[what] = min(mine, key=lambda effect: effect.p_value)
        verdict = "significant" if found[what].significant else "no more than chance"
        rate = found[what].estimate[0]
        size = f"{rate.value:+.2f} {rate.unit} ± {rate.sigma:.2f}"
        print(f"{what}: {found[what].name}: {size}; p = {found[what].p_value:.2g}, {verdict}")
    return found


if __name__ == "__main__":
    main()
