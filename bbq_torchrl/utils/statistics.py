"""Estimates with their intervals, and tests. The unit is the training seed or the participant.

Dialogues of one seed, and sessions of one participant, are not independent. The standard error over
dialogues (:func:`binomial_standard_error`) covers the measurement of one trained agent; the spread
over seeds (:func:`estimate`) covers training.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from statistics import fmean
from typing import Any

import numpy as np
from scipy import special, stats

from bbq_torchrl.utils.text import EMPTY

CONFIDENCE = 0.95
"""Confidence level of every interval."""

ALPHA = 0.05
"""Significance level of every test."""

RESAMPLES = 9_999
MIN_BOOTSTRAP = 5
"""Minimum number of seeds for a bootstrap: fewer give too few distinct samples."""

ROUNDING = 1e-9
"""Tolerance by which a mean over rounds may exceed its bounds, and equal numbers may differ."""

_MAX_SUMS = 5_000_000
_RANDOM_FLIPS = 99_999


@dataclass(frozen=True)
class Estimate:
    """A value over seeds or participants with its interval.

    Attributes:
        value: the estimate; NaN without data.
        low: lower end of the interval; NaN with too few data.
        high: upper end of the interval; NaN with too few data.
        spec: default format of the numbers; ``+.3f`` shows the sign of differences.
    """

    value: float
    low: float = math.nan
    high: float = math.nan
    spec: str = field(default=".3f", compare=False)

    def __str__(self) -> str:
        return format(self)

    def __format__(self, spec: str) -> str:
        """Formats each number by ``spec``."""
        spec = spec or self.spec
        if math.isnan(self.value):
            return EMPTY
        if math.isnan(self.low):
            return format(self.value, spec)
        return f"{self.value:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"

    def csv_columns(self) -> dict[str, float]:
        """Returns suffixes of CSV columns and their numbers."""
        return {"": self.value, "_low": self.low, "_high": self.high}


class PValue(float):
    """A p-value, printed with three decimals; NaN if there was nothing to test."""

    def __str__(self) -> str:
        if math.isnan(self):
            return EMPTY
        return f"{float(self):.3f}" if self >= 0.001 else "< .001"

    def csv_columns(self) -> dict[str, float]:
        """Returns the suffix of the CSV column and the number."""
        return {"": float(self)}


def binomial_standard_error(rate: float, dialogues: int) -> float:
    """Standard error of a success rate over independent dialogues of one agent.

    ``sqrt(rate (1 - rate) / dialogues)``, the maximum-likelihood estimate of the binomial's.

    Args:
        rate: successes / dialogues, in [0, 1].
        dialogues: number of dialogues.

    Examples:
        >>> round(binomial_standard_error(0.5, 10_000), 4)
        0.005
    """
    return math.sqrt(rate * (1 - rate) / dialogues)


def interquartile_mean(values: Any, axis: int = -1) -> Any:
    """Returns the mean of the middle half: ``int(n / 4)`` of n values are dropped at each end.

    The 25 % trimmed mean of Agarwal et al. (2021, "Deep RL at the edge of the statistical
    precipice"). Five values keep the middle three; fewer than four keep all.

    Examples:
        >>> float(interquartile_mean([0.0, 1.0, 2.0, 3.0, 100.0]))
        2.0
    """
    return stats.trim_mean(np.asarray(values, dtype=float), 0.25, axis=axis)


def estimate(
    values: Sequence[float], spec: str = ".3f", *, bounds: tuple[float, float] = (0.0, 1.0)
) -> Estimate:
    """Returns the mean over training seeds with its 95 % Student t interval, clipped to ``bounds``.

    A single seed has no interval. The t interval assumes normally distributed seeds; with few of
    them a bootstrap would be too narrow: for five such seeds the BCa interval covers the mean in
    about 85 % of cases.

    Args:
        values: one value per seed.
        spec: the format of the :class:`Estimate`.
        bounds: smallest and largest possible value; a rate's by default.

    Raises:
        ValueError: no values, or a value that is not finite or out of bounds.

    Examples:
        >>> print(estimate([0.7, 0.72, 0.74, 0.76, 0.78]))
        0.740 [0.701, 0.779]
        >>> print(estimate([0.35, 0.47]))
        0.410 [0.000, 1.000]
    """
    data, (least, most) = _finite(values), bounds
    if data.min() < least - ROUNDING or data.max() > most + ROUNDING:
        raise ValueError(f"values must be from {least:g} to {most:g}, got {list(values)}")
    if data.size == 1:
        return Estimate(float(data[0]), spec=spec)
    mean = float(data.mean())
    half = half_width(data)
    return Estimate(mean, max(least, mean - half), min(most, mean + half), spec)


def estimate_iqm(values: Sequence[float]) -> Estimate:
    """Returns the interquartile mean over training seeds with its 95 % bootstrap interval.

    The bootstrap is bias-corrected and accelerated (BCa, ``scipy.stats.bootstrap``), or by
    percentiles where BCa is undefined. Fewer than five seeds have no interval.

    Args:
        values: one value per seed.

    Raises:
        ValueError: no values, or a value that is not finite.

    Examples:
        >>> print(estimate_iqm([0.7, 0.72, 0.74, 0.76, 0.78]))
        0.740 [0.707, 0.773]
    """
    data = _finite(values)
    value = float(interquartile_mean(data))
    if data.size < MIN_BOOTSTRAP:
        return Estimate(value)
    for method in ("BCa", "percentile"):  # BCa is undefined if all values are equal, for example
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            interval = stats.bootstrap(
                (data,),
                interquartile_mean,
                n_resamples=RESAMPLES,
                confidence_level=CONFIDENCE,
                method=method,
                rng=np.random.default_rng(0),
            ).confidence_interval
        if math.isfinite(interval.low) and math.isfinite(interval.high):
            break
    return Estimate(value, float(interval.low), float(interval.high))


def _finite(values: Sequence[float]) -> Any:
    data = np.asarray(values, dtype=float)
    if data.size == 0 or not np.isfinite(data).all():
        raise ValueError(f"values must be finite numbers, at least one, got {list(values)}")
    return data


def t_test(differences: Sequence[float]) -> float:
    """Returns the two-sided p-value of Student's t test that the mean difference is 0.

    A single difference gives 1. Equal differences, which have no spread, give 1 if they are 0, else
    0.

    Examples:
        >>> round(t_test([0.1, 0.2, 0.3]), 4)
        0.0742
    """
    if len(differences) < 2:
        return 1.0
    if len({*differences}) == 1:
        return float(differences[0] == 0)
    return float(stats.ttest_1samp(differences, 0).pvalue)


def half_width(values: Any) -> float:
    """Returns half the width of the 95 % Student t interval of the mean of at least two values.

    Examples:
        >>> round(half_width([0.7, 0.72, 0.74, 0.76, 0.78]), 3)
        0.039
    """
    quantile = stats.t.ppf((1 + CONFIDENCE) / 2, len(values) - 1)
    return float(quantile * stats.sem(values))


def holm(p_values: Sequence[float]) -> list[float]:
    """Returns Holm's (1979) adjusted p-values, in the given order.

    Examples:
        >>> holm([0.01, 0.04, 0.03])
        [0.03, 0.06, 0.06]
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted


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
    resamples: int = 2_000,
) -> Estimate:
    """Returns a statistic with its 95 % percentile bootstrap interval over participants.

    Args:
        statistic: from the values of sessions, shape [sessions, 2], and from how often each is
            drawn, shape [samples, sessions], to [samples]; NaN where it is undefined.
        by_person: the values of each participant's sessions.
        doubtful: participants who are added if all resamples are equal, such as those of a few
            sessions that all agree: they give the interval a width.
        resamples: the number of bootstrap samples.
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
            times = np.random.default_rng(0).multinomial(count, [1 / count] * count, resamples)
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


def pass_k(successes: Any, plays: Any, k: int) -> Any:
    """Returns pass^k: the probability that an agent reaches the same goal ``k`` times in a row.

    Yao et al. (2024, "tau-bench"): the mean over goals of C(c, k) / C(n, k), the unbiased estimate
    from c successes in n plays. Goals with fewer than ``k`` plays are left out.

    Args:
        successes: number of successes, shape [..., goals].
        plays: number of plays, the same shape.
        k: number of plays that must all succeed.

    Returns:
        Shape [...]; NaN if no goal was played ``k`` times.

    Examples:
        >>> [float(pass_k([4, 2], [4, 4], k)) for k in (1, 2)]
        [0.75, 0.5833333333333334]
    """
    successes, plays = np.asarray(successes), np.asarray(plays)
    counts = plays >= k
    shares = special.comb(successes, k) / np.where(counts, special.comb(plays, k), 1)
    goals = counts.sum(-1)
    return np.where(goals > 0, np.where(counts, shares, 0).sum(-1) / np.maximum(goals, 1), np.nan)


def probability_of_improvement(one: Any, other: Any) -> Any:
    """Returns the probability that a run of one agent scores higher than a run of the other.

    Agarwal et al. (2021): the mean over settings; a tie counts one half.

    Args:
        one: scores, shape [..., settings, seeds].
        other: scores, shape [..., settings, seeds].

    Examples:
        >>> float(probability_of_improvement([[0.1, 0.3]], [[0.2, 0.3]]))
        0.375
    """
    left, right = np.asarray(one)[..., :, None], np.asarray(other)[..., None, :]
    return ((left > right) + 0.5 * (left == right)).mean((-3, -2, -1))


def performance_profile(scores: Any, levels: Any) -> Any:
    """Returns the share of runs that score more than each level (Agarwal et al. 2021).

    Args:
        scores: shape [..., settings, seeds].
        levels: shape [levels].

    Returns:
        Shape [..., levels].

    Examples:
        >>> performance_profile([[0.2, 0.6]], [0.0, 0.5, 0.9]).tolist()
        [1.0, 0.5, 0.0]
    """
    return np.stack([(np.asarray(scores) > level).mean((-2, -1)) for level in levels], -1)


def stratified(statistic: Callable[..., Any], *scores: Any, resamples: int = 2_000) -> Any:
    """Returns a statistic's 95 % interval by a bootstrap that draws seeds within each setting.

    The stratified percentile bootstrap of Agarwal et al. (2021); groups are drawn independently.

    Args:
        statistic: from arrays [resamples, settings, seeds] to [resamples, ...].
        scores: a group's scores, shape [settings, seeds]; one array for each argument.
        resamples: number of bootstrap samples.

    Returns:
        Shape [2, ...]; NaN with fewer than five seeds.
    """
    rng = np.random.default_rng(0)
    drawn = [
        np.take_along_axis(
            np.asarray(group)[None],
            rng.integers(len(group[0]), size=(resamples, *np.shape(group))),
            -1,
        )
        for group in scores
    ]
    ends = np.quantile(statistic(*drawn), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    enough = min(np.shape(group)[-1] for group in scores) >= MIN_BOOTSTRAP
    return ends if enough else np.full_like(ends, np.nan)
