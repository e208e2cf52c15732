"""Estimates and tests of a study against scipy, closed forms and simulation."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from bbq_torchrl.people.study.__main__ import main
from bbq_torchrl.people.study.outcomes import auroc, kappa, participant_mean, proportion, sign_flip
from bbq_torchrl.utils.statistics import PValue


@pytest.mark.parametrize(("won", "count"), [(0, 10), (3, 10), (40, 66), (66, 66)])
def test_a_proportion_of_single_sessions_has_wilsons_interval(won, count):
    found = proportion([[True]] * won + [[False]] * (count - won))
    expected = stats.binomtest(won, count).proportion_ci(method="wilson")
    assert found.value == won / count
    assert found.low <= found.value <= found.high  # a figure draws the distances
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_sessions_of_one_person_are_averaged_first():
    sessions = [[True] * 5] * 12 + [[False]] * 8
    assert proportion(sessions) == participant_mean([[1.0]] * 12 + [[0.0]] * 8, (0, 1))


def test_nothing_has_no_estimate():
    assert str(proportion([])) == str(participant_mean([[], []], (1, 5))) == "–"
    assert str(participant_mean([[4.0, 5.0]], (1, 5))) == "4.50"


def test_a_mean_has_students_interval_over_people():
    people = [[1.0, 3.0], [4.0], [5.0, 5.0, 2.0]]
    found = participant_mean(people, (-10, 10))
    expected = stats.ttest_1samp([2.0, 4.0, 4.0], 0).confidence_interval()
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


@pytest.mark.parametrize("values", [[1, 0, 1], [1, 1, 1], [0] * 30, [-1, -1, -1, 0]])
def test_a_mean_at_its_bounds_has_the_interval_of_two_more_people(values):
    found = participant_mean([[value] for value in values], (-1, 1))
    more = np.array([*values, -1, 1])
    low, high = stats.t.interval(0.95, len(values) + 1, more.mean(), stats.sem(more))
    assert (found.low, found.high) == pytest.approx((max(-1, low), min(1, high)))
    assert found.low <= found.value <= found.high


@pytest.mark.parametrize("seed", range(2))
def test_sign_flips_are_scipys_permutations(seed):
    rng = np.random.default_rng(seed)
    values = [Fraction(int(v), 6) for v in rng.integers(-6, 9, size=12)]
    expected = stats.permutation_test(
        ([float(value) for value in values],),
        lambda x, axis: np.mean(x, axis=axis),
        permutation_type="samples",
        n_resamples=2**13,
    )
    assert sign_flip(values) == pytest.approx(expected.pvalue, abs=1e-9)


def test_without_any_difference_p_is_one():
    assert sign_flip([]) == sign_flip([Fraction(0)] * 5) == 1.0


def test_denominators_with_nothing_in_common_are_drawn():
    primes = [101, 103, 107, 109, 113, 127, 131, 137, 139, 149, 151, 157]
    values = [Fraction(prime // 2, prime) for prime in primes]
    assert sign_flip(values) == pytest.approx(2 / 2**12, abs=2e-4)


def test_p_values_have_three_decimals():
    shown = [str(PValue(p)) for p in (0.04567, 0.0009, 1, math.nan)]
    assert shown == ["0.046", "< .001", "1.000", "–"]


def test_kappa_is_the_textbooks():
    # Cohen (1960): 20 yes-yes, 5 yes-no, 10 no-yes, 15 no-no: (.7 - .5) / (1 - .5).
    pairs = [(True, True)] * 20 + [(True, False)] * 5 + [(False, True)] * 10 + [(False, False)] * 15
    found = kappa([[pair] for pair in pairs])
    assert found.value == pytest.approx(0.4)
    assert found.low < 0.4 < found.high
    # The asymptotic standard error of Fleiss, Cohen and Everitt (1969) is .1268 here.
    assert found.high - found.low == pytest.approx(2 * 1.96 * 0.1268, rel=0.15)
    assert math.isnan(kappa([[(True, True)] * 3]).value)
    assert math.isnan(kappa([]).value)


@pytest.mark.parametrize("turns", [1, -1])
def test_six_sessions_that_agree_or_are_told_apart_are_no_certainty(turns):
    agreed = kappa([[(number > 2, number > 2)] for number in range(6)])
    assert (agreed.value, agreed.high) == (1, 1)
    assert 0 < agreed.low < 0.7
    found = auroc([[(turns * number, number > 2)] for number in range(6)])
    assert found.value == (turns > 0)
    assert found.low <= found.value <= found.high
    assert 0.4 < found.high - found.low < 0.9


def test_auroc_counts_the_pairs_in_order():
    sessions = [(0.1, False), (0.4, False), (0.35, True), (0.8, True)]
    assert auroc([[session] for session in sessions]).value == 0.75
    assert auroc([sessions]).value == 0.75
    assert math.isnan(auroc([sessions]).low)
    assert auroc([[(0.5, True)], [(0.5, False)]]).value == 0.5
    assert math.isnan(auroc([[(0.1, False)]]).value)


def test_the_interval_of_auroc_is_of_people():
    rng = np.random.default_rng(0)
    failed = rng.random(400) < 0.4
    sessions = list(zip((rng.normal(size=400) + failed).tolist(), failed.tolist(), strict=True))
    strangers = auroc([[session] for session in sessions])
    assert strangers.low < stats.norm.cdf(1 / math.sqrt(2)) < strangers.high
    # The standard error of Hanley and McNeil (1982) is .025 here.
    assert strangers.high - strangers.low == pytest.approx(2 * 1.96 * 0.025, rel=0.15)
    # Who has each session four times says no more than who has it once.
    again = auroc([[session] * 4 for session in sessions])
    assert again.high - again.low == pytest.approx(strangers.high - strangers.low, rel=0.1)


def power(capsys, command):
    """Returns how often the difference is found, and the standard error, as printed."""
    assert main(["power", *command.split()]) == 0
    return [float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize(("pairs", "expected"), [(1, 0.558), (5, 0.319)])
def test_power_without_differences_between_people_is_the_sign_tests(capsys, pairs, expected):
    """Its closed form: a sum over how many people differ and how many of them upward."""
    command = f"0.6 0.4 66 --person-sd 0 --pairs {pairs} --simulations 800"
    assert power(capsys, command) == [pytest.approx(expected, abs=4.5 * 0.018), 0.018]


def test_between_equal_agents_a_difference_is_found_no_more_often_than_the_level(capsys):
    found, _ = power(capsys, "0.5 0.5 24 --sessions 2 --person-sd 1.5 --simulations 500")
    assert found <= 0.05 + 4.5 * math.sqrt(0.05 * 0.95 / 500)
