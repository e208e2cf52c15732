"""metrics.csv as arrays, and the speed of learning in them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median_low
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import integrate, stats

from bbq_torchrl.utils.files import METRICS
from bbq_torchrl.utils.statistics import CONFIDENCE
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


_NEEDED = ("round", "replica", "dialogues", "success_rate")


def _number(text: str, column: str) -> float:
    """Returns a value of metrics.csv: NaN for an empty one, which no needed column may have."""
    value = float(text or "nan")
    if column in _NEEDED and not math.isfinite(value):
        raise ValueError(f"{column} must be a number")
    return value


class Metrics:
    """The columns of a metrics.csv.

    Args:
        columns: name to values, shape [rounds, replicas] each.

    Attributes:
        rounds: how many rounds are complete.
        replicas: how many replicas there are.
    """

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns = columns
        self.rounds, self.replicas = columns["success_rate"].shape

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, float]]) -> Metrics:
        """Returns the metrics of a trainer's rows, replica after replica and round after round."""
        replicas = sum(row["round"] == rows[0]["round"] for row in rows)
        table = np.array([list(row.values()) for row in rows], dtype=float)
        columns = table.reshape(-1, replicas, table.shape[1])
        return cls({name: columns[..., index] for index, name in enumerate(rows[0])})

    def __getitem__(self, name: str) -> Any:
        """A column, shape [rounds, replicas].

        Raises:
            KeyError: naming the columns that there are.
        """
        if name not in self.columns:
            raise KeyError(f"metrics have no column {name!r}, only {', '.join(self.columns)}")
        return self.columns[name]

    @property
    def training_success(self) -> Any:
        """Share of successful training dialogues of each replica, shape [replicas]."""
        weights = self["dialogues"]
        return (self["success_rate"] * weights).sum(0) / weights.sum(0)


def read_metrics(folder: Path) -> Metrics:
    """Reads the metrics.csv of a result folder; a last round that is not complete is left out.

    What is empty, such as an evaluation in a round that had none, is NaN.

    Raises:
        ValueError: there is none, or a line is damaged; the message names file and line.
    """
    file = folder / METRICS
    if not file.is_file():
        raise ValueError(f"{folder} has no {METRICS}: it is no run folder")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{file} must be UTF-8 text: {error}") from error
    head, *lines = text[: text.rfind("\n") + 1].splitlines() or [""]
    names = head.split(",")
    for needed in _NEEDED:
        if needed not in names:
            raise ValueError(f"{file} must have the column {needed}, got {', '.join(names)}")
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 2):
        try:
            values = zip(line.split(","), names, strict=True)
            rows.append([_number(text, column) for text, column in values])
        except ValueError as error:
            raise ValueError(f"{file}, line {number}, is damaged: {shown(line)}") from error
    # At least one: where no row is of round 0, none is in order.
    replicas = max(1, sum(row[names.index("round")] == 0 for row in rows))
    rounds = len(rows) // replicas
    if rounds == 0:
        raise ValueError(f"{file} has no complete round")
    table = np.array(rows[: rounds * replicas]).reshape(rounds, replicas, len(names))
    columns = {name: table[..., index] for index, name in enumerate(names)}
    in_order = (columns["replica"] == np.arange(replicas)).all() and (
        columns["round"] == np.arange(rounds)[:, None]
    ).all()
    if not in_order:
        raise ValueError(f"{file} must have a row for each round and replica, in order")
    return Metrics(columns)


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

    def csv_columns(self) -> dict[str, float]:
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
