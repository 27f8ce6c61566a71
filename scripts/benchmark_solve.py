"""How fast the solver is, as ratios to its peers in the same run.

4 cameras, 1,000 frames, about 250,000 corners, at the level of detections: the time of every stage, PnP and marginals
included; beside it, to the same optimum, scipy.optimize.least_squares with the analytic Jacobian, and one CustomFactor
per corner (on a subset of the views, scaled by the number of corners). Then the same by cores, and the growth with the
number of frames, with peak memory, each in a process of its own.

    python scripts/benchmark_solve.py                 # all of it, about five minutes on two cores
    python scripts/benchmark_solve.py --no-growth     # the comparison only
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import gtsam
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from factors import CornerReprojectionFactor, RobustKernel
from factors.cores import JOBS_VARIABLE, n_cores
from factors.moments import chain
from gtcal import CalibrationOptions, board_from_manifest, synchronise
from gtcal.blas import on_one_blas_thread
from gtcal.camera import FloatArray
from gtcal.estimation.adjustment import Adjusted, adjust, joint_covariance
from gtcal.estimation.alignment import GuideViews, stage_1, stage_2
from gtcal.estimation.errors_in_variables import MocapNoiseFit, adjust_with_mocap_noise, fit_mocap_noise
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import BODY_T_BOARD, camera_T_ref_key, minimise, reprojection_graph, to_values, updated
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.pnp import solve_pnp
from gtcal.estimation.residuals import chain_residuals_px, select_views
from gtcal.recordings.capture import RefMotion
from gtcal.results.covariance import ERRORS_IN_VARIABLES, NAIVE, JointCovariance
from gtcal.simulation import SimulationOptions, quest3_like_rig, simulate

BOARD = {
    "type": "aprilgrid",
    "family": "36h11",
    "tag_columns": 6,
    "tag_rows": 6,
    "tag_side_m": 0.055,
    "tag_spacing": 0.3,
}
OPTIONS = CalibrationOptions(intrinsics="exact")
GROWTH_FRAMES = (250, 1_000, 4_000, 16_000)
CORES_FRAMES = 4_000
FRAME_RATE_HZ = 30.0
PER_CORNER_VIEWS = 10  # of each camera

STAGE_3, STAGE_3_MARGINALS = "stage 3: pixels, screened", "marginals"
NOISE, STAGE_4 = "mocap noise: estimated, gross frames, hold-out", "stage 4: mocap noise, marginals"

T = TypeVar("T")
Seconds = dict[str, float]


def timed(work: Callable[[], T]) -> tuple[T, float]:
    started = time.perf_counter()
    result = work()
    return result, time.perf_counter() - started


def options_of(n_frames: int) -> SimulationOptions:
    """A headset and a board, both tracked; every frame of a minute or of as long as it takes."""
    return SimulationOptions(
        rig=quest3_like_rig(),
        board=board_from_manifest(BOARD),
        n_frames=n_frames,
        duration_s=max(60.0, n_frames / FRAME_RATE_HZ),
        camera_rate_hz=FRAME_RATE_HZ,
    )


def recording_of(n_frames: int) -> Observations:
    """What is simulated of so many frames."""
    return synchronise(simulate(options_of(n_frames), seed=0).recording)


def guided(views: Mapping[str, Views]) -> dict[str, GuideViews]:
    return {name: GuideViews.of(v, solve_pnp(v, max_views=OPTIONS.pnp_views)) for name, v in views.items()}


@on_one_blas_thread
def solve(observations: Observations) -> tuple[Estimate, Estimate, Seconds]:
    """Where stage 2 and stage 3 end, and what each part takes."""
    seconds: Seconds = {}
    views = observations.views
    guides, seconds["PnP"] = timed(lambda: guided(views))
    aligned, seconds["stage 1: sweeps"] = timed(lambda: stage_1(guides, np.random.default_rng(0)))
    (start, _), seconds["stage 2: 3-D alignment"] = timed(
        lambda: stage_2(aligned.views, aligned.estimate, eps=OPTIONS.eps, max_iterations=100)
    )
    adjusted, seconds[STAGE_3] = timed(lambda: adjust(views, start, OPTIONS))
    _, seconds[STAGE_3_MARGINALS] = timed(lambda: joint_covariance(adjusted, NAIVE))
    (screened, noise), seconds[NOISE] = timed(lambda: fit_mocap_noise(adjusted, observations.motion, OPTIONS))
    _, seconds[STAGE_4] = timed(lambda: stage_4(screened, noise, observations.motion))
    return start, adjusted.estimate, seconds


def stage_4(screened: Adjusted, noise: MocapNoiseFit, motion: RefMotion) -> JointCovariance | None:
    """Errors in variables: every frame's ref_T_body a variable, to the covariance of what the frames share."""
    freed = adjust_with_mocap_noise(screened, noise, motion, OPTIONS)
    return joint_covariance(freed, ERRORS_IN_VARIABLES)


def stage_3_alone(views: Mapping[str, Views], start: Estimate) -> tuple[Estimate, float]:
    """The minimisation of stage 3 without screening: what its peers do too."""
    graph = reprojection_graph(views, start, sigma_px=1.0, robust=RobustKernel(), intrinsics_priors=None)
    found, seconds = timed(
        lambda: minimise(graph, to_values(start, with_theta=False), eps=OPTIONS.eps, max_iterations=100)
    )
    return updated(start, found.values), seconds


def scipy_alone(views: Mapping[str, Views], start: Estimate) -> tuple[Estimate, float]:
    """The same minimisation by MINPACK's Levenberg-Marquardt, with vectorised residuals and Jacobian."""

    def residuals(x: FloatArray) -> FloatArray:
        estimate = moved(start, x)
        by_camera = [chain_residuals_px(v, estimate) for v in views.values()]
        outside = 2.0 * np.concatenate([np.full(v.n_corners, v.camera.theta[0]) for v in views.values()])
        found = np.concatenate(by_camera)
        return np.where(np.isnan(found), outside[:, None], found).ravel()

    def jacobian(x: FloatArray) -> FloatArray:
        estimate = moved(start, x)
        return np.concatenate([camera_jacobian(v, estimate, i, len(views), x) for i, v in enumerate(views.values())])

    found, seconds = timed(
        lambda: least_squares(residuals, np.zeros(6 + 6 * len(views)), jacobian, method="lm", ftol=1e-6)
    )
    return moved(start, found.x), seconds


def moved(start: Estimate, x: FloatArray) -> Estimate:
    """The estimate with X and every Y_c moved by T * Exp(xi)."""
    poses = {
        name: pose @ gtsam.Pose3.Expmap(x[6 + 6 * i : 12 + 6 * i]).matrix()
        for i, (name, pose) in enumerate(start.camera_T_ref.items())
    }
    return Estimate(start.body_T_board @ gtsam.Pose3.Expmap(x[:6]).matrix(), poses, start.theta)


def camera_jacobian(views: Views, estimate: Estimate, index: int, n_cameras: int, x: FloatArray) -> FloatArray:
    """Residuals' derivative (2 N, 6 + 6 C) by the steps x of ``moved``."""
    camera_T_ref = estimate.camera_T_ref[views.camera.name]
    ref_T_board = chain(np.eye(4), views.ref_T_body, estimate.body_T_board)[views.view_of_corner]
    in_ref = np.einsum("nij,nj->ni", ref_T_board[:, :3, :3], views.corners_m) + ref_T_board[:, :3, 3]
    in_camera = in_ref @ camera_T_ref[:3, :3].T + camera_T_ref[:3, 3]
    _, valid, J_point, _ = views.camera.model.project_with_jacobians(in_camera, views.camera.theta)
    by_ref = np.where(valid[:, None, None], J_point, 0.0) @ camera_T_ref[:3, :3]
    by_board = by_ref @ ref_T_board[:, :3, :3]
    J = np.zeros((len(in_ref), 2, 6 + 6 * n_cameras))
    J[:, :, :3], J[:, :, 3:6] = np.cross(views.corners_m[:, None], by_board), by_board
    own = 6 + 6 * index
    J[:, :, own : own + 3], J[:, :, own + 3 : own + 6] = np.cross(in_ref[:, None], by_ref), by_ref
    J = J.reshape(-1, J.shape[2])
    J[:, :6] = J[:, :6] @ right_jacobian(x[:6])
    J[:, own : own + 6] = J[:, own : own + 6] @ right_jacobian(x[own : own + 6])
    return J


def right_jacobian(xi: FloatArray) -> FloatArray:
    """d Exp(xi) in the tangent at Exp(xi)."""
    return np.asarray(gtsam.Pose3.ExpmapDerivative(xi))


def per_corner_alone(views: Mapping[str, Views], start: Estimate) -> tuple[Estimate, float]:
    """One CustomFactor per corner."""
    graph = gtsam.NonlinearFactorGraph()
    noise = gtsam.noiseModel.Unit.Create(2)
    for index, v in enumerate(views.values()):
        for n, view in enumerate(v.view_of_corner):
            graph.add(
                CornerReprojectionFactor(
                    camera_T_ref_key(index),
                    BODY_T_BOARD,
                    corner_m=v.corners_m[n],
                    corner_px=v.corners_px[n],
                    model=v.camera.model,
                    ref_T_body=v.ref_T_body[view],
                    theta=v.camera.theta,
                    noise_model=noise,
                )
            )
    found, seconds = timed(
        lambda: minimise(graph, to_values(start, with_theta=False), eps=OPTIONS.eps, max_iterations=100)
    )
    return updated(start, found.values), seconds


def difference_mm(a: Estimate, b: Estimate) -> float:
    """Largest difference of a translation, in mm."""
    pairs = [(a.body_T_board, b.body_T_board), *zip(a.camera_T_ref.values(), b.camera_T_ref.values(), strict=True)]
    return 1e3 * max(float(np.abs(one[:3, 3] - other[:3, 3]).max()) for one, other in pairs)


def compare(console: Console) -> None:
    observations = recording_of(1_000)
    views = observations.views
    n_corners = sum(v.n_corners for v in views.values())
    console.print(f"{len(views)} cameras, 1,000 frames, {n_corners:,} corners")
    solve(observations)  # compiles the kernels
    start, _, seconds = min((solve(observations) for _ in range(3)), key=lambda run: sum(run[2].values()))
    ours, ours_s = min((stage_3_alone(views, start) for _ in range(3)), key=lambda run: run[1])
    total_s = sum(seconds.values())
    parts = Table("part", "s", "of stage 3", "of its minimisation alone")
    for name, part_s in [*seconds.items(), ("all of it", total_s)]:
        parts.add_row(name, f"{part_s:.3f}", f"{part_s / seconds[STAGE_3]:.2f}", f"{part_s / ours_s:.2f}")
    console.print(parts)
    plain_s = seconds[STAGE_3] + seconds[STAGE_3_MARGINALS]
    console.print(
        f"stage 4 against stage 3, marginals included: {seconds[STAGE_4] / plain_s:.1f} times; with the noise "
        f"estimated first: {(seconds[NOISE] + seconds[STAGE_4]) / plain_s:.1f} times"
    )

    by_scipy, scipy_s = scipy_alone(views, start)
    few = {
        name: select_views(v, np.linspace(0, v.n_views - 1, PER_CORNER_VIEWS).astype(np.int64))
        for name, v in views.items()
    }
    n_few = sum(v.n_corners for v in few.values())
    per_corner_alone(few, start)
    by_corner, few_s = per_corner_alone(few, start)
    few_fused, _ = stage_3_alone(few, start)
    peers = Table("stage 3 by", "s", "times ours", "difference of the optimum, mm")
    peers.add_row("ours: one fused factor per camera", f"{ours_s:.3f}", "1", "")
    peers.add_row(
        "scipy least_squares, analytic Jacobian",
        f"{scipy_s:.2f}",
        f"{scipy_s / ours_s:.0f}",
        f"{difference_mm(by_scipy, ours):.1e}",
    )
    per_corner_s = few_s * n_corners / n_few
    peers.add_row(
        f"a CustomFactor per corner, scaled from {n_few:,}",
        f"{per_corner_s:.1f}",
        f"{per_corner_s / ours_s:.0f}",
        f"{difference_mm(by_corner, few_fused):.1e}",
    )
    console.print(peers)


def one_size(n_frames: int) -> None:
    """Print, as JSON, what one size takes; the peak memory is that of this process."""
    observations = recording_of(n_frames)
    views = observations.views
    before_mib = peak_mib()
    solve(recording_of(60))  # compiles the kernels
    start, _, seconds = min((solve(observations) for _ in range(2)), key=lambda run: sum(run[2].values()))
    seconds["stage 3, minimisation alone"] = min(stage_3_alone(views, start)[1] for _ in range(2))
    print(
        json.dumps(
            {
                "corners": sum(v.n_corners for v in views.values()),
                "seconds": seconds,
                "simulated_mib": before_mib,
                "peak_mib": peak_mib(),
            }
        )
    )


def peak_mib() -> float:
    """Of this process since it was started; getrusage would count its parent's too (Linux)."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024


def growth(console: Console) -> None:
    table = parts_table("frames", "growth with the number of frames, s")
    for n_frames in GROWTH_FRAMES:
        with console.status(f"{n_frames:,} frames"):
            table.add_row(f"{n_frames:,}", *cells(n_frames, n_cores()))
    console.print(table)


def by_cores(console: Console) -> None:
    table = parts_table("cores", f"by cores, {CORES_FRAMES:,} frames, s")
    powers = [2**power for power in range(n_cores().bit_length()) if 2**power < n_cores()]
    for jobs in (*powers, n_cores()):
        with console.status(f"{jobs} cores"):
            table.add_row(f"{jobs}", *cells(CORES_FRAMES, jobs))
    console.print(table)


PARTS = ("PnP", "stage 1: sweeps", "stage 2: 3-D alignment", "stage 3, minimisation alone", STAGE_4)


def parts_table(first: str, title: str) -> Table:
    table = Table(first, "corners", title=title, title_justify="left")
    for heading in (*PARTS, "peak memory, MiB", "of it to simulate"):
        table.add_column(heading, justify="right")
    return table


def cells(n_frames: int, jobs: int) -> tuple[str, ...]:
    """Of a size, in a process of its own that uses so many cores."""
    command = [sys.executable, __file__, "--one-size", str(n_frames)]
    limited = os.environ | {JOBS_VARIABLE: str(jobs)}
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, env=limited).stdout)
    seconds = (f"{found['seconds'][part]:.3f}" for part in PARTS)
    return f"{found['corners']:,}", *seconds, f"{found['peak_mib']:.0f}", f"{found['simulated_mib']:.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-growth", action="store_true", help="leave the table of growth out")
    parser.add_argument("--one-size", type=int, metavar="FRAMES", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    console = Console(width=140)
    if arguments.one_size:
        return one_size(arguments.one_size)
    compare(console)
    by_cores(console)
    if not arguments.no_growth:
        growth(console)
    return None


if __name__ == "__main__":
    main()
