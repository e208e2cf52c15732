"""When agents reached a success rate, and the area under their curves."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from bbq_torchrl.evaluation.curves import Reach, rounds_to_reach
from bbq_torchrl.evaluation.groups import pair, read_groups

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


@pytest.mark.parametrize(
    ("dialogues", "median", "shown"),
    [
        ([3000.0, 1000, 2000], 2000, "2,000 (3 of 3)"),
        ([1000.0, 2000, INF, INF], 2000, "2,000 (2 of 4)"),
        ([1000.0, INF, INF], INF, "> 5,000 (1 of 3)"),
    ],
)
def test_the_median_is_when_half_of_the_seeds_had_reached_it(dialogues, median, shown):
    found = Reach(tuple(dialogues), trained=5000)
    assert (found.median, str(found)) == (median, shown)
    assert found.csv_columns() == {"": median, "_reached": found.reached}


def test_a_group_reaches_a_level_in_dialogues(add):
    (group,) = read_groups([add([0.8, 1.0, 1.0], rounds=6)])
    assert group.reach(0.5).dialogues == (INF, 250, 250)


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
        add([0.7, 0.7], dropout=0.1, **dqn),
    ]
    often, rarely, never = read_groups(runs)
    # Rounds 4 and 8 alone: .4 and .8, .5 and .9 against .3 and .7, twice.
    assert pair(often, rarely).differences["area"] == pytest.approx([0.1, 0.2])
    assert "area" not in pair(often, never).differences
