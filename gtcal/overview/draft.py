"""The draft of a manifest: what a folder states is taken, and said why; what it doesn't is a question."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import yaml

from factors import CAMERA_MODELS
from gtcal.board import BOARD_TYPES, PRESETS, Board, TaggedBoard, board_from_manifest
from gtcal.detection.board_guess import BoardGuess, LoneTag, guess_board, guess_lone_tag
from gtcal.detection.plain_guess import PlainGuess, guess_plain_board
from gtcal.errors import GtcalError
from gtcal.overview.mocap_files import MocapBody
from gtcal.overview.survey import FoundBoard, FoundCamera, Survey
from gtcal.progress import Progress, silent
from gtcal.readers import pose_list
from gtcal.recordings.capture import Capture
from gtcal.recordings.images import Images, relative
from gtcal.recordings.open_questions import OPEN
from gtcal.verification.lollypop import DEVICE_PRESETS, Lollypop

_WIDTH = 116
_PLATFORM = re.compile(
    r"(platform|headset|hmd|rig|body|camera|cams?\b|glasses|quest|aria|vicon|mocap|wrist|flange|gripper|hand|robot|\barm|"
    r"tool|tcp|effector)"
)
_BOARD = re.compile(r"(board|target|grid|april|aruco|tags?\b|checker)")
_LOLLYPOP = re.compile(r"(lolly|lolli|wand|device_body)")
_BODY_QUESTIONS = {
    "quaternion": "In which order are the quaternion's numbers, xyzw or wxyz? The file doesn't say.",
    "length_unit": "Are the positions in m or in mm? The file doesn't say.",
    "time_unit": "Are the time stamps in ns, us, ms or s? The file doesn't say.",
    "rotation": "How are rotations written? The file doesn't say; 'gtcal schema' lists the choices.",
    "rate_hz": "How many frames a second were taken? The file numbers frames only.",
    "angle_unit": "Are the angles in deg or in rad? The file doesn't say.",
}
_CAPTURES = (
    "fixed_cameras (the cameras stand, the board is tracked), tracked_platform (rig or headset and board are tracked) "
    "or standing_board (rig or headset is tracked, the board stands still)"
)
_LOLLYPOP_CAPTURES = "fixed_cameras (the cameras stand) or tracked_platform (rig or headset is tracked too)"
_MODELS = (
    f"Which lens model: {', '.join(CAMERA_MODELS)}? pinhole_radtan for ordinary lenses, a fisheye model for views "
    "wider than about 100 degrees."
)


@dataclass(frozen=True)
class Draft:
    """text: the manifest. questions: what is open in it, as 'field: question'. warnings: what doesn't fit together."""

    text: str
    questions: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def draft(found: Survey, manifest: Path, progress: Progress = silent) -> Draft:
    """The draft of ``manifest`` for what was found. The paths in it are relative to its folder.

    Raises GtcalError where an image can't be read."""
    lines = _Lines(found.folder, manifest.parent)
    lines.say(
        f"Drafted by 'gtcal init'. Check what was taken, and replace each {OPEN} by the answer to the question above "
        "it; until then the manifest does not load."
    )
    lines.put("gtcal_recording", 1)
    numbered = _is_numbered(found)
    if numbered:
        lines.say("Names and poses have numbers and no times: one pose for each image.")
        lines.put("numbered", True)
    else:
        found = _without_lists(found)
    shown = _shown(found, progress)
    roles = _roles(found.bodies, shown)
    lines.blank()
    _write_capture(lines, roles, found.bodies, shown)
    lines.blank()
    if shown.lone_tag is None:
        _write_board(lines, found, shown.board, shown.plain)
    else:
        _write_device(lines, shown.lone_tag)
    lines.blank()
    _write_cameras(lines, found, shown, numbered)
    _write_bodies(lines, roles, found.bodies, shown)
    warnings = tuple(_times_apart(found))
    _write_left(lines, warnings, found.left)
    return Draft("\n".join(lines.text) + "\n", tuple(lines.questions), warnings)


def _is_numbered(found: Survey) -> bool:
    """Whether all cameras go by number, and poses without time are there."""
    listed = any(body.format == pose_list.FORMAT for body in found.bodies)
    return bool(found.cameras) and all(camera.numbered for camera in found.cameras) and listed


def _without_lists(found: Survey) -> Survey:
    """Poses without time are of no use to images with it."""
    bodies = tuple(body for body in found.bodies if body.format != pose_list.FORMAT)
    listed = [body for body in found.bodies if body.format == pose_list.FORMAT]
    left = tuple(
        f"{relative(body.path, found.folder)}: {body.n_samples} poses without time, but not all images go by number"
        for body in listed
    )
    return replace(found, bodies=bodies, left=(*found.left, *left))


class _Lines:
    """The lines of the draft as they grow. Fields inside others are indented."""

    def __init__(self, found_in: Path, written_in: Path) -> None:
        self.found_in, self.written_in = found_in, written_in
        self.text: list[str] = []
        self.questions: list[str] = []
        self._within: list[str] = []

    def path(self, given: str) -> str:
        """A path relative to the folder that was looked at, as the manifest names it."""
        return relative(self.found_in / given, self.written_in)

    def blank(self) -> None:
        self.text.append("")

    def say(self, words: str) -> None:
        indent = "  " * len(self._within)
        self.text += textwrap.wrap(words, _WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")

    def put(self, name: str, value: Any) -> None:
        dumped = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False).removesuffix("...\n")
        self.text.append(f"{'  ' * len(self._within)}{name}: {dumped.strip()}")

    def ask(self, name: str, question: str) -> None:
        self.say(f"{OPEN}: {question}")
        self.put(name, OPEN)
        self.questions.append(f"{'.'.join([*self._within, name])}: {question}")

    def enter(self, name: str) -> None:
        self.text.append(f"{'  ' * len(self._within)}{name}:")
        self._within.append(name)

    def leave(self) -> None:
        self._within.pop()


@dataclass(frozen=True)
class _Shown:
    """What the images show: a board as far as its tags tell, one without tags, or one tag alone, which is taken for a
    Lollypop's."""

    board: BoardGuess | None = None
    plain: PlainGuess | None = None
    lone_tag: LoneTag | None = None

    @property
    def body(self) -> str:
        """The manifest's field of the body that carries it."""
        return "board_body" if self.lone_tag is None else "device_body"

    @property
    def called(self) -> str:
        return "the board" if self.lone_tag is None else "the Lollypop"

    @property
    def captures(self) -> str:
        return _CAPTURES if self.lone_tag is None else _LOLLYPOP_CAPTURES


def _shown(found: Survey, progress: Progress) -> _Shown:
    """Of the first camera that shows a board; where none does and no file describes one, that shows a board without
    tags, one whose tags are hard to read, or a tag alone."""
    cameras = [camera.images for camera in found.cameras if camera.images is not None]

    def first(what: str, guess: Callable[[Images], _T | None]) -> _T | None:
        for done, images in enumerate(cameras):
            progress(f"looking for {what}", done, len(cameras))
            if (guessed := guess(images)) is not None:
                return guessed
        return None

    board = first("tags", guess_board)
    if board is not None or any(_is_valid(one) for one in found.boards):
        return _Shown(board)
    plain = None if found.boards else first("squares and dots", guess_plain_board)
    if plain is not None:
        return _Shown(plain=plain)
    board = first("tags that are hard to read", partial(guess_board, thorough=True))
    return _Shown(board) if board is not None else _Shown(lone_tag=first("a tag alone", guess_lone_tag))


_T = TypeVar("_T")
_Roles = dict[str, list[MocapBody]]


def _roles(bodies: Iterable[MocapBody], shown: _Shown) -> _Roles:
    """The bodies that by their names carry the cameras ('platform') or what is shown ('held'); 'other': those whose
    names tell nothing. A board beside a Lollypop that is shown, or the other way round, is none of them."""
    held, beside = (_BOARD, _LOLLYPOP) if shown.lone_tag is None else (_LOLLYPOP, _BOARD)
    roles: _Roles = {"held": [], "beside": [], "platform": [], "other": []}
    for body in bodies:
        words = body.called.lower()
        patterns = {"held": held, "beside": beside, "platform": _PLATFORM}
        roles[next((role for role, pattern in patterns.items() if pattern.search(words)), "other")].append(body)
    return roles if roles["held"] else {**roles, "held": roles["beside"]}


def _capture(roles: _Roles, shown: _Shown) -> Capture | None:
    """What the names of the bodies tell; None where they don't."""
    n_platforms, n_held, n_others = (len(roles[role]) for role in ("platform", "held", "other"))
    kinds = {(1, 1): Capture.TRACKED_PLATFORM, (0, 1): Capture.FIXED_CAMERAS}
    if shown.lone_tag is None:
        kinds[1, 0] = Capture.STANDING_BOARD
    return None if n_others else kinds.get((n_platforms, n_held))


def _write_capture(lines: _Lines, roles: _Roles, bodies: tuple[MocapBody, ...], shown: _Shown) -> None:
    capture = _capture(roles, shown)
    if capture is None:
        names = ", ".join(body.called for body in bodies) or "none was found"
        lines.ask("capture", f"What was tracked: {shown.captures}? Tracked bodies: {names}.")
        return
    told = " and ".join(
        f"{roles[role][0].called!r} is taken for {what}"
        for role, what in (("platform", "what carries the cameras"), ("held", shown.called))
        if roles[role]
    )
    nothing_else = "" if len(bodies) > 1 else "; nothing else is tracked"
    lines.say(f"By its name, {told}{nothing_else}. The kinds of capture: {shown.captures}.")
    lines.put("capture", capture.value)


def _write_device(lines: _Lines, tag: LoneTag) -> None:
    lines.say(
        f"The images show one tag alone, {tag.tag_id} of {tag.dictionary}: taken for the Lollypop's, of a recording to "
        "verify a calibration with. A recording to calibrate from shows a board: then write 'board' in place of "
        "'device', and 'board_body' in place of 'device_body'."
    )
    preset = next((name for name, device in DEVICE_PRESETS.items() if _is_the_tag_of(tag, device)), None)
    if preset is not None:
        lines.ask(
            "device",
            f"Which Lollypop was shown? If it is the preset {preset} ({DEVICE_PRESETS[preset].describe()}), printed at "
            f"100 %, and the body's origin is its markers' centroid, answer {{preset: {preset}}}; else {{dictionary: "
            f"{tag.dictionary}, tag_id: {tag.tag_id}, tag_side_m: ..., centre_offset_m: [x, y, z]}}: the side of the "
            "tag's black square, and where its middle is in the tracked body's frame, in m.",
        )
        return
    lines.enter("device")
    lines.put("dictionary", tag.dictionary)
    lines.put("tag_id", tag.tag_id)
    lines.ask("tag_side_m", "How long is the side of the tag's black square, in m? Measure it on the print.")
    lines.ask(
        "centre_offset_m",
        "Where is the tag's middle in the tracked body's frame, [x, y, z] in m? [0, 0, 0] where the markers' centroid "
        "is the tag's middle and the body's origin, as on the Lollypop.",
    )
    lines.leave()


def _is_the_tag_of(tag: LoneTag, device: Lollypop) -> bool:
    return device.dictionary == tag.dictionary and device.tag_ids.tolist() == [tag.tag_id]


def _write_board(lines: _Lines, found: Survey, guess: BoardGuess | None, plain: PlainGuess | None) -> None:
    usable = [board for board in found.boards if _is_valid(board)]
    if len(usable) == 1:
        where = relative(usable[0].path, lines.written_in)
        lines.say(f"From {where}.{_agrees(usable[0].block, guess)}")
        lines.put("board", usable[0].block)
    elif guess is None and plain is not None:
        _write_plain_guess(lines, plain)
    elif guess is None:
        several = " ".join(f"{relative(board.path, lines.written_in)} says {board.block}." for board in usable)
        lines.ask(
            "board",
            f"Which board was shown? {several + ' ' if several else ''}As {{preset: paper_a2}}, or {{type: ...}} with "
            f"its fields, of {', '.join(BOARD_TYPES)}; 'gtcal schema' lists them. "
            + ("No tags were read in the images." if found.cameras else ""),
        )
    else:
        _write_guess(lines, guess)


def _is_valid(board: FoundBoard) -> bool:
    try:
        board_from_manifest(board.block)
    except GtcalError:
        return False
    return True


def _write_plain_guess(lines: _Lines, guess: PlainGuess) -> None:
    what = "square" if guess.kind == "chessboard" else "dot"
    kind = "a chessboard" if what == "square" else f"{'an asymmetric' if guess.asymmetric else 'a'} grid of dots"
    lines.say(
        f"Images show {kind} of {guess.columns} x {guess.rows} {what}s; "
        "there is no code in it: check which are columns and which rows of the upright print."
    )
    lines.enter("board")
    lines.put("type", guess.kind)
    lines.put(f"{what}_columns", guess.columns)
    lines.put(f"{what}_rows", guess.rows)
    if guess.asymmetric:
        lines.put("asymmetric", True)
    name, length = ("square_side_m", "the side of a square") if what == "square" else ("dot_pitch_m", _PITCH)
    lines.ask(name, f"How long is {length}, in m? Measure it on the print, over several of them.")
    lines.leave()


_PITCH = "the way from a dot's centre to that of the next in its row"


def _agrees(block: dict[str, Any], guess: BoardGuess | None) -> str:
    """What the images say to the board of a file."""
    if guess is None:
        return " No tags were read in the images: check it."
    board = board_from_manifest(block)
    if not isinstance(board, TaggedBoard):
        return f" BUT the images show tags of {guess.dictionary}: check it."
    if guess.dictionary != board.dictionary or not set(guess.ids.tolist()) <= set(board.tag_ids.tolist()):
        return (
            f" BUT the images show {guess.kind} tags of {guess.dictionary}, ids {guess.ids.min()} to "
            f"{guess.ids.max()}: check it."
        )
    return f" The images show its tags ({len(guess.ids)} of them were read)."


def _write_guess(lines: _Lines, guess: BoardGuess) -> None:
    lines.say(
        f"The images show tags of {guess.dictionary}, ids {guess.ids.min()} to {guess.ids.max()}"
        + (
            f", arranged as on a board of type {guess.kind}."
            if guess.columns
            else "; how they are arranged is unclear."
        )
    )
    preset = next((name for name, board in PRESETS.items() if _could_be(board, guess)), None)
    if preset is not None:
        lines.ask(
            "board",
            f"Which board was shown? If it is the preset {preset} ({PRESETS[preset].describe()}), printed at 100 %, "
            f"answer {{preset: {preset}}}; else {{type: {guess.kind}, ...}}, see 'gtcal schema'.",
        )
        return
    lines.enter("board")
    lines.put("type", guess.kind)
    if guess.kind == "aprilgrid":
        lines.put("family", guess.dictionary.removeprefix("DICT_APRILTAG_"))
    else:
        lines.put("dictionary", guess.dictionary)
    what = "square" if guess.kind == "charuco" else "tag"
    for name, count in ((f"{what}_columns", guess.columns), (f"{what}_rows", guess.rows)):
        if count is None:
            lines.ask(name, f"How many {name.replace('_', ' ')} has the board?")
        else:
            lines.put(name, count)
    if guess.first_tag_id:
        lines.put("first_tag_id", guess.first_tag_id)
    for name, question in _SIZE_QUESTIONS[guess.kind].items():
        lines.ask(name, question)
    lines.leave()


_SIDE_QUESTION = "How long is the side of a tag's black square, in m? Measure it on the print, over several tags."
_SIZE_QUESTIONS = {
    "aprilgrid": {
        "tag_side_m": _SIDE_QUESTION,
        "tag_spacing": "How wide is the gap between two tags, over a tag's side? 0.3 on Kalibr's boards; measure it.",
    },
    "aruco_grid": {
        "tag_side_m": _SIDE_QUESTION,
        "tag_gap_m": "How wide is the white between two tags, in m?",
        "corner_squares": "Are there black squares where the gaps cross, true or false?",
    },
    "charuco": {
        "square_side_m": "How long is the side of a chessboard square, in m? Measure it over several squares.",
        "marker_side_m": "How long is the side of a tag's black square, in m?",
    },
}


def _could_be(board: Board, guess: BoardGuess) -> bool:
    if not isinstance(board, TaggedBoard):
        return False
    same_tags = board.dictionary == guess.dictionary and set(guess.ids.tolist()) <= set(board.tag_ids.tolist())
    columns = getattr(board, "tag_columns", None)
    return same_tags and guess.columns in (None, columns)


def _write_cameras(lines: _Lines, found: Survey, shown: _Shown, numbered: bool) -> None:
    if not found.cameras:
        lines.ask("cameras", "Where are the cameras' images? None were found in this folder; see 'gtcal schema'.")
        return
    lines.enter("cameras")
    for camera in found.cameras:
        _write_camera(lines, camera, numbered, to_verify=shown.lone_tag is not None)
    lines.leave()


def _write_camera(lines: _Lines, camera: FoundCamera, numbered: bool, *, to_verify: bool) -> None:
    lines.say(
        camera.what + ("" if camera.lens_from is None else f"; the lens is that of {lines.path(camera.lens_from)}")
    )
    lines.enter(camera.name)
    if "model" in camera.fields:
        lines.put("model", camera.fields["model"])
    else:
        lines.ask("model", _MODELS + (" The one that it was calibrated with." if to_verify else ""))
    if to_verify:
        lines.say("The intrinsics are the calibration's.")
    elif "parameters" not in camera.fields and "parameters" not in camera.asked:
        lines.say("No intrinsics were found: 'gtcal calibrate' finds them from the recording, or state 'parameters'.")
    for name, value in camera.fields.items():
        if name != "model":
            lines.put(name, lines.path(value) if name in _PATH_FIELDS else value)
    for name, question in camera.asked.items():
        if not (numbered and name == "image_list"):
            lines.ask(name, question)
    if camera.detections is not None:
        lines.say(f"Corners were found in {lines.path(camera.detections)}; to take them in place of detecting, add:")
        lines.say(f"detections: {lines.path(camera.detections)}")
    lines.leave()


_PATH_FIELDS = ("images", "image_list", "video", "bag", "vrs", "detections")


def _write_bodies(lines: _Lines, roles: _Roles, bodies: tuple[MocapBody, ...], shown: _Shown) -> None:
    """Those that the capture needs; where that is open, a question for each kind that could be."""
    capture = _capture(roles, shown)
    if capture is not None:
        for role in capture.bodies:
            if role == "platform":
                _write_body(lines, role, roles["platform"][0])
            else:
                _write_body(lines, shown.body, roles["held"][0])
        return
    choices = "; ".join(_flow(lines, body) for body in bodies) or "none was found"
    for role, what in (("platform", "carries the cameras"), (shown.body, f"carries {shown.called}")):
        lines.blank()
        leave_out = "" if role == "device_body" else " Leave this field out where nothing does."
        lines.ask(role, f"Which tracked body {what}? One of: {choices}.{leave_out}")


def _flow(lines: _Lines, body: MocapBody) -> str:
    """The body's entry on one line."""
    named = {} if body.name is None else {"name": body.name}
    entry = {"trajectory": relative(body.path, lines.written_in), "format": body.format, **named}
    open_fields = dict.fromkeys(body.open_fields, "...")
    return yaml.safe_dump({**entry, **open_fields}, default_flow_style=True, width=10_000, sort_keys=False).strip()


def _write_body(lines: _Lines, role: str, body: MocapBody) -> None:
    lines.blank()
    lines.say(f"{body.n_samples} poses{_seconds(body)}.")
    lines.enter(role)
    lines.put("trajectory", relative(body.path, lines.written_in))
    lines.put("format", body.format)
    if body.name is not None:
        lines.put("name", body.name)
    for name in body.open_fields:
        lines.ask(name, _BODY_QUESTIONS[name])
    lines.leave()


def _seconds(body: MocapBody) -> str:
    return "" if body.span_ns is None else f" over {(body.span_ns[1] - body.span_ns[0]) * 1e-9:.1f} s"


def _write_left(lines: _Lines, warnings: tuple[str, ...], left: tuple[str, ...]) -> None:
    """What doesn't fit together, and what was left aside."""
    notes = [*(f"WARNING: {line}" for line in warnings), *(f"Left aside: {line}" for line in left)]
    if notes:
        lines.blank()
    for note in notes:
        lines.say(note)


def _times_apart(found: Survey) -> Iterable[str]:
    """A line for the cameras that have no time in common with the same bodies."""
    apart: dict[str, list[str]] = {}
    for camera in found.cameras:
        if camera.images is None or camera.numbered or "stamp_offset_ns" in camera.asked:
            continue
        first, last = int(camera.images.stamps_ns[0]), int(camera.images.stamps_ns[-1])
        spans = {body.called: body.span_ns for body in found.bodies if body.span_ns is not None}
        bodies = [
            f"{name} ({span[0]} to {span[1]} ns)" for name, span in spans.items() if last < span[0] or first > span[1]
        ]
        if bodies:
            cameras = apart.setdefault(", ".join(bodies), [])
            cameras.append(camera.name if cameras else f"{camera.name} ({first} to {last} ns)")
    for bodies_named, (one, *others) in apart.items():
        too = f" ({', '.join(others)} too)" if others else ""
        yield (
            f"{one} has no time in common with {bodies_named}{too}: another clock? 'stamp_offset_ns' under "
            "each of these bodies is what is to be added to its stamps; 'gtcal doctor' finds it, once all else is "
            "answered."
        )
