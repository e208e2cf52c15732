"""Speed of learning: rounds until a success rate is reached, and the area under the curve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median_low
from typing import Any

import numpy as np
from scipy import integrate, stats

from bbq_torchrl.statistics import CONFIDENCE

LEVELS = (0.5, 0.6, 0.7, 0.8)
"""Success rates that are to be reached."""

FIRST = (500, 1_000, 2_000, 5_000)
"""Numbers of training dialogues whose success is reported: what exploring costs early."""

WINDOW = 5
"""Rounds whose mean training success is to reach a level: 250 dialogues have an error of .03."""


@dataclass(frozen=True)
class Reach:
    """The time that the seeds of a group took to reach a success rate.

    Attributes:
        rounds: of training until then, one value for each seed; infinite where it was not reached.
        trained: rounds of training in all.
        dialogues: of a round.
    """

    rounds: tuple[float, ...]
    trained: int
    dialogues: int

    @property
    def reached(self) -> int:
        """The number of seeds that reached it."""
        return sum(map(math.isfinite, self.rounds))

    @property
    def median(self) -> float:
        """The rounds after which half of the seeds had reached it; infinite if fewer did.

        So a seed that did not reach it counts as one that takes longer than it was trained.
        """
        return median_low(self.rounds)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the median, from the order of the seeds alone; NaN below six seeds."""
        found = stats.quantile_test(self.rounds, p=0.5).confidence_interval(CONFIDENCE)
        return float(found.low), float(found.high)

    def columns(self) -> dict[str, float]:
        """Returns what stands in the columns of a CSV file."""
        low, high = self.interval
        return {
            "": self.median,
            "_low": low,
            "_high": high,
            "_reached": self.reached,
            "_dialogues": self.median * self.dialogues,
        }

    def shown(self, rounds: float, unit: int = 1) -> str:
        """Returns rounds as text, in units of so many dialogues: ``38``, or ``> 150``."""
        if math.isinf(rounds):
            return f"> {self.trained * unit:,}"
        return f"{rounds * unit:,.0f}"

    def __str__(self) -> str:
        """``38 [34, 45] (1,900), 9 of 10``: rounds, interval, dialogues and seeds."""
        if self.reached == 0:
            return "not reached"
        low, high = self.interval
        interval = "" if math.isnan(low) else f" [{self.shown(low)}, {self.shown(high)}]"
        text = f"{self.shown(self.median)}{interval} ({self.shown(self.median, self.dialogues)})"
        seeds = len(self.rounds)
        return text if self.reached == seeds else f"{text}, {self.reached} of {seeds}"


def reach(success: Any, level: float, dialogues: int, window: int = WINDOW) -> Reach:
    """Returns how long the seeds took to a level; see :func:`rounds_to_reach`."""
    rounds = rounds_to_reach(success, level, window)
    return Reach(tuple(rounds.tolist()), len(success), dialogues)


def rounds_to_reach(success: Any, level: float, window: int = WINDOW) -> Any:
    """The first round, counted from 1, after which the mean of the last rounds reaches a level.

    Args:
        success: success rates, shape [rounds, seeds]; NaN in rounds without.
        level: the success rate to reach.
        window: over how many rounds the mean is taken, none of them NaN.

    Returns:
        One value for each seed, shape [seeds]; infinite where the level is not reached.

    Examples:
        >>> curve = np.array([[0.2], [0.4], [0.8], [0.6]])
        >>> rounds_to_reach(curve, 0.6, window=2), rounds_to_reach(curve, 0.9, window=2)
        (array([3.]), array([inf]))
    """
    success = np.asarray(success, dtype=float)
    if len(success) < window:
        return np.full(success.shape[1], np.inf)
    means = np.lib.stride_tricks.sliding_window_view(success, window, axis=0).mean(-1)
    # Rates of a few dialogues hit a level exactly, and must not miss it by rounding.
    is_reached = means >= level - 1e-9
    return np.where(is_reached.any(0), is_reached.argmax(0) + window, np.inf)


def booked(success: Any, dialogues: int, first: int) -> list[float]:
    """Share of the first training dialogues that succeeded, one value for each seed.

    Args:
        success: success rates of the training dialogues, shape [rounds, seeds].
        dialogues: of a round.
        first: how many dialogues count. Of a round that they end in, its rate counts for its part.

    Returns:
        one value for each seed; empty where fewer dialogues were trained.

    Examples:
        >>> booked(np.array([[0.0], [0.5], [1.0]]), 50, 75)
        [0.16666666666666666]
        >>> booked(np.array([[0.0]]), 50, 75)
        []
    """
    success = np.asarray(success, dtype=float)
    if len(success) * dialogues < first:
        return []
    before = np.arange(len(success)) * dialogues
    counted = np.clip(first - before, 0, dialogues)
    return (counted @ success / first).tolist()


def areas(curve: Any) -> list[float]:
    """Area under each seed's curve between its first and last value, divided by their distance.

    The mean height of the curve, its values joined by straight lines.

    Args:
        curve: success rates, shape [rounds, seeds]; NaN in rounds without, a value in at least one.

    Examples:
        >>> areas(np.array([[0.0], [np.nan], [0.5], [0.5]]))
        [0.3333333333333333]
    """
    found = []
    for success in np.asarray(curve, dtype=float).T:
        (rounds,) = np.isfinite(success).nonzero()
        values, span = success[rounds], rounds[-1] - rounds[0]
        found.append(float(integrate.trapezoid(values, rounds) / span if span else values[0]))
    return found
