"""VRS's own reader, as ``gtcal.own_process`` runs it."""

from __future__ import annotations

from typing import Any

import numpy as np
from pyvrs import ImageConversion, RecordType, SyncVRSReader


class Reader:
    """Of one file."""

    def __init__(self, path: str) -> None:
        # one that has skipped the pixels skips them for good
        self._with_pixels, self._without = (SyncVRSReader(path, auto_read_configuration_records=True) for _ in range(2))
        self._with_pixels.set_image_conversion(ImageConversion.NORMALIZE_GREY8)

    def image_streams(self) -> dict[str, int]:
        """The streams that may hold images, by id, and how many data records each has."""
        reader = self._without
        found = {name: int(reader.get_records_count(name, RecordType.DATA)) for name in sorted(reader.stream_ids)}
        return {name: count for name, count in found.items() if count and reader.might_contain_images(name)}

    def stamps(self, stream: str, field: str) -> tuple[list[int | None], list[float]]:
        """Of a stream's data records, the whole number in this field of their metadata, and their own times in s."""
        records = _records(self._without, stream)
        self._without.skip_trailing_blocks(int(stream.split("-")[0]), RecordType.DATA, 1)  # reads no pixels
        captured = [_number(records[i], field) for i in range(len(records))]
        return captured, [float(time_s) for time_s in records.get_timestamp_list()]

    def image(self, stream: str, record: int) -> tuple[np.ndarray | None, str]:
        """A data record's pixels, None where it has none, and their format."""
        found = _records(self._with_pixels, stream)[record]
        if not found.n_image_blocks:
            return None, "no image"
        return np.array(found.image_blocks[0]), str(found.image_specs[0].pixel_format)


def _records(reader: Any, stream: str) -> Any:
    return reader.filtered_by_fields(stream_ids={stream}, record_types={"data"})


def _number(record: Any, field: str) -> int | None:
    fields = record.metadata_blocks[0] if record.n_metadata_blocks else {}
    return int(fields[field]) if field in fields else None
