"""The images of one stream of a VRS file, as headsets and glasses record. Needs VRS's own reader:
``pip install 'gtcal[vrs]'``."""

from __future__ import annotations

import glob
import struct
import threading
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gtcal.bounds import added
from gtcal.errors import GtcalError
from gtcal.files import check_regular
from gtcal.own_process import EndedError, OwnProcess, RefusedError
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, InOneFile, of_size, relative

VRS_SUFFIXES = (".vrs",)
CAPTURE_FIELD = "capture_timestamp_ns"
"""The metadata of an image, as Project Aria writes it, with the time of its exposure in whole nanoseconds."""


_READER = Path(__file__).with_name("vrs_reader.py")
_TO_GREY = {"rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY}


@dataclass(frozen=True)
class VrsImages(InOneFile):
    """The V images of a stream in order of time.

    stream: its id, as 1201-1. records: (V,) the numbers of the images among the stream's data records."""

    stream: str
    records: IntArray
    readers: _Readers

    @property
    def source(self) -> str:
        return f"stream {self.stream}"

    def read(self, index: int) -> GreyImage:
        """One image as 8-bit grey, shape (height, width).

        Raises GtcalError where it can't be decoded, or is not of the size expected."""
        name = f"{self.path}, image {index} of stream {self.stream}"
        return of_size(self.readers.image(self.stream, int(self.records[index]), name), self.size_px, name)

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """The fields of a manifest in ``folder``."""
        return {"vrs": relative(self.path, folder), "stream": self.stream, **self.offset_entry()}


def vrs_images(path: Path, stream: str | None, offset_ns: int = 0) -> VrsImages:
    """The images of a stream, at their capture time stamps: the metadata's where each image has them, else those of the
    records. ``offset_ns`` is added.

    Raises GtcalError where the library is missing, the file can't be read, it has no such stream with images, or its
    time stamps repeat."""
    readers = _Readers(path)
    streams = _streams(path, readers)
    _check_whole(path)
    listed = ", ".join(f"{name} ({count})" for name, count in streams.items()) or "none"
    if stream is None:
        raise GtcalError(f"{path}: name the 'stream' to take from this file; streams with images: {listed}")
    if stream not in streams:
        raise GtcalError(f"{path}: has no stream {stream!r} with images; streams with images: {listed}")
    stamps_ns, notes = _capture_stamps(path, readers, stream)
    order = np.argsort(stamps_ns, kind="stable")
    same = np.flatnonzero(np.diff(stamps_ns[order]) == 0)
    if len(same):
        raise GtcalError(f"{path}: two images of stream {stream} have the time stamp {stamps_ns[order][same[0]]} ns")
    stamps_ns = added(str(path), stamps_ns[order], offset_ns)
    return VrsImages(path, stamps_ns, offset_ns, stream, order, readers, notes=notes)


def image_streams(path: Path) -> dict[str, int]:
    """The streams with images, by id, and how many records each has. Raises GtcalError where it can't be read."""
    return _streams(path, _Readers(path))


def _streams(path: Path, readers: _Readers) -> dict[str, int]:
    try:
        found: dict[str, int] = readers.own().ask("image_streams")
        return found
    except RefusedError as error:
        raise GtcalError(f"{path}: is not a VRS file that can be read, or is cut off: {error}") from None
    except EndedError:
        raise _unsurvived(path) from None


def _unsurvived(path: Path) -> GtcalError:
    return GtcalError(f"{path}: is damaged: VRS's reader does not survive reading it; copy it again")


def _check_whole(path: Path) -> None:
    """The library makes do with what is left of a file. Its header says where the index is: at the end, once the
    recording is closed."""
    check_regular(path)
    with path.open("rb") as file:
        (index_offset,) = struct.unpack_from("<q", file.read(32), 24)
    chunks = (path, *path.parent.glob(f"{glob.escape(path.name)}_*"))
    size = sum(chunk.stat().st_size for chunk in chunks)
    if not 0 < index_offset < size:
        raise GtcalError(
            f"{path}: is cut off or was never closed: its index, at the end, is missing; copy it again, or repair it "
            "with VRS's command line ('vrs copy')"
        )


def _capture_stamps(path: Path, readers: _Readers, stream: str) -> tuple[IntArray, tuple[str, ...]]:
    """(V,) of the data records in their order, and what is to be said about them."""
    try:
        captured, times_s = readers.own().ask("stamps", stream, CAPTURE_FIELD)
    except RefusedError as error:
        raise GtcalError(f"{path}: is damaged or cut off: {error}") from None
    except EndedError:
        raise _unsurvived(path) from None
    if all(stamp is not None for stamp in captured):
        return np.array(captured, dtype=np.int64), ()
    stamps_ns = np.rint(np.array(times_s) * 1e9).astype(np.int64)
    note = f"{path}: the images of stream {stream} have no {CAPTURE_FIELD}; the time stamps of their records are taken"
    return stamps_ns, (note,)


class _Readers:
    """A process with VRS's reader for each thread, so that images are decoded side by side."""

    def __init__(self, path: Path) -> None:
        check_regular(path)
        if find_spec("pyvrs") is None:
            raise GtcalError("reading a VRS file needs VRS's reader; install it with: pip install 'gtcal[vrs]'")
        self.path = path
        self._of_thread = threading.local()

    def own(self) -> OwnProcess:
        """This thread's."""
        if not hasattr(self._of_thread, "process"):
            self._of_thread.process = OwnProcess(_READER, str(self.path))
        process: OwnProcess = self._of_thread.process
        return process

    def image(self, stream: str, record: int, name: str) -> GreyImage:
        try:
            pixels, pixel_format = self.own().ask("image", stream, record)
        except RefusedError as error:
            raise GtcalError(f"{name}: can't be read: {error}") from None
        except EndedError:
            del self._of_thread.process  # others may be whole
            raise GtcalError(f"{name}: is damaged: VRS's reader does not survive reading it") from None
        if pixels is not None and pixel_format in _TO_GREY and pixels.ndim == 3:
            pixels = np.asarray(cv2.cvtColor(pixels, _TO_GREY[pixel_format]))
        if pixels is None or pixels.dtype != np.uint8 or pixels.ndim != 2:
            raise GtcalError(f"{name}: can't be turned into 8-bit grey ({pixel_format})")
        return np.ascontiguousarray(pixels)
