"""The images of one stream of a VRS file, as headsets and glasses record. Needs VRS's own reader:
``pip install 'gtcal[vrs]'``."""

from __future__ import annotations

import glob
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gtcal.bounds import added
from gtcal.errors import GtcalError
from gtcal.files import check_regular
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, InOneFile, of_size, relative

VRS_SUFFIXES = (".vrs",)
CAPTURE_FIELD = "capture_timestamp_ns"
"""The metadata of an image, as Project Aria writes it, with the time of its exposure in whole nanoseconds."""


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
        return of_size(self.readers.image(int(self.records[index]), name), self.size_px, name)

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """The fields of a manifest in ``folder``."""
        return {"vrs": relative(self.path, folder), "stream": self.stream, **self.offset_entry()}


def vrs_images(path: Path, stream: str | None, offset_ns: int = 0) -> VrsImages:
    """The images of a stream, at their capture time stamps: the metadata's where each image has them, else those of the
    records. ``offset_ns`` is added.

    Raises GtcalError where the library is missing, the file can't be read, it has no such stream with images, or its
    time stamps repeat."""
    reader = _reader(path)
    _check_whole(path)
    streams = _image_streams(reader)
    listed = ", ".join(f"{name} ({count})" for name, count in streams.items()) or "none"
    if stream is None:
        raise GtcalError(f"{path}: name the 'stream' to take from this file; streams with images: {listed}")
    if stream not in streams:
        raise GtcalError(f"{path}: has no stream {stream!r} with images; streams with images: {listed}")
    stamps_ns, notes = _capture_stamps(path, reader, stream)
    order = np.argsort(stamps_ns, kind="stable")
    same = np.flatnonzero(np.diff(stamps_ns[order]) == 0)
    if len(same):
        raise GtcalError(f"{path}: two images of stream {stream} have the time stamp {stamps_ns[order][same[0]]} ns")
    stamps_ns = added(str(path), stamps_ns[order], offset_ns)
    return VrsImages(path, stamps_ns, offset_ns, stream, order, _Readers(path, stream), notes=notes)


def image_streams(path: Path) -> dict[str, int]:
    """The streams with images, by id, and how many records each has. Raises GtcalError where it can't be read."""
    return _image_streams(_reader(path))


def _reader(path: Path) -> Any:
    check_regular(path)
    try:
        from pyvrs import SyncVRSReader
    except ImportError:
        raise GtcalError("reading a VRS file needs VRS's reader; install it with: pip install 'gtcal[vrs]'") from None
    _check_opens(path)
    try:
        with _quiet():
            return SyncVRSReader(str(path), auto_read_configuration_records=True)
    except Exception as error:  # whatever a damaged file makes the library raise
        raise GtcalError(f"{path}: is not a VRS file that can be read, or is cut off: {_words(error)}") from None


_OPEN = "import sys, pyvrs; pyvrs.SyncVRSReader(sys.argv[1], auto_read_configuration_records=True)"
_LONGEST_S = 60


def _check_opens(path: Path) -> None:
    """The library ends the whole program where an index speaks of streams that aren't there. So a file is opened once
    in a process of its own, and again only where it has changed."""
    try:
        status = path.stat()
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from None
    if not _survives(path, (status.st_size, status.st_mtime_ns, status.st_ctime_ns)):
        raise GtcalError(f"{path}: is damaged: VRS's reader does not survive opening it; copy it again")


@lru_cache(maxsize=64)
def _survives(path: Path, _state: tuple[int, ...]) -> bool:
    try:
        ended = subprocess.run([sys.executable, "-c", _OPEN, str(path)], capture_output=True, timeout=_LONGEST_S)
    except subprocess.TimeoutExpired:
        return False
    return ended.returncode >= 0  # else by a signal; what it raises there it raises here too


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


def _words(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


_muted = threading.Lock()


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what the library logs straight to stderr on opening a file; it has no switch for that."""
    with _muted:
        kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            os.close(nowhere)


def _image_streams(reader: Any) -> dict[str, int]:
    from pyvrs import RecordType

    found = {name: int(reader.get_records_count(name, RecordType.DATA)) for name in sorted(reader.stream_ids)}
    return {name: count for name, count in found.items() if count and reader.might_contain_images(name)}


def _data_records(reader: Any, stream: str) -> Any:
    return reader.filtered_by_fields(stream_ids={stream}, record_types={"data"})


def _capture_stamps(path: Path, reader: Any, stream: str) -> tuple[IntArray, tuple[str, ...]]:
    """(V,) of the data records in their order, and what is to be said about them."""
    from pyvrs import RecordType

    records = _data_records(reader, stream)
    reader.skip_trailing_blocks(int(stream.split("-")[0]), RecordType.DATA, 1)  # reads no pixels
    try:
        captured = [_captured_ns(records[i]) for i in range(len(records))]
    except Exception as error:  # as above
        raise GtcalError(f"{path}: is damaged or cut off: {_words(error)}") from None
    if all(stamp is not None for stamp in captured):
        return np.array(captured, dtype=np.int64), ()
    stamps_ns = np.rint(np.array(records.get_timestamp_list()) * 1e9).astype(np.int64)
    note = f"{path}: the images of stream {stream} have no {CAPTURE_FIELD}; the time stamps of their records are taken"
    return stamps_ns, (note,)


def _captured_ns(record: Any) -> int | None:
    fields = record.metadata_blocks[0] if record.n_metadata_blocks else {}
    return int(fields[CAPTURE_FIELD]) if CAPTURE_FIELD in fields else None


class _Readers:
    """One reader per thread, so that images are decoded side by side."""

    def __init__(self, path: Path, stream: str) -> None:
        self.path, self.stream = path, stream
        self._own = threading.local()

    def image(self, record: int, name: str) -> GreyImage:
        try:
            found = self._records()[record]
            pixels = np.array(found.image_blocks[0]) if found.n_image_blocks else None
            pixel_format = found.image_specs[0].pixel_format if found.n_image_blocks else "no image"
        except GtcalError:
            raise
        except Exception as error:  # whatever damaged data make the library raise
            raise GtcalError(f"{name}: can't be read: {_words(error)}") from None
        if pixels is not None and pixel_format in _TO_GREY and pixels.ndim == 3:
            pixels = np.asarray(cv2.cvtColor(pixels, _TO_GREY[pixel_format]))
        if pixels is None or pixels.dtype != np.uint8 or pixels.ndim != 2:
            raise GtcalError(f"{name}: can't be turned into 8-bit grey ({pixel_format})")
        return np.ascontiguousarray(pixels)

    def _records(self) -> Any:
        if not hasattr(self._own, "records"):
            from pyvrs import ImageConversion

            reader = _reader(self.path)
            reader.set_image_conversion(ImageConversion.NORMALIZE_GREY8)
            self._own.reader, self._own.records = reader, _data_records(reader, self.stream)
        return self._own.records
