"""metrics.csv as arrays, and measures of learning speed."""

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
    """Parses a value of metrics.csv; an empty one is NaN, refused in required columns."""
    value = float(text or "nan")
    if column in _NEEDED and not math.isfinite(value):
        raise ValueError(f"{column} must be a number")
    return value


class Metrics:
    """The columns of a metrics.csv.

    Args:
        columns: name -> values, shape [rounds, replicas].

    Attributes:
        rounds: number of complete rounds.
        replicas: number of replicas.
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
        """Returns a column, shape [rounds, replicas].

        Raises:
            KeyError: an unknown column; the message lists the known ones.
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
    """Reads the metrics.csv of a result folder, without an incomplete last round.

    Empty cells, such as those of evaluations that other rounds have, are NaN.

    Raises:
        ValueError: the file is missing or a line is damaged; the message names file and line.
    """
    file = folder / METRICS
    if not file.is_file():
        raise ValueError(f"{folder} has no {METRICS}: it is not a run folder")
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
    # At least one, so that rows without round 0 are refused below.
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
"""Success rates whose first round is reported."""

FIRST = (500, 1_000, 2_000, 5_000)
"""Numbers of first training dialogues whose success is reported: the early cost of exploring."""

WINDOW = 5
"""Rounds averaged to reach a level in training: 250 dialogues have a standard error of .03."""


@dataclass(frozen=True)
class Reach:
    """The time that the seeds of a group took to reach a success rate.

    Attributes:
        rounds: training rounds until then, per seed; infinite if it was not reached.
        trained: rounds of the whole training.
        dialogues: dialogues per round.
    """

    rounds: tuple[float, ...]
    trained: int
    dialogues: int

    @property
    def reached(self) -> int:
        """The number of seeds that reached the rate."""
        return sum(map(math.isfinite, self.rounds))

    @property
    def median(self) -> float:
        """The rounds after which half of the seeds had reached the rate; infinite if fewer did."""
        return median_low(self.rounds)

    @property
    def interval(self) -> tuple[float, float]:
        """The distribution-free 95 % interval of the median; NaN below six seeds."""
        found = stats.quantile_test(self.rounds, p=0.5).confidence_interval(CONFIDENCE)
        return float(found.low), float(found.high)

    def csv_columns(self) -> dict[str, float]:
        """Returns suffixes of CSV columns and their numbers."""
        low, high = self.interval
        return {
            "": self.median,
            "_low": low,
            "_high": high,
            "_reached": self.reached,
            "_dialogues": self.median * self.dialogues,
        }

    def shown(self, rounds: float, unit: int = 1) -> str:
        """Returns rounds multiplied by ``unit`` as text, such as ``38`` or ``> 150``."""
        if math.isinf(rounds):
            return f"> {self.trained * unit:,}"
        return f"{rounds * unit:,.0f}"

    def __str__(self) -> str:
        """Returns rounds, interval, dialogues and seeds, as in ``38 [34, 45] (1,900), 9 of 10``."""
        if self.reached == 0:
            return "not reached"
        low, high = self.interval
        interval = "" if math.isnan(low) else f" [{self.shown(low)}, {self.shown(high)}]"
        text = f"{self.shown(self.median)}{interval} ({self.shown(self.median, self.dialogues)})"
        seeds = len(self.rounds)
        return text if self.reached == seeds else f"{text}, {self.reached} of {seeds}"


def reach(success: Any, level: float, dialogues: int, window: int = WINDOW) -> Reach:
    """Returns the time that the seeds took to reach a level; see :func:`rounds_to_reach`."""
    rounds = rounds_to_reach(success, level, window)
    return Reach(tuple(rounds.tolist()), len(success), dialogues)


def rounds_to_reach(success: Any, level: float, window: int = WINDOW) -> Any:
    """Returns the first round, counted from 1, after which the moving mean reaches a level.

    Args:
        success: success rates, shape [rounds, seeds]; NaN in rounds without a value.
        level: the success rate to reach.
        window: number of rounds of the mean, none of them NaN.

    Returns:
        Rounds, shape [seeds]; infinite if the level is not reached.

    Examples:
        >>> curve = np.array([[0.2], [0.4], [0.8], [0.6]])
        >>> rounds_to_reach(curve, 0.6, window=2), rounds_to_reach(curve, 0.9, window=2)
        (array([3.]), array([inf]))
    """
    success = np.asarray(success, dtype=float)
    if len(success) < window:
        return np.full(success.shape[1], np.inf)
    means = np.lib.stride_tricks.sliding_window_view(success, window, axis=0).mean(-1)
    # Rates of few dialogues can equal a level; rounding must not make them miss it.
    is_reached = means >= level - 1e-9
    return np.where(is_reached.any(0), is_reached.argmax(0) + window, np.inf)


def booked(success: Any, dialogues: int, first: int) -> list[float]:
    """Returns the share of the first training dialogues that succeeded, per seed.

    Args:
        success: success rates of the training dialogues, shape [rounds, seeds].
        dialogues: dialogues per round.
        first: number of dialogues to count; the last round may count in part.

    Returns:
        A value per seed; empty if fewer dialogues were trained.

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
    """Returns the mean height of each seed's curve between its first and last value.

    This is the area under the curve, with values joined by straight lines, divided by the distance.

    Args:
        curve: success rates, shape [rounds, seeds]; NaN in rounds without a value, at least one
            value.

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
