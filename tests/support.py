"""Data and helpers that several test files share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import Camera
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.trajectory import Trajectory

EPOCH_NS = 1_606_153_863_362_296_104  # beyond 2^53: no float64 holds it


def wandering_trajectory(body: str, *, n: int = 60, interval_ns: int = 8_333_333, seed: int = 0) -> Trajectory:
    """A body that wanders about the middle of a room."""
    random = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (n, 1, 1))
    steps = Rotation.from_rotvec(random.normal(0, 0.05, (n, 3)))
    turned = Rotation.random(rng=random)
    for i in range(n):
        turned = turned * steps[i]
        poses[i, :3, :3] = turned.as_matrix()
    poses[:, :3, 3] = random.normal(0, 1, 3) + np.cumsum(random.normal(0, 0.01, (n, 3)), axis=0)
    return Trajectory(body, EPOCH_NS + interval_ns * np.arange(n), poses)


def random_detections(camera: Camera, n_corners: int, stamps_ns: np.ndarray, seed: int) -> CameraDetections:
    """Corners anywhere in the image; every view has eight or more."""
    random = np.random.default_rng(seed)
    size_px = np.array([camera.image_width_px, camera.image_height_px])
    views = []
    for stamp_ns in stamps_ns:
        ids = np.sort(random.choice(n_corners, size=random.integers(8, n_corners), replace=False))
        views.append(
            (
                int(stamp_ns),
                ids,
                random.uniform(-0.5, 1, (len(ids), 2)) + random.random((len(ids), 2)) * (size_px - 2),
            )
        )
    return CameraDetections.from_views(views)


def replace_once(path: Path, old: str, new: str) -> None:
    """Replace the first ``old`` in a text file; it must be there."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
