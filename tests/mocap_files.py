"""Exports of mocap software as tests need them: written from known poses, with every digit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gtcal.recordings.trajectory import Trajectory, quaternions_from_poses

CUBE_M = 0.001 * np.array([[45.0, -13, 110], [52, -15, -41], [51, 40, -17], [-149, -12, -52], [10, 60, 70]])
"""Five markers, no two of whose distances are alike."""


def markers_of(poses: np.ndarray, points_m: np.ndarray = CUBE_M) -> np.ndarray:
    """(N, n, 3) the points of a body in the world."""
    return poses[:, None, :3, 3] + points_m @ np.swapaxes(poses[:, :3, :3], 1, 2)


def from_zero(trajectory: Trajectory) -> Trajectory:
    """The same motion with stamps that count from the start, as exports do."""
    return Trajectory(trajectory.body, trajectory.stamps_ns - trajectory.stamps_ns[0], trajectory.world_T_body)


def cells(numbers: Sequence[float]) -> list[str]:
    """Every digit, blank for NaN."""
    return ["" if np.isnan(number) else repr(float(number)) for number in numbers]


def write_motive(
    path: Path,
    poses: dict[str, np.ndarray],
    *,
    markers: dict[str, np.ndarray] | None = None,
    expected: dict[str, np.ndarray] | None = None,
    rate_hz: float = 120.0,
    unit: str = "Meters",
    rotation: str = "Quaternion",
    separator: str = ",",
    ending: str = "\r\n",
    parents: bool = False,
    settings: dict[str, str] | None = None,
) -> Path:
    """A Motive CSV of bodies (N, 4, 4) and markers (N, 3); NaN becomes blank cells."""
    scale = {"Meters": 1.0, "Centimeters": 100.0, "Millimeters": 1000.0}[unit]
    n = len(next(iter((poses | (markers or {}) | (expected or {})).values())))
    head = {
        "Format Version": "1.23",
        "Take Name": "Take 1",
        "Take Notes": "",
        "Capture Frame Rate": f"{rate_hz:.6f}",
        "Export Frame Rate": f"{rate_hz:.6f}",
        "Capture Start Time": "2020-01-16 07.07.59.330 PM",
        "Total Frames in Take": str(n),
        "Total Exported Frames": str(n),
        "Rotation Type": rotation,
        "Length Units": unit,
        "Coordinate Space": "Global",
    } | (settings or {})
    columns: list[tuple[str, str, str, str]] = []  # type, name, kind, axis
    blocks = []
    for name, world_T_body in poses.items():
        seen = np.isfinite(world_T_body).all(axis=(1, 2))
        axes = "XYZW" if rotation == "Quaternion" else "XYZ"
        turned = np.full((n, len(axes)), np.nan)
        if rotation == "Quaternion":
            turned[seen] = quaternions_from_poses(world_T_body[seen], "xyzw")
        else:
            turned[seen] = Rotation.from_matrix(world_T_body[seen, :3, :3]).as_euler(rotation, degrees=True)
        columns += [("Rigid Body", name, "Rotation", axis) for axis in axes]
        columns += [("Rigid Body", name, "Position", axis) for axis in "XYZ"]
        columns.append(("Rigid Body", name, "Mean Marker Error", ""))
        blocks += [turned, scale * world_T_body[:, :3, 3], np.where(seen, 0.0001, np.nan)[:, None]]
    for kind, given in (("Rigid Body Marker", expected or {}), ("Marker", markers or {})):
        for name, at in given.items():
            columns += [(kind, name, "Position", axis) for axis in "XYZ"]
            blocks.append(scale * at)
    values = np.concatenate(blocks, axis=1) if blocks else np.empty((n, 0))
    lines = [[text for item in head.items() for text in item], []]
    lines += [["", "Type", *(c[0] for c in columns)], ["", "Name", *(f'"{c[1]}"' for c in columns)]]
    lines.append(["", "ID", *(f"ID{c[1]}{c[0]}" for c in columns)])
    if parents:
        lines.append(["", "Parent", *("" for _ in columns)])
    lines += [["", "", *(c[2] for c in columns)], ["Frame", "Time (Seconds)", *(c[3] for c in columns)]]
    lines += [[str(i), f"{i / rate_hz:.6f}", *cells(row)] for i, row in enumerate(values.tolist())]
    text = ending.join(separator.join(line) for line in lines) + ending
    if separator != ",":
        start = text.index(ending)
        text = text[:start].replace(f"{rate_hz:.6f}", f"{rate_hz:.6f}".replace(".", ",")) + text[start:].replace(
            ".", ","
        )
    path.write_bytes(text.encode())
    return path


def write_vicon(
    path: Path,
    *,
    segments: dict[str, np.ndarray] | None = None,
    markers: dict[str, np.ndarray] | None = None,
    rotation: str = "helical",
    angles: str = "deg",
    rate_hz: float = 100.0,
    first_frame: int = 1,
    ending: str = "\n",
    units: bool = True,
) -> Path:
    """A Nexus CSV in millimetres: segments (N, 4, 4), rotated as 'helical' or an order of axes, and markers (N, 3)."""
    lines: list[list[str]] = []
    for title, given in (("Segments", segments), ("Trajectories", markers)):
        if given is None:
            continue
        axes = ("RX", "RY", "RZ", "TX", "TY", "TZ") if title == "Segments" else ("X", "Y", "Z")
        blocks = [_segment(at, rotation, angles) if title == "Segments" else 1000.0 * at for at in given.values()]
        values = np.concatenate(blocks, axis=1)
        lines += [[title], [f"{rate_hz:g}"], ["", "", *(c for n in given for c in (n, *[""] * (len(axes) - 1)))]]
        lines.append(["Frame", "Sub Frame", *(axis for _ in given for axis in axes)])
        if units:
            lines.append(["", "", *(angles if axis.startswith("R") else "mm" for _ in given for axis in axes)])
        lines += [[str(first_frame + i), "0", *cells(row)] for i, row in enumerate(values.tolist())]
        lines.append([])
    path.write_bytes((ending.join(",".join(line) for line in lines)).encode())
    return path


def _segment(poses: np.ndarray, rotation: str, angles: str) -> np.ndarray:
    seen = np.isfinite(poses).all(axis=(1, 2))
    out = np.full((len(poses), 6), np.nan)
    turned = Rotation.from_matrix(poses[seen, :3, :3])
    numbers = turned.as_rotvec() if rotation == "helical" else turned.as_euler(rotation)
    out[seen, :3] = np.rad2deg(numbers) if angles == "deg" else numbers
    out[seen, 3:] = 1000.0 * poses[seen, :3, 3]
    return out


def write_qualisys(
    path: Path,
    poses: dict[str, np.ndarray],
    *,
    rate_hz: float = 100.0,
    euler: str = "XYZ",
    by: str = "columns",
    matrix: bool = True,
    times: bool = False,
    lost: str = "zeros",
) -> Path:
    """A QTM 6D TSV of bodies (N, 4, 4); a body not seen has 'zeros' with residual -1, or 'blank' cells."""
    n = len(next(iter(poses.values())))
    head = [
        ["NO_OF_FRAMES", str(n)],
        ["NO_OF_CAMERAS", "8"],
        ["NO_OF_BODIES", str(len(poses))],
        ["FREQUENCY", f"{rate_hz:g}"],
        ["NO_OF_ANALOG", "0"],
        ["ANALOG_FREQUENCY", "0"],
        ["DESCRIPTION", "--"],
        ["TIME_STAMP", "2022-06-02, 15:49:44.620", "25975.44751328"],
        ["DATA_INCLUDED", "6D"],
        ["BODY_NAMES", *poses],
    ]
    own = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9) if matrix)]
    names = [
        *(["Frame", "Time"] if times else []),
        *(f"{b} {own[0]}" if i == 0 else c for b in poses for i, c in enumerate(own)),
    ]
    blocks = []
    for world_T_body in poses.values():
        seen = np.isfinite(world_T_body).all(axis=(1, 2))
        block = np.zeros((n, len(own)))
        block[:, 6] = -1.0
        if lost == "blank":
            block[:] = np.nan
        turned = world_T_body[seen, :3, :3]
        block[seen, :3] = 1000.0 * world_T_body[seen, :3, 3]
        block[seen, 3:6] = Rotation.from_matrix(turned).as_euler(euler, degrees=True)
        block[seen, 6] = 0.4
        if matrix:
            block[seen, 7:] = (np.swapaxes(turned, 1, 2) if by == "columns" else turned).reshape(-1, 9)
        blocks.append(block)
    values = np.concatenate(blocks, axis=1).tolist()
    lead = [[str(i + 1), f"{i / rate_hz:.5f}"] if times else [] for i in range(n)]
    lines = [*head, names, *([*first, *cells(row)] for first, row in zip(lead, values, strict=True))]
    path.write_bytes(("\r\n".join("\t".join(line) for line in lines) + "\r\n").encode())
    return path


def write_trc(
    path: Path,
    markers: dict[str, np.ndarray],
    *,
    rate_hz: float = 100.0,
    unit: str = "mm",
    separator: str = "\t",
    ending: str = "\n",
    blank_line: bool = True,
) -> Path:
    """A TRC of markers (N, 3)."""
    n = len(next(iter(markers.values())))
    scale = {"m": 1.0, "mm": 1000.0}[unit]
    values = np.concatenate([scale * at for at in markers.values()], axis=1).tolist()
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", path.name],
        [
            "DataRate",
            "CameraRate",
            "NumFrames",
            "NumMarkers",
            "Units",
            "OrigDataRate",
            "OrigDataStartFrame",
            "OrigNumFrames",
        ],
        [f"{rate_hz:g}", f"{rate_hz:g}", str(n), str(len(markers)), unit, f"{rate_hz:g}", "1", str(n)],
        ["Frame#", "Time", *(cell for name in markers for cell in (name, "", ""))],
        ["", "", *(f"{axis}{i + 1}" for i in range(len(markers)) for axis in "XYZ")],
        *([[]] if blank_line else []),
        *([str(i + 1), f"{i / rate_hz:.5f}", *cells(row)] for i, row in enumerate(values)),
    ]
    text = ending.join(separator.join(line) for line in lines) + ending
    path.write_bytes((text.replace(".", ",") if separator == ";" else text).encode())
    return path


def write_c3d(path: Path, given: dict[str, np.ndarray], *, unit: str = "mm", rate_hz: float = 100.0) -> Path:
    ezc3d = pytest.importorskip("ezc3d")
    points = np.stack([1000.0 * at.T for at in given.values()], axis=1)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate_hz]
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(given)
    file["data"]["points"] = np.concatenate([points, np.ones((1, *points.shape[1:]))])
    file.write(str(path))
    return path
