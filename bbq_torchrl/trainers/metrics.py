"""The metrics of a run: in memory, in metrics.csv and in loggers."""

from __future__ import annotations

import csv
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from bbq_torchrl.trainers.errors import TrainingError
from bbq_torchrl.utils.files import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from torchrl.record.loggers import Logger

MetricRow = dict[str, int | float]
"""The metrics of one round and replica."""


class MetricsFile:
    """The metrics of a run, in memory and in a tidy CSV file that grows with every round.

    Loggers get the same rows. A missing metric (NaN) is empty in the file and not logged.

    The file is a copy of the metrics in the checkpoint. A process that is killed while it writes,
    or between two checkpoints, leaves rows that a resumed run replaces (:meth:`load_state_dict`).

    Args:
        path: the file; its folder is created if it is missing.
        replicas: the number of replicas.
        loggers: TorchRL loggers, which get ``<metric>/replica_<r>`` for all replicas at once, with
            the round as the step.

    Attributes:
        rows: the rows of all rounds, one for each round and replica.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     metrics = MetricsFile(Path(folder) / "metrics.csv", replicas=2)
        ...     rows = metrics.append(0, {"success_rate": torch.tensor([0.5, 0.25]), "seconds": 3})
        ...     print((Path(folder) / "metrics.csv").read_text().splitlines())
        ['round,replica,success_rate,seconds', '0,0,0.5,3', '0,1,0.25,3']
    """

    def __init__(self, path: Path, replicas: int, loggers: Sequence[Logger] = ()) -> None:
        self.path = path
        self.replicas = replicas
        self.loggers = tuple(loggers)
        self.rows: list[MetricRow] = []

    def append(
        self, round_number: int, columns: Mapping[str, float | Tensor | Sequence[float]]
    ) -> list[MetricRow]:
        """Adds a round to the rows, the file and the loggers, and returns its rows.

        Args:
            round_number: the round, from 0.
            columns: one number, or one for each replica, by name.

        Raises:
            ValueError: if the columns differ from those of earlier rounds.
            TrainingError: if a column has a wrong shape.
        """
        values = {name: _per_replica(name, value, self.replicas) for name, value in columns.items()}
        rows: list[MetricRow] = [
            {
                "round": round_number,
                "replica": replica,
                **{name: column[replica] for name, column in values.items()},
            }
            for replica in range(self.replicas)
        ]
        names = tuple((self.rows or rows)[0])
        if tuple(rows[0]) != names:
            raise ValueError(f"a row must have the columns {names}, got {tuple(rows[0])}")
        is_first = not self.rows
        self.rows.extend(rows)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        is_new = is_first or not self.path.exists()  # it may have been removed
        with self.path.open("w" if is_new else "a", encoding="utf-8", newline="") as file:
            file.write(_csv(self.rows if is_new else rows, header=is_new))
        logged = _logged(rows)
        for logger in self.loggers:
            logger.log_metrics(dict(logged), step=round_number)
        return rows

    def state_dict(self) -> dict[str, Any]:
        """Returns all rows: the names of the columns, those of integer columns, and the values."""
        first = self.rows[0] if self.rows else {}
        return {
            "columns": list(first),
            "integers": [name for name, value in first.items() if isinstance(value, int)],
            "values": torch.tensor(
                [list(row.values()) for row in self.rows], dtype=torch.float64
            ).reshape(len(self.rows), len(first)),
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores the state from :meth:`state_dict` and rewrites the file."""
        integers = set(state_dict["integers"])
        self.rows = [
            {
                name: int(value) if name in integers else value
                for name, value in zip(state_dict["columns"], values, strict=True)
            }
            for values in state_dict["values"].tolist()
        ]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.rows:
            write_text(self.path, _csv(self.rows, header=True))
        else:
            self.path.unlink(missing_ok=True)


def _per_replica(name: str, value: float | Tensor | Sequence[float], replicas: int) -> list[float]:
    """Returns a metric's value for each replica."""
    numbers = np.asarray(value.tolist() if isinstance(value, Tensor) else value)
    if numbers.shape not in ((), (1,), (replicas,)):
        raise TrainingError(
            f"the metric {name} must be one number or one for each replica, shape [{replicas}], "
            f"got shape {list(numbers.shape)}"
        )
    values: list[float] = np.broadcast_to(numbers, (replicas,)).tolist()
    return values


def _logged(rows: Sequence[MetricRow]) -> dict[str, float]:
    """Returns the metrics of a round by the names that loggers get."""
    return {
        f"{name}/replica_{row['replica']}": float(value)
        for row in rows
        for name, value in row.items()
        if name not in ("round", "replica") and value == value
    }


def _csv(rows: Sequence[MetricRow], *, header: bool) -> str:
    buffer = StringIO()
    writer = csv.DictWriter(buffer, fieldnames=list(rows[0]), lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(
        {name: "" if value != value else value for name, value in row.items()} for row in rows
    )
    return buffer.getvalue()
