"""Readers of other programs' files. A trajectory format is a name in ``TRAJECTORY_READERS``."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from gtcal.readers.c3d import read_c3d as read_c3d
from gtcal.readers.euroc_csv import read_euroc_csv as read_euroc_csv
from gtcal.readers.euroc_csv import write_euroc_csv as write_euroc_csv
from gtcal.readers.mocap_summary import BodySummary as BodySummary
from gtcal.readers.mocap_summary import MocapSummary as MocapSummary
from gtcal.readers.mocap_summary import detect_mocap_format as detect_mocap_format
from gtcal.readers.mocap_summary import inspect_mocap as inspect_mocap
from gtcal.readers.motive_csv import read_motive_csv as read_motive_csv
from gtcal.readers.poses import PoseConventions as PoseConventions
from gtcal.readers.qualisys_tsv import read_qualisys_tsv as read_qualisys_tsv
from gtcal.readers.rosbag import read_rosbag as read_rosbag
from gtcal.readers.selection import BodySelection as BodySelection
from gtcal.readers.trc import read_trc as read_trc
from gtcal.readers.tum import read_tum as read_tum
from gtcal.readers.tum import write_tum as write_tum
from gtcal.readers.vicon_csv import read_vicon_csv as read_vicon_csv
from gtcal.recordings.trajectory import Trajectory


class TrajectoryReader(Protocol):
    """Reads the trajectory of ``body`` from ``path``. ``declared`` is what the manifest states about its
    conventions, ``selection`` which body of the file it is: the reader fills in what its format or the file states, and
    raises GtcalError where they contradict each other or leave something open."""

    def __call__(
        self, path: Path, body: str, declared: PoseConventions, selection: BodySelection = ...
    ) -> Trajectory: ...


class TrajectoryWriter(Protocol):
    """Writes a trajectory with every digit, whole or not at all. Raises GtcalError where it can't be written."""

    def __call__(self, path: Path, trajectory: Trajectory) -> None: ...


TRAJECTORY_WRITERS: dict[str, TrajectoryWriter] = {"euroc_csv": write_euroc_csv, "tum": write_tum}
TRAJECTORY_READERS: dict[str, TrajectoryReader] = {
    "euroc_csv": read_euroc_csv,
    "tum": read_tum,
    "motive_csv": read_motive_csv,
    "vicon_csv": read_vicon_csv,
    "qualisys_tsv": read_qualisys_tsv,
    "c3d": read_c3d,
    "trc": read_trc,
    "rosbag": read_rosbag,
}
