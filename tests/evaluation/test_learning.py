"""When agents reached a success rate, and the area under their curves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy import integrate, stats
from tiny import rows

from bbq_torchrl.evaluation import areas, rounds_to_reach
from bbq_torchrl.evaluation.comparison import learning_table
from bbq_torchrl.evaluation.curves import Reach, booked
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.pairs import pair

curves = arrays(float, st.tuples(st.integers(1, 20), st.integers(1, 4)), elements=st.floats(0, 1))
INF = math.inf


@given(curves, st.floats(0, 1), st.integers(1, 6))
def test_a_level_is_reached_in_the_first_round_whose_last_rounds_mean_it(success, level, window):
    found = rounds_to_reach(success, level, window)
    for seed, rounds in enumerate(found):
        means = {
            end: math.fsum(success[end - window : end, seed]) / window
            for end in range(window, len(success) + 1)
        }
        reached = [end for end, mean in means.items() if mean >= level - 1e-9]
        assert rounds == (reached[0] if reached else INF)


@given(arrays(int, st.tuples(st.integers(1, 20), st.integers(1, 4)), elements=st.integers(0, 10)))
def test_the_first_dialogues_booked_are_counted_one_by_one(successes):
    for first in (10, 40, 120):
        found = booked(successes / 10, dialogues=10, first=first)
        counts = successes[: first // 10].sum(0) / first
        assert found == (pytest.approx(counts) if len(successes) * 10 >= first else [])


def test_early_success_is_compared_by_pairs_where_both_trained_for_as_long(add):
    agents = {"bbqn": 0.8, "dqn": 0.6}
    long = [add([rate], agent=agent, rounds=30) for agent, rate in agents.items()]
    assert pair(*read_groups(long)).differences["early"] == pytest.approx([0.1])
    short = [add([rate], agent=agent, seed=7) for agent, rate in agents.items()]
    assert "early" not in pair(*read_groups(short)).differences


def test_a_rate_that_hits_the_level_reaches_it_in_spite_of_rounding():
    # Five rounds of 50 dialogues: 150 successes of 250 are .6, though not in floating point.
    success = np.array([[0.86], [0.52], [0.34], [0.96], [0.32]])
    assert success.mean() < 0.6
    assert rounds_to_reach(success, 0.6).tolist() == [5]


@pytest.mark.parametrize(
    ("rounds", "median", "reached"),
    [
        ([7.0], 7, 1),
        ([30.0, 10, 20], 20, 3),
        ([10.0, 20, INF, INF], 20, 2),
        ([10.0, INF, INF], INF, 1),
        ([INF, INF], INF, 0),
    ],
)
def test_the_median_is_when_half_of_the_seeds_had_reached_it(rounds, median, reached):
    found = Reach(tuple(rounds), trained=50, dialogues=50)
    assert (found.median, found.reached) == (median, reached)
    # Kaplan and Meier's median: where at most half have not reached it.
    data = stats.CensoredData.right_censored(np.minimum(rounds, 50), np.isinf(rounds))
    survival = stats.ecdf(data).sf
    done = survival.quantiles[survival.probabilities <= 0.5]
    assert found.median == (done[0] if median < INF else INF)


@pytest.mark.parametrize("seeds", [5, 6, 10, 17])
def test_the_medians_interval_is_between_seeds_by_the_binomial_distribution(seeds):
    rounds = np.random.default_rng(seeds).permutation(seeds) + 1.0
    low, high = Reach(tuple(rounds.tolist()), trained=50, dialogues=50).interval
    if seeds < 6:
        assert math.isnan(low)
        assert math.isnan(high)
        return
    # Between the k-th smallest and k-th largest: k is the largest whose error is at most 5 %.
    k = max(k for k in range(1, seeds) if 2 * stats.binom.cdf(k - 1, seeds, 0.5) <= 0.05)
    assert (low, high) == (k, seeds + 1 - k)


@given(curves)
def test_area_of_a_whole_curve_is_the_integral_over_its_length(curve):
    found = areas(curve)
    rounds, seeds = curve.shape
    assert len(found) == seeds
    expected = integrate.trapezoid(curve, axis=0) / (rounds - 1) if rounds > 1 else curve[0]
    assert found == pytest.approx(expected.tolist())


def test_each_curve_has_a_row_with_its_area_and_when_it_reached_a_level(add):
    evaluated = add([0.8, 0.9], rounds=6, eval_every=2)
    runs = [evaluated, add([0.8, 1.0, 0.9], rounds=6, agent="dqn")]
    first, second, third = str(learning_table(read_groups(runs))).splitlines()[2:]
    assert first.startswith("| BBQN-MAP | training | 0.425 [")
    assert first.endswith(" | not reached | not reached | not reached | not reached |")
    # Evaluated after rounds 2, 4 and 6: .4, .6, .8 and .5, .7, .9.
    assert second.startswith("| BBQN-MAP | evaluation | 0.650 [")
    assert second.endswith(" | 2 (100) | 4 (200) | 4 (200) | 6 (300) |")
    # Of three seeds one trained at .5.
    assert third.startswith("| DQN | training | 0.450 [")
    assert third.endswith(" | > 6 (> 300), 1 of 3 | not reached | not reached | not reached |")


def test_seeds_evaluated_in_different_rounds_have_those_in_common(add):
    runs = [add([0.8], rounds=6, eval_every=2), add([0.9], rounds=6, eval_every=3, seed=1)]
    (group,) = read_groups(runs)
    assert np.isfinite(group.evaluation).tolist() == [[False, False]] * 5 + [[True, True]]
    (group,) = read_groups([*runs, add([0.9], rounds=6, seed=2)])
    assert group.evaluation is None


def test_evaluations_are_compared_by_pairs_over_the_rounds_in_common(add):
    dqn = {"agent": "dqn", "rounds": 8}
    runs = [
        add([0.8, 0.9], rounds=8, eval_every=2),
        add([0.7, 0.7], eval_every=4, **dqn),
        add([0.7, 0.7], dropout=0.0, **dqn),
    ]
    often, rarely, never = read_groups(runs)
    # Rounds 4 and 8 alone: .4 and .8, .5 and .9 against .3 and .7, twice.
    assert pair(often, rarely).differences["area"] == pytest.approx([0.1, 0.2])
    assert "area" not in pair(often, never).differences


def test_the_tables_csv_leaves_empty_what_was_not_reached(add, tmp_path):
    table = learning_table(read_groups([add([0.8, *[1.0] * 5], rounds=8, eval_every=4)]))
    table.write(tmp_path)
    training, evaluation = rows(tmp_path / "learning.csv")
    assert training["to_0.5_reached"] == "5"
    assert float(training["to_0.5"]) == float(training["to_0.5_low"]) == 5
    assert float(training["to_0.5_dialogues"]) == 250
    assert training["to_0.5_high"] == ""
    assert [training[f"to_0.6{part}"] for part in ("", "_reached", "_dialogues")] == ["", "0", ""]
    assert (evaluation["to_0.8_reached"], float(evaluation["to_0.8"])) == ("6", 8)
    assert "| 5 [5, > 8] (250), 5 of 6 | not reached |" in str(table)
