"""A writer of small VRS files, as the Python package of VRS can only read: one stream of images, and one without.

After the format's own description: a file header, the description record with each stream's tags (among them the
format of its records), the records, and the index record."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_CONFIGURATION, _DATA = 2, 3
_INDEX_TYPE, _DESCRIPTION_TYPE = 1, 2
_HEADER = "<IIiIdHBBI"
_HEADER_SIZE = struct.calcsize(_HEADER)


@dataclass(frozen=True)
class Stream:
    """type_id, instance: its id, as 1201-1. records: time in s and payload. content: VRS's description of the payload.
    layout: the fields of metadata before an image, with their types."""

    type_id: int
    instance: int
    content: str
    records: Sequence[tuple[float, bytes]]
    layout: Sequence[tuple[str, str]] = ()


def image_stream(
    images: Sequence[np.ndarray],
    times_s: Sequence[float],
    capture_ns: Sequence[int] | None = None,
    *,
    type_id: int = 1201,
    instance: int = 1,
    pixel: str = "grey8",
) -> Stream:
    """Raw images; with the capture time stamps in metadata, as Aria has them, where given."""
    height, width = images[0].shape[:2]
    image = f"image/raw/{width}x{height}/pixel={pixel}"
    if capture_ns is None:
        records = [(t, picture.tobytes()) for t, picture in zip(times_s, images, strict=True)]
        return Stream(type_id, instance, image, records)
    records = [
        (t, struct.pack("<q", ns) + picture.tobytes())
        for t, ns, picture in zip(times_s, capture_ns, images, strict=True)
    ]
    layout = [("capture_timestamp_ns", "DataPieceValue<int64_t>")]
    return Stream(type_id, instance, f"data_layout/size=8+{image}", records, layout)


def write_vrs(path: Path, streams: Sequence[Stream]) -> Path:
    file_header_size = struct.calcsize("<IIQIIqqqQQQII")
    description = _description(streams)
    body, index = b"", []
    previous = len(description)
    ordered = sorted(((t, i, data) for i, s in enumerate(streams) for t, data in s.records), key=lambda r: r[0])
    first = min((record[0] for record in ordered), default=0.0)
    configurations = [(first - 1.0, i, _CONFIGURATION, b"") for i in range(len(streams))]
    for time_s, i, kind, data in (*configurations, *((t, i, _DATA, data) for t, i, data in ordered)):
        stream = streams[i]
        size = _HEADER_SIZE + len(data)
        body += struct.pack(_HEADER, size, previous, stream.type_id, 1, time_s, stream.instance, kind, 0, 0) + data
        index.append(struct.pack("<dIBiH", time_s, size, kind, stream.type_id, stream.instance))
        previous = size
    ids = b"".join(struct.pack("<iH", stream.type_id, stream.instance) for stream in streams)
    entries = struct.pack("<I", len(streams)) + ids + struct.pack("<I", len(index)) + b"".join(index)
    size = _HEADER_SIZE + len(entries)
    trailer = struct.pack(_HEADER, size, previous, _INDEX_TYPE, 2, 1e300, 0, _DATA, 0, 0) + entries
    header = struct.pack(
        "<4s4sQIIqqqQQQ4s4s",
        b"Visi",
        b"onRe",
        1,
        file_header_size,
        _HEADER_SIZE,
        file_header_size + len(description) + len(body),
        file_header_size,
        0,
        0,
        0,
        0,
        b"cord",
        b"VRS1",
    )
    path.write_bytes(header + description + body + trailer)
    return path


def _description(streams: Sequence[Stream]) -> bytes:
    data = struct.pack("<I", len(streams))
    for stream in streams:
        tags = {"VRS_Original_Recordable_Name": "camera", "RF:Data:1": stream.content, "RF:Configuration:1": ""}
        if stream.layout:
            fields = [{"name": name, "type": kind, "offset": 8 * i} for i, (name, kind) in enumerate(stream.layout)]
            tags["DL:Data:1:0"] = json.dumps({"data_layout": fields})
        data += struct.pack("<iH", stream.type_id, stream.instance) + _map({}) + _map(tags)
    data += _map({})
    size = _HEADER_SIZE + len(data)
    return struct.pack(_HEADER, size, 0, _DESCRIPTION_TYPE, 2, 1e300, 0, _DATA, 0, 0) + data


def _map(entries: dict[str, str]) -> bytes:
    return struct.pack("<I", len(entries)) + b"".join(_text(k) + _text(v) for k, v in entries.items())


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()
