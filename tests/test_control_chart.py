"""Control charts and trends against simulation: the run length that they state, and the days that are left."""

from __future__ import annotations

import numpy as np
import pytest

from gtcal.fleet.control_chart import (
    WEIGHT,
    autocorrelation_of,
    chart,
    limit_for,
    run_length_at,
    self_starting_scores,
)
from gtcal.fleet.trend import change_of, days_left, drift_tolerance


def autocorrelated(random: np.random.Generator, n_series: int, n: int, share: float) -> np.ndarray:
    """(n_series, n) of which each takes over a share of the one before."""
    noise = random.normal(size=(n_series, n))
    values = noise.copy()
    values[:, 0] /= np.sqrt(1.0 - share**2)
    for i in range(1, n):
        values[:, i] = share * values[:, i - 1] + noise[:, i]
    return values


@pytest.mark.parametrize("run_length", [50.0, 200.0])
def test_the_limit_gives_the_run_length(run_length: float) -> None:
    random, limit = np.random.default_rng(0), limit_for(run_length)
    assert run_length_at(limit) == pytest.approx(run_length, rel=1e-4)
    ewma, alive, lengths = np.zeros(4000), np.ones(4000, dtype=bool), np.zeros(4000)
    while alive.any():
        ewma += WEIGHT * (random.normal(size=4000) - ewma)
        lengths += alive
        alive &= np.abs(ewma) <= limit
    assert lengths.mean() == pytest.approx(run_length, abs=4.0 * lengths.std() / np.sqrt(4000))


def test_published_limits() -> None:
    """Crowder (1989), Lucas and Saccucci (1990): weight 0.2, in units of the EWMA's own sigma."""
    assert limit_for(500.0) / np.sqrt(WEIGHT / (2.0 - WEIGHT)) == pytest.approx(2.962, abs=0.002)


def test_scores_are_standard_normal_whatever_the_series() -> None:
    random = np.random.default_rng(1)
    scores = np.array([self_starting_scores(40.0 + 7.0 * random.normal(size=12)) for _ in range(1500)])[:, 2:]
    assert np.abs(scores.mean(axis=0)).max() < 0.11
    assert np.abs(scores.std(axis=0) - 1.0).max() < 0.08
    assert np.abs(np.corrcoef(scores.T) - np.eye(10)).max() < 0.11
    assert not self_starting_scores(np.full(6, 3.0)).any()


def run_length_of(values: np.ndarray, stated: float, autocorrelation: float) -> float:
    """How many values there are to an alarm, over series that begin anew after each."""
    alarms = [chart(series, run_length=stated, autocorrelation=autocorrelation).alarm for series in values]
    looked_at = sum(values.shape[1] if alarm is None else alarm + 1 for alarm in alarms)
    return looked_at / max(sum(alarm is not None for alarm in alarms), 1)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_the_stated_run_length_is_kept_with_autocorrelation(share: float) -> None:
    """In series that start by themselves, with the autocorrelation that is found in them; without it, it is not."""
    values = autocorrelated(np.random.default_rng(2), 400, 40, share)
    found = autocorrelation_of(values)
    assert found == pytest.approx(share, abs=0.06)
    assert run_length_of(values, 100.0, found) > 85.0
    if share:
        assert run_length_of(values, 100.0, 0.0) < 50.0


def test_a_drift_is_no_autocorrelation() -> None:
    values = np.random.default_rng(3).normal(size=(200, 20)) + np.linspace(0.0, 6.0, 20)
    assert autocorrelation_of(values) < 0.08
    assert autocorrelation_of([]) == 0.0


def test_a_drift_and_a_bump_are_noticed() -> None:
    random = np.random.default_rng(4)
    days = np.arange(30.0)
    for change in (0.3 * np.maximum(days - 10.0, 0.0), 5.0 * (days >= 15.0)):
        values = random.normal(size=(100, 30)) + change
        alarms = [chart(series, run_length=1e5).alarm for series in values]
        assert sum(alarm is not None and alarm >= 10 for alarm in alarms) > 90


def test_what_changed_and_since_when() -> None:
    random, days = np.random.default_rng(5), np.arange(40.0)
    sigmas = np.full((40, 2), 0.1)
    direction = np.array([0.6, -0.8])
    noise = 0.1 * random.normal(size=(40, 2))
    drift = change_of(days, noise + np.outer(0.05 * np.maximum(days - 20.0, 0.0), direction), sigmas)
    assert drift is not None
    assert (drift.kind, drift.significant) == ("drift", True)
    assert drift.since_day == pytest.approx(20.0, abs=3.0)
    assert drift.rate == pytest.approx(0.05, abs=4.0 * drift.rate_sigma)
    assert drift.direction @ direction > 0.98
    step = change_of(days, noise + np.outer(0.5 * (days >= 25.0), direction), sigmas)
    assert step is not None
    assert (step.kind, step.since_day) == ("step", 25.0)
    assert days_left(step, 1.0) is None
    nothing = [change_of(days, 0.1 * random.normal(size=(40, 2)), sigmas) for _ in range(100)]
    assert sum(one is not None and one.significant for one in nothing) <= 2
    assert change_of(days[:4], noise[:4], sigmas[:4]) is None


def test_the_days_that_are_left_are_so_sure() -> None:
    """Of drifts of 0.05 a day, with noise beyond what is stated of it: the interval holds the true day nine times in
    ten."""
    random, days = np.random.default_rng(6), np.arange(0.0, 30.0, 2.0)
    held, middles = [], []
    for _ in range(300):
        values = (0.05 * days + 0.2 * random.normal(size=len(days)))[:, None]
        change = change_of(days, values, np.full_like(values, 0.15))
        if change is None or change.kind != "drift" or change.since_day > 6.0:
            continue  # noticed as something else
        left = days_left(change, 2.0)
        assert left is not None
        held.append(left.low <= 40.0 - days[-1] <= left.high)
        middles.append(left.middle)
    assert len(held) > 150
    assert 0.8 < np.mean(held) < 0.97
    assert np.median(middles) == pytest.approx(12.0, abs=1.5)


def test_at_which_bias_the_rmse_leaves_its_tolerance() -> None:
    bias = np.linspace(0.0, 0.3, 10)
    assert drift_tolerance(np.hypot(0.16, bias), bias, 0.5) == pytest.approx(np.sqrt(0.25 - 0.16**2))
    assert drift_tolerance(np.sqrt(0.16**2 + 2.0 * bias**2), bias, 0.5) == pytest.approx(
        np.sqrt(0.2244 / 2.0), rel=1e-3
    )
    assert drift_tolerance(np.full(10, 0.9), np.zeros(10), 0.5) == 0.0
