"""Estimates and tests of a study. The unit is the participant, whose sessions are not independent.

scipy has the classical tests; this module adds others, and handles data that are all equal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize, stats

from bbq_torchrl.utils.statistics import CONFIDENCE, half_width

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from fractions import Fraction

_Z = float(stats.norm.ppf((1 + CONFIDENCE) / 2))
_MAX_SUMS = 5_000_000
_RESAMPLES = 99_999
_BOOTSTRAPS = 2_000
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval.

    Attributes:
        value: the estimate; NaN without data.
        low: lower end; NaN without an interval.
        high: upper end; NaN without an interval.
        count: the number of observations.
    """

    value: float
    low: float
    high: float
    count: int

    def __str__(self) -> str:
        if math.isnan(self.value):
            return "–"
        interval = "" if math.isnan(self.low) else f" [{self.low:.2f}, {self.high:.2f}]"
        return f"{self.value:.2f}{interval}"


def proportion(by_person: Collection[Sequence[bool]]) -> Interval:
    """Returns the share of successes with its Wilson interval.

    If participants have several sessions, the number of sessions is divided by the design effect:
    the variance between participants over the binomial one (at least 1).

    Args:
        by_person: each participant's successes and failures.

    Examples:
        >>> print(proportion([[True]] * 40 + [[False]] * 26))
        0.61 [0.49, 0.71]
    """
    people = [person for person in by_person if person]
    count = sum(map(len, people))
    if not count:
        return Interval(math.nan, math.nan, math.nan, 0)
    rate = sum(map(sum, people)) / count
    effective = count / _design_effect(people, rate, count)
    return Interval(rate, *_wilson(rate, effective), count)


def _wilson(rate: float, count: float) -> tuple[float, float]:
    shrink = 1 + _Z**2 / count
    center = (rate + _Z**2 / (2 * count)) / shrink
    spread = rate * (1 - rate) / count + _Z**2 / (4 * count**2)
    half = _Z * math.sqrt(spread) / shrink
    # Rounding must not put a rate of 0 or 1 outside its interval.
    return max(0.0, min(rate, center - half)), min(1.0, max(rate, center + half))


def _design_effect(people: Sequence[Sequence[bool]], rate: float, count: int) -> float:
    if count == len(people) or len(people) < 2 or rate in (0.0, 1.0):
        return 1.0
    between = sum((sum(person) - rate * len(person)) ** 2 for person in people)
    variance = between * len(people) / (len(people) - 1) / count**2
    return max(1.0, variance / (rate * (1 - rate) / count))


def mean(by_person: Collection[Sequence[float]], bounds: tuple[float, float]) -> Interval:
    """Returns the mean of participants' means, with a Student t interval if there are several.

    If that interval exceeds ``bounds``, or has no width because all participants are alike, two
    participants are added, one at each bound, and the new interval is clipped to ``bounds``.
    Bonett and Price (2012) adjust the interval of a difference of paired rates like this.

    Args:
        by_person: each participant's values.
        bounds: the smallest and the largest possible value.

    Examples:
        >>> print(mean([[5.0], [5.0], [5.0]], (1, 5)))
        5.00 [1.98, 5.00]
    """
    means = [sum(person) / len(person) for person in by_person if person]
    count = sum(map(len, by_person))
    if not means:
        return Interval(math.nan, math.nan, math.nan, 0)
    value = sum(means) / len(means)
    if len(means) == 1:
        return Interval(value, math.nan, math.nan, count)
    least, most = bounds
    half = half_width(means)
    low, high = value - half, value + half
    if low < least or high > most or len({*means}) == 1:
        means = [*means, least, most]
        center, half = sum(means) / len(means), half_width(means)
        low, high = max(least, min(value, center - half)), min(most, max(value, center + half))
    return Interval(value, low, high, count)


def sign_flip(differences: Sequence[Fraction]) -> float:
    """Returns the two-sided p-value of the sign-flip permutation test of a mean of 0.

    If two agents are alike, a participant's difference between them is as likely as its opposite:
    p is the share of all sign flips whose sum is at least as far from 0. All sign flips are
    counted, or 99,999 random ones (by scipy) if the denominators have too little in common.

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
            ([float(weight) for weight in weights],),
            lambda values, axis: np.mean(values, axis=axis),
            permutation_type="samples",
            n_resamples=_RESAMPLES,
            rng=np.random.default_rng(0),
        )
        return float(found.pvalue)
    # ways[s]: probability that the weights flipped to the positive side add up to s.
    ways = np.ones(1)
    for size in sizes:
        ways = np.pad(ways, (0, size)) / 2 + np.pad(ways, (size, 0)) / 2
    sums = np.abs(2 * np.arange(ways.size) - sum(sizes))
    return min(1.0, float(ways[sums >= abs(int(sum(weights) * scale))].sum()))


def two_by_two(one: Sequence[int], other: Sequence[int]) -> tuple[float, float]:
    """Returns Fisher's and Boschloo's exact p-values; both treat sessions as independent."""
    table = [[sum(side), len(side) - sum(side)] for side in (one, other)]
    if not one or not other or 0 in np.sum(table, axis=0):
        return 1.0, 1.0
    # Boschloo's statistic is a maximum found on a grid, which rounds beyond 1.
    boschloo = float(stats.boschloo_exact(table).pvalue)
    return float(stats.fisher_exact(table).pvalue), min(1.0, boschloo)


def mann_whitney(one: Sequence[float], other: Sequence[float]) -> float:
    """Returns the p-value of the Mann-Whitney test; it treats sessions as independent."""
    if not one or not other or len({*one, *other}) == 1:
        return 1.0
    return float(stats.mannwhitneyu(one, other).pvalue)


def kappa(by_person: Sequence[Sequence[tuple[bool, bool]]], seed: int = 0) -> Interval:
    """Returns Cohen's κ of two judges with its bootstrap interval over participants.

    If all resamples have the same κ, the interval is Wilson's for the share of equal verdicts, with
    each participant counted once.

    Args:
        by_person: each participant's pairs of verdicts.
        seed: seed of the bootstrap.

    Returns:
        The estimate; NaN if all verdicts are the same, which leaves no agreement beyond chance.
    """
    tables = np.array([_agreement(person) for person in by_person], dtype=float).reshape(-1, 2, 2)
    count = int(tables.sum())
    value = float(_kappa(tables.sum(0)))
    if len(tables) < 2 or math.isnan(value):
        return Interval(value, math.nan, math.nan, count)
    chosen = np.random.default_rng(seed).integers(len(tables), size=(_BOOTSTRAPS, len(tables)))
    drawn = _kappa(tables[chosen].sum(1))
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    if high - low < _ROUNDING:
        agreed, chance = _agreed_and_chance(tables.sum(0))
        low, high = ((end - chance) / (1 - chance) for end in _wilson(float(agreed), len(tables)))
    return Interval(value, float(low), float(high), count)


def _agreement(pairs: Sequence[tuple[bool, bool]]) -> list[list[int]]:
    return [[pairs.count((row, column)) for column in (False, True)] for row in (False, True)]


def _kappa(tables: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore", divide="ignore"):
        agreed, chance = _agreed_and_chance(tables)
        found = (agreed - chance) / (1 - chance)
    return np.where(np.isfinite(found), found, np.nan)


def _agreed_and_chance(tables: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the share of verdicts that agree, and the share by chance, shapes [*tables]."""
    count = tables.sum((-2, -1))
    agreed = (tables[..., 0, 0] + tables[..., 1, 1]) / count
    return agreed, (tables.sum(-1) * tables.sum(-2)).sum(-1) / count**2


def auroc(by_person: Sequence[Sequence[tuple[float, bool]]], seed: int = 0) -> Interval:
    """Returns the probability that a failure scores higher than a success, ties counting half.

    If all resamples give the same value, such as those of a few sessions that the score separates,
    the interval is Newcombe's, with each participant counted once.

    Args:
        by_person: each participant's sessions, with score and whether they failed.
        seed: seed of the bootstrap.

    Returns:
        The estimate with its bootstrap interval over participants; NaN without failures or without
        successes.
    """
    people = len(by_person)
    rows = [(*pair, who) for who, pairs in enumerate(by_person) for pair in pairs]
    high = [(score, who) for score, has_failed, who in rows if has_failed]
    low = [(score, who) for score, has_failed, who in rows if not has_failed]
    if not high or not low:
        return Interval(math.nan, math.nan, math.nan, len(rows))
    above = np.subtract.outer([score for score, _ in high], [score for score, _ in low])
    wins = (np.sign(above) + 1) / 2
    value = float(wins.mean())
    if people < 2:
        return Interval(value, math.nan, math.nan, len(rows))
    # The bootstrap's counts of each participant, which weight the pairs of sessions.
    drawn = np.random.default_rng(seed).multinomial(people, [1 / people] * people, _BOOTSTRAPS)
    of_high, of_low = (drawn[:, [who for _, who in side]] for side in (high, low))
    with np.errstate(invalid="ignore"):
        found = ((of_high @ wins) * of_low).sum(1) / (of_high.sum(1) * of_low.sum(1))
    lower, upper = np.nanpercentile(found, [2.5, 97.5])
    if upper - lower < _ROUNDING:
        once = people / len(rows)
        lower, upper = _newcombe(value, len(high) * once, len(low) * once)
    return Interval(value, float(lower), float(upper), len(rows))


def _newcombe(area: float, failures: float, successes: float) -> tuple[float, float]:
    """Returns the interval of an AUROC by method 5 of Newcombe (2006), like Wilson's of a rate.

    The estimate is 1.96 standard errors from each end. The standard error is that of the end, by
    Hanley and McNeil (1982).
    """
    more = max(0.0, (failures + successes) / 2 - 1)

    def beyond(end: float) -> float:
        either = (1 - end) / (2 - end) + end / (1 + end)
        variance = end * (1 - end) * (1 + more * either) / (failures * successes)
        return (area - end) ** 2 - _Z**2 * variance

    # At 0 and 1 the standard error is 0, so they would be found as their own ends.
    low = optimize.brentq(beyond, 0.0, min(area, 1 - _ROUNDING)) if area > _ROUNDING else 0.0
    high = optimize.brentq(beyond, max(area, _ROUNDING), 1.0) if area < 1 - _ROUNDING else 1.0
    return low, high
