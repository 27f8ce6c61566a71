"""ROS 1 and ROS 2 bags, opened. Needs no ROS, but the library rosbags: ``pip install 'gtcal[bags]'``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gtcal.documents import load_plain_yaml, read_text
from gtcal.errors import GtcalError
from gtcal.files import check_regular

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


@contextmanager
def opened_bag(path: Path) -> Iterator[AnyReader]:
    """A bag to read from. Raises GtcalError as ``open_bag``."""
    reader = open_bag(path)
    try:
        yield reader
    finally:
        reader.close()


def open_bag(path: Path) -> AnyReader:
    """A bag to read from, which whoever asks for it closes. Types that it doesn't define are those of ROS 2 Humble.

    Raises GtcalError where rosbags is missing or the bag can't be read."""
    check_regular(path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise GtcalError(f"{path}: reading a ROS bag needs rosbags: pip install 'gtcal[bags]'") from None
    _check_metadata(path)
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # whatever a damaged bag makes the library's parsers, SQLite, struct, ... raise
        raise GtcalError(f"{path}: is not a ROS bag that can be read, or is cut off: {words_of(error)}") from None
    return reader


def _check_metadata(path: Path) -> None:
    """The library's own parser takes seconds to give up on what is nested without end; gtcal's does not."""
    metadata = path / "metadata.yaml"
    if path.is_dir() and metadata.is_file():
        load_plain_yaml(metadata, read_text(metadata))


def words_of(error: Exception) -> str:
    """What an error of the library's says, in one line."""
    return " ".join(str(error).split()) or type(error).__name__
