"""What a weak direction is, and which motion of the board would fix it, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtcal.camera import FloatArray
from gtcal.recordings.capture import Capture
from gtcal.uncertainty.motions import BoardMotion, CameraMotion
from gtcal.uncertainty.placement import UNIT_DEG, UNIT_MM, Placement

TAKES_PART = 0.3
"""What moves by less than this share of what moves most is not named."""

_MOSTLY = 0.8
_NEARLY_AN_AXIS = 0.95
_TOGETHER = 0.9

MOVERS = {
    Capture.FIXED_CAMERAS: "the board",
    Capture.TRACKED_PLATFORM: "the board or the platform",
    Capture.STANDING_BOARD: "the rig",
}
"""What is moved by hand while one records."""

BODIES = {
    Capture.FIXED_CAMERAS: "the body",
    Capture.TRACKED_PLATFORM: "the body",
    Capture.STANDING_BOARD: "the mocap's world",
}
"""The frame that the board is fixed in."""


@dataclass(frozen=True)
class Words:
    """moves_places: whether the board or a camera moves, not only a lens."""

    what: str
    size: str
    fix: str
    moves_places: bool


def described(
    board: BoardMotion, cameras: Mapping[str, CameraMotion], placement: Placement, *, nothing_turned: bool = False
) -> Words:
    """A direction from its motions. ``nothing_turned``: it is one of several shifts of the board with all cameras."""
    largest = max(board.size, *(camera.size for camera in cameras.values()))
    moving = [name for name, camera in cameras.items() if camera.size >= TAKES_PART * largest]
    if board.size >= TAKES_PART * largest:
        if len(moving) == len(cameras):
            return _board_and_cameras(board, list(cameras.values()), placement, nothing_turned)
        return _board(board, moving, placement)
    if len(moving) == 1:
        return _camera(moving[0], cameras[moving[0]], placement)
    return _several(moving, cameras, placement)


def in_detail(board: BoardMotion, cameras: Mapping[str, CameraMotion]) -> str:
    """What tells a direction from another of the same words: how the board and each camera that takes part move, as
    "'cam0' (0.012, -0.003, 0.001) mm in ref"."""
    largest = max(board.size, *(camera.size for camera in cameras.values()))
    moving = {name: _motion(camera) for name, camera in cameras.items() if camera.size >= TAKES_PART * largest}
    parts = [f"{name!r} {moves}" for name, moves in moving.items()]
    if board.size < TAKES_PART * largest:
        parts = parts if len(moving) > 1 else list(moving.values())
    else:
        moves = f"{_vector(board.shift_mm)} mm" if _shifts(board) else f"{_vector(board.turn_deg)} deg"
        parts.insert(0, f"the board {moves} in its body")
    return ", ".join(parts)


def _motion(camera: CameraMotion) -> str:
    """The largest of shift, turn and lens."""
    if camera.lens_size > max(camera.shift_size, camera.turn_size):
        of_parts = (camera.focal_px, camera.centre_px, camera.distortion_px)
        focal, centre, distortion = (_number(px) for px in of_parts)
        return f"focal length {focal}, principal point {centre}, distortion {distortion} px"
    if camera.shift_size >= camera.turn_size:
        return f"{_vector(camera.shift_mm)} mm in ref"
    return f"{_vector(camera.turn_deg)} deg about its own axes"


def _vector(components: FloatArray) -> str:
    """With the digits that the largest one needs for two."""
    digits = max(0, 1 - int(np.floor(np.log10(max(float(np.abs(components).max()), 1e-9)))))
    return f"({', '.join(f'{np.round(component, digits) + 0.0:.{digits}f}' for component in components)})"


def shifts_all(board: BoardMotion, cameras: Mapping[str, CameraMotion]) -> bool:
    """Whether the board shifts and all cameras with it, one way and by about as much: only a turn tells this apart."""
    shifts_mm = [camera.shift_mm for camera in cameras.values()]
    as_much = TAKES_PART * board.size <= min(camera.size for camera in cameras.values())
    return _shifts(board) and as_much and _parallel(shifts_mm)


def _board_and_cameras(
    board: BoardMotion, cameras: list[CameraMotion], placement: Placement, nothing_turned: bool
) -> Words:
    """The gauge: X and all Y_c move together, as far as the recorded turns let them."""
    mover = MOVERS[placement.capture]
    if _shifts(board):
        size = _mm(board.shift_mm, *(camera.shift_mm for camera in cameras))
        axis = axis_in_words(board.shift_mm, BODIES[placement.capture])
        if _parallel([camera.shift_mm for camera in cameras]):
            why, fix = ", which all turns share,", f"turn {mover} about a second axis, by 20 deg or more"
            if nothing_turned:
                why, fix = ", as hardly anything turned,", f"turn {mover} about two different axes, by 20 deg or more"
            return Words(f"body_T_board: translation along {axis}{why} and the cameras with it", size, fix, True)
        what = f"body_T_board: translation along {axis}, against the places of all cameras"
        return Words(what, size, f"turn {mover} more, about two axes, and record nearer to the cameras", True)
    size = _deg(board.turn_deg, *(camera.turn_deg for camera in cameras))
    axis = axis_in_words(board.turn_deg, BODIES[placement.capture])
    what = f"body_T_board: attitude about {axis}, and the cameras with it"
    return Words(what, size, f"turn {mover} more, about two axes or more", True)


def _board(board: BoardMotion, moving: list[str], placement: Placement) -> Words:
    mover, body = MOVERS[placement.capture], BODIES[placement.capture]
    along = f", and with it {_cameras(moving)}" if moving else ""
    fix = f"record more views, with {mover} turned about several axes"
    if _shifts(board):
        axis = axis_in_words(board.shift_mm, body)
        return Words(f"body_T_board: translation along {axis}{along}", _mm(board.shift_mm), fix, True)
    axis = axis_in_words(board.turn_deg, body)
    return Words(f"body_T_board: attitude about {axis}{along}", _deg(board.turn_deg), fix, True)


def _camera(name: str, camera: CameraMotion, placement: Placement) -> Words:
    place = max(camera.shift_size, camera.turn_size)
    if camera.lens_size >= TAKES_PART * camera.size and place >= TAKES_PART * camera.size:
        return _lens_against_place(name, camera)
    if camera.lens_size > place:
        return _lens(name, camera)
    if camera.shift_size < camera.turn_size * TAKES_PART:
        what = f"camera {name!r}: its attitude about {_own_axis(camera.turn_deg)}"
        fix = "record over more of its image, and farther from its middle"
        return Words(what, _deg(camera.turn_deg), fix, True)
    depth_mm = abs(float(camera.shift_in_camera_mm[2]))
    if depth_mm > _MOSTLY * np.linalg.norm(camera.shift_mm):
        fix = "record nearer to it, over more of its image, with the board tilted"
        return Words(f"camera {name!r}: its depth, along its optical axis", _mm(camera.shift_mm), fix, True)
    if camera.turn_size < camera.shift_size * TAKES_PART:
        what = f"camera {name!r}: its position across its optical axis"
        return Words(what, _mm(camera.shift_mm), "record more views of the board in it, at several distances", True)
    what = f"camera {name!r}: its position against its attitude ({_deg(camera.turn_deg)})"
    fix = "record nearer to it and at several distances, over more of its image"
    return Words(what, _mm(camera.shift_mm), fix, True)


def _lens_against_place(name: str, camera: CameraMotion) -> Words:
    depth = abs(float(camera.shift_in_camera_mm[2])) > _MOSTLY * np.linalg.norm(camera.shift_mm)
    fix = "record it at several distances and tilted, over the whole image"
    lens = _main_part(camera)
    if camera.shift_size < camera.turn_size:
        what = f"camera {name!r}: its {lens} against its attitude"
        return Words(what, f"{_px(camera)} and {_deg(camera.turn_deg)}", fix, True)
    place = "its depth" if depth else "its position"
    return Words(f"camera {name!r}: its {lens} against {place}", f"{_px(camera)} and {_mm(camera.shift_mm)}", fix, True)


def _lens(name: str, camera: CameraMotion) -> Words:
    what = f"camera {name!r}: its {_main_part(camera)}, over the image"
    fix = "show it the board over the whole image, into its corners, and tilted"
    return Words(what, _px(camera), fix, False)


def _main_part(camera: CameraMotion) -> str:
    parts = {
        "focal length": camera.focal_px,
        "principal point": camera.centre_px,
        "distortion": camera.distortion_px,
    }
    return max(parts, key=lambda part: parts[part])


def _several(moving: list[str], cameras: Mapping[str, CameraMotion], placement: Placement) -> Words:
    parts = [cameras[name] for name in moving]
    shifts = max(part.shift_size for part in parts) >= max(part.turn_size for part in parts)
    size = _mm(*(part.shift_mm for part in parts)) if shifts else _deg(*(part.turn_deg for part in parts))
    what = f"{_cameras(moving)} together: {_positions(moving, parts) if shifts else _attitudes(moving, parts)}"
    if max(part.lens_size for part in parts) > max(max(part.shift_size, part.turn_size) for part in parts):
        most = max(range(len(parts)), key=lambda i: parts[i].lens_size)
        what = f"{_cameras(moving)} together: their lenses, most the {_main_part(parts[most])} of {moving[most]!r}"
        return Words(
            what, _px(max(parts, key=lambda part: part.lens_px)), "show them the board over the whole image", False
        )
    fix = f"record nearer to them and over more of their images, with {MOVERS[placement.capture]} turned about two axes"
    return Words(what, size, fix, True)


def _positions(moving: list[str], parts: list[CameraMotion]) -> str:
    most = max(range(len(parts)), key=lambda i: parts[i].shift_size)
    axis = axis_in_words(parts[most].shift_mm, "ref")
    if _parallel([part.shift_mm for part in parts]):
        return f"their positions along {axis}"
    return f"their positions, {moving[most]!r} most, along {axis}"


def _attitudes(moving: list[str], parts: list[CameraMotion]) -> str:
    most = max(range(len(parts)), key=lambda i: parts[i].turn_size)
    return f"their attitudes, {moving[most]!r} most, about {_own_axis(parts[most].turn_deg)}"


def axis_in_words(axis: FloatArray, frame: str) -> str:
    """As "the body's z axis", or "(0.10, 0.93, 0.36) of the body frame"; the largest component counts as positive."""
    unit = axis / max(float(np.linalg.norm(axis)), 1e-300)
    largest = int(np.argmax(np.abs(unit)))
    if abs(unit[largest]) > _NEARLY_AN_AXIS:
        return (
            f"{frame}'s {'xyz'[largest]} axis"
            if not frame.endswith("'s world")
            else f"the {'xyz'[largest]} axis of {frame}"
        )
    numbers = ", ".join(f"{component:.2f}" for component in np.round(unit * np.sign(unit[largest]), 2) + 0.0)
    return f"({numbers}) of {frame}"


def _own_axis(turn_deg: FloatArray) -> str:
    unit = np.abs(turn_deg) / max(float(np.linalg.norm(turn_deg)), 1e-300)
    if unit[2] > _MOSTLY:
        return "its optical axis"
    return "an axis of its image" if unit[2] < 1.0 - _MOSTLY else "an oblique axis"


def _parallel(shifts_mm: list[FloatArray]) -> bool:
    """Whether all go one way, by about as much."""
    mean = np.mean(shifts_mm, axis=0)
    lengths = [float(np.linalg.norm(shift)) for shift in shifts_mm]
    return all(
        float(shift @ mean) > _TOGETHER * length * float(np.linalg.norm(mean)) and length > 0.5 * max(lengths)
        for shift, length in zip(shifts_mm, lengths, strict=True)
    )


def _shifts(board: BoardMotion) -> bool:
    return float(np.linalg.norm(board.shift_mm)) / UNIT_MM >= float(np.linalg.norm(board.turn_deg)) / UNIT_DEG


def _cameras(names: list[str]) -> str:
    quoted = [repr(name) for name in names]
    listed = f"{', '.join(quoted[:-1])} and {quoted[-1]}" if len(quoted) > 1 else quoted[0]
    return f"camera {listed}" if len(quoted) == 1 else f"cameras {listed}"


def _mm(*shifts_mm: FloatArray) -> str:
    return f"{_number(max(float(np.linalg.norm(shift)) for shift in shifts_mm))} mm"


def _deg(*turns_deg: FloatArray) -> str:
    return f"{_number(max(float(np.linalg.norm(turn)) for turn in turns_deg))} deg"


def _px(camera: CameraMotion) -> str:
    return f"{_number(camera.lens_px)} px"


def _number(value: float) -> str:
    """Two digits, never as a power of ten."""
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}"
