"""Where the images have no mocap poses: time stamps in another unit, clocks that count from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gtcal.doctor.manifest_lines import ManifestFile
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray
from gtcal.recordings.recording import Recording
from gtcal.recordings.text_table import TIME_UNIT_DIGITS

ENOUGH = 0.5
"""The share of the images that the mocap should have a pose for."""

_POWERS = (3, -3, 6, -6, 9, -9)
_LAST_NS = 9e18  # int64 ends there


@dataclass(frozen=True)
class TimeReading:
    """Another unit of time stamps: of these bodies, or of the cameras where there are none."""

    says: str
    lines: tuple[str, ...]
    advice: tuple[str, ...]
    recording: Recording


def posed_share(recording: Recording) -> float:
    """The share of all views that the mocap has a pose for; 0 without views."""
    stamps_ns = np.concatenate([of_camera.stamps_ns for of_camera in recording.detections.values()])
    return float(np.mean(recording.motion.at(stamps_ns).ok)) if len(stamps_ns) else 0.0


def time_readings(recording: Recording, file: ManifestFile | None) -> Iterator[TimeReading]:
    """Other units: of one trajectory, of all, of the cameras' stamps."""
    names = tuple(recording.motion.trajectories)
    for size in range(1, len(names) + 1):
        for bodies in combinations(names, size):
            for power in _POWERS:
                if reread := _bodies(recording, bodies, power, file):
                    yield reread
    for power in _POWERS[::2]:
        if reread := _cameras(recording, power):
            yield reread


def shifted(recording: Recording, shift_s: float, cameras: tuple[str, ...] | None = None) -> Recording:
    """With the stamps of these cameras, of all by default, put later."""
    moved = {
        name: replace(of_camera, stamps_ns=of_camera.stamps_ns + round(1e9 * shift_s))
        for name, of_camera in recording.detections.items()
        if cameras is None or name in cameras
    }
    return replace(recording, detections=recording.detections | moved)


def spans_ns(recording: Recording) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last stamp of the cameras, and of the time that all trajectories have in common."""
    cameras = [of_camera.stamps_ns for of_camera in recording.detections.values()]
    bodies = [of_body.stamps_ns for of_body in recording.motion.trajectories.values()]
    return (
        (min(int(stamps[0]) for stamps in cameras), max(int(stamps[-1]) for stamps in cameras)),
        (max(int(stamps[0]) for stamps in bodies), min(int(stamps[-1]) for stamps in bodies)),
    )


def _bodies(recording: Recording, bodies: tuple[str, ...], power: int, file: ManifestFile | None) -> TimeReading | None:
    motion = recording.motion
    stamps = {body: _times(motion.trajectories[body].stamps_ns, power) for body in bodies}
    found = {body: of_body for body, of_body in stamps.items() if of_body is not None}
    if len(found) < len(bodies):
        return None
    units = {body: _unit(file, body, power) for body in bodies}
    if any(unit == "" for unit in units.values()):
        return None
    moved = motion.trajectories | {
        body: replace(motion.trajectories[body], stamps_ns=of_body) for body, of_body in found.items()
    }
    named = " and ".join(bodies)
    unit = units[bodies[0]]
    says = f"the time stamps of {named} are " + (f"in {unit}" if unit else f"to be multiplied by {10.0**power:g}")
    lines = tuple(f"{body}.time_unit: {of_body}" for body, of_body in units.items() if of_body)
    return TimeReading(
        says,
        lines,
        (),
        replace(recording, platform=moved.get("platform"), board_body=moved.get("board_body")),
    )


def with_motion(recording: Recording, motion: RefMotion) -> Recording:
    """The recording with these trajectories."""
    return replace(recording, platform=motion.platform, board_body=motion.board_body)


def _unit(file: ManifestFile | None, body: str, power: int) -> str | None:
    """The unit that multiplies the stamps by this power of ten against the one stated: None where that isn't known,
    nothing where there is no such unit."""
    stated = file.stated(body, "time_unit", TIME_UNIT_DIGITS) if file else None
    if stated is None:
        return None
    units = {digits: unit for unit, digits in TIME_UNIT_DIGITS.items()}
    return units.get(TIME_UNIT_DIGITS[stated] + power, "")


def _cameras(recording: Recording, power: int) -> TimeReading | None:
    stamps = {name: _times(of_camera.stamps_ns, power) for name, of_camera in recording.detections.items()}
    detections = {
        name: replace(recording.detections[name], stamps_ns=of_camera)
        for name, of_camera in stamps.items()
        if of_camera is not None
    }
    if len(detections) < len(stamps):
        return None
    unit = {3: "us", 6: "ms", 9: "s"}[power]
    return TimeReading(
        f"the time stamps of the images are in {unit}, not in ns",
        (),
        (f"write the time stamps of images and detections in ns: multiply them by {10**power:,}",),
        replace(recording, detections=detections),
    )


def _times(stamps_ns: IntArray, power: int) -> IntArray | None:
    """Stamps multiplied by this power of ten; None where they leave 64 bits, or no longer differ."""
    if power < 0:
        divided = stamps_ns // 10**-power
        return divided if (np.diff(divided) > 0).all() else None
    return stamps_ns * 10**power if np.abs(stamps_ns).max() < _LAST_NS / 10.0**power else None
