"""Hand-eye calibration from poses on KinHEC's sequences, by its own protocol, against its own baselines.

KinHEC (Aiersilan) is a synthetic benchmark of AX = XB and AX = YB: robot and camera poses with noise of several kinds,
outliers, drift, poor motion, a clock's offset. Its package brings the solvers, the keyframes and the measures; what is
added is 'gtcal', gtcal.calibrate_poses on the same keyframes. Printed is, by track, the median error of X of the best
baseline and of gtcal, and in how many sequences gtcal is nearer to the truth than the best baseline of the track.

    pip install kinhec
    kinhec generate --tier small --out kinhec_data --no-card
    python scripts/yardstick_hand_eye.py kinhec_data

    kinhec generate --tier smoke --out kinhec_data --no-card   # 46 sequences, two minutes

Sequences without scale (the track 'monocular', some of 'mixed') have no board of a known size, which gtcal needs, and
are left out.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from factors.rigid import inverse
from gtcal import calibrate_poses
from gtcal.camera import FloatArray

OURS = "gtcal"
MEASURES = {"X_trans_err_mm": "mm", "X_rot_err_deg": "deg"}


def solve(data: tuple[FloatArray, FloatArray, Any, Any], rng: np.random.Generator) -> dict[str, FloatArray]:
    """As a solver of KinHEC: A X = Y B, with A the robot's poses and B the camera's.

    Whether the camera is in the hand or looks at it is not told to a solver: both are tried, and the likelier is taken,
    for the noise is the camera's."""
    A, B, _, _ = data
    in_hand, at_hand = calibrate_poses(inverse(A), inverse(B), rng), calibrate_poses(A, B, rng)
    if in_hand.minus_log_likelihood <= at_hand.minus_log_likelihood:
        return {"X": inverse(in_hand.camera_T_ref), "Y": in_hand.body_T_board}
    return {"X": at_hand.body_T_board, "Y": inverse(at_hand.camera_T_ref)}


def results(folder: Path, tracks: list[str] | None) -> Any:
    """KinHEC's table of results, a row for each sequence and solver.

    Raises ImportError where kinhec is not installed."""
    from kinhec import benchmark

    benchmark.SOLVERS[OURS] = solve
    benchmark.SOLVER_DOCS[OURS] = "gtcal.calibrate_poses: joint, with the noise's covariance and tail"
    with tempfile.TemporaryDirectory() as out:
        return benchmark.run_benchmark(folder, Path(out), tracks=tracks)


def rows(found: Any) -> Iterator[list[str]]:
    """A row for each track, way of synchronising, and measure."""
    known = found[found["ok"] & (found["scale"] == 1.0)]
    for (track, sync), of_track in known.groupby(["track", "eval_sync"]):
        for measure, unit in MEASURES.items():
            errors = of_track.pivot_table(index="sequence_id", columns="solver", values=measure)
            medians = errors.median().sort_values()
            best = next(name for name in medians.index if name != OURS)
            nearer = float((errors[OURS] <= errors[best]).mean())
            cells = [f"{medians[best]:.3f}", f"{medians[OURS]:.3f}", f"{nearer:.0%}"]
            yield [str(track), str(sync), str(len(errors)), unit, best, *cells]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder that 'kinhec generate' wrote, or of the published data")
    parser.add_argument("--tracks", nargs="*", help="only these")
    arguments = parser.parse_args()
    try:
        found = results(arguments.data, arguments.tracks)
    except ImportError:
        sys.exit("kinhec is not installed, so there is nothing to compare with: pip install kinhec")
    table = Table(title="hand-eye calibration from poses, KinHEC's protocol: median error of X")
    for heading in ("track", "clock", "sequences", "unit", "best baseline", "its", OURS, "gtcal nearer"):
        table.add_column(heading, justify="right" if heading in ("sequences", "its", OURS, "gtcal nearer") else "left")
    for row in rows(found):
        table.add_row(*row)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
