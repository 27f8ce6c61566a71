"""The frames of a video as images, each at its own presentation time stamp. Needs PyAV: ``pip install 'gtcal[video]'``.

Stamps come from the packets, without decoding, and count from the first frame: where a container starts counting is
its own business. A frame is found by its time stamp, never by counting. Frames are taken as the camera stored them: a
flag that players turn them by is noted, not followed.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtcal.bounds import added
from gtcal.cores import n_cores
from gtcal.errors import GtcalError
from gtcal.files import check_regular
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, InOneFile, of_size, relative

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg", ".ts")
# Forward over so many frames is faster than seeking back to a key frame and decoding from there.
_SEEK_BEYOND = 16
# A video ends with its last frame; one that lasts this many of its frames longer has lost some.
_MISSING_FRAMES = 3
_UNEVEN = 0.1
# Decoders fill what is damaged with what they guess, unless told not to; most say so only in their log.
_REFUSE_DAMAGE = "crccheck+bitstream+buffer+explode"
# What they call an error and is none: cameras write APP fields of their own in JPEG.
_HARMLESS = ("APP fields",)


@dataclass(frozen=True)
class VideoImages(InOneFile):
    """The V frames of a video in order of time; stamps count from the first frame, whose time is ``offset_ns``.

    stream: the number of the file's video stream."""

    stream: int
    decoder: _Decoder

    @property
    def source(self) -> str:
        return f"stream {self.stream}"

    def read(self, index: int) -> GreyImage:
        """One frame as 8-bit grey, shape (height, width).

        Raises GtcalError where it can't be decoded, or is not of the size expected."""
        return of_size(self.decoder.frame(index), self.size_px, f"{self.path}, frame {index}")

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """The fields of a manifest in ``folder``."""
        return {"video": relative(self.path, folder), "stream": str(self.stream), "stamp_offset_ns": self.offset_ns}


def video_images(path: Path, offset_ns: int, stream: str | None = None) -> VideoImages:
    """The frames of a video at their presentation time stamps. ``offset_ns``: the first frame's time; ``stream``: the
    number of the video stream, where there are several.

    Raises GtcalError where PyAV is missing, or the file is no video, cut off, or without time stamps that increase."""
    with _opened(path) as container:
        video = _chosen_stream(path, container, stream)
        pts = _packet_stamps(path, container, video)
        _check_whole(path, container, video, pts)
        time_base = _time_base(path, video)
        index = video.index
    stamps_ns = _nanoseconds(pts - pts[0], time_base)
    decoder = _Decoder(path, index, pts)
    first = decoder.look(0)
    notes = (*_notes(path, stamps_ns, first), *_depth_notes(path, first))
    return VideoImages(path, added(str(path), stamps_ns, offset_ns), offset_ns, index, decoder, notes=notes)


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise GtcalError("reading a video needs PyAV; install it with: pip install 'gtcal[video]'") from None
    return av


def _opened(path: Path) -> InputContainer:
    check_regular(path)
    library = _av()
    try:
        container: InputContainer = library.open(str(path), metadata_errors="replace")
    except (library.FFmpegError, OSError) as error:
        raise GtcalError(f"{path}: is not a video that can be read, or is cut off: {_reason(error)}") from None
    return container


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or " ".join(str(error).split())


def _chosen_stream(path: Path, container: InputContainer, given: str | None) -> VideoStream:
    # one of a codec that is not known has no width
    known = (stream for stream in container.streams.video if stream.codec_context is not None)
    streams = {str(stream.index): stream for stream in known if stream.average_rate or stream.frames}
    listed = ", ".join(f"{index} ({stream.width} x {stream.height})" for index, stream in streams.items())
    if not streams:
        raise GtcalError(f"{path}: holds no video stream")
    if given is None and len(streams) > 1:
        raise GtcalError(f"{path}: holds {len(streams)} video streams; name one with 'stream': {listed}")
    if given is not None and given not in streams:
        raise GtcalError(f"{path}: has no video stream {given!r}; video streams: {listed}")
    return streams[given] if given is not None else next(iter(streams.values()))


def _packet_stamps(path: Path, container: InputContainer, video: VideoStream) -> IntArray:
    """(V,) the frames' stamps, in order of time."""
    library = _av()
    stamps: list[int] = []
    try:
        for packet in container.demux(video):
            if packet.size == 0 or packet.is_discard:
                continue
            if packet.is_corrupt:
                raise GtcalError(f"{path}: is damaged or cut off at frame {len(stamps)}; copy it again")
            if packet.pts is None:
                raise GtcalError(
                    f"{path}: frame {len(stamps)} has no time stamp; remux it, or list its frames as image files"
                )
            stamps.append(packet.pts)
    except library.FFmpegError as error:
        raise GtcalError(f"{path}: is damaged or cut off at frame {len(stamps)}: {_reason(error)}") from None
    if not stamps:
        raise GtcalError(f"{path}: holds no frames; is it cut off?")
    pts = np.sort(np.array(stamps, dtype=np.int64))
    same = np.flatnonzero(np.diff(pts) == 0)
    if len(same):
        raise GtcalError(f"{path}: frames {same[0]} and {same[0] + 1} have the same time stamp")
    return pts


def _time_base(path: Path, video: VideoStream) -> Fraction:
    if not video.time_base:
        raise GtcalError(f"{path}: doesn't say what its time stamps count")
    return video.time_base


def _nanoseconds(pts: IntArray, time_base: Fraction) -> IntArray:
    """(V,) pts in ns, rounded to the nearest: by whole numbers, as a float64 ends at 2^53."""
    up, down = time_base.numerator * 1_000_000_000, time_base.denominator
    return np.array([(2 * int(stamp) * up + down) // (2 * down) for stamp in pts], dtype=np.int64)


def _check_whole(path: Path, container: InputContainer, video: VideoStream, pts: IntArray) -> None:
    """Against what the header promises; a file without promises passes."""
    duration_s = _stated_duration_s(container, video)
    if duration_s is None or len(pts) < 2:
        return
    interval = float(np.median(np.diff(pts)))
    lasts_s = float((pts[-1] - pts[0] + interval) * _time_base(path, video))
    if duration_s - lasts_s > _MISSING_FRAMES * interval * float(_time_base(path, video)):
        raise GtcalError(
            f"{path}: is cut off: its header says {duration_s:.2f} s, its frames end after {lasts_s:.2f} s; "
            "copy it again"
        )


def _stated_duration_s(container: InputContainer, video: VideoStream) -> float | None:
    """Of the stream, where its header says; of the file, where that has nothing but the stream."""
    if video.duration and video.time_base:
        return float(video.duration * video.time_base)
    if container.duration and len(container.streams) == 1:
        return max(container.duration - max(container.start_time or 0, 0), 0) * 1e-6
    return None


def _notes(path: Path, stamps_ns: IntArray, first: VideoFrame) -> Iterator[str]:
    if first.interlaced_frame:
        raise GtcalError(
            f"{path}: is interlaced: each frame is two half images of different times; record progressive video"
        )
    if first.rotation:
        yield (
            f"{path}: is marked to be shown turned by {first.rotation} deg; the frames are taken as they are stored, "
            f"{first.width} x {first.height}, not turned"
        )
    intervals_ms = np.diff(stamps_ns) * 1e-6
    if len(intervals_ms) and np.ptp(intervals_ms) > _UNEVEN * np.median(intervals_ms):
        yield (
            f"{path}: its frame rate varies (intervals of {intervals_ms.min():.1f} to {intervals_ms.max():.1f} ms); "
            "each frame has its own time stamp"
        )


def _depth_notes(path: Path, first: VideoFrame) -> Iterator[str]:
    deepest = max((component.bits for component in first.format.components), default=8)
    if deepest > 8:
        yield f"{path}: its pixels of {deepest} bits are scaled to 8"


_logging = threading.Lock()


@contextmanager
def _logged() -> Iterator[list[str]]:
    """Collects the errors that decoders log meanwhile; they share one log."""
    logging, said = _av().logging, list[str]()
    with _logging, logging.Capture(local=False) as messages:
        logging.set_level(logging.ERROR)
        try:
            yield said
        finally:
            logging.set_level(None)
            words = (f"{name}: {' '.join(text.split())}" for level, name, text in messages if level <= logging.ERROR)
            said += [error for error in words if not any(harmless in error for harmless in _HARMLESS)]


class _Decoder:
    """Decodes one frame at a time, forward as long as frames are asked for nearly in order, else from a key frame.
    The last frames are kept: threads that share the video ask a little out of order."""

    def __init__(self, path: Path, stream: int, pts: IntArray) -> None:
        self.path, self.stream, self.pts = path, stream, pts
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, GreyImage] = OrderedDict()
        self._most = max(2 * n_cores(), _SEEK_BEYOND)
        self._container: InputContainer | None = None
        self._frames: Iterator[VideoFrame] = iter(())
        self._next = 0
        self._from_start = False

    def frame(self, index: int) -> GreyImage:
        """(H, W) as 8-bit grey. Raises GtcalError where the frame can't be decoded."""
        with self._lock:
            if index not in self._kept:
                self._keep(index, self._found(index))
            return self._kept[index]

    def look(self, index: int) -> VideoFrame:
        """The frame with all that is said of it."""
        with self._lock:
            found = self._found(index)
            self._keep(index, found)
            return found

    def _keep(self, index: int, frame: VideoFrame) -> None:
        self._kept[index] = np.ascontiguousarray(frame.to_ndarray(format="gray"), dtype=np.uint8)
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)

    def _found(self, index: int) -> VideoFrame:
        if not self._next <= index <= self._next + _SEEK_BEYOND:
            self._seek(int(self.pts[index]))
        found = self._forward(index)
        if found is None:  # some containers seek to behind the frame
            self._seek(None)
            found = self._forward(index)
        if found is None:
            raise GtcalError(f"{self.path}: frame {index} of {len(self.pts)} can't be decoded; is the file damaged?")
        return found

    def _forward(self, index: int) -> VideoFrame | None:
        """Decode until this frame; None where the decoder is past it or at the end."""
        library = _av()
        if self._container is None:
            self._seek(None)
        wanted = int(self.pts[index])
        found: VideoFrame | None = None
        with _logged() as said:
            try:
                for frame in self._frames:
                    if frame.is_corrupt and (self._from_start or frame.pts == wanted):
                        raise GtcalError(f"{self.path}: the frame before frame {index} or itself is damaged")
                    if frame.pts is None or frame.pts < wanted:
                        self._keep_passed(frame)
                        continue
                    self._next = index + 1
                    found = frame if frame.pts == wanted else None
                    break
            except library.FFmpegError as error:
                raise GtcalError(f"{self.path}: frame {index} can't be decoded: {_reason(error)}") from None
        if said and self._from_start:
            raise GtcalError(
                f"{self.path}: is damaged at or near frame {index}; the decoder says: {said[0]}. Copy it again, or cut "
                "that part out"
            )
        return found

    def _keep_passed(self, frame: VideoFrame) -> None:
        """One that was passed by is soon asked for by another thread. After a seek it may refer to frames before."""
        if not self._from_start:
            return
        at = int(np.searchsorted(self.pts, frame.pts)) if frame.pts is not None else len(self.pts)
        if at < len(self.pts) and self.pts[at] == frame.pts:
            self._keep(at, frame)

    def _seek(self, pts: int | None) -> None:
        """To the key frame before this stamp; None: to the start. Only from there all that a frame refers to is known,
        so that what the decoder finds wrong is damage."""
        if self._container is not None:
            self._container.close()
        self._container = _opened(self.path)
        stream = self._container.streams[self.stream]
        assert isinstance(stream, _av().VideoStream)
        if pts is None:
            stream.codec_context.options = {"err_detect": _REFUSE_DAMAGE}
        else:
            self._container.seek(pts, stream=stream)
        self._from_start = pts is None
        self._next = 0 if pts is None else int(np.searchsorted(self.pts, pts))
        self._frames = self._container.decode(stream)
