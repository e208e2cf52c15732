"""Estimates and tests whose unit is the participant: the sessions of one are not independent."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from fractions import Fraction
from itertools import chain
from statistics import fmean
from typing import Any

import numpy as np
from scipy import stats

from bbq_torchrl.utils.statistics import CONFIDENCE, ROUNDING, Estimate, estimate

_MAX_SUMS = 5_000_000
_RANDOM_FLIPS = 99_999
_RESAMPLES = 2_000


def proportion(by_person: Collection[Sequence[bool]]) -> Estimate:
    """Returns the share of participants' sessions that succeed.

    The interval is Wilson's if nobody has several sessions, else that of :func:`participant_mean`.

    Args:
        by_person: each participant's successes and failures.

    Examples:
        >>> print(proportion([[True]] * 40 + [[False]] * 26))
        0.61 [0.49, 0.71]
    """
    sessions = list(chain(*by_person))
    if not sessions or any(len(person) > 1 for person in by_person):
        return participant_mean(by_person, (0.0, 1.0))
    found = stats.binomtest(sum(sessions), len(sessions)).proportion_ci(CONFIDENCE, "wilson")
    value = fmean(sessions)
    # Rounding must not put a rate of 0 or 1 outside its interval.
    return Estimate(value, min(value, float(found.low)), max(value, float(found.high)), ".2f")


def participant_mean(
    by_person: Collection[Sequence[float]], bounds: tuple[float, float]
) -> Estimate:
    """Returns the mean of participants' means, with a Student t interval if there are several.

    If that interval exceeds ``bounds``, or has no width because all participants are alike, two
    participants are added, one at each bound, and the new interval is clipped to ``bounds``.
    Bonett and Price (2012) adjust the interval of a difference of paired rates like this.

    Args:
        by_person: each participant's values.
        bounds: the smallest and the largest possible value.

    Examples:
        >>> print(participant_mean([[5.0], [5.0], [5.0]], (1, 5)))
        5.00 [1.98, 5.00]
    """
    means = [fmean(person) for person in by_person if person]
    if not means:
        return Estimate(math.nan)
    found = estimate(means, ".2f", bounds=bounds)
    if found.low == bounds[0] or found.high == bounds[1] or found.low == found.high:
        more = estimate([*means, *bounds], bounds=bounds)
        low, high = min(found.value, more.low), max(found.value, more.high)
        return Estimate(found.value, low, high, ".2f")
    return found


def kappa(by_person: Sequence[Sequence[tuple[bool, bool]]]) -> Estimate:
    """Returns Cohen's κ of two judges with its interval by :func:`bootstrap`.

    Args:
        by_person: each participant's pairs of verdicts.

    Returns:
        The estimate; NaN if all verdicts are the same, which leaves no agreement beyond chance.
    """
    all_verdicts = [(True, True), (True, False), (False, True), (False, False)]
    return bootstrap(_kappa, by_person, [all_verdicts])


def _kappa(verdicts: Any, counts: Any) -> Any:
    total = counts.sum(-1)
    agreed = counts @ (verdicts[:, 0] == verdicts[:, 1]) / total
    one, other = (counts @ verdicts).T / total
    chance = one * other + (1 - one) * (1 - other)
    return (agreed - chance) / (1 - chance)


def auroc(by_person: Sequence[Sequence[tuple[float, bool]]]) -> Estimate:
    """Returns the probability that a failure scores higher than a success, ties counting half.

    Args:
        by_person: each participant's sessions, with score and whether they failed.

    Returns:
        The estimate with its interval by :func:`bootstrap`; NaN without failures or without
        successes.
    """
    return bootstrap(_auroc, by_person, [[(math.inf, True)], [(-math.inf, True)]])


def _auroc(sessions: Any, counts: Any) -> Any:
    scores, has_failed = sessions[:, 0], sessions[:, 1] == 1
    wins = (np.sign(np.subtract.outer(scores[has_failed], scores[~has_failed])) + 1) / 2
    failures, successes = counts[:, has_failed], counts[:, ~has_failed]
    return ((failures @ wins) * successes).sum(-1) / (failures.sum(-1) * successes.sum(-1))


def bootstrap(
    statistic: Callable[[Any, Any], Any],
    by_person: Sequence[Sequence[tuple[float, float]]],
    doubtful: Sequence[Sequence[tuple[float, float]]],
) -> Estimate:
    """Returns a statistic with its 95 % percentile bootstrap interval over participants.

    Args:
        statistic: from the values of sessions, shape [sessions, 2], and from how often each is
            drawn, shape [samples, sessions], to [samples]; NaN where it is undefined.
        by_person: the values of each participant's sessions.
        doubtful: participants who are added if all resamples are equal, such as those of a few
            sessions that all agree: they give the interval a width.
    """
    people = [person for person in by_person if person]
    if not people:
        return Estimate(math.nan)
    with np.errstate(invalid="ignore"):
        value = float(statistic(*_sessions(people, np.ones((1, len(people)))))[0])
        if math.isnan(value) or len(people) < 2:
            return Estimate(value, spec=".2f")
        for drawn_from in (people, [*people, *doubtful]):
            count = len(drawn_from)
            times = np.random.default_rng(0).multinomial(count, [1 / count] * count, _RESAMPLES)
            drawn = statistic(*_sessions(drawn_from, times))
            ends = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
            low, high = np.nanquantile(drawn, ends).tolist()
            if high - low > ROUNDING:
                break
    return Estimate(value, min(low, value), max(high, value), ".2f")


def _sessions(people: Sequence[Sequence[tuple[float, float]]], times: Any) -> tuple[Any, Any]:
    """Returns the values of all sessions, and how often each is drawn when people are."""
    whose = np.repeat(range(len(people)), [len(person) for person in people])
    return np.array([*chain(*people)], dtype=float), times[:, whose]


def sign_flip(differences: Sequence[Fraction]) -> float:
    """Returns the two-sided p-value of the sign-flip permutation test of a mean of 0.

    If two agents are alike, a participant's difference between them is as likely as its opposite:
    p is the share of all sign flips whose sum is at least as far from 0. All sign flips are
    counted, or 99,999 random ones (by SciPy) if the denominators have too little in common.

    Args:
        differences: one for each participant.

    Examples:
        >>> from fractions import Fraction
        >>> sign_flip([Fraction(1)] * 6)
        0.03125
    """
    weights = [difference for difference in differences if difference]
    scale = math.lcm(*(weight.denominator for weight in weights))
    sizes = [abs(int(weight * scale)) for weight in weights]
    if sum(sizes) > _MAX_SUMS:
        found = stats.permutation_test(
            (np.array(weights, dtype=float),),
            np.mean,
            permutation_type="samples",
            n_resamples=_RANDOM_FLIPS,
            rng=np.random.default_rng(0),
        )
        return float(found.pvalue)
    # ways[s]: probability that the weights flipped to the positive side add up to s.
    ways = np.ones(1)
    for size in sizes:
        ways = np.pad(ways, (0, size)) / 2 + np.pad(ways, (size, 0)) / 2
    sums = np.abs(2 * np.arange(ways.size) - sum(sizes))
    return min(1.0, float(ways[sums >= abs(int(sum(weights) * scale))].sum()))
