"""Statistics over seeds agree with their closed forms and with SciPy."""

import math

import numpy as np
import pytest
from scipy import stats

from bbq_torchrl.utils.statistics import (
    estimate,
    estimate_iqm,
    interquartile_mean,
    stratified,
    t_test,
)

SEEDS = [0.71, 0.64, 0.80, 0.75, 0.69, 0.77, 0.73]


@pytest.mark.parametrize("values", [SEEDS, [0.355, 0.463], [1.0, 0.9, 1.0], [0.0, 0.02, 0.0]])
def test_an_interval_is_students_cut_at_the_bounds_of_what_is_estimated(values):
    low, high = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    assert (low < 0 or high > 1) == (values != SEEDS)
    found, free = estimate(values), estimate(values, bounds=(-1.0, 1.0))
    assert (found.low, found.high) == pytest.approx((max(0, low), min(1, high)))
    assert (free.low, free.high) == pytest.approx((max(-1, low), min(1, high)))


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


@pytest.mark.parametrize("values", [[], [0.5, math.nan], [0.5, 1.2], [-0.1]])
def test_estimates_of_what_is_no_rate_are_refused(values):
    with pytest.raises(ValueError, match="values"):
        estimate(values)


def test_differences_that_are_all_equal_need_no_test():
    assert [t_test(values) for values in ([0.3], [0.0, 0.0], [0.3, 0.3])] == [1, 1, 0]


def test_a_stratified_interval_is_that_of_the_percentile_bootstrap():
    scores = np.random.default_rng(3).normal(size=(1, 12))
    low, high = stratified(lambda values: values.mean((-2, -1)), scores, resamples=20_000)
    expected = stats.bootstrap(
        scores, np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    width = expected.high - expected.low
    assert (low, high) == pytest.approx(tuple(expected), abs=0.05 * width)


def test_seeds_are_drawn_within_a_setting_of_at_least_five():
    scores = np.array([[0.1] * 6, [0.9] * 6])  # no seed differs, the settings do

    def mean(values):
        return interquartile_mean(values.reshape(len(values), -1))

    assert stratified(mean, scores).tolist() == pytest.approx([0.5, 0.5])
    assert np.isnan(stratified(mean, scores[:, :4])).all()
