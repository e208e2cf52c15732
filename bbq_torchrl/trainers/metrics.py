"""The path of a round's numbers: into memory, metrics.csv and the loggers."""

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
"""A round's metrics of one replica."""


class MetricsFile:
    """The metrics of a run, in memory and in a tidy CSV file that grows round by round.

    Loggers are fed from the same rows. What a round has not (NaN) is empty in the file, and is not
    logged.

    The file is a copy: what counts is in the checkpoint. A process killed while it writes, or
    between two checkpoints, leaves rows that a resumed run replaces (:meth:`load_state_dict`).

    Args:
        path: the file; its folder is made if it is missing.
        replicas: the number of replicas.
        loggers: TorchRL loggers, which get ``<metric>/replica_<r>`` of all replicas at once, at the
            step of the round.

    Attributes:
        rows: those of all rounds, one for each round and replica.

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
        """Adds a round, in memory, at the end of the file and to the loggers; returns its rows.

        Args:
            round_number: the round, from 0.
            columns: by name, one number, or one for each replica.

        Raises:
            ValueError: if the columns are others than those of the rounds before.
            TrainingError: if a column has another shape.
        """
        values = {name: _of_each(name, value, self.replicas) for name, value in columns.items()}
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
        is_anew = is_first or not self.path.exists()  # somebody has removed it
        with self.path.open("w" if is_anew else "a", encoding="utf-8", newline="") as file:
            file.write(_csv(self.rows if is_anew else rows, header=is_anew))
        logged = _logged(rows)
        for logger in self.loggers:
            logger.log_metrics(dict(logged), step=round_number)
        return rows

    def state_dict(self) -> dict[str, Any]:
        """Returns all rows: the columns' names, which of them are integers, and the values."""
        first = self.rows[0] if self.rows else {}
        return {
            "columns": list(first),
            "integers": [name for name, value in first.items() if isinstance(value, int)],
            "values": torch.tensor(
                [list(row.values()) for row in self.rows], dtype=torch.float64
            ).reshape(len(self.rows), len(first)),
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores what :meth:`state_dict` returned and replaces the file at once."""
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


def _of_each(name: str, value: float | Tensor | Sequence[float], replicas: int) -> list[float]:
    """Returns a metric's value for each replica."""
    numbers = np.asarray(value.tolist() if isinstance(value, Tensor) else value)
    if numbers.shape not in ((), (1,), (replicas,)):
        raise TrainingError(
            f"the metric {name} must be one number or one for each replica, shape [{replicas}], "
            f"got shape {list(numbers.shape)}"
        )
    of_each: list[float] = np.broadcast_to(numbers, (replicas,)).tolist()
    return of_each


def _logged(rows: Sequence[MetricRow]) -> dict[str, float]:
    """Returns a round by the names that loggers have for its metrics."""
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
