"""The detector against others that pip installs, on images whose corners are known.

Renders a grid of AprilTags (36h11) at 1080p through a pinhole lens with some distortion, and through a fisheye, from
random sides and distances, by three kinds of images: sharp, blurred and dim. Each detector sees the same images.
Recall: share of the visible corners that it gives to within 3 px, of tags whose modules are 2 px wide or more. Error:
of those, the mean length of what is left when the detector's own mean shift, a matter of where a pixel's middle is said
to be, is taken out (locus-tag's 'debiased mean', 0.062 px at 1080p by its README on Blender images of its own); 95 %:
of the same. ms: of one image, on one thread where the detector has a choice.

OpenCV is always there; the others are looked for, and left out with a line where they are not installed:

    pip install locus-tag pupil-apriltags
    python scripts/yardstick_detection.py
    python scripts/yardstick_detection.py --images 10
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from factors import PINHOLE_RADTAN
from gtcal.board import ArucoGrid
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.detection.view_detection import detect_view
from gtcal.simulation import ImageOptions, quest3_like_rig
from gtcal.simulation.backdrop import room
from gtcal.simulation.rendering import lens_of, plate_of, render

Image = NDArray[np.uint8]
Corners = dict[int, FloatArray]
"""By tag its corners (n, 2), in any order."""

Detector = Callable[[Image], Corners]

BOARD = ArucoGrid("DICT_APRILTAG_36h11", 6, 6, 0.06, 0.018)
"""With one module of border round each tag, as all of them read it; Kalibr's own AprilGrids have two."""

PINHOLE = Camera(
    "1080p pinhole", PINHOLE_RADTAN, np.array([1100, 1100, 959.5, 539.5, -0.08, 0.03, 0, 0, 0.0]), 1920, 1080
)
FISHEYE = replace(quest3_like_rig().cameras[0], name="fisheye")
LOOKS = {
    "sharp": ImageOptions(),
    "blurred": ImageOptions(blur_px=1.5),
    "dim": ImageOptions(white_grey=70.0, black_grey=15.0, dark_noise_grey=2.0, light_noise_grey=2.0),
}
HIT_PX, LEAST_MODULE_PX, MARGIN_PX = 3.0, 2.0, 6.0
_MODULES = 10  # across a 36h11 tag and its border


@dataclass(frozen=True)
class Shot:
    """An image, its corners by tag (4, 2), and which of them are to be found (4,)."""

    image: Image
    corners_px: dict[int, FloatArray]
    visible: dict[int, BoolArray]


def shots(camera: Camera, look: ImageOptions, n: int, seed: int) -> Iterator[Shot]:
    """The board from random sides, at 0.35 to 1.2 m, tilted by up to 55 deg."""
    random = np.random.default_rng(seed)
    lens, backdrop, plate = lens_of(camera, look, random), room(random), plate_of(BOARD)
    for _ in range(n):
        pose = _pose(camera, random)
        image = render(lens, plate, backdrop, pose[None], np.eye(4), look, random)
        yield _shot(image, camera, pose)


def _pose(camera: Camera, random: np.random.Generator) -> FloatArray:
    size_px = np.array([camera.image_width_px, camera.image_height_px])
    bearing = camera.unproject(size_px[None] * random.uniform(0.3, 0.7, (1, 2)))[0][0]
    about = random.uniform(0.0, 2.0 * np.pi)
    tilt = np.deg2rad(random.uniform(0.0, 55.0)) * np.array([np.cos(about), np.sin(about), 0.0])
    facing = Rotation.from_euler("x", 180.0, degrees=True)
    turn = Rotation.from_rotvec(tilt) * facing * Rotation.from_euler("z", random.uniform(-180.0, 180.0), degrees=True)
    x_min, y_min, x_max, y_max = BOARD.bounds_m
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    middle = pose[:3, :3] @ np.array([0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0])
    pose[:3, 3] = random.uniform(0.35, 1.2) * bearing - middle
    return pose


def _shot(image: Image, camera: Camera, pose: FloatArray) -> Shot:
    pixels_px, valid = camera.project(BOARD.corners_m @ pose[:3, :3].T + pose[:3, 3])
    size_px = np.array([camera.image_width_px, camera.image_height_px])
    inside = valid & (pixels_px > MARGIN_PX).all(axis=1) & (pixels_px < size_px - 1 - MARGIN_PX).all(axis=1)
    corners, visible = {}, {}
    for tag in range(len(BOARD.corners_m) // 4):
        own = pixels_px[4 * tag : 4 * tag + 4]
        sides_px = np.linalg.norm(own - np.roll(own, 1, axis=0), axis=1)
        all_in = inside[4 * tag : 4 * tag + 4].all()
        large = np.nanmin(sides_px) / _MODULES >= LEAST_MODULE_PX if all_in else False
        corners[tag], visible[tag] = own, np.full(4, all_in and large)
    return Shot(image, corners, visible)


def ours(camera: Camera | None) -> Detector:
    """gtcal's, without and with the lens known."""

    def detector(image: Image) -> Corners:
        ids, pixels_px = detect_view(image, BOARD, camera)
        return {int(tag): pixels_px[ids // 4 == tag] for tag in np.unique(ids // 4)}

    return detector


def opencv(refinement: int) -> Detector:
    """OpenCV's ArUco detector."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found_by = cv2.aruco.ArucoDetector(dictionary, parameters)

    def detector(image: Image) -> Corners:
        corners, ids, _ = found_by.detectMarkers(image)
        tags = [] if ids is None else np.ravel(ids).tolist()
        return {tag: np.asarray(four, dtype=np.float64).reshape(4, 2) for tag, four in zip(tags, corners, strict=True)}

    return detector


def locus() -> Detector:
    """locus-tag. Raises ImportError where it is not installed."""
    import locus as library

    found_by: Any = library.Detector(families=[library.TagFamily.AprilTag36h11])

    def detector(image: Image) -> Corners:
        found = found_by.detect(image)
        return {int(tag): np.array(four, dtype=np.float64) for tag, four in zip(found.ids, found.corners, strict=True)}

    return detector


def pupil() -> Detector:
    """pupil-apriltags, the AprilTag 3 library. Raises ImportError where it is not installed."""
    import pupil_apriltags as library

    found_by: Any = library.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
    return lambda image: {tag.tag_id: np.asarray(tag.corners) for tag in found_by.detect(image)}


def detectors(camera: Camera) -> tuple[dict[str, Detector], list[str]]:
    """By name; and a line on each that is not there."""
    found: dict[str, Detector] = {
        "gtcal": ours(None),
        "gtcal, lens known": ours(camera),
        "OpenCV, subpixel": opencv(cv2.aruco.CORNER_REFINE_SUBPIX),
        "OpenCV, AprilTag": opencv(cv2.aruco.CORNER_REFINE_APRILTAG),
    }
    missing = []
    for name, make in (("locus-tag", locus), ("pupil-apriltags", pupil)):
        try:
            found[name] = make()
        except ImportError:
            missing.append(f"{name} is not installed: left out")
    return found, missing


@dataclass(frozen=True)
class Score:
    """errors_px: (n, 2) of the corners that were found, shift and all. n_visible: to be found. ms: of an image."""

    errors_px: FloatArray
    n_visible: int
    ms: float

    @property
    def recall(self) -> float:
        return len(self.errors_px) / self.n_visible

    @property
    def cells(self) -> tuple[str, ...]:
        """Recall, error, 95 %, shift, ms."""
        if not len(self.errors_px):
            return f"{self.recall:.1%}", "-", "-", "-", f"{self.ms:.0f}"
        shift_px = self.errors_px.mean(axis=0)
        lengths_px = np.linalg.norm(self.errors_px - shift_px, axis=1)
        numbers = lengths_px.mean(), np.quantile(lengths_px, 0.95), np.linalg.norm(shift_px)
        return f"{self.recall:.1%}", *(f"{number:.3f}" for number in numbers), f"{self.ms:.0f}"


def score(detector: Detector, seen: list[Shot]) -> Score:
    """What a detector makes of images."""
    detector(seen[0].image)  # not timed: what is compiled or allocated once
    errors, elapsed_s = [], 0.0
    for shot in seen:
        started = time.perf_counter()
        found = detector(shot.image)
        elapsed_s += time.perf_counter() - started
        errors += [error for tag, four in found.items() for error in _errors(four, shot, tag)]
    n_visible = sum(int(visible.sum()) for shot in seen for visible in shot.visible.values())
    return Score(np.array(errors).reshape(-1, 2), n_visible, 1e3 * elapsed_s / len(seen))


def _errors(found_px: FloatArray, shot: Shot, tag: int) -> Iterator[FloatArray]:
    """Of the visible corners of a tag that were found: the nearest of those given, in whatever order."""
    if tag not in shot.corners_px:
        return
    for true_px, visible in zip(shot.corners_px[tag], shot.visible[tag], strict=True):
        errors_px = found_px - true_px
        nearest = errors_px[np.argmin(np.linalg.norm(errors_px, axis=1))]
        if visible and np.linalg.norm(nearest) < HIT_PX:
            yield nearest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=40, help="of each lens and look")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    console, table = Console(width=120), Table(title="detectors on rendered images of a grid of AprilTags")
    for heading in ("lens", "images", "detector", "recall", "error, px", "95 %, px", "shift, px", "ms"):
        table.add_column(heading, justify="left" if heading in ("lens", "images", "detector") else "right")
    missing: list[str] = []
    for camera in (PINHOLE, FISHEYE):
        found, missing = detectors(camera)
        for look, options in LOOKS.items():
            made = shots(camera, options, arguments.images, arguments.seed)
            seen = list(track(made, f"{camera.name}, {look}", arguments.images, console=Console(stderr=True)))
            for name, detector in found.items():
                result = score(detector, seen)
                table.add_row(camera.name, look, name, *result.cells, end_section=name == list(found)[-1])
    console.print(table)
    for line in missing:
        console.print(line)


if __name__ == "__main__":
    main()
