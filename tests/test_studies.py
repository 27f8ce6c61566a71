"""The studies whose tables the README shows, each in small: that they run, and that what they show is so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import study_coverage
import study_effects
import study_kernels
import study_priors
import table1_benchmark
import table2_ablation

from gtcal.baselines.compare import JOINT
from gtcal.results.covariance import NAIVE


@pytest.fixture(scope="module", name="outcomes")
def _outcomes() -> list[study_coverage.Outcome]:
    runs = [study_coverage.Run(name, 100 + i) for name in ("white mocap noise", "all of it") for i in range(4)]
    return [study_coverage.outcome(run) for run in runs]


def test_the_stated_covariance_is_true_and_the_naive_one_is_not(outcomes: list[study_coverage.Outcome]) -> None:
    deviations = [d for outcome in outcomes for d in outcome.deviations]
    default = [d for d in deviations if d.kind == study_coverage.DEFAULT]
    assert {d.what for d in default} == {"X", "Y", "theta"}
    assert 0.6 < study_coverage.nees_per_dof(default)[0] < 1.6
    assert study_coverage.coverage(default, 0.95) > 0.87
    naive = [d for d in deviations if d.kind == NAIVE]
    assert study_coverage.nees_per_dof(naive)[0] > 10.0
    errors_mm = np.array([[o.position_errors_mm[3], o.position_errors_mm[4]] for o in outcomes])
    assert errors_mm[:, 1].mean() < 0.6 * errors_mm[:, 0].mean()
    titles = [table.title for table in study_coverage.tables(outcomes)]
    assert titles == [
        "stated against true, by scenario",
        "stated against true, by unknown",
        "mean error of a camera's position, mm",
    ]


def test_nees_and_coverage_of_drawn_deviations() -> None:
    random = np.random.default_rng(0)
    run = study_coverage.Run("white mocap noise", 0)
    drawn = [
        study_coverage._deviation(run, "X", "", "default", xi, np.diag([1.0, 4.0, 9.0]))
        for xi in random.normal(size=(4000, 3)) * [1.0, 2.0, 3.0]
    ]
    assert study_coverage.nees_per_dof(drawn)[0] == pytest.approx(1.0, abs=0.05)
    assert study_coverage.coverage(drawn, 0.5) == pytest.approx(0.5, abs=0.02)


def test_kernels(tmp_path: Path) -> None:
    found = {
        method: np.array([study_kernels.outcome(study_kernels.Run(method, share, 3)) for share in study_kernels.SHARES])
        for method in (study_kernels.DEFAULT, "no kernel")
    }
    assert found[study_kernels.DEFAULT][:, 0].max() < 2.0 * found[study_kernels.DEFAULT][0, 0]
    assert found["no kernel"][-1, 0] > 10.0 * found["no kernel"][0, 0]
    assert len(list(study_kernels.tables(found))) == 2
    study_kernels.draw(found, tmp_path / "kernels.png")
    assert (tmp_path / "kernels.png").stat().st_size > 10_000


def test_priors(tmp_path: Path) -> None:
    poor = list(study_priors.MOTIONS)[1]
    without, true, wrong = (
        study_priors.outcome(study_priors.Run(poor, is_wrong, sigma, 6))
        for is_wrong, sigma in ((False, None), (False, 0.3), (True, 0.3))
    )
    assert true[0] < 0.3 * without[0]
    assert (wrong[3], true[3]) == (True, False)
    rows = np.tile(true, (len(study_priors.SIGMAS_MM), 1)).astype(float)
    assert study_priors.table_of({(poor, False): rows}).row_count == len(study_priors.SIGMAS_MM)
    study_priors.draw({(poor, False): rows}, tmp_path / "priors.png")
    assert (tmp_path / "priors.png").stat().st_size > 5_000


def test_table_1() -> None:
    result = table1_benchmark.outcome(0)
    ours, theirs = (np.mean([px for _, px in result[method].values()]) for method in (JOINT, "Sturm, Huber"))
    assert ours < theirs
    assert [table.row_count for table in table1_benchmark.tables([result, result])] == [4, 4]


@pytest.mark.parametrize("variant", table2_ablation.VARIANTS, ids=lambda variant: variant.name)
def test_table_2(variant: table2_ablation.Variant) -> None:
    found = [table2_ablation.outcome((variant, seed)) for seed in range(2)]
    if 1 in variant.stages:
        assert all(outcome.right for outcome in found)
    assert table2_ablation.table_of(iter([(variant, found)]), 2).row_count == 1


def test_effects() -> None:
    cases = [
        ("board's markers move", 2.0),
        ("a camera turns", 0.2),
        ("clock drift", 100.0),
        ("scale", 0.3),
        (None, 0.0),
    ]
    found = {case: [study_effects.outcome(study_effects.Run(*case, 50_002))] for case in cases}
    assert [one.found for (one,) in found.values()] == [True, True, True, True, False]
    assert all(abs(one.deviation) < 5.0 for (one,) in found.values() if one.found)
    assert found[None, 0.0][0].others == ()
    assert study_effects.table_of(found).row_count == len(cases)
