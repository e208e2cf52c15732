"""Estimates with their intervals, and tests. The unit is the training seed.

Dialogues of one seed are not independent. The standard error over dialogues
(:func:`binomial_standard_error`) covers the measurement of one trained agent; the spread over seeds
(:func:`estimate`) covers training.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import special, stats

from bbq_torchrl.utils.text import EMPTY

CONFIDENCE = 0.95
"""Confidence level of every interval."""

ALPHA = 0.05
"""Significance level of every test."""

MIN_BOOTSTRAP = 5
"""Minimum number of seeds for a bootstrap: fewer give too few distinct samples."""

ROUNDING = 1e-9
"""Tolerance by which a mean over rounds may exceed its bounds, and equal numbers may differ."""


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


def interquartile_mean(values: Any) -> Any:
    """Returns the mean of the middle half: ``int(n / 4)`` of n values are dropped at each end.

    The 25 % trimmed mean of Agarwal et al. (2021, "Deep RL at the edge of the statistical
    precipice"). Five values keep the middle three; fewer than four keep all.

    Examples:
        >>> float(interquartile_mean([0.0, 1.0, 2.0, 3.0, 100.0]))
        2.0
    """
    return stats.trim_mean(np.asarray(values, dtype=float), 0.25, axis=-1)


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
    data, (least, most) = np.asarray(values, dtype=float), bounds
    is_allowed = np.isfinite(data) & (data >= least - ROUNDING) & (data <= most + ROUNDING)
    if data.size == 0 or not is_allowed.all():
        raise ValueError(
            f"values must be finite, from {least:g} to {most:g}, at least one, got {list(values)}"
        )
    if data.size == 1:
        return Estimate(float(data[0]), spec=spec)
    mean = float(data.mean())
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, data.size - 1) * stats.sem(data))
    return Estimate(mean, max(least, mean - half), min(most, mean + half), spec)


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


def bootstrapped(statistic: Callable[..., Any], *scores: Any) -> Estimate:
    """Returns a statistic of groups with its interval by :func:`stratified`, with its arguments."""
    low, high = stratified(statistic, *scores)
    return Estimate(float(statistic(*map(np.asarray, scores))), float(low), float(high))


def estimate_iqm(scores: Any) -> Estimate:
    """Returns the interquartile mean over seeds with its 95 % bootstrap interval.

    Args:
        scores: a value per seed, shape [seeds] or [settings, seeds].

    Examples:
        >>> print(estimate_iqm([0.7, 0.72, 0.74, 0.76, 0.78]))
        0.740 [0.713, 0.773]
    """
    return bootstrapped(
        lambda drawn: interquartile_mean(drawn.reshape(*drawn.shape[:-2], -1)),
        np.atleast_2d(scores),
    )
