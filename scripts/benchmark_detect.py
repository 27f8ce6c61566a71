"""What detection costs, as ratios to its floors in the same run: decoding the images, and OpenCV's detectMarkers.

Renders a board from all sides through a headset's camera, as PNG files, at several sizes. Then, of one image on one
core: decoding it, one plain detectMarkers, gtcal's search, and gtcal's look where the board is predicted to be, as the
mocap and a first calibration do for most images of a recording; here the prediction is the truth moved by a pixel. Of
both the corners found, and how far the fitted corners of both are from each other. Then, by cores, all images of the
smallest size as often as it takes to keep the cores busy.

    python scripts/benchmark_detect.py                       # some five minutes on two cores
    python scripts/benchmark_detect.py --frames 20 --scales 0.5
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from gtcal.board import aruco_dictionary
from gtcal.camera import Camera
from gtcal.cores import n_cores
from gtcal.detection.detect import detect
from gtcal.detection.many_images import WORTH_PROCESSES
from gtcal.detection.view_detection import PredictedBoard, SeenBoard, see_board
from gtcal.recordings.images import ImageSequence
from gtcal.simulation import Simulation, SimulationOptions, quest3_like_rig, simulate, write_simulation

SCALES = (0.5, 1.0, 1.5)
OFF_PX = 1.0
CAMERA = "front_left"


@dataclass(frozen=True)
class Shots:
    """Images of one camera, and where the board is in each, by the truth moved by OFF_PX."""

    camera: Camera
    images: ImageSequence
    predicted: list[PredictedBoard]
    board: Any

    @property
    def size(self) -> str:
        return f"{self.camera.image_width_px} x {self.camera.image_height_px}"


def shots(scale: float, n_frames: int, folder: Path) -> Shots:
    rig = quest3_like_rig().scaled(scale)
    rig = replace(rig, cameras=rig.cameras[:1], rig_T_camera=rig.rig_T_camera[:1])
    simulation = simulate(SimulationOptions(rig=rig, n_frames=n_frames), seed=0)
    write_simulation(simulation, folder, images=True)
    camera, stamps_ns = rig.cameras[0], simulation.truth.cameras[CAMERA].stamps_ns
    paths = tuple(folder / "images" / CAMERA / f"{stamp}.png" for stamp in stamps_ns.tolist())
    return Shots(camera, ImageSequence(stamps_ns, paths), predictions(simulation, camera), simulation.options.board)


def predictions(simulation: Simulation, camera: Camera) -> list[PredictedBoard]:
    truth = simulation.truth.cameras[CAMERA]
    poses = truth.camera_T_ref @ truth.ref_T_body @ simulation.truth.body_T_board
    turn = 2.0 * np.pi * np.random.default_rng(0).random(len(poses))
    depth_m = np.linalg.norm(poses[:, :3, 3], axis=1)
    poses[:, 0, 3] += OFF_PX * np.cos(turn) * depth_m / camera.theta[0]
    poses[:, 1, 3] += OFF_PX * np.sin(turn) * depth_m / camera.theta[1]
    return [PredictedBoard(camera, pose) for pose in poses]


def cpu_ms(work: Callable[[int], object], n: int) -> float:
    """CPU time of one, the first, which may compile or allocate, left out: the least of two runs."""
    work(0)
    return min(1e3 * total_s(work, n) / n for _ in range(2))


def total_s(work: Callable[[int], object], n: int) -> float:
    started = time.process_time()
    for index in range(n):
        work(index)
    return time.process_time() - started


def one_image(made: Sequence[Shots]) -> Table:
    table = Table(title="one image on one core, ms of CPU", title_justify="left")
    headings = ("image", "decoding", "detectMarkers", "search", "times that", "predicted", "of decoding")
    for heading in (*headings, "corners", "predicted", "apart, px, 99 %"):
        table.add_column(heading, justify="right")
    for shot in made:
        table.add_row(*one_size(shot))
    return table


def one_size(shot: Shots) -> tuple[str, ...]:
    n = len(shot.images)
    images = [shot.images.read(index) for index in range(n)]
    parameters = cv2.aruco.DetectorParameters()
    plain = cv2.aruco.ArucoDetector(aruco_dictionary(shot.board.dictionary), parameters)
    decoding_ms = cpu_ms(shot.images.read, n)
    plain_ms = cpu_ms(lambda index: plain.detectMarkers(images[index]), n)
    search_ms = cpu_ms(lambda index: see_board(images[index], shot.board, shot.camera), n)
    predicted_ms = cpu_ms(lambda index: see_board(images[index], shot.board, shot.camera, shot.predicted[index]), n)
    searched = [see_board(image, shot.board, shot.camera) for image in images]
    looked = [see_board(image, shot.board, shot.camera, at) for image, at in zip(images, shot.predicted, strict=True)]
    apart_px = np.concatenate([apart(*both) for both in zip(searched, looked, strict=True)])
    return (
        shot.size,
        *(f"{ms:.1f}" for ms in (decoding_ms, plain_ms, search_ms)),
        f"{search_ms / plain_ms:.1f}",
        f"{predicted_ms:.1f}",
        f"{predicted_ms / decoding_ms:.1f}",
        *(f"{sum(len(seen.corner_ids) for seen in found):,}" for found in (searched, looked)),
        f"{np.quantile(apart_px, 0.99):.4f}",
    )


def apart(a: SeenBoard, b: SeenBoard) -> NDArray[np.float64]:
    """(n,) of the corners that both have."""
    _, i, j = np.intersect1d(a.corner_ids, b.corner_ids, return_indices=True)
    return np.asarray(np.linalg.norm(a.corners_px[i] - b.corners_px[j], axis=1))


def by_cores(shot: Shots, n_images: int) -> Table:
    """The images again and again, each time later."""
    again = np.arange(n_images) % len(shot.images)
    stamps_ns = shot.images.stamps_ns[0] + 33_333_333 * np.arange(n_images)
    images = ImageSequence(stamps_ns, tuple(shot.images.paths[index] for index in again))
    few = ImageSequence(images.stamps_ns[: 4 * n_cores()], images.paths[: 4 * n_cores()])
    table = Table(title=f"{n_images} images of {shot.size} by cores, searched", title_justify="left")
    for heading in (
        "cores",
        "s",
        "images/s",
        "times one core",
        "decoding alone, s",
        "peak memory, MiB",
        "of a process",
    ):
        table.add_column(heading, justify="right")
    one_core_s = 0.0
    for jobs in cores():
        detect(few, shot.board, shot.camera, workers=jobs, of_all=n_images)  # started and compiled
        seconds = wall_s(partial(detect, images, shot.board, shot.camera, workers=jobs))
        one_core_s = one_core_s or seconds
        alone_s = wall_s(lambda: [images.read(index) for index in range(n_images)]) / jobs
        peaks = (resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        table.add_row(
            f"{jobs}",
            f"{seconds:.1f}",
            f"{n_images / seconds:.0f}",
            f"{one_core_s / seconds:.1f}",
            f"{alone_s:.1f}",
            *(f"{peak:.0f}" for peak in peaks),
        )
    return table


def cores() -> list[int]:
    """1, 2, 4, ... and all."""
    powers = [2**power for power in range(n_cores().bit_length()) if 2**power < n_cores()]
    return [*powers, n_cores()]


def wall_s(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=40, help="images rendered of each size")
    parser.add_argument("--scales", type=float, nargs="+", default=SCALES, help="of 1280 x 1024")
    parser.add_argument("--images", type=int, default=WORTH_PROCESSES, help="by cores")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    console = Console(width=140)
    console.print(f"{n_cores()} cores, OpenCV {cv2.__version__}, load {os.getloadavg()[0]:.1f} before")
    with tempfile.TemporaryDirectory() as folder:
        made = [shots(scale, arguments.frames, Path(folder) / f"{scale}") for scale in arguments.scales]
        console.print(one_image(made))
        console.print(by_cores(made[0], arguments.images))


if __name__ == "__main__":
    main()
