"""Readers of other programs' files. A trajectory format is a name in ``TRAJECTORY_READERS``."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from gtcal.readers.euroc_csv import read_euroc_csv as read_euroc_csv
from gtcal.readers.euroc_csv import write_euroc_csv as write_euroc_csv
from gtcal.readers.poses import PoseConventions as PoseConventions
from gtcal.readers.tum import read_tum as read_tum
from gtcal.readers.tum import write_tum as write_tum
from gtcal.recordings.trajectory import Trajectory


class TrajectoryReader(Protocol):
    """Reads the trajectory of ``body`` from ``path``. ``declared`` is what the manifest states about its
    conventions: the reader fills in what its format or the file states, and raises GtcalError where they
    contradict each other or leave something open."""

    def __call__(self, path: Path, body: str, declared: PoseConventions) -> Trajectory: ...


class TrajectoryWriter(Protocol):
    """Writes a trajectory with every digit, whole or not at all. Raises GtcalError where it can't be written."""

    def __call__(self, path: Path, trajectory: Trajectory) -> None: ...


TRAJECTORY_WRITERS: dict[str, TrajectoryWriter] = {"euroc_csv": write_euroc_csv, "tum": write_tum}
TRAJECTORY_READERS: dict[str, TrajectoryReader] = {"euroc_csv": read_euroc_csv, "tum": read_tum}
