"""The images of one camera, in order of time and read one at a time: what every source of them has, and files."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, Self

import cv2
import numpy as np
import numpy.typing as npt

from gtcal.bounds import added
from gtcal.documents import read_text
from gtcal.errors import GtcalError
from gtcal.files import IMAGE_BYTES, is_there, read_bytes, write_text
from gtcal.recordings.detections import IntArray
from gtcal.recordings.numbering import number_of_name, stamps_of

GreyImage = npt.NDArray[np.uint8]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp")
# No camera takes images a microsecond apart: such stems count frames.
_SHORTEST_INTERVAL_NS = 1_000


class Images(Protocol):
    """The V images of one camera in order of time, wherever they are kept. ``read`` may be called from any thread."""

    @property
    def stamps_ns(self) -> IntArray:
        """(V,) strictly increasing time stamps, camera clock."""

    @property
    def size_px(self) -> tuple[int, int] | None:
        """(width, height) that every image must have; None where any size will do."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was taken otherwise than it was named, one sentence each, for the user to see."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that hold the images: where none changes, no image does."""

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Files or folders that a result names as what it was computed from."""

    @property
    def source(self) -> str:
        """What says, beside the files, which images these are: a topic, a stream."""

    def __len__(self) -> int: ...

    def expecting(self, width_px: int, height_px: int) -> Images:
        """The same images, of which ``read`` takes only those of this size."""

    def read(self, index: int) -> GreyImage:
        """One image as 8-bit grey, shape (height, width). Raises GtcalError where it can't be read whole, or is not
        of the size expected."""

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """The fields of a manifest in ``folder`` that point to the images; a list of them is written where their
        names need one. Raises GtcalError where the folder can't be written."""


@dataclass(frozen=True)
class ImageSequence:
    """Image files of one camera in order of time.

    stamps_ns: (V,) strictly increasing time stamps, camera clock.
    paths: the V files.
    size_px: (width, height) that every image must have; None where any size will do.
    notes: what was taken otherwise than it was named, one sentence each, for the user to see.
    numbered: whether the stamps stand for the numbers in the files' names (``gtcal.recordings.numbering``).
    """

    stamps_ns: IntArray
    paths: tuple[Path, ...]
    size_px: tuple[int, int] | None = None
    notes: tuple[str, ...] = ()
    numbered: bool = False

    def __len__(self) -> int:
        return len(self.paths)

    def expecting(self, width_px: int, height_px: int) -> ImageSequence:
        """The same images, of which ``read`` takes only those of this size."""
        return replace(self, size_px=(width_px, height_px))

    def read(self, index: int) -> GreyImage:
        """One image as 8-bit grey, shape (height, width).

        Raises GtcalError where the file is missing, cut off, no image, or not of the size expected."""
        path = self.paths[index]
        return of_size(read_grey(path), self.size_px, str(path))

    @property
    def files(self) -> tuple[Path, ...]:
        return self.paths

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The folders."""
        return tuple(sorted({path.parent for path in self.paths}))

    @property
    def source(self) -> str:
        return ""

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """A folder of images named by their time stamps, or their numbers, needs no list.

        Raises GtcalError where the images are in several folders, or the list can't be written."""
        if len(self.inputs) != 1:
            raise GtcalError(f"camera {camera!r}: the images are in {len(self.inputs)} folders; put them in one")
        (image_dir,) = self.inputs
        where = relative(image_dir, folder)
        stamped = [path.stem == str(stamp) for stamp, path in zip(self.stamps_ns, self.paths, strict=True)]
        if self.numbered or (all(stamped) and len(image_folder(image_dir)) == len(self)):
            return {"images": where}
        listing = f"{camera}_images.csv"
        rows = (f"{stamp},{path.name}\n" for stamp, path in zip(self.stamps_ns, self.paths, strict=True))
        write_text(folder / listing, "".join(["#timestamp [ns],filename\n", *rows]))
        return {"images": where, "image_list": listing}


@dataclass(frozen=True)
class InOneFile:
    """What images have in common that one file, or one bag, holds. path: the file. stamps_ns: (V,) with ``offset_ns``,
    which the manifest gives. size_px, notes: as ``ImageSequence`` has them."""

    path: Path
    stamps_ns: IntArray
    offset_ns: int
    _: KW_ONLY
    size_px: tuple[int, int] | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def files(self) -> tuple[Path, ...]:
        return (self.path,)

    @property
    def inputs(self) -> tuple[Path, ...]:
        return (self.path,)

    def expecting(self, width_px: int, height_px: int) -> Self:
        """The same images, of which ``read`` takes only those of this size."""
        return replace(self, size_px=(width_px, height_px))

    def offset_entry(self) -> dict[str, int]:
        """The manifest's field of the offset, where there is one."""
        return {"stamp_offset_ns": self.offset_ns} if self.offset_ns else {}


class WrongSizeError(GtcalError):
    """An image of another size than its camera's, as all of them are where one is."""


MOST_UNREADABLE = 0.05
"""The share of a camera's images that may be unreadable, as recorders leave the last ones: those are left out."""


def read_if_whole(images: Images, index: int) -> GreyImage | GtcalError:
    """One image, or why it can't be read. Raises WrongSizeError where it is of another size."""
    try:
        return images.read(index)
    except WrongSizeError:
        raise
    except GtcalError as error:
        return error


def left_out(name: str, why: Sequence[GtcalError], n_images: int) -> str:
    """What to say of the images that can't be read, nothing where all can.

    Raises GtcalError where those are too many."""
    if not why:
        return ""
    said = f"{len(why)} of {n_images} images of {name} can't be read"
    if len(why) > MOST_UNREADABLE * n_images:
        raise GtcalError(f"{why[0]}; {said}, too many to leave out")
    return f"{said} and are left out; the first: {why[0]}"


def first_whole(images: Images) -> GreyImage:
    """The first image that can be read. Raises GtcalError where too many before it can't."""
    why: list[GtcalError] = []
    for index in range(len(images)):
        image = read_if_whole(images, index)
        if not isinstance(image, GtcalError):
            return image
        why.append(image)
        left_out("the camera", why, len(images))
    raise GtcalError("there are no images")


def of_size(image: GreyImage, size_px: tuple[int, int] | None, name: str) -> GreyImage:
    """The image. Raises GtcalError with its ``name`` where it is not of the size (width, height) expected."""
    height, width = image.shape
    if size_px is not None and (width, height) != size_px:
        raise WrongSizeError(
            f"{name}: the image is {width} x {height} pixels, but the camera's image size is "
            f"{size_px[0]} x {size_px[1]}; intrinsics hold for one image size only"
        )
    return image


def relative(path: Path, folder: Path) -> str:
    """The path as a manifest in ``folder`` names it."""
    return Path(os.path.relpath(path, folder)).as_posix()


def shifted(images: ImageSequence, offset_ns: int) -> ImageSequence:
    """The images with ``offset_ns`` added to their stamps."""
    stamps_ns = added(str(images.paths[0].parent), images.stamps_ns, offset_ns)
    return replace(images, stamps_ns=stamps_ns) if offset_ns else images


def image_folder(folder: Path) -> ImageSequence:
    """The images of a folder, each named by its time stamp in integer nanoseconds, as 1606153907495166540.jpg.
    Other files are left alone.

    Raises GtcalError where the folder is missing or has no images, a name is no time stamp, two images share one,
    or the names count frames."""
    if not folder.is_dir():
        raise GtcalError(f"{folder}: there is no such folder of images")
    stamped = sorted((_stamp_of(path), path) for path in _images_in(folder))
    if not stamped:
        raise GtcalError(f"{folder}: holds no images ({', '.join(IMAGE_SUFFIXES)})")
    for (stamp, path), (next_stamp, next_path) in pairwise(stamped):
        if stamp == next_stamp:
            raise GtcalError(f"{folder}: {path.name} and {next_path.name} have the same time stamp {stamp} ns")
    stamps_ns = np.array([stamp for stamp, _ in stamped], dtype=np.int64)
    _check_no_frame_counter(folder, stamps_ns)
    return ImageSequence(stamps_ns, tuple(path for _, path in stamped))


def numbered_folder(folder: Path) -> ImageSequence:
    """The images of a folder, each named by a number (its last digits), as frame_0012.png; in order of these.

    Raises GtcalError where the folder is missing or has no images, a name has no number, or two share one."""
    if not folder.is_dir():
        raise GtcalError(f"{folder}: there is no such folder of images")
    numbered = sorted((_number_of(path), path) for path in _images_in(folder))
    if not numbered:
        raise GtcalError(f"{folder}: holds no images ({', '.join(IMAGE_SUFFIXES)})")
    for (number, path), (next_number, next_path) in pairwise(numbered):
        if number == next_number:
            raise GtcalError(f"{folder}: {path.name} and {next_path.name} have the same number {number}")
    numbers = np.array([number for number, _ in numbered], dtype=np.int64)
    return ImageSequence(stamps_of(numbers), tuple(path for _, path in numbered), numbered=True)


def _number_of(path: Path) -> int:
    try:
        return number_of_name(path.name)
    except GtcalError as error:
        raise GtcalError(f"{path}: {error}") from None


def image_list(listing: Path, folder: Path | None = None) -> ImageSequence:
    """The images that a CSV 'timestamp [ns],filename' (EuRoC's data.csv) lists.

    folder: where the names are; by default EuRoC's ``data`` beside the list where there is one, else the list's
    own folder. Where a listed file isn't there but one with another image extension is, that one is taken, and
    ``notes`` says so.

    Raises GtcalError where the list is missing, damaged, empty or not in order of time, states another unit than
    nanoseconds, or lists a file that isn't there."""
    rows = _listed_rows(listing)
    where = folder if folder is not None else _default_folder(listing)
    if not where.is_dir():
        raise GtcalError(f"{where}: there is no such folder; {listing} lists {len(rows)} images in it")
    names = [name for _, name in rows]
    paths = tuple(_listed_file(listing, where, name) for name in names)
    stamps_ns = np.array([stamp for stamp, _ in rows], dtype=np.int64)
    return ImageSequence(stamps_ns, paths, notes=_substitutions(listing, names, paths))


def read_grey(path: Path) -> GreyImage:
    """An image file as 8-bit grey, shape (height, width); colour is turned to grey.

    Raises GtcalError where the file is missing, cut off or no image that OpenCV reads."""
    try:
        data = read_bytes(path, IMAGE_BYTES)
    except OSError as error:
        raise GtcalError(f"{path}: the image can't be read: {error.strerror}") from error
    return decode_grey(data, str(path))


def decode_grey(data: bytes, name: str) -> GreyImage:
    """The contents of an image file as 8-bit grey, shape (height, width).

    Raises GtcalError with its ``name`` where they are cut off or no image that OpenCV reads."""
    if _is_cut_off(data):
        raise GtcalError(f"{name}: the image file is cut off ({len(data)} bytes); copy it again or leave it out")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        raise GtcalError(f"{name}: not an image that can be read ({len(data)} bytes)")
    return np.asarray(image, dtype=np.uint8)


def _is_cut_off(data: bytes) -> bool:
    """Whether a PNG or JPEG lacks its end. OpenCV fills what is missing with grey and says nothing."""
    if data.startswith(b"\x89PNG"):
        return b"IEND" not in data[-64:]
    if data.startswith(b"\xff\xd8"):
        return b"\xff\xd9" not in data[-4096:]
    return False


def _images_in(folder: Path) -> list[Path]:
    return [
        path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
    ]


def _stamp_of(path: Path) -> int:
    if not re.fullmatch(r"\d{1,19}", path.stem) or int(path.stem) >= 2**63:
        raise GtcalError(
            f"{path}: the name {path.stem!r} is no time stamp; expected integer nanoseconds, as "
            "1606153907495166540.png. List other names in a CSV 'timestamp [ns],filename'"
        )
    return int(path.stem)


def _check_no_frame_counter(where: Path, stamps_ns: IntArray) -> None:
    if len(stamps_ns) > 1 and np.median(np.diff(stamps_ns)) < _SHORTEST_INTERVAL_NS:
        raise GtcalError(
            f"{where}: the images' time stamps are {int(np.median(np.diff(stamps_ns)))} ns apart, so these are "
            "frame numbers or another unit; expected ns. Of frame numbers, list the images in a CSV 'timestamp "
            "[ns],filename', or set numbered: true where there is one pose for each image"
        )


def _listed_rows(listing: Path) -> list[tuple[int, str]]:
    """The (time stamp, name) rows of a list, in strict order of time."""
    try:
        lines = read_text(listing).splitlines()
    except GtcalError as error:
        raise GtcalError(f"{listing}: the list of images can't be read: {error}") from error
    rows: list[tuple[int, str]] = []
    for number, line in enumerate(lines, start=1):
        if _is_header(listing, number, line) or not line.strip():
            continue
        stamp, name = _listed_row(listing, number, line)
        if rows and stamp <= rows[-1][0]:
            raise GtcalError(f"{listing}:{number}: time stamp {stamp} ns is not after the one before, {rows[-1][0]}")
        rows.append((stamp, name))
    if not rows:
        raise GtcalError(f"{listing}: lists no images; expected rows 'timestamp [ns],filename'")
    _check_no_frame_counter(listing, np.array([stamp for stamp, _ in rows]))
    return rows


def _is_header(listing: Path, number: int, line: str) -> bool:
    """Whether the line names the columns. A unit that it states must be nanoseconds."""
    if not line.startswith("#") and not (number == 1 and line[:1].isalpha()):
        return False
    unit = re.search(r"[\[(]\s*(\w+)\s*[\])]|_(s|ms|us)\b", line.split(",")[0])
    if unit and (unit[1] or unit[2]) != "ns":
        raise GtcalError(f"{listing}:{number}: the time stamps are in {unit[1] or unit[2]!r}; expected ns")
    return True


def _listed_row(listing: Path, number: int, line: str) -> tuple[int, str]:
    stamp, comma, name = (part.strip() for part in line.partition(","))
    if not comma or not name or not re.fullmatch(r"\d{1,19}", stamp) or int(stamp) >= 2**63:
        raise GtcalError(
            f"{listing}:{number}: {line.strip()!r}; expected 'timestamp,filename' with the time stamp in whole ns"
        )
    return int(stamp), name


def _default_folder(listing: Path) -> Path:
    data = listing.parent / "data"
    return data if data.is_dir() else listing.parent


def _listed_file(listing: Path, folder: Path, name: str) -> Path:
    path = folder / name
    if is_there(path) and path.is_file():
        return path
    others = [path.with_suffix(suffix) for suffix in IMAGE_SUFFIXES if is_there(path.with_suffix(suffix))]
    if len(others) != 1:
        found = ", ".join(other.name for other in others)
        raise GtcalError(
            f"{listing}: lists {name!r}, which is not in {folder}"
            + (f"; of the others there ({found}) any could be meant" if others else "")
        )
    return others[0]


def _substitutions(listing: Path, names: list[str], paths: tuple[Path, ...]) -> tuple[str, ...]:
    taken = [(name, path) for name, path in zip(names, paths, strict=True) if Path(name).name != path.name]
    if not taken:
        return ()
    name, path = taken[0]
    return (
        f"{listing}: {len(taken)} of {len(names)} listed images are not there under the listed name and were "
        f"taken with another extension, as {path.name} for {name}",
    )
