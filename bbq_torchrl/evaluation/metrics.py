"""metrics.csv of a finished run, or of one under way, as arrays."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.run_folder import METRICS
from bbq_torchrl.text import shown

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
