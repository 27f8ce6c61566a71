"""The images of one camera: files in order of time, read one at a time."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

GreyImage = npt.NDArray[np.uint8]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp")
# No camera takes images a microsecond apart: such stems count frames.
_SHORTEST_INTERVAL_NS = 1_000


@dataclass(frozen=True)
class ImageSequence:
    """Image files of one camera in order of time.

    stamps_ns: (V,) strictly increasing time stamps, camera clock.
    paths: the V files.
    size_px: (width, height) that every image must have; None where any size will do.
    notes: what was taken otherwise than it was named, one sentence each, for the user to see.
    """

    stamps_ns: IntArray
    paths: tuple[Path, ...]
    size_px: tuple[int, int] | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.paths)

    def expecting(self, width_px: int, height_px: int) -> ImageSequence:
        """The same images, of which ``read`` takes only those of this size."""
        return replace(self, size_px=(width_px, height_px))

    def read(self, index: int) -> GreyImage:
        """One image as 8-bit grey, shape (height, width).

        Raises GtcalError where the file is missing, cut off, no image, or not of the size expected."""
        path = self.paths[index]
        image = read_grey(path)
        height, width = image.shape
        if self.size_px is not None and (width, height) != self.size_px:
            raise GtcalError(
                f"{path}: the image is {width} x {height} pixels, but the camera's image size is "
                f"{self.size_px[0]} x {self.size_px[1]}; intrinsics hold for one image size only"
            )
        return image


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
        data = path.read_bytes()
    except OSError as error:
        raise GtcalError(f"{path}: the image can't be read: {error.strerror}") from error
    if _is_cut_off(data):
        raise GtcalError(f"{path}: the image file is cut off ({len(data)} bytes); copy it again or leave it out")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        raise GtcalError(f"{path}: not an image that can be read ({len(data)} bytes)")
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
            "frame numbers or another unit; expected ns. List the images in a CSV 'timestamp [ns],filename'"
        )


def _listed_rows(listing: Path) -> list[tuple[int, str]]:
    """The (time stamp, name) rows of a list, in strict order of time."""
    try:
        lines = listing.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
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
    if path.is_file():
        return path
    others = [path.with_suffix(suffix) for suffix in IMAGE_SUFFIXES if path.with_suffix(suffix).is_file()]
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
