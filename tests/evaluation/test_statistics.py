"""Statistics over seeds agree with their closed forms and with SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from bbq_torchrl.evaluation import (
    binomial_standard_error,
    estimate,
    interquartile_mean,
    probability_of_improvement,
)

SEEDS = [0.71, 0.64, 0.80, 0.75, 0.69, 0.77, 0.73]


def numbers(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=count)


@pytest.mark.parametrize(("rate", "dialogues"), [(0.0, 10), (0.183, 100_000), (0.5, 1), (1.0, 7)])
def test_standard_error_is_that_of_the_binomial_distribution(rate, dialogues):
    expected = stats.binom(dialogues, rate).std() / dialogues
    assert binomial_standard_error(rate, dialogues) == pytest.approx(expected)


@pytest.mark.parametrize("count", range(1, 13))
def test_interquartile_mean_drops_a_quarter_on_each_side(count):
    values = numbers(count)
    dropped = count // 4
    expected = np.sort(values)[dropped : count - dropped].mean()
    assert interquartile_mean(values) == pytest.approx(expected)


@pytest.mark.parametrize("count", [2, 3, 5, 30])
def test_t_interval_is_that_of_student(count):
    values = numbers(count)
    low, high = stats.t.interval(0.95, count - 1, values.mean(), stats.sem(values))
    found = estimate(values, method="t")
    assert (found.value, found.low, found.high) == pytest.approx((values.mean(), low, high))
    assert (found.method, found.count) == ("t", count)


@pytest.mark.parametrize("statistic", ["mean", "iqm"])
def test_bootstrap_interval_is_scipys(statistic):
    function = np.mean if statistic == "mean" else interquartile_mean
    expected = stats.bootstrap(
        (np.array(SEEDS),), function, n_resamples=9_999, rng=np.random.default_rng(5)
    ).confidence_interval
    found = estimate(SEEDS, statistic, seed=11)
    assert found.value == pytest.approx(function(SEEDS))
    # Other resamples: the ends differ by their sampling error, a hundredth or two of the width.
    tolerance = 0.1 * (expected.high - expected.low)
    assert (found.low, found.high) == pytest.approx(tuple(expected), abs=tolerance)
    assert found.method == "bootstrap"


@pytest.mark.slow
def test_five_normal_seeds_are_covered_as_often_as_is_said():
    generator, repeats, hits = np.random.default_rng(1), 1000, {"bootstrap": 0, "t": 0}
    for _ in range(repeats):
        values = generator.normal(size=5)
        for method in hits:
            found = estimate(values, method=method)
            hits[method] += found.low <= 0 <= found.high
    # Four standard errors of a share of 1000 around .85 and .95.
    assert abs(hits["bootstrap"] / repeats - 0.85) < 0.045
    assert abs(hits["t"] / repeats - 0.95) < 0.028


def test_an_interval_is_the_same_each_time():
    assert estimate(SEEDS) == estimate(SEEDS)
    assert estimate(SEEDS, seed=1) != estimate(SEEDS)


def test_equal_seeds_have_an_interval_of_no_width():
    found = estimate([0.5] * 6)
    assert (found.value, found.low, found.high) == (0.5, 0.5, 0.5)


def test_few_seeds_get_a_t_interval_and_one_seed_none():
    four, one = estimate(SEEDS[:4]), estimate(SEEDS[:1])
    assert four == estimate(SEEDS[:4], method="t")
    assert one.method == "none"
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    assert (str(one), str(four)[:7]) == ("0.710", "0.725 [")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([],), "values must be finite numbers, at least one"),
        (([0.5, math.nan],), "values must be finite numbers"),
        ((SEEDS, "iqm", "t"), "iqm needs method=bootstrap"),
        ((SEEDS[:4], "iqm"), "at least 5 seeds, got method=bootstrap and 4 seeds"),
    ],
)
def test_estimates_of_nonsense_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        estimate(*arguments)


@pytest.mark.parametrize("sizes", [(5, 5), (3, 8), (1, 1), (6, 20)])
def test_probability_of_improvement_is_the_share_of_pairs_won(sizes):
    # Rounded to tenths, so that there are ties.
    better, worse = (numbers(size, seed).round(1) for seed, size in enumerate(sizes))
    u = stats.mannwhitneyu(better, worse).statistic
    found = probability_of_improvement(better, worse)
    assert found.value == pytest.approx(u / (sizes[0] * sizes[1]))
    assert found.value + probability_of_improvement(worse, better).value == pytest.approx(1)


def test_probability_of_improvement_has_an_interval_from_five_seeds_on():
    better, worse = numbers(8) + 0.5, numbers(8, 1)
    found = probability_of_improvement(better, worse)
    assert 0 <= found.low < found.value < found.high <= 1
    assert math.isnan(probability_of_improvement(better, worse[:4]).low)


def test_an_estimate_is_shown_with_signs_where_asked():
    found = estimate([0.7, 0.72, 0.74, 0.76, 0.78], method="t")
    assert f"{found:+.2f}" == "+0.74 [+0.70, +0.78]"
    assert (f"{found}", found.interval()) == (str(found), "[0.701, 0.779]")
    assert (f"{estimate([0.5]):+.2f}", estimate([0.5]).interval()) == ("+0.50", "–")
