"""Fixtures that several test files share."""

from __future__ import annotations

import one_thread  # noqa: F401  # before numpy

# isort: split
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support import EPOCH_NS, random_detections, wandering_trajectory

from factors import FISHEYE62, PINHOLE_RADTAN
from gtcal.board import AprilGrid
from gtcal.camera import Camera
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording, write_recording

SHARED = Path(__file__).resolve().parents[2] / "shared"

VICON_MANIFEST = """\
gtcal_recording: 1
capture: {capture}
board: {{type: aprilgrid, family: 36h11, tag_columns: 6, tag_rows: 6, tag_side_m: 0.088, tag_spacing: 0.3}}
cameras:
  cam0:
    model: pinhole_radtan
    image_size_px: [640, 480]
    images: cam0/data
    {detections}
platform: {{trajectory: body0/data.csv, format: euroc_csv, length_unit: m}}
"""
VICON_BOARD_BODY = "board_body: {trajectory: target0/data.csv, format: euroc_csv, length_unit: m}\n"


@pytest.fixture
def shared() -> Callable[[str], Path]:
    """A file or folder of the shared data; the test is skipped where it is absent."""

    def find(name: str) -> Path:
        path = SHARED / name
        if not path.exists():
            pytest.skip(f"shared/{name} is not beside the project")
        return path

    return find


@pytest.fixture
def vicon_recording(shared: Callable[[str], Path], tmp_path: Path) -> Callable[..., Path]:
    """Makes folders with the real camera-to-Vicon recording: ``vicon_recording(capture, given_corners=...)``."""
    data = shared("data/vicon_aprilgrid")

    def make(capture: Capture = Capture.TRACKED_PLATFORM, *, given_corners: bool = True) -> Path:
        folder = tmp_path / f"vicon_{capture.value}"
        shutil.copytree(data, folder)
        detections = "detections: grid0/cam0/data" if given_corners else ""
        text = VICON_MANIFEST.format(capture=capture.value, detections=detections)
        bodies = VICON_BOARD_BODY if "board_body" in capture.bodies else ""
        (folder / "recording.yaml").write_text(text + bodies)
        return folder

    return make


@pytest.fixture
def small_recording() -> Recording:
    """Two cameras, a tracked platform and a tracked board, ten frames; the corners are noise, not projections."""
    board = AprilGrid(tag_columns=3, tag_rows=2, tag_side_m=0.05, tag_spacing=0.3, first_tag_id=7)
    left = np.array([250.1, 250.2, 319.4, 239.7, *np.full(8, 1 / 300)])
    right = np.array([600.0, 601.0, 322.0, 250.0, *np.full(5, -0.01)])
    cameras = {
        "left": Camera("left", FISHEYE62, left, 640, 480),
        "right": Camera("right", PINHOLE_RADTAN, right, 640, 512),
    }
    stamps_ns = EPOCH_NS + 33_333_333 + 33_333_333 * np.arange(10)
    detections = {
        name: random_detections(camera, board.n_corners, stamps_ns, seed)
        for seed, (name, camera) in enumerate(cameras.items())
    }
    return Recording(
        path=None,
        capture=Capture.TRACKED_PLATFORM,
        cameras=cameras,
        board=board,
        detections=detections,
        platform=wandering_trajectory("platform", seed=1),
        board_body=wandering_trajectory("board_body", seed=2),
    )


@pytest.fixture
def recording_folder(small_recording: Recording, tmp_path: Path) -> Path:
    """``small_recording`` on disk, for tests to damage."""
    write_recording(small_recording, tmp_path / "recording")
    return tmp_path / "recording"
