"""A simulated fleet: rigs over weeks, some of which come to harm. For the demo, the tests and the benchmark."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from gtcal.cores import n_cores
from gtcal.files import write_text
from gtcal.fleet.workers import begin_worker
from gtcal.progress import Progress, silent
from gtcal.simulation import MocapNoise, SimulationOptions, quest3_like_rig, write_simulation
from gtcal.simulation.fault import RigFault, small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.simulation.rig import Rig
from gtcal.simulation.simulate import scene_of, seed_of_take, simulate_take

JOBS = "jobs.yaml"
_FIRST_DAY = datetime.datetime(2026, 3, 2, 8, 30, tzinfo=datetime.UTC)


@dataclass(frozen=True)
class Harm:
    """What comes to a rig. fault: all of it. from_day, to_day: it begins after the first, and is all there at the
    second; a bump where both are the same."""

    fault: RigFault
    from_day: float
    to_day: float

    def on(self, day: float) -> RigFault:
        """As much of it as has come by that day."""
        if day >= self.to_day:
            return self.fault
        return self.fault.scaled((day - self.from_day) / (self.to_day - self.from_day) if day > self.from_day else 0.0)


@dataclass(frozen=True)
class FleetOptions:
    """A fleet to simulate.

    harms: by the rig's number, from 0. n_days: from the first calibration on. verified_every, calibrated_every: days.
    n_frames, verification_frames, duration_s: of a calibration's recording, of a verification's, and of both.
    donned_mm, donned_deg: 1-sigma of how the markers sit each day, along and about each axis: what is no harm."""

    n_rigs: int = 5
    n_days: int = 56
    verified_every: tuple[int, ...] = (1, 3, 5)
    calibrated_every: int = 14
    harms: dict[int, Harm] = field(default_factory=dict)
    n_frames: int = 60
    verification_frames: int = 240
    duration_s: float = 20.0
    mocap_rate_hz: float = 100.0
    mocap: MocapNoise = field(default_factory=lambda: MocapNoise(0.05, 0.005))
    donned_mm: float = 0.02
    donned_deg: float = 0.002
    rig: Rig = field(default_factory=quest3_like_rig)
    seed: int = 0


def demo_fleet(seed: int = 0) -> FleetOptions:
    """Five rigs over eight weeks: a camera of the second drifts, the fourth is bumped, a lens of the fifth warms."""
    drifted = RigFault(cameras={"side_left": small_motion((0.45, 0.0, 0.0), (0.0, 0.0, 0.0))})
    bumped = RigFault(cameras={"front_right": small_motion((0.5, 0.4, 0.0), (0.0, 0.08, 0.0))})
    warmed = RigFault(focal_shares={"front_left": 0.0015})
    harms = {1: Harm(drifted, 14.0, 58.0), 3: Harm(bumped, 38.2, 38.2), 4: Harm(warmed, 21.0, 49.0)}
    return FleetOptions(harms=harms, seed=seed, calibrated_every=28)


@dataclass(frozen=True)
class _Take:
    """One recording to write."""

    rig: int
    day: float
    number: int
    calibrates: bool
    folder: Path

    @property
    def called(self) -> str:
        return f"{at_day(self.day):%Y-%m-%d}_{'board' if self.calibrates else 'lollypop'}"


def at_day(day: float) -> datetime.datetime:
    """The moment so many days after the first calibration."""
    return _FIRST_DAY + datetime.timedelta(days=day)


def rig_name(number: int) -> str:
    """Of the rig of this number, from 0."""
    return f"rig{number + 1:02d}"


def write_fleet(
    folder: Path, options: FleetOptions, *, workers: int | None = None, progress: Progress = silent
) -> Path:
    """Write all recordings of a fleet below a folder, and the file of jobs for them, whose path is returned. workers:
    processes, as many as there are cores by default; 0: none beside this."""
    takes = list(_takes(folder, options))
    if workers == 0:
        for done, take in enumerate(takes):
            _write(take, options)
            progress("simulating", done + 1, len(takes))
    else:
        with ProcessPoolExecutor(workers or n_cores(), get_context("spawn"), begin_worker) as pool:
            for done, _ in enumerate(pool.map(_write, takes, [options] * len(takes))):
                progress("simulating", done + 1, len(takes))
    jobs = [
        {
            "rig": rig_name(take.rig),
            "kind": "calibrate" if take.calibrates else "verify",
            "recording": f"{rig_name(take.rig)}/{take.called}",
            "taken": at_day(take.day).isoformat(),
        }
        for take in takes
    ]
    known = {"mocap_sigma_mm": options.mocap.translation_mm, "mocap_sigma_deg": options.mocap.rotation_deg}
    head = {"gtcal_jobs": 1, "options": {"calibrate": {"effects": False, **known}}}
    text = yaml.safe_dump({**head, "jobs": jobs}, sort_keys=False, default_flow_style=None, width=160)
    write_text(folder / JOBS, text)
    return folder / JOBS


def _takes(folder: Path, options: FleetOptions) -> Iterator[_Take]:
    verified = [d for d in range(options.n_days) if d % 7 in options.verified_every]
    for rig in range(options.n_rigs):
        for number, day in enumerate(range(0, options.n_days, options.calibrated_every)):
            yield _Take(rig, day, number, True, folder / rig_name(rig))
        for number, day in enumerate(verified, start=1000):
            yield _Take(rig, day, number, False, folder / rig_name(rig))


def _write(take: _Take, options: FleetOptions) -> None:
    seed = seed_of_take(options.seed, take.rig + 1)
    path = take.folder / take.called
    board = SimulationOptions(
        rig=options.rig,
        n_frames=options.n_frames,
        duration_s=options.duration_s,
        mocap_rate_hz=options.mocap_rate_hz,
        mocap=options.mocap,
    )
    fault = _on_the_day(take, options)
    if take.calibrates:
        write_simulation(simulate_take(board, seed=seed, take=take.number, fault=fault), path, images=False)
        return
    device = LollypopOptions(
        rig=options.rig,
        fault=fault,
        calibrated_in=scene_of(board, seed=seed),
        n_frames=options.verification_frames,
        duration_s=options.duration_s,
        mocap_rate_hz=options.mocap_rate_hz,
        mocap=options.mocap,
    )
    write_lollypop_simulation(simulate_lollypop(device, seed=seed_of_take(seed, take.number)), path, images=False)


def _on_the_day(take: _Take, options: FleetOptions) -> RigFault:
    """What has come to the rig by then, and how it was put on that day; as it was calibrated first, on the first."""
    harm = options.harms[take.rig].on(take.day) if take.rig in options.harms else RigFault()
    if take.calibrates and take.number == 0:
        return harm
    random = np.random.default_rng([options.seed, take.rig, take.number])
    donned = small_motion(options.donned_mm * random.normal(size=3), options.donned_deg * random.normal(size=3))
    return replace(harm, markers=harm.markers @ donned)
