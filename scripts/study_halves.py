"""How far halves of real recordings differ from each other, in units of what their covariances claim.

There is no truth beside a real recording, but two halves of it are two measurements of the same thing. Each recording
is halved so many ways: frame by frame at random (what errs slowly is in both halves alike), and by blocks of time at
random (it is not). Both halves are calibrated; printed is the squared difference of all unknowns, per degree of
freedom, by the sum of the halves' own covariances (1, where these are true; below 1 where both lean on the same
priors), and by the covariance of the whole recording, as 'gtcal selfcheck' judges it; the same of the cameras' and the
board's poses alone, which a lens that its model does not quite fit disturbs less than its intrinsics. What half of a
short recording leaves weak is not refused here: its covariance has to say so.

    python scripts/study_halves.py my_recording another/recording.yaml
    python scripts/study_halves.py my_recording --ways 50 --calibrate-intrinsics
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from in_parallel import in_parallel
from rich.console import Console
from rich.table import Table

from gtcal import CalibrationOptions, GtcalError, load_recording
from gtcal.camera import BoolArray
from gtcal.effects.find import with_effects
from gtcal.estimation.observations import Observations
from gtcal.estimation.options import IntrinsicsMode
from gtcal.estimation.solver import calibrate_observations
from gtcal.results.calibration import Calibration
from gtcal.selfchecks.halves import Difference, SplitHalf, split_half
from gtcal.selfchecks.time_blocks import only_frames, time_blocks
from gtcal.workflow import prepared

BLOCKS = 10
CUTS = ("random frames", "blocks of time")


@dataclass(frozen=True)
class Way:
    """One way to halve a recording."""

    cut: str
    seed: int

    def first_half(self, observations: Observations) -> BoolArray:
        """(F,) mask of its frames."""
        n_units = observations.n_frames if self.cut == CUTS[0] else min(BLOCKS, observations.n_frames)
        chosen = np.random.default_rng(self.seed).permutation(n_units)[: n_units // 2]
        return np.isin(time_blocks(observations, n_units), chosen)


@dataclass(frozen=True)
class Outcome:
    """own: by the sum of the halves' covariances. whole: by the covariance of the whole recording."""

    way: Way
    own: SplitHalf
    whole: SplitHalf

    @property
    def position_mm(self) -> float:
        return float(np.mean([pose.position_mm for pose in _cameras_and_board(self.own) if pose.what != "board"]))


def _cameras_and_board(halves: SplitHalf) -> list[Difference]:
    return [one for one in halves.by_unknown if not one.what.startswith("intrinsics")]


def overall(halves: SplitHalf) -> float:
    """Per degree of freedom, of all unknowns jointly."""
    return halves.overall.per_dof


def of_poses(halves: SplitHalf) -> float:
    """Per degree of freedom, of the cameras and the board: the mean over them."""
    return float(np.mean([one.per_dof for one in _cameras_and_board(halves)]))


def outcome(way: Way, observations: Observations, options: CalibrationOptions, whole: Calibration) -> Outcome | None:
    """Halve, calibrate both and compare; None where a half is refused."""
    mask = way.first_half(observations)
    try:
        first, second = (calibrated(only_frames(observations, keep), options) for keep in (mask, ~mask))
        own, by_whole = split_half(first, second), split_half(first, second, whole)
    except GtcalError:
        return None
    return Outcome(way, own, by_whole)


def calibrated(observations: Observations, options: CalibrationOptions) -> Calibration:
    """As 'gtcal calibrate' does by default: with what the search for effects adds to the covariance."""
    return with_effects(calibrate_observations(observations, options), observations, options)


def study(
    recording: Path, options: CalibrationOptions, ways: int, workers: int | None
) -> tuple[Calibration, list[Outcome]]:
    """Both cuts, so many ways each, of one recording; and the calibration of all of it."""
    observations, _ = prepared(load_recording(recording), options)
    whole = calibrated(observations, options)
    bare = replace(whole, solution=None)  # which no other process could take
    run = partial(outcome, observations=observations, options=options, whole=bare)
    todo = [Way(cut, seed) for cut in CUTS for seed in range(ways)]
    return whole, [found for found in in_parallel(run, todo, workers, str(recording)) if found is not None]


def rows(name: str, whole: Calibration, found: list[Outcome], ways: int) -> Iterator[list[str]]:
    """Of one recording, a row for each cut."""
    for cut in CUTS:
        of_cut = [one for one in found if one.way.cut == cut]
        if not of_cut:
            yield [name, cut, f"0 of {ways}", *[""] * 7]
            continue
        own = np.array([overall(one.own) for one in of_cut])
        yield [
            name,
            cut,
            f"{len(of_cut)} of {ways}",
            f"{np.median([one.position_mm for one in of_cut]):.2f}",
            f"{own.mean():.2f}",
            f"{np.quantile(own, 0.1):.2f} to {np.quantile(own, 0.9):.2f}",
            f"{np.mean([overall(one.whole) for one in of_cut]):.2f}",
            f"{np.mean([of_poses(one.own) for one in of_cut]):.2f}",
            f"{np.mean([of_poses(one.whole) for one in of_cut]):.2f}",
            whole.covariance_kind.replace("_", " "),
        ]


def main() -> None:
    arguments = _arguments()
    intrinsics: IntrinsicsMode = "calibrate" if arguments.calibrate_intrinsics else "auto"
    options = CalibrationOptions(intrinsics=intrinsics, allow_degenerate=True)
    table = Table(title="halves of a recording against each other: squared difference by claimed covariance, per dof")
    numbers = ("solved", "median, mm", "by own", "10 to 90 %", "by whole", "poses by own", "poses by whole")
    for heading in ("recording", "halved by", *numbers):
        table.add_column(heading, justify="left" if heading in ("recording", "halved by") else "right")
    table.add_column("covariance")
    for recording in arguments.recordings:
        for row in rows(recording.stem, *study(recording, options, arguments.ways, arguments.workers), arguments.ways):
            table.add_row(*row)
    Console(width=170).print(table)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="+", help="folders, or manifests")
    parser.add_argument("--ways", type=int, default=20, help="to halve each recording, by either cut")
    parser.add_argument("--calibrate-intrinsics", action="store_true", help="as for 'gtcal calibrate'")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    return parser.parse_args()


if __name__ == "__main__":
    main()
