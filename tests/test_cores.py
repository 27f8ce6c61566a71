"""Work that is shared among the cores: in order, a bounded way ahead, and never shared twice."""

from __future__ import annotations

import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor

import pytest

from factors import cores
from factors.cores import in_order, n_cores_here


@pytest.fixture(params=[1, 4])
def n(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(cores, "n_cores", lambda: request.param)
    cores._threads.cache_clear()
    return int(request.param)


def test_results_come_in_the_order_of_the_items(n: int) -> None:
    assert list(in_order(lambda i: i * i, range(50))) == [i * i for i in range(50)]
    assert list(in_order(lambda i: i, [])) == []


def test_a_thread_that_shares_work_shares_its_own_with_none(n: int) -> None:
    assert n_cores_here() == n
    within = list(in_order(lambda _: (n_cores_here(), list(in_order(lambda j: j, range(3)))), range(8)))
    assert within == [(1, [0, 1, 2])] * 8


def test_a_single_item_shares_its_own_work(n: int) -> None:
    assert list(in_order(lambda _: n_cores_here(), [0])) == [n]


def test_no_more_is_begun_ahead_than_there_are_cores(n: int) -> None:
    begun = []
    lock = threading.Lock()

    def begin(item: int) -> int:
        with lock:
            begun.append(item)
        return item

    results = in_order(begin, range(1_000))
    for expected in range(10):
        assert next(results) == expected
        assert max(begun) <= expected + n + 1


def test_what_fails_is_raised_where_it_is_asked_for(n: int) -> None:
    def fail(item: int) -> int:
        if item == 3:
            raise ValueError("three")
        return item

    results = in_order(fail, range(10))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(results)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on this system")
def test_a_forked_process_shares_work_with_threads_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores, "n_cores", lambda: 4)
    cores._threads.cache_clear()
    assert list(in_order(abs, range(20))) == list(range(20))  # its parent has threads
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        assert pool.submit(_in_order, 20).result(timeout=60) == list(range(20))


def _in_order(n: int) -> list[int]:
    return list(in_order(abs, range(n)))
