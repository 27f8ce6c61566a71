"""Recordings that are refused as they stand: read with other lines in their manifest, each part by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations, islice, permutations, product
from typing import Any

import numpy as np

from gtcal.doctor.fit import fit_alone, views_of
from gtcal.doctor.lens_readings import IMAGE_SCALES, scaled_intrinsics
from gtcal.doctor.manifest_lines import ManifestFile, line_of
from gtcal.errors import GtcalError
from gtcal.recordings.detection_files import stated_tags
from gtcal.recordings.images import first_whole, image_folder
from gtcal.recordings.manifest import TrajectoryEntry
from gtcal.recordings.recording import Recording

_MOST = 64
_BOARD_UNITS = {1e-3: "mm", 1e-2: "cm", 0.0254: "inches"}
_CONVENTIONS = {"quaternion": ("xyzw", "wxyz"), "length_unit": ("m", "mm"), "time_unit": ("ns", "us", "ms", "s")}
_FAULTS = {
    "quaternion": "quaternion order",
    "length_unit": "units",
    "time_unit": "time unit",
    "image_size_px": "image size",
    "parameters": "image size",
    "detections": "swapped cameras",
    "images": "swapped cameras",
    "image_list": "swapped cameras",
    "first_tag_id": "first tag id",
    "tag_columns": "board columns and rows",
    "tag_rows": "board columns and rows",
}

Lines = tuple[str, ...]


@dataclass(frozen=True)
class Opened:
    """A recording as read with these lines in its manifest. refusals: why each part was refused, with the lines that
    mend it."""

    file: ManifestFile
    recording: Recording
    refusals: tuple[tuple[str, Lines], ...]


def opened(file: ManifestFile) -> list[Opened]:
    """The recording, or where it is refused the readings of it that are not, with as few changes as do.

    Raises GtcalError, why it is refused, where there is no such reading."""
    try:
        return [Opened(file, file.recording(), ())]
    except GtcalError as error:
        refusal = error
    found = [Opened(file, recording, refusals) for file, recording, refusals in _mended(file)]
    if not found:
        raise refusal
    return found


def fault_of(lines: Lines) -> str:
    """The kind of fault that these lines mend."""
    names = {line.partition(": ")[0].rpartition(".")[2] for line in lines}
    listed = list(dict.fromkeys(_FAULTS.get(name, "board size" if name.endswith("_m") else name) for name in names))
    return " and ".join(sorted(listed))


def _mended(file: ManifestFile) -> Iterator[tuple[ManifestFile, Recording, tuple[tuple[str, Lines], ...]]]:
    """Parts that others rest on come first: board, cameras, detections and images; trajectories on their own."""
    states: list[tuple[ManifestFile, tuple[tuple[str, Lines], ...]]] = [(file, ())]
    for stage in (_boards, _cameras, _seen, _bodies, _all):
        following: list[tuple[ManifestFile, tuple[tuple[str, Lines], ...]]] = []
        for state, refusals in states:
            refused = stage(state)
            for chosen in islice(product(*(choices for _, choices in refused)), _MOST):
                told = tuple((why, lines) for (why, _), lines in zip(refused, chosen, strict=True))
                following.append((state.changed(line for lines in chosen for line in lines), (*refusals, *told)))
        states = following[:_MOST]
    for state, refusals in states:
        with suppress(GtcalError):
            yield state, state.recording(), refusals


def _refused(read: Callable[[], Any]) -> str | None:
    try:
        read()
    except GtcalError as error:
        return str(error)
    return None


def _that_read(file: ManifestFile, tried: Iterable[Lines], read: Callable[[ManifestFile], Any]) -> list[Lines]:
    return [lines for lines in tried if _refused(lambda lines=lines: read(file.changed(lines))) is None]  # type: ignore[misc]


def _boards(file: ManifestFile) -> list[tuple[str, list[Lines]]]:
    def read(tried: ManifestFile) -> None:
        tried.loader().board(tried.manifest().board)

    why = _refused(lambda: read(file))
    if why is None:
        return []
    lengths = {name: value for name, value in file.fields["board"].items() if name.endswith("_m")}
    tried = [
        tuple(line_of(f"board.{name}", float(f"{value * factor:.6g}")) for name, value in lengths.items())
        for factor in _BOARD_UNITS
        if all(isinstance(value, int | float) for value in lengths.values())
    ]
    return [(why, _that_read(file, tried, read)[:1])]


def _cameras(file: ManifestFile) -> list[tuple[str, list[Lines]]]:
    """Cameras whose parameters don't go with the size of their images."""
    found = []
    for name, entry in file.manifest().cameras.items():

        def read(tried: ManifestFile, name: str = name) -> None:
            tried.loader().camera(name, tried.manifest().cameras[name])

        if why := _refused(lambda read=read: read(file)):  # type: ignore[misc]
            readable = _that_read(file, _other_lenses(file, name, entry.parameters or {}), read)
            found.append((why, _best_fitting(file, name, readable)))
    return found


def _best_fitting(file: ManifestFile, name: str, tried: list[Lines]) -> list[Lines]:
    """Of these lines for one camera those under which its views alone fit best; the first where there are no corners or
    intrinsics to tell by."""

    def misfit_px(lines: Lines) -> float:
        with suppress(GtcalError):
            changed = file.changed(lines)
            loader, manifest = changed.loader(), changed.manifest()
            entry, board = manifest.cameras[name], loader.board(manifest.board)
            camera = loader.camera(name, entry)
            if entry.detections is not None and camera.parameters is not None:
                detections = loader.detections(name, entry.detections, board, camera)
                return fit_alone(views_of(camera, board, detections)).typical_px
        return float("inf")

    return [min(tried, key=misfit_px)] if tried else []


def _other_lenses(file: ManifestFile, name: str, parameters: dict[str, float]) -> Iterator[Lines]:
    where = f"cameras.{name}"
    size_px = file.manifest().cameras[name].image_size_px
    if size_px is None:  # the lens is a file's, and so is its size
        return
    width_px, height_px = size_px
    yield (line_of(f"{where}.image_size_px", [height_px, width_px]),)
    if not {"fx", "fy", "cx", "cy"} <= set(parameters):
        return
    four = np.array([parameters[key] for key in ("fx", "fy", "cx", "cy")])
    exchanged = four[[0, 1, 3, 2]]
    in_widths = four * (width_px, width_px, 1, 1)
    in_sizes = four * (width_px, height_px, width_px, height_px)
    scaled = [scaled_intrinsics(four, scale) for scale in IMAGE_SCALES]
    for other in (exchanged, in_widths, in_sizes, *scaled):
        changed = parameters | dict(zip(("fx", "fy", "cx", "cy"), other.tolist(), strict=True))
        yield (line_of(f"{where}.parameters", changed),)


def _seen(file: ManifestFile) -> list[tuple[str, list[Lines]]]:
    """Detections that lie outside the image or are not on the board, and images of another size."""
    found = []
    for name in file.manifest().cameras:

        def read(tried: ManifestFile, name: str = name) -> None:
            loader, manifest = tried.loader(), tried.manifest()
            entry, board = manifest.cameras[name], loader.board(manifest.board)
            camera = loader.camera(name, entry)
            if entry.detections is not None:
                loader.detections(name, entry.detections, board, camera)
            if entry.image_sources:
                loader.images(name, entry, camera)

        if why := _refused(lambda read=read: read(file)):  # type: ignore[misc]
            readable = _best_fitting(file, name, _that_read(file, _other_sizes(file, name), read))
            boards = [] if readable else _that_read(file, _other_boards(file, name), read)
            found.append((why, readable or boards or _that_read(file, _other_sources(file, name), read)))
            if boards:  # one board serves all cameras
                return found
    return found


def _other_sizes(file: ManifestFile, name: str) -> Iterator[Lines]:
    where, entry = f"cameras.{name}", file.manifest().cameras[name]
    if entry.image_size_px is None:
        return
    width_px, height_px = entry.image_size_px
    sizes = [(height_px, width_px)]
    if entry.images is not None:
        with suppress(GtcalError):
            height, width = first_whole(image_folder(file.path.parent / entry.images)).shape
            sizes = [(width, height)]
    for size_px in [*sizes, *((round(width_px * k), round(height_px * k)) for k in IMAGE_SCALES)]:
        line = line_of(f"{where}.image_size_px", list(size_px))
        yield (line,)
        if entry.parameters is not None:
            names = ("fx", "fy", "cx", "cy")
            four = np.array([entry.parameters[key] for key in names])
            scaled = scaled_intrinsics(four, size_px[0] / width_px)
            changed = entry.parameters | dict(zip(names, scaled.tolist(), strict=True))
            yield line, line_of(f"{where}.parameters", changed)


def _other_boards(file: ManifestFile, name: str) -> Iterator[Lines]:
    """What the detections say of their board."""
    board, given = file.fields["board"], file.manifest().cameras[name].detections
    stated = stated_tags(file.path.parent / given) if given is not None else None
    if stated is None or "preset" in board:
        return
    yield (line_of("board.first_tag_id", int(stated.tag_ids[0])),)
    columns, rows = board.get("tag_columns"), board.get("tag_rows")
    yield line_of("board.tag_columns", rows), line_of("board.tag_rows", columns)
    if stated.grid is not None:
        changed = dict(zip(("tag_columns", "tag_rows", "tag_side_m", "tag_spacing"), stated.grid, strict=True))
        yield tuple(line_of(f"board.{key}", value) for key, value in changed.items() if board.get(key) != value)


def _other_sources(file: ManifestFile, name: str) -> Iterator[Lines]:
    """The images of another camera, which takes those of this one."""
    for one, other in permutations(file.manifest().cameras, 2):
        if one == name:
            yield (*source_lines(file, one, other), *source_lines(file, other, one))


def source_lines(file: ManifestFile | None, name: str, other: str) -> Lines:
    """The lines by which camera ``name`` takes the images and detections of ``other``."""
    if file is None:
        return ()
    entry = file.fields["cameras"][other]
    return tuple(
        line_of(f"cameras.{name}.{key}", entry[key]) for key in ("images", "image_list", "detections") if key in entry
    )


def _bodies(file: ManifestFile) -> list[tuple[str, list[Lines]]]:
    """Trajectories that contradict their conventions, or leave one open: with as few changes as make them read."""
    found = []
    for body, entry in file.manifest().bodies.items():

        def read(tried: ManifestFile, body: str = body) -> None:
            tried.loader().trajectory(body, tried.manifest().bodies[body])

        if why := _refused(lambda read=read: read(file)):  # type: ignore[misc]
            by_count: dict[int, list[Lines]] = {}
            for lines in _other_conventions(body, entry):
                by_count.setdefault(len(lines), []).append(lines)
            readable = (_that_read(file, by_count[count], read) for count in sorted(by_count))
            found.append((why, next((lines for lines in readable if lines), [])))
    return found


def _other_conventions(body: str, entry: TrajectoryEntry) -> Iterator[Lines]:
    choices = {
        field: [value for value in values if value != getattr(entry, field)] for field, values in _CONVENTIONS.items()
    }
    for size in range(1, len(choices) + 1):
        for fields in combinations(choices, size):
            for values in product(*(choices[field] for field in fields)):
                yield tuple(f"{body}.{field}: {value}" for field, value in zip(fields, values, strict=True))


def _all(file: ManifestFile) -> list[tuple[str, list[Lines]]]:
    """What only shows in the whole: bodies that hardly move in millimetres."""
    why = _refused(file.recording)
    if why is None:
        return []
    declared = [body for body, entry in file.manifest().bodies.items() if entry.length_unit == "mm"]
    tried = [
        tuple(f"{body}.length_unit: m" for body in bodies)
        for size in range(1, len(declared) + 1)
        for bodies in combinations(declared, size)
    ]
    return [(why, _that_read(file, tried, ManifestFile.recording))]
