"""Statistics over seeds agree with their closed forms and with SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from bbq_torchrl.evaluation.pairs import difference
from bbq_torchrl.utils.statistics import (
    binomial_standard_error,
    estimate,
    estimate_iqm,
    interquartile_mean,
    t_test,
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
    found = estimate(values, bounds=(-math.inf, math.inf))
    assert (found.value, found.low, found.high) == pytest.approx((values.mean(), low, high))


@pytest.mark.parametrize("values", [[0.355, 0.463], [1.0, 0.9, 1.0], [0.0, 0.02, 0.0]])
def test_an_interval_is_cut_at_the_bounds_of_what_is_estimated(values):
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    assert low < 0 or high > 1
    found, free = estimate(values), estimate(values, bounds=(-1.0, 1.0))
    assert (found.low, found.high) == pytest.approx((max(0, low), min(1, high)))
    assert (free.low, free.high) == pytest.approx((max(-1, low), min(1, high)))


def test_differences_of_rates_lie_between_minus_one_and_one():
    assert f"{difference([0.9, -0.1])}" == "+0.400 [-1.000, +1.000]"


@pytest.mark.parametrize("values", [[0.5, 1.2], [-0.1]])
def test_what_is_no_rate_is_not_estimated_as_one(values):
    with pytest.raises(ValueError, match="values"):
        estimate(values)


def test_bootstrap_interval_of_the_interquartile_mean_is_scipys():
    expected = stats.bootstrap(
        (np.array(SEEDS),), interquartile_mean, n_resamples=9_999, rng=np.random.default_rng(5)
    ).confidence_interval
    found = estimate_iqm(SEEDS)
    assert found.value == pytest.approx(interquartile_mean(SEEDS))
    # Other resamples: the ends differ by their sampling error, a hundredth or two of the width.
    tolerance = 0.1 * (expected.high - expected.low)
    assert (found.low, found.high) == pytest.approx(tuple(expected), abs=tolerance)
    assert found == estimate_iqm(SEEDS)


@pytest.mark.parametrize(("of", "least"), [(estimate, 2), (estimate_iqm, 5)])
def test_an_interval_takes_enough_seeds_and_has_no_width_where_they_are_equal(of, least):
    enough, few, same = of(SEEDS[:least]), of(SEEDS[: least - 1]), of([0.5] * 6)
    assert enough.low < enough.value < enough.high
    assert math.isnan(few.low)
    assert math.isnan(few.high)
    assert (same.value, same.low, same.high) == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("of", [estimate, estimate_iqm])
@pytest.mark.parametrize("values", [[], [0.5, math.nan]])
def test_estimates_of_nonsense_are_refused(of, values):
    with pytest.raises(ValueError, match="values"):
        of(values)


def test_an_estimate_is_shown_with_signs_where_asked():
    found = estimate([0.7, 0.72, 0.74, 0.76, 0.78])
    assert f"{found:+.2f}" == "+0.74 [+0.70, +0.78]"
    assert f"{found}" == str(found)
    assert f"{estimate([0.5]):+.2f}" == "+0.50"


def test_differences_that_are_all_equal_need_no_test():
    assert [t_test(values) for values in ([0.3], [0.0, 0.0], [0.3, 0.3])] == [1, 1, 0]
