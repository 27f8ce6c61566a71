"""What is in a folder that may become a recording: images of cameras, files of a mocap, boards, lenses, corners."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gtcal.camera_files.fields import Field
from gtcal.documents import load_plain_yaml, read_text
from gtcal.errors import GtcalError
from gtcal.overview.mocap_files import MOCAP_SUFFIXES, MocapBody, mocap_bodies
from gtcal.recordings.bag_images import BAG_SUFFIXES, bag_images, image_topics
from gtcal.recordings.images import (
    IMAGE_SUFFIXES,
    Images,
    first_whole,
    image_folder,
    image_list,
    numbered_folder,
    read_grey,
    relative,
)
from gtcal.recordings.layouts import find_layout, lens_fields
from gtcal.recordings.manifest import MANIFEST_NAMES
from gtcal.recordings.numbering import numbers_of
from gtcal.recordings.parquet_table import SUFFIX as PARQUET
from gtcal.recordings.parquet_table import open_parquet
from gtcal.recordings.video_images import VIDEO_SUFFIXES, video_images
from gtcal.recordings.vrs_images import VRS_SUFFIXES, image_streams, vrs_images

# Folders of pictures of results and the like lie deeper.
_DEEPEST = 4
_FEWEST_IMAGES = 2
_NUMBERED_HEADERS = ("number,corner_id,", "number,tag_id,")
_DETECTION_HEADERS = ("timestamp_ns,corner_id,", "timestamp_ns,tag_id,", "ts,tag_rows,", *_NUMBERED_HEADERS)
# A camera's images often lie in a folder of such a name within the camera's.
_PLAIN_FOLDERS = ("data", "images", "image", "frames", "img", "image_raw")
_LENSES_OF_YAC = {
    ("pinhole", "radtan4"): "pinhole_radtan",
    ("pinhole", "equi4"): "kannala_brandt4",
}


@dataclass(frozen=True)
class FoundCamera:
    """Images of one camera.

    fields: of the manifest's entry, as far as the files state them. asked: by field, questions that they leave open.
    what: the images in words. lens_from: the file that describes the lens. images: to look at, None where they can't
    be read yet. detections: files of corners that seem to be this camera's. numbered: whether the images, or corners
    where there are no images, go by number, as far as their names tell."""

    name: str
    fields: dict[str, Any]
    what: str
    images: Images | None
    asked: dict[str, str] = field(default_factory=dict)
    lens_from: str | None = None
    detections: str | None = None
    numbered: bool = False


@dataclass(frozen=True)
class FoundBoard:
    """A file that describes a board, as a manifest's block."""

    block: dict[str, Any]
    path: Path


@dataclass(frozen=True)
class Survey:
    """What is in ``folder``. left: what was found and can't be used, a line each."""

    folder: Path
    cameras: tuple[FoundCamera, ...]
    bodies: tuple[MocapBody, ...]
    boards: tuple[FoundBoard, ...]
    left: tuple[str, ...]


def survey(folder: Path) -> Survey:
    """Look at a folder and the folders in it.

    Raises GtcalError where it is none, or holds neither images nor files of a mocap."""
    if not folder.is_dir():
        raise GtcalError(f"{folder}: there is no such folder")
    left: list[str] = []
    try:
        files = [path for path in _files(folder) if path.name not in MANIFEST_NAMES]
    except OSError as error:
        raise GtcalError(f"{error.filename}: can't be looked into: {error.strerror}") from error
    documents = {path: block for path in files if (block := _yaml_block(path)) is not None}
    cameras = [*_image_cameras(folder, files, left), *_packed_cameras(folder, files, left)]
    lenses = _lenses(folder, documents, left)
    named = _with_names(folder, cameras)
    seen = [*_with_detections(folder, named, files)]
    found = tuple(_with_lens(camera, lenses) for camera in seen or _of_corners(folder, files))
    lists = {path for path in files if _first_line(path).strip().lower().endswith("filename")}
    bodies = [body for path in _mocap_files(files) if path not in lists for body in mocap_bodies(path)]
    if not found and not bodies:
        raise GtcalError(
            f"{folder}: holds no images, videos, bags or VRS files and no file of a mocap that gtcal reads"
            + (f"; {left[0]}" if left else "")
        )
    return Survey(folder, found, tuple(_without_sensors(bodies)), tuple(_boards(documents)), tuple(left))


def _files(folder: Path, depth: int = 0) -> Iterator[Path]:
    """All files, hidden ones aside, in order of their names."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_file():
            yield path
        elif path.is_dir() and depth < _DEEPEST:
            yield from _files(path, depth + 1)


def _first_line(path: Path) -> str:
    """Of a small text file of columns, or what it would be of a Parquet file; nothing of others."""
    if path.suffix == PARQUET:
        return _names(path)
    if path.suffix.lower() not in (".csv", ".tsv", ".txt"):
        return ""
    with path.open("rb") as file:
        return file.readline(4096).decode("utf-8", errors="replace").lstrip("\ufeff# ")


def _names(path: Path) -> str:
    """Of a Parquet file's columns; nothing where it can't be read."""
    try:
        return ",".join(open_parquet(path).names)
    except GtcalError:
        return ""


def _mocap_files(files: list[Path]) -> Iterator[Path]:
    """Those that may hold tracked bodies; of a ROS 2 bag its folder."""
    yield from _bag_folders(files)
    for path in files:
        in_bag = path.suffix in BAG_SUFFIXES and (path.parent / "metadata.yaml").is_file()
        corners = _first_line(path).startswith(_DETECTION_HEADERS)
        if path.suffix.lower() in MOCAP_SUFFIXES and not in_bag and not corners:
            yield path


def _without_sensors(bodies: Iterable[MocapBody]) -> Iterator[MocapBody]:
    """Without what data sets add that no mocap has measured."""
    for body in bodies:
        if not re.match(r"(state_groundtruth|imu|leica)", body.path.parent.name):
            yield body


def _image_cameras(folder: Path, files: list[Path], left: list[str]) -> Iterator[FoundCamera]:
    in_folders: dict[Path, int] = {}
    for path in files:
        if path.suffix.lower() in IMAGE_SUFFIXES:
            in_folders[path.parent] = in_folders.get(path.parent, 0) + 1
    for images_in, n in in_folders.items():
        if n < _FEWEST_IMAGES:
            left.append(f"{relative(images_in, folder)}: a single image, taken for no camera's")
            continue
        try:
            yield _image_camera(folder, images_in)
        except GtcalError as error:
            left.append(str(error))


def _image_camera(folder: Path, images_in: Path) -> FoundCamera:
    where = relative(images_in, folder)
    listing = next((path for path in _possible_lists(images_in) if _lists_images(path)), None)
    fields = {"images": where} | ({} if listing is None else {"image_list": relative(listing, folder)})
    try:
        images = image_folder(images_in) if listing is None else image_list(listing, images_in)
    except GtcalError as error:
        asked = {"image_list": f"Which CSV 'timestamp [ns],filename' lists these images? ({_short(error, images_in)})"}
        try:
            numbered = numbered_folder(images_in) if listing is None else None
        except GtcalError:
            numbered = None
        if numbered is None:
            return FoundCamera(where, _sized(fields, images_in), f"images in {where}", None, asked)
        numbers = numbers_of(numbered.stamps_ns)
        what = f"{len(numbered)} images in {where}, numbers {numbers[0]} to {numbers[-1]}"
        return FoundCamera(where, _sized(fields, images_in), what, numbered, asked, numbered=True)
    size_px = first_whole(images).shape[::-1]
    return FoundCamera(where, {"image_size_px": list(size_px), **fields}, _in_words(images, where, size_px), images)


def _possible_lists(images_in: Path) -> tuple[Path, ...]:
    return (images_in.parent / "data.csv", images_in / "data.csv", images_in.parent / f"{images_in.name}.csv")


def _lists_images(path: Path) -> bool:
    return path.is_file() and bool(re.match(r"timestamp.*,\s*(filename|name)", _first_line(path).strip().lower()))


def _sized(fields: dict[str, Any], images_in: Path) -> dict[str, Any]:
    for path in sorted(images_in.iterdir()):
        if path.suffix.lower() in IMAGE_SUFFIXES:
            with suppress(GtcalError):
                return {"image_size_px": list(read_grey(path).shape[::-1]), **fields}
    return fields


def _short(error: GtcalError, path: Path) -> str:
    """Without the path."""
    return str(error).removeprefix(str(path)).lstrip("/: ")


def _in_words(images: Images, where: str, size_px: tuple[int, ...]) -> str:
    seconds = float(images.stamps_ns[-1] - images.stamps_ns[0]) * 1e-9
    return f"{len(images)} images of {size_px[0]} x {size_px[1]} in {where}, over {seconds:.1f} s"


def _packed_cameras(folder: Path, files: list[Path], left: list[str]) -> Iterator[FoundCamera]:
    """Of videos, bags and VRS files."""
    for path in _packed_files(files):
        try:
            yield from list(_cameras_of(folder, path))
        except GtcalError as error:
            left.append(str(error))


def _packed_files(files: list[Path]) -> Iterator[Path]:
    """A ROS 2 bag is its folder."""
    yield from _bag_folders(files)
    folders = _bag_folders(files)
    for path in files:
        if path.suffix.lower() in (*VIDEO_SUFFIXES, *BAG_SUFFIXES, *VRS_SUFFIXES) and path.parent not in folders:
            yield path


def _bag_folders(files: list[Path]) -> list[Path]:
    with_metadata = {path.parent for path in files if path.name == "metadata.yaml"}
    return sorted({path.parent for path in files if path.parent in with_metadata and path.suffix in BAG_SUFFIXES})


def _cameras_of(folder: Path, path: Path) -> Iterator[FoundCamera]:
    where = relative(path, folder)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        asked = {
            "stamp_offset_ns": "At which time of the mocap's clock, in ns, was the first frame taken? (0: at its 0)"
        }
        yield _packed(Path(where).stem, where, {"video": where}, video_images(path, 0), asked)
    elif path.suffix.lower() in VRS_SUFFIXES:
        for stream in image_streams(path):
            name = f"{path.stem}_{stream}".replace("-", "_")
            yield _packed(name, f"{where}, stream {stream}", {"vrs": where, "stream": stream}, vrs_images(path, stream))
    else:
        for topic in image_topics(path):
            name = topic.strip("/").removesuffix("/image_raw").removesuffix("/compressed").replace("/", "_")
            yield _packed(name, f"{where}, {topic}", {"bag": where, "topic": topic}, bag_images(path, topic))


def _packed(
    name: str, where: str, fields: dict[str, Any], images: Images, asked: dict[str, str] | None = None
) -> FoundCamera:
    size_px = first_whole(images).shape[::-1]
    fields = {"image_size_px": list(size_px), **fields}
    return FoundCamera(name, fields, _in_words(images, where, size_px), images, asked or {})


def _with_names(folder: Path, cameras: list[FoundCamera]) -> list[FoundCamera]:
    """Named after their folders, as 'cam0' of mav0/cam0/data; with the whole path where that names two."""
    short = [_short_name(camera.name) for camera in cameras]
    return [
        replace(camera, name=name if short.count(name) == 1 else re.sub(r"[^\w.-]+", "_", camera.name))
        for camera, name in zip(cameras, short, strict=True)
    ]


def _short_name(where: str) -> str:
    parts = [part for part in Path(where).parts if part.lower() not in _PLAIN_FOLDERS and part != "."]
    return re.sub(r"[^\w.-]+", "_", parts[-1]) if parts else "cam0"


def _with_detections(folder: Path, cameras: list[FoundCamera], files: list[Path]) -> Iterator[FoundCamera]:
    """Corners lie in a file, or a folder of files, of the camera's name."""
    corners = sorted({path for path in files if _first_line(path).startswith(_DETECTION_HEADERS)})
    by_folder: dict[Path, int] = {}
    for path in corners:
        by_folder[path.parent] = by_folder.get(path.parent, 0) + 1
    places = [path.parent if by_folder[path.parent] > 1 else path for path in corners]
    for camera in cameras:
        own = next((place for place in places if camera.name in _words(relative(place, folder))), None)
        yield camera if own is None else replace(camera, detections=relative(own, folder))


def _of_corners(folder: Path, files: list[Path]) -> Iterator[FoundCamera]:
    """Where there are no images: a camera for each file of corners, or for each folder of them."""
    corners = [path for path in files if _first_line(path).startswith(_DETECTION_HEADERS)]
    places = dict.fromkeys(path.parent if _is_of_views(path, corners) else path for path in corners)
    for index, place in enumerate(places):
        first = place if place.is_file() else next(path for path in corners if path.parent == place)
        name = place.stem.removesuffix("_detections").removesuffix("_corners")
        name = f"cam{index}" if name in ("corners", "detections") else name
        where = relative(place, folder)
        asked = {"image_size_px": "How many pixels wide and high are the images, as [640, 480]?"}
        numbered = _first_line(first).startswith(_NUMBERED_HEADERS)
        yield FoundCamera(name, {"detections": where}, f"corners in {where}", None, asked, numbered=numbered)


def _is_of_views(path: Path, corners: list[Path]) -> bool:
    """Whether the file is one of a folder with one for each view."""
    return _first_line(path).startswith("ts,tag_rows,") and sum(p.parent == path.parent for p in corners) > 1


def _words(where: str) -> list[str]:
    return re.split(r"[/.]|_detections", where)


def _yaml_block(path: Path) -> dict[str, Any] | None:
    if path.suffix.lower() not in (".yaml", ".yml"):
        return None
    try:
        block = load_plain_yaml(path, read_text(path))
    except GtcalError:
        return None
    return block if isinstance(block, dict) else None


def _lenses(
    folder: Path, documents: Mapping[Path, dict[str, Any]], left: list[str]
) -> dict[str, tuple[dict[str, Any], str]]:
    """Lenses by camera name, and the file they are from: ASL's and TUM-VI's in their places, then any camchain."""
    found: dict[str, tuple[dict[str, Any], str]] = {}
    try:
        layout = find_layout(folder)
    except GtcalError as error:
        left.append(str(error))
        layout = None
    for path, block in documents.items():
        for name, camera in block.items():
            try:
                lens = _lens(Field(path, str(name), camera)) if isinstance(camera, dict) else {}
            except GtcalError as error:
                left.append(str(error))
                continue
            if lens:
                found.setdefault(str(name), (lens, relative(path, folder)))
    in_place = {} if layout is None else {n: (lens, relative(p, folder)) for n, (lens, p) in layout.lenses.items()}
    return found | in_place


def _lens(block: Field) -> dict[str, Any]:
    """Of Kalibr's and ASL's files, or of yac's, which may name the model alone."""
    lens = lens_fields(block)
    model = _LENSES_OF_YAC.get((str(block.value.get("proj_model")), str(block.value.get("dist_model"))))
    return lens or ({} if model is None else {"model": model})


def _with_lens(camera: FoundCamera, lenses: Mapping[str, tuple[dict[str, Any], str]]) -> FoundCamera:
    lens, where = lenses.get(camera.name, ({}, None))
    if not lens:
        return camera
    size_px = camera.fields.get("image_size_px")
    if lens.get("image_size_px", size_px) != size_px:
        asked = {"parameters": f"{where} has the lens for images of {lens['image_size_px']} px: which parameters hold?"}
        return replace(camera, fields={"model": lens["model"], **camera.fields}, asked={**camera.asked, **asked})
    return replace(camera, fields={**lens, **camera.fields}, lens_from=where)


def _boards(documents: Mapping[Path, dict[str, Any]]) -> Iterator[FoundBoard]:
    for path, block in documents.items():
        for candidate in (block, block.get("calib_target"), block.get("target")):
            board = _kalibr_board(candidate) if isinstance(candidate, dict) else None
            if board is not None:
                yield FoundBoard(board, path)


def _kalibr_board(block: Mapping[str, Any]) -> dict[str, Any] | None:
    """Kalibr's target file of an AprilGrid, or yac's, which names the fields otherwise."""
    if block.get("target_type") != "aprilgrid":
        return None
    for names in (("tagCols", "tagRows", "tagSize", "tagSpacing"), ("tag_cols", "tag_rows", "tag_size", "tag_spacing")):
        if all(isinstance(block.get(name), int | float) for name in names):
            columns, rows, side_m, spacing = (block[name] for name in names)
            sizes = {"tag_side_m": float(side_m), "tag_spacing": float(spacing)}
            return {"type": "aprilgrid", "tag_columns": int(columns), "tag_rows": int(rows), **sizes}
    return None
