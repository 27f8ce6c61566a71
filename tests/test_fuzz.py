"""A short run of scripts/fuzz.py, which takes minutes; and that it sees what it is there to see."""

from __future__ import annotations

from pathlib import Path

import fuzz
import numpy as np
import pytest

from gtcal.errors import GtcalError


@pytest.mark.long
def test_no_spoilt_file_is_more_than_refused() -> None:
    failed, done, most_s, _ = fuzz.run(range(400), 12, workers=1)
    assert failed == []
    assert done == 400
    assert most_s < fuzz.SLOW_S


def test_after_its_time_it_begins_no_more() -> None:
    assert fuzz.run(range(10), 12, workers=1, seconds=-1.0)[:2] == ([], 0)


@pytest.mark.parametrize(
    ("error", "kind"),
    [(ZeroDivisionError(), "uncaught"), (MemoryError(), "large"), (RecursionError(), "uncaught")],
)
def test_what_goes_wrong_is_counted(error: BaseException, kind: str, tmp_path: Path) -> None:
    def read() -> None:
        raise error

    (tmp_path / "file").write_bytes(b"good 1 2 3")
    (failed,), _ = fuzz.spoil_and_read(5, 0, [fuzz.Target("it", tmp_path / "file", read)])
    assert (failed.number, failed.target, failed.kind) == (5, "it", kind)
    assert (tmp_path / "file").read_bytes() == b"good 1 2 3"


def test_a_refusal_in_one_line_is_none(tmp_path: Path) -> None:
    def read(message: str) -> None:
        raise GtcalError(message)

    (tmp_path / "file").write_bytes(b"good")
    assert not fuzz.spoil_and_read(5, 0, [fuzz.Target("it", tmp_path / "file", lambda: read("one"))])[0]
    assert fuzz.spoil_and_read(5, 0, [fuzz.Target("it", tmp_path / "file", lambda: read("two\nlines"))])[0]


def test_the_same_seed_spoils_the_same_and_every_way_spoils() -> None:
    import random

    content = np.arange(256, dtype=np.uint8).tobytes() + b"\nfx: 500.5\nname: cam0\n"
    assert fuzz.spoilt(content, random.Random("3")) == fuzz.spoilt(content, random.Random("3"))
    assert len({fuzz.spoilt(content, random.Random(str(i))) for i in range(200)}) > 150
    for way in set(fuzz._WAYS):
        assert any(way(content, random.Random(str(i))) != content for i in range(20))
        way(b"", random.Random("1"))  # of an empty file too
