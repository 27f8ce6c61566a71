"""The images of one topic of a ROS 1 or ROS 2 bag, at the stamps of their headers. Needs no ROS, but the library
rosbags: ``pip install 'gtcal[bags]'``."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from gtcal.bags import open_bag, opened_bag, words_of
from gtcal.bounds import added
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, InOneFile, decode_grey, of_size, relative

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# Drivers stamp within milliseconds; header stamps further from the time of recording are those of another clock.
_OTHER_CLOCK_S = 1.0

# Encodings of sensor_msgs/Image with 8 bits: bytes per pixel, and OpenCV's way to grey (None: it is grey).
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, None),
    "8UC1": (1, None),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2GRAY),
    "yuv422": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2GRAY_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2GRAY_YUY2),
}


@dataclass(frozen=True)
class BagImages(InOneFile):
    """The V images of a topic in order of time, at the stamps of their headers.

    topic: of sensor_msgs/Image or CompressedImage. received_ns: (V,) when each was recorded, by which it is found."""

    topic: str
    received_ns: IntArray
    readers: _Readers

    @property
    def files(self) -> tuple[Path, ...]:
        return tuple(sorted(f for f in self.path.iterdir() if f.is_file())) if self.path.is_dir() else (self.path,)

    @property
    def source(self) -> str:
        return f"topic {self.topic}"

    def read(self, index: int) -> GreyImage:
        """One image as 8-bit grey, shape (height, width).

        Raises GtcalError where its encoding can't be read, its data are cut off, or it is not of the size expected."""
        header_ns = int(self.stamps_ns[index]) - self.offset_ns
        name = f"{self.path}, {self.topic} at {header_ns} ns"
        message = self.readers.message(int(self.received_ns[index]), header_ns)
        return of_size(grey_of_message(message, name), self.size_px, name)

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """The fields of a manifest in ``folder``."""
        return {"bag": relative(self.path, folder), "topic": self.topic, **self.offset_entry()}


def bag_images(path: Path, topic: str | None, offset_ns: int = 0) -> BagImages:
    """The images of a topic. ``offset_ns`` is added to the stamps of their headers.

    Raises GtcalError where rosbags is missing, the bag can't be read, it has no such topic with images, or the stamps
    of the headers aren't set or repeat."""
    with opened_bag(path) as reader:
        connections = _connections(path, reader, topic)
        assert topic is not None  # else the error above
        stamps = [
            (_header_ns(message), received_ns, message.header.frame_id)
            for message, received_ns in _messages(path, reader, connections)
        ]
    stamps.sort(key=lambda entry: entry[:2])
    header_ns, received_ns = (np.array([entry[i] for entry in stamps], dtype=np.int64) for i in (0, 1))
    _check_stamps(path, topic, header_ns)
    notes = tuple(_clock_notes(path, topic, header_ns, received_ns))
    return BagImages(
        path, added(str(path), header_ns, offset_ns), offset_ns, topic, received_ns, _Readers(path, topic), notes=notes
    )


def image_topics(path: Path) -> dict[str, int]:
    """The topics with images, and how many each has. Raises GtcalError where the bag can't be read."""
    with opened_bag(path) as reader:
        return {name: info.msgcount for name, info in reader.topics.items() if info.msgtype in IMAGE_TYPES}


def _connections(path: Path, reader: AnyReader, topic: str | None) -> list[Connection]:
    found = [connection for connection in reader.connections if connection.topic == topic]
    if found and all(connection.msgtype in IMAGE_TYPES for connection in found):
        return found
    topics = {name: info for name, info in reader.topics.items() if info.msgtype in IMAGE_TYPES}
    listed = ", ".join(f"{name} ({info.msgcount})" for name, info in topics.items()) or "none"
    if topic is None:
        raise GtcalError(f"{path}: name the 'topic' to take from this bag; topics with images: {listed}")
    if found:
        raise GtcalError(
            f"{path}: the topic {topic!r} holds {found[0].msgtype}, no images; topics with images: {listed}"
        )
    raise GtcalError(f"{path}: has no topic {topic!r}; topics with images: {listed}")


def _messages(path: Path, reader: AnyReader, connections: list[Connection], **span: int) -> Iterator[tuple[Any, int]]:
    """Messages and the times of their recording, in ns."""
    try:
        for connection, received_ns, data in reader.messages(connections, **span):
            yield reader.deserialize(data, connection.msgtype), received_ns
    except Exception as error:  # as above
        raise GtcalError(f"{path}: is damaged or cut off: {words_of(error)}") from None


def _header_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _check_stamps(path: Path, topic: str, header_ns: IntArray) -> None:
    if not len(header_ns):
        raise GtcalError(f"{path}: the topic {topic!r} holds no messages")
    if not header_ns.any():
        raise GtcalError(f"{path}: the headers of {topic!r} have no stamps (all are 0); the driver must set them")
    same = np.flatnonzero(np.diff(header_ns) == 0)
    if len(same):
        raise GtcalError(f"{path}: two images of {topic!r} have the same header stamp {header_ns[same[0]]} ns")


def _clock_notes(path: Path, topic: str, header_ns: IntArray, received_ns: IntArray) -> Iterator[str]:
    late_s = float(np.median(received_ns - header_ns)) * 1e-9
    if abs(late_s) > _OTHER_CLOCK_S:
        yield (
            f"{path}: the header stamps of {topic} are {abs(late_s):.1f} s {'before' if late_s > 0 else 'after'} the "
            "times of recording, so of another clock; they are taken as they are"
        )


class _Readers:
    """One reader per thread: SQLite's may not be shared."""

    def __init__(self, path: Path, topic: str) -> None:
        self.path, self.topic = path, topic
        self._own = threading.local()

    def message(self, received_ns: int, header_ns: int) -> Any:
        reader = self._reader()
        connections = _connections(self.path, reader, self.topic)
        for message, _ in _messages(self.path, reader, connections, start=received_ns, stop=received_ns + 1):
            if _header_ns(message) == header_ns:
                return message
        raise GtcalError(f"{self.path}: the image of {self.topic} at {header_ns} ns is gone; has the bag changed?")

    def _reader(self) -> AnyReader:
        if not hasattr(self._own, "reader"):
            self._own.reader = open_bag(self.path)
        reader: AnyReader = self._own.reader
        return reader


def grey_of_message(message: Any, name: str) -> GreyImage:
    """A sensor_msgs/Image or CompressedImage as 8-bit grey, shape (height, width).

    Raises GtcalError with its ``name`` where its encoding isn't one of 8 bits that can be read, or data are missing."""
    if hasattr(message, "format"):
        if "compressedDepth" in message.format:
            raise GtcalError(f"{name}: is a depth image ({message.format}); name a topic with images")
        return decode_grey(message.data.tobytes(), name)
    if message.encoding not in _ENCODINGS:
        scaled = "; scale it to 8 bits, as mono8" if re.search("16|32|64", message.encoding) else ""
        raise GtcalError(
            f"{name}: the encoding {message.encoding!r} can't be read{scaled}; encodings: {', '.join(_ENCODINGS)}"
        )
    bytes_per_pixel, to_grey = _ENCODINGS[message.encoding]
    pixels = _rows(message, bytes_per_pixel, name)
    return pixels[..., 0] if to_grey is None else np.asarray(_convert(to_grey)(pixels), dtype=np.uint8)


def _convert(code: int) -> Callable[[npt.NDArray[np.uint8]], Any]:
    return lambda pixels: cv2.cvtColor(pixels, code)


def _rows(message: Any, bytes_per_pixel: int, name: str) -> npt.NDArray[np.uint8]:
    """(H, W, bytes per pixel), without the padding at the ends of rows."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data).view(np.uint8)
    if not height or not width or step < width * bytes_per_pixel or len(data) < step * height:
        raise GtcalError(
            f"{name}: {len(data)} bytes in rows of {step} are no {width} x {height} image of {message.encoding}"
        )
    rows = data[: step * height].reshape(height, step)[:, : width * bytes_per_pixel]
    return np.ascontiguousarray(rows).reshape(height, width, bytes_per_pixel)
