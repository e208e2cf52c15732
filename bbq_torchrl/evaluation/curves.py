"""metrics.csv as arrays, and measures of learning speed."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median_low
from typing import Any

import numpy as np
from scipy import integrate

from bbq_torchrl.utils.files import METRICS
from bbq_torchrl.utils.text import sentence

_NEEDED = ("round", "replica", "dialogues", "success_rate")


class Metrics:
    """The columns of a metrics.csv.

    Args:
        rows: column -> value of each round and replica, replica after replica and round after
            round; an incomplete last round is left out.

    Attributes:
        columns: name -> values, shape [rounds, replicas].
        rounds: number of complete rounds.
        replicas: number of replicas.

    Raises:
        ValueError: no complete round, rows that are not in order, or a missing number.
        KeyError: a missing column.
    """

    def __init__(self, rows: Sequence[Mapping[str, float]]) -> None:
        self.replicas = max(1, sum(row.get("round") == 0 for row in rows))
        self.rounds = len(rows) // self.replicas
        if self.rounds == 0:
            raise ValueError("it has no complete round")
        complete = rows[: self.rounds * self.replicas]
        table = np.array([[*row.values()] for row in complete], dtype=float)
        table = table.reshape(self.rounds, self.replicas, -1)
        self.columns = {name: table[..., place] for place, name in enumerate(rows[0])}
        expected = np.ogrid[: self.rounds, : self.replicas]
        for name, numbers in zip(("round", "replica"), expected, strict=True):
            if not (self[name] == numbers).all():
                raise ValueError("it must have a row for each round and replica, in order")
        if not np.isfinite([self[name] for name in _NEEDED]).all():
            raise ValueError(f"{', '.join(_NEEDED)} must be numbers")

    def __getitem__(self, name: str) -> Any:
        """Returns a column, shape [rounds, replicas]."""
        return self.columns[name]

    @property
    def training_success(self) -> Any:
        """Share of successful training dialogues of each replica, shape [replicas]."""
        weights = self["dialogues"]
        return (self["success_rate"] * weights).sum(0) / weights.sum(0)


def read_metrics(folder: Path) -> Metrics:
    """Reads the metrics.csv of a run folder, without an incomplete last round or line.

    Empty cells, such as those of evaluations that other rounds have, are NaN.

    Raises:
        ValueError: the file is missing or damaged.
    """
    file = folder / METRICS
    if not file.is_file():
        raise ValueError(f"{folder} has no {METRICS}: it is not a run folder")
    try:
        complete, *_ = file.read_text(encoding="utf-8-sig").rpartition("\n")
        rows = csv.DictReader(complete.splitlines(), restval="?")  # a missing cell is no number
        return Metrics([numbers(row) for row in rows])
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{file} is damaged: {sentence(error)}") from error


def numbers(row: Mapping[str, str]) -> dict[str, float]:
    """Returns a row of CSV as numbers; empty cells are NaN."""
    return {name: float(text or "nan") for name, text in row.items()}


FIRST = (500, 1_000, 2_000, 5_000)
"""Numbers of first training dialogues whose success is reported: the early cost of exploring."""

LEVEL = 0.5
"""Training success for which the number of dialogues is reported."""

WINDOW = 5
"""Rounds averaged to reach a level in training: 250 dialogues have a standard error of .03."""


@dataclass(frozen=True)
class Reach:
    """The training dialogues that the seeds of a group took to reach a success rate.

    Attributes:
        dialogues: of each seed; infinite if it was not reached.
        trained: dialogues of the whole training.
    """

    dialogues: tuple[float, ...]
    trained: int

    @property
    def reached(self) -> int:
        """The number of seeds that reached the rate."""
        return sum(map(math.isfinite, self.dialogues))

    @property
    def median(self) -> float:
        """The dialogues after which half of the seeds had reached it; infinite if fewer did."""
        return median_low(self.dialogues)

    def csv_columns(self) -> dict[str, float]:
        """Returns suffixes of CSV columns and their numbers."""
        return {"": self.median, "_reached": self.reached}

    def __str__(self) -> str:
        """Returns the median, and how many seeds reached it: ``1,900 (9 of 10)``."""
        text = f"{self.median:,.0f}" if math.isfinite(self.median) else f"> {self.trained:,}"
        return f"{text} ({self.reached} of {len(self.dialogues)})"


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
