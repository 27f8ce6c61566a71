"""A CSV file of retroreflective markers seen in images, with where the mocap has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors.rigid import inverse
from gtcal.baselines.markers import MarkerSightings
from gtcal.bounds import LARGEST_STAMP_NS, within
from gtcal.documents import read_text
from gtcal.errors import GtcalError
from gtcal.files import InputFile, fingerprint
from gtcal.recordings.recording import Recording

COLUMNS = ("camera", "stamp_ns", "x_px", "y_px", "x_m", "y_m", "z_m")


def read_marker_sightings(path: Path, recording: Recording) -> tuple[dict[str, MarkerSightings], InputFile]:
    """By camera; positions taken from the mocap's world into ref by the recording's motion at each stamp.

    Raises GtcalError naming the file and the line for anything that is wrong, and for sightings at times when the
    platform was not tracked."""
    rows = _rows(path)
    cameras = np.array([row[0] for row in rows])
    for number, name in enumerate(cameras, start=2):
        if name not in recording.cameras:
            raise GtcalError(f"{path}:{number}: camera {str(name)!r} is not in the recording")
    stamps_ns = np.array([int(row[1]) for row in rows], dtype=np.int64)
    numbers = np.array([[float(cell) for cell in row[2:]] for row in rows])
    world_m = numbers[:, 2:]
    in_ref = world_m
    if recording.platform is not None:
        found = recording.platform.interpolate(stamps_ns, recording.max_gap_s or recording.platform.default_max_gap_s)
        if not found.ok.all():
            raise GtcalError(f"{path}:{2 + int(np.argmin(found.ok))}: the platform is not tracked at this time")
        ref_T_world = inverse(found.world_T_body)
        in_ref = np.einsum("nij,nj->ni", ref_T_world[:, :3, :3], world_m) + ref_T_world[:, :3, 3]
    sightings = {
        name: MarkerSightings(recording.cameras[name], in_ref[cameras == name], numbers[cameras == name, :2])
        for name in recording.cameras
        if (cameras == name).any()
    }
    return sightings, fingerprint(path)


def _rows(path: Path) -> list[list[str]]:
    lines = read_text(path).splitlines()
    if not lines or tuple(cell.strip() for cell in lines[0].split(",")) != COLUMNS:
        raise GtcalError(f"{path}:1: expected the columns {', '.join(COLUMNS)}")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip():
            continue
        try:
            if len(cells) != len(COLUMNS):
                raise ValueError(f"{len(cells)} cells")
            if abs(int(cells[1])) > LARGEST_STAMP_NS or not all(within(float(cell)) for cell in cells[2:]):
                raise ValueError("a number that is not finite, or far too large")
        except ValueError as error:
            raise GtcalError(f"{path}:{number}: {error}; expected {', '.join(COLUMNS)}") from None
        rows.append(cells)
    if not rows:
        raise GtcalError(f"{path}: holds no sightings")
    return rows
