"""A short run of scripts/fuzz.py, which takes minutes; and that it sees what it is there to see."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import fuzz
import numpy as np
import pytest

from gtcal.errors import GtcalError


@pytest.mark.long
def test_no_spoilt_file_is_more_than_refused() -> None:
    failed, tallies = fuzz.run(range(1000), 12, workers=1)
    assert failed == []
    assert sum(tally.inputs for tally in tallies.values()) == 1000
    assert sum(tally.refused + tally.taken for tally in tallies.values()) == 1000
    assert max(tally.most_s for tally in tallies.values()) < fuzz.SLOW_S


def test_after_its_time_it_begins_no_more() -> None:
    assert fuzz.run(range(10), 12, workers=1, until=time.monotonic() - 1.0) == ([], {})


@pytest.mark.parametrize(
    ("error", "kind"),
    [(ZeroDivisionError(), "uncaught"), (MemoryError(), "large"), (RecursionError(), "uncaught")],
)
def test_what_goes_wrong_is_counted(error: BaseException, kind: str, tmp_path: Path) -> None:
    def read() -> None:
        raise error

    (tmp_path / "file").write_bytes(b"good 1 2 3")
    failed, tally = spoil_and_read(tmp_path / "file", read)
    assert failed is not None
    assert (failed.number, failed.target, failed.kind) == (5, "it", kind)
    assert (tally.inputs, tally.refused, tally.taken, tally.failed) == (1, 0, 0, 1)
    assert (tmp_path / "file").read_bytes() == b"good 1 2 3"


def test_a_refusal_in_one_line_is_none(tmp_path: Path) -> None:
    def read(message: str) -> None:
        raise GtcalError(message)

    (tmp_path / "file").write_bytes(b"good")
    failed, tally = spoil_and_read(tmp_path / "file", lambda: read("one"))
    assert failed is None
    assert (tally.refused, tally.taken, tally.failed) == (1, 0, 0)
    failed, tally = spoil_and_read(tmp_path / "file", lambda: read("two\nlines"))
    assert failed is not None
    assert (tally.refused, tally.taken, tally.failed) == (1, 0, 1)


def test_memory_is_that_of_the_input_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"good")
    much = spoil_and_read(tmp_path / "file", lambda: np.ones(10_000_000))[1]
    little = spoil_and_read(tmp_path / "file", lambda: None)[1]
    assert 70_000_000 < much.most_bytes < 120_000_000
    assert little.most_bytes < 10_000_000


def test_runs_are_added_up(tmp_path: Path) -> None:
    one = {"a": fuzz.Tally(3, 2, 1, 0, 0.5, 7)}
    fuzz.added_to(tmp_path / "sum.json", 1, Counter(slow=1), one)
    other = {"a": fuzz.Tally(2, 2, 0, 0, 0.1, 9), "b": fuzz.Tally(1, 0, 1, 0)}
    seeds, wrong, both = fuzz.added_to(tmp_path / "sum.json", 2, Counter(slow=1), other)
    assert (seeds, wrong) == ([1, 2], {"slow": 2})
    assert both == {"a": fuzz.Tally(5, 4, 1, 0, 0.5, 9), "b": fuzz.Tally(1, 0, 1, 0)}
    with pytest.raises(SystemExit, match="holds seed 2 already"):
        fuzz.added_to(tmp_path / "sum.json", 2, Counter(), other)


def spoil_and_read(path: Path, read: Callable[[], object]) -> tuple[fuzz.Failed | None, fuzz.Tally]:
    return fuzz.spoil_and_read(5, fuzz.Target("it", path, read), random.Random(0))


def test_the_same_seed_spoils_the_same_and_every_way_spoils() -> None:
    content = np.arange(256, dtype=np.uint8).tobytes() + b"\nfx: 500.5\nname: cam0\n"
    assert fuzz.spoilt(content, random.Random("3")) == fuzz.spoilt(content, random.Random("3"))
    assert len({fuzz.spoilt(content, random.Random(str(i))) for i in range(200)}) > 150
    for way in set(fuzz._WAYS):
        assert any(way(content, random.Random(str(i))) != content for i in range(20))
        way(b"", random.Random("1"))  # of an empty file too
