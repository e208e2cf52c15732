"""pass^k, probability of improvement and profiles agree with their definitions and SciPy."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from scipy import stats

from bbq_torchrl.utils.statistics import (
    interquartile_mean,
    pass_k,
    performance_profile,
    probability_of_improvement,
    stratified,
)


def drawn(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape).round(1)  # with ties


@pytest.mark.parametrize("k", [1, 2, 4, 8])
def test_pass_k_is_the_share_of_k_plays_that_all_succeed(k):
    outcomes = [[1] * 8 + [0], [1] * 5 + [0] * 4, [0] * 8, [1] * 8, [1] * 3]  # of five goals
    shares = [
        np.mean([all(chosen) for chosen in combinations(goal, k)])
        for goal in outcomes
        if len(goal) >= k
    ]
    wins, plays = [sum(goal) for goal in outcomes], [len(goal) for goal in outcomes]
    assert pass_k(wins, plays, k) == pytest.approx(np.mean(shares))


@pytest.mark.parametrize("k", [1, 2, 4, 8])
def test_pass_k_has_no_bias(k):
    chances, plays = np.array([0.3, 0.8, 0.95]), np.full((20_000, 3), 10)
    wins = np.random.default_rng(k).binomial(plays, chances)
    found = pass_k(wins, plays, k)
    assert abs(found.mean() - (chances**k).mean()) < 4 * stats.sem(found)


def test_pass_k_needs_k_plays_of_a_goal():
    assert np.isnan(pass_k([[3, 1]], [[3, 3]], 4)).all()
    assert pass_k([3, 4], [3, 4], 4) == 1


def test_probability_of_improvement_counts_pairs_of_runs():
    one, other = drawn(3, 6), drawn(3, 4, seed=1)
    by_hand = [
        np.mean([(a > b) + 0.5 * (a == b) for a, b in product(mine, theirs)])
        for mine, theirs in zip(one, other, strict=True)
    ]
    found = probability_of_improvement(one, other)
    assert found == pytest.approx(np.mean(by_hand))
    assert found + probability_of_improvement(other, one) == pytest.approx(1)
    u = stats.mannwhitneyu(one[0], other[0]).statistic
    assert probability_of_improvement(one[:1], other[:1]) == pytest.approx(u / 24)


def test_the_area_under_a_profile_is_the_mean_score():
    scores, levels = drawn(4, 7), np.linspace(0, 1, 10_001)
    profile = performance_profile(scores, levels)
    assert np.trapezoid(profile, levels) == pytest.approx(scores.mean(), abs=1e-3)
    assert performance_profile(scores, [0.35])[0] == np.mean(scores > 0.35)


def test_a_stratified_interval_is_that_of_the_percentile_bootstrap():
    scores = np.random.default_rng(3).normal(size=(1, 12))
    low, high = stratified(lambda values: values.mean((-2, -1)), scores, resamples=20_000)
    expected = stats.bootstrap(
        scores, np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    width = expected.high - expected.low
    assert (low, high) == pytest.approx(tuple(expected), abs=0.05 * width)


def test_seeds_are_drawn_within_a_setting():
    scores = np.array([[0.1] * 6, [0.9] * 6])  # no seed differs, the settings do
    ends = stratified(lambda values: interquartile_mean(values.reshape(len(values), -1)), scores)
    assert ends.tolist() == pytest.approx([0.5, 0.5])


def test_an_interval_takes_five_seeds():
    low, high = stratified(lambda values: values.mean((-2, -1)), drawn(2, 4))
    assert np.isnan([low, high]).all()
