import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.statistics import (
    _bca_interval,
    bootstrap_ratio,
    exceedance,
    histogram_quantiles,
    pooled_standard_deviation,
    standard_deviation,
)


def skewed(n: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).gamma(2.0, 0.05, size=n)


def test_mean_interval_agrees_with_scipys_bca():
    values = skewed(60)
    ours = bootstrap_ratio(values, resamples=20_000, seed=3)
    theirs = stats.bootstrap(
        (values,), np.mean, method="BCa", n_resamples=20_000, rng=np.random.default_rng(4)
    ).confidence_interval
    width = theirs.high - theirs.low
    assert float(ours.value) == pytest.approx(values.mean(), rel=1e-12)
    assert abs(float(ours.low) - theirs.low) < 0.03 * width
    assert abs(float(ours.high) - theirs.high) < 0.03 * width


def test_ratio_interval_agrees_with_scipys_bca_on_pairs():
    rng = np.random.default_rng(5)
    denominators = rng.integers(1, 200, size=50).astype(float)
    numerators = denominators * rng.normal(250.0, 60.0, size=50)
    ours = bootstrap_ratio(numerators, denominators, resamples=20_000)
    theirs = stats.bootstrap(
        (numerators, denominators),
        lambda top, bottom, axis: top.sum(axis=axis) / bottom.sum(axis=axis),
        paired=True,
        vectorized=True,
        method="BCa",
        n_resamples=20_000,
        rng=np.random.default_rng(6),
    ).confidence_interval
    width = theirs.high - theirs.low
    assert abs(float(ours.low) - theirs.low) < 0.03 * width
    assert abs(float(ours.high) - theirs.high) < 0.03 * width


def test_interval_of_normal_values_agrees_with_the_t_distribution():
    values = np.random.default_rng(7).normal(size=400)
    ours = bootstrap_ratio(values, resamples=20_000)
    low, high = stats.t.interval(0.95, 399, loc=values.mean(), scale=stats.sem(values))
    assert float(ours.low) == pytest.approx(low, abs=0.05 * (high - low))
    assert float(ours.high) == pytest.approx(high, abs=0.05 * (high - low))


def test_interval_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(8)
    # One experiment per column would share its resampling; separate calls are independent.
    covered = 0
    for trial in range(300):
        estimate = bootstrap_ratio(rng.gamma(2.0, 1.0, size=80), resamples=600, seed=trial)
        covered += bool(estimate.low <= 2.0 <= estimate.high)
    # Five standard deviations of a binomial with p = 0.95, and 2 % for the bootstrap itself.
    assert 0.95 - 0.083 < covered / 300 <= 1.0


def test_columns_are_estimated_like_single_ones():
    table = np.random.default_rng(9).random((40, 2, 3))
    whole = bootstrap_ratio(table)
    single = bootstrap_ratio(table[:, 1, 2])
    assert whole.value.shape == (2, 3)
    assert whole.low[1, 2] == pytest.approx(float(single.low), rel=1e-12)
    assert whole.high[1, 2] == pytest.approx(float(single.high), rel=1e-12)


def test_resampling_in_blocks_changes_nothing(monkeypatch):
    values = skewed(50)
    whole = bootstrap_ratio(values)
    monkeypatch.setattr("wisar_planner.evaluation.statistics._BATCH_ELEMENTS", 50 * 7)
    blocks = bootstrap_ratio(values)
    assert float(blocks.low) == pytest.approx(float(whole.low), rel=1e-12)
    assert float(blocks.high) == pytest.approx(float(whole.high), rel=1e-12)


def test_constant_values_have_an_interval_of_no_width():
    estimate = bootstrap_ratio(np.full(20, 0.25))
    assert [float(estimate.low), float(estimate.value), float(estimate.high)] == [0.25] * 3


def test_one_run_has_a_value_and_no_interval():
    estimate = bootstrap_ratio([0.3])
    assert float(estimate.value) == 0.3
    assert np.isnan(estimate.low)
    assert np.isnan(estimate.high)


def test_nobody_found_is_no_ratio_at_all():
    assert np.isnan(bootstrap_ratio(np.zeros(10), np.zeros(10)).value)


def test_few_found_give_an_interval_from_the_samples_that_have_one():
    denominators = np.zeros(10)
    denominators[3] = 4.0
    estimate = bootstrap_ratio(denominators * 100.0, denominators)
    assert float(estimate.low) == float(estimate.high) == 100.0


def test_samples_without_a_ratio_do_not_move_the_interval():
    """The bias is counted among the samples that have a ratio: as if the others were not drawn."""
    rng = np.random.default_rng(5)
    samples = rng.normal(size=(4000, 1))
    value, acceleration = np.array([0.1]), np.zeros(1)
    holes = np.full((1000, 1), np.nan)
    with_holes = _bca_interval(np.concatenate([samples, holes]), value, acceleration, 0.95)
    without = _bca_interval(samples, value, acceleration, 0.95)
    np.testing.assert_allclose(with_holes, without, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "options", "named"),
    [
        (([],), {}, "numerators"),
        (([1.0, 2.0], [1.0]), {}, "denominators"),
        (([1.0, 2.0],), {"confidence": 1.0}, "confidence"),
    ],
)
def test_wrong_arguments_are_named(arguments, options, named):
    with pytest.raises(InvalidInput, match=named):
        bootstrap_ratio(*arguments, **options)


def test_pooled_standard_deviation_is_that_of_all_values_together():
    groups = [skewed(5), skewed(1, seed=2), skewed(30, seed=3)]
    together = np.concatenate(groups)
    pooled = pooled_standard_deviation(
        sum(map(len, groups)), sum(g.sum() for g in groups), sum((g**2).sum() for g in groups)
    )
    assert pooled == pytest.approx(np.std(together, ddof=1), rel=1e-9)
    assert standard_deviation(together) == pytest.approx(pooled, rel=1e-9)


def test_spread_of_one_value_does_not_exist():
    assert np.isnan(standard_deviation([1.0]))
    assert np.isnan(pooled_standard_deviation(1, 3.0, 9.0))


def test_exceedance_averages_to_the_survival_function():
    values, thresholds = skewed(500), np.linspace(0.0, 0.5, 21)
    survival = stats.ecdf(values).sf.evaluate(thresholds)
    np.testing.assert_allclose(exceedance(values, thresholds).mean(axis=0), survival, atol=1e-12)


@given(
    values=st.lists(st.floats(0.0, 512.0), min_size=1, max_size=200),
    level=st.floats(0.0, 1.0),
)
def test_binned_quantile_is_within_a_bin_of_the_exact_one(values, level):
    edges = np.arange(257) * 2.0
    counts, _ = np.histogram(values, edges)
    binned = histogram_quantiles(counts, edges, [level])[0]
    exact = np.quantile(values, level, method="inverted_cdf")
    assert abs(binned - exact) <= 2.0 + 1e-9


def test_quantiles_of_nothing_do_not_exist():
    assert np.isnan(histogram_quantiles([0, 0], [0.0, 1.0, 2.0], [0.5])).all()
