"""Estimates over training seeds and their intervals. The unit is the seed, never the dialogue.

Dialogues of one trained agent only tell how well *that* agent was measured
(:func:`binomial_standard_error`); what another training would give is told by the spread over seeds
(:func:`estimate`). Where seeds of two agents belong together in pairs, what they have in common
cancels out of their differences (:func:`paired_differences`).
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy import stats

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

__all__ = [
    "Estimate",
    "Summary",
    "binomial_standard_error",
    "estimate",
    "interquartile_mean",
    "paired_differences",
    "probability_of_improvement",
    "summarize",
    "t_test",
]

Statistic = Literal["mean", "iqm"]
Method = Literal["bootstrap", "t"]

CONFIDENCE = 0.95
RESAMPLES = 9_999
MIN_BOOTSTRAP = 5
"""Below so many seeds a bootstrap has too few distinct samples to mean anything."""

MIN_IQM = 4
"""Below so many seeds the interquartile mean drops nothing and is the mean."""


@dataclass(frozen=True)
class Estimate:
    """A value over seeds with its interval.

    Attributes:
        value: the estimate.
        low: lower end of the interval; NaN where one seed gives none.
        high: upper end of the interval; NaN where one seed gives none.
        count: number of seeds.
        method: how the interval was made: ``bootstrap``, ``t`` or ``none``.
    """

    value: float
    low: float
    high: float
    count: int
    method: str

    def interval(self, spec: str = ".3f") -> str:
        """Returns the interval alone: ``[0.701, 0.779]``, or a dash where there is none."""
        return "–" if math.isnan(self.low) else f"[{self.low:{spec}}, {self.high:{spec}}]"

    def __str__(self) -> str:
        return format(self)

    def __format__(self, spec: str) -> str:
        """Formats each number by ``spec``: ``f"{difference:+.3f}"`` shows the signs."""
        spec = spec or ".3f"
        if math.isnan(self.low):
            return format(self.value, spec)
        return f"{self.value:{spec}} {self.interval(spec)}"


@dataclass(frozen=True)
class Summary:
    """A quantity over seeds.

    Attributes:
        bootstrap: the mean with its bootstrap interval; the interval is NaN below five seeds.
        t: the mean with its Student t interval; the interval is NaN for one seed.
        iqm: interquartile mean with its bootstrap interval; the interval is NaN below five seeds.
    """

    bootstrap: Estimate
    t: Estimate
    iqm: Estimate


def binomial_standard_error(rate: float, dialogues: int) -> float:
    """Standard error of a success rate over independent dialogues of one agent.

    ``sqrt(rate (1 - rate) / dialogues)``, the maximum-likelihood estimate of the binomial's.

    Args:
        rate: successes / dialogues, in [0, 1].
        dialogues: how many were played.

    Example:
        >>> round(binomial_standard_error(0.5, 10_000), 4)
        0.005
    """
    return math.sqrt(rate * (1 - rate) / dialogues)


def interquartile_mean(values: Any, axis: int = -1) -> Any:
    """Mean of the middle half: the lowest and the highest ``int(n / 4)`` of n values are dropped.

    The 25 % trimmed mean that Agarwal et al. (2021, "Deep RL at the edge of the statistical
    precipice") report. Five values keep the middle three; fewer than four keep all.

    Example:
        >>> float(interquartile_mean([0.0, 1.0, 2.0, 3.0, 100.0]))
        2.0
    """
    return stats.trim_mean(np.asarray(values, dtype=float), 0.25, axis=axis)


def estimate(
    values: Sequence[float],
    statistic: Statistic = "mean",
    method: Method = "bootstrap",
    seed: int = 0,
) -> Estimate:
    """A statistic over training seeds with a 95 % interval.

    ``bootstrap``: seeds are resampled with replacement, bias-corrected and accelerated (BCa,
    ``scipy.stats.bootstrap``); percentiles where BCa is undefined. ``t``: the Student t interval of
    the mean, which assumes normally distributed seeds. With few seeds the bootstrap is too narrow
    (for five normally distributed seeds its 95 % interval holds the mean in about 85 % of cases,
    the t interval in 95 %); below five seeds the t interval of the mean is therefore used whatever
    ``method`` says, and there is none for a single seed.

    Args:
        values: one value for each seed.
        statistic: ``mean`` or ``iqm`` (see :func:`interquartile_mean`).
        method: ``bootstrap`` or ``t``; ``t`` only for the mean.
        seed: of the bootstrap's resampling.

    Raises:
        ValueError: no values, a value that is not finite, or a t interval of the IQM.

    Example:
        >>> print(estimate([0.7, 0.72, 0.74, 0.76, 0.78], method="t"))
        0.740 [0.701, 0.779]
    """
    data = np.asarray(values, dtype=float)
    if data.size == 0 or not np.isfinite(data).all():
        raise ValueError(f"values must be finite numbers, at least one, got {list(values)}")
    if statistic == "iqm" and (method == "t" or data.size < MIN_BOOTSTRAP):
        raise ValueError(
            f"iqm needs method=bootstrap and at least {MIN_BOOTSTRAP} seeds, "
            f"got method={method} and {data.size} seeds"
        )
    function: Callable[..., Any] = np.mean if statistic == "mean" else interquartile_mean
    value = float(function(data))
    if data.size == 1:
        return Estimate(value, math.nan, math.nan, 1, "none")
    if method == "t" or data.size < MIN_BOOTSTRAP:
        half = float(stats.t.ppf((1 + CONFIDENCE) / 2, data.size - 1) * stats.sem(data))
        return Estimate(value, value - half, value + half, data.size, "t")
    low, high = _bootstrap((data,), function, seed)
    return Estimate(value, low, high, data.size, "bootstrap")


def summarize(values: Sequence[float]) -> Summary:
    """Sums up a quantity over seeds, one value for each.

    Example:
        >>> summary = summarize([0.7, 0.72, 0.74, 0.76, 0.78])
        >>> print(summary.bootstrap, summary.t)
        0.740 [0.716, 0.764] 0.740 [0.701, 0.779]
    """
    t = estimate(values, method="t")
    if len(values) >= MIN_BOOTSTRAP:
        return Summary(estimate(values), t, estimate(values, "iqm"))
    nothing = (math.nan, math.nan, len(values), "none")
    iqm = float(interquartile_mean(values))
    return Summary(Estimate(t.value, *nothing), t, Estimate(iqm, *nothing))


def paired_differences(one: Mapping[Any, float], other: Mapping[Any, float]) -> list[float]:
    """Returns ``one`` minus ``other`` for every key that both have, in the order of the keys.

    The order is that of the keys whatever the order of the mappings, so that a bootstrap of the
    differences does not depend on it.

    Example:
        >>> paired_differences({"b": 0.75, "a": 0.5}, {"a": 0.25, "b": 0.25, "c": 0.9})
        [0.25, 0.5]
    """
    return [one[key] - other[key] for key in sorted(one.keys() & other.keys())]


def t_test(differences: Sequence[float]) -> float:
    """Returns the two-sided p-value of Student's t test that the mean difference is 0.

    Of one difference it is 1. Where all are equal, so that there is no spread to judge by, it is 1
    for differences of 0 and 0 for others.

    Example:
        >>> round(t_test([0.1, 0.2, 0.3]), 4)
        0.0742
    """
    if len(differences) < 2:
        return 1.0
    if len({*differences}) == 1:
        return float(differences[0] == 0)
    return float(stats.ttest_1samp(differences, 0).pvalue)


def probability_of_improvement(better: Sequence[float], worse: Sequence[float]) -> Estimate:
    """P(a seed of ``better`` beats a seed of ``worse``), ties counting half, with a 95 % interval.

    The Mann-Whitney U statistic divided by the number of pairs; the interval is a BCa bootstrap
    over the seeds of both (none below five seeds on either side).

    Example:
        >>> probability_of_improvement([0.7, 0.8], [0.5, 0.75]).value
        0.75
    """
    first, second = (np.asarray(values, dtype=float) for values in (better, worse))

    def share(a: Any, b: Any, axis: int = -1) -> Any:
        difference = np.asarray(a)[..., :, None] - np.asarray(b)[..., None, :]
        return (np.sign(difference) / 2 + 0.5).mean(axis=(-2, -1))

    value, count = float(share(first, second)), min(first.size, second.size)
    if count < MIN_BOOTSTRAP:
        return Estimate(value, math.nan, math.nan, count, "none")
    low, high = _bootstrap((first, second), share, seed=0)
    return Estimate(value, low, high, count, "bootstrap")


def _bootstrap(
    samples: tuple[Any, ...], function: Callable[..., Any], seed: int
) -> tuple[float, float]:
    """BCa interval; the percentile interval where BCa is undefined (all values the same, say)."""
    for method in ("BCa", "percentile"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            interval = stats.bootstrap(
                samples,
                function,
                n_resamples=RESAMPLES,
                confidence_level=CONFIDENCE,
                method=method,
                rng=np.random.default_rng(seed),
            ).confidence_interval
        if math.isfinite(interval.low) and math.isfinite(interval.high):
            break
    return float(interval.low), float(interval.high)
