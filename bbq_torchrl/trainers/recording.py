"""The metrics of a run: in memory, in metrics.csv, and as progress on a terminal."""

from __future__ import annotations

import logging
import math
import multiprocessing
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from torch import Tensor
from tqdm import tqdm

from bbq_torchrl.trainers.checkpoint import TrainingError
from bbq_torchrl.utils.files import csv_text, write_text

MetricRow = dict[str, int | float]
"""The metrics of one round and replica."""


class MetricsFile:
    """The metrics of a run, in memory and in a tidy CSV file that grows with every round.

    A missing metric (NaN) is empty in the file.

    The file is a copy of the metrics in the checkpoint. A process that is killed while it writes,
    or between two checkpoints, leaves rows that a resumed run replaces (:meth:`load_state_dict`).

    Args:
        path: the file; its folder is created if it is missing.
        replicas: the number of replicas.

    Attributes:
        rows: the rows of all rounds, one for each round and replica.

    Examples:
        >>> import torch
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     metrics = MetricsFile(Path(folder) / "metrics.csv", replicas=2)
        ...     rows = metrics.append(0, {"success_rate": torch.tensor([0.5, 0.25]), "seconds": 3})
        ...     print((Path(folder) / "metrics.csv").read_text().splitlines())
        ['round,replica,success_rate,seconds', '0,0,0.5,3', '0,1,0.25,3']
    """

    def __init__(self, path: Path, replicas: int) -> None:
        self.path = path
        self.replicas = replicas
        self.rows: list[MetricRow] = []

    def append(
        self, round_number: int, columns: Mapping[str, float | Tensor | Sequence[float]]
    ) -> list[MetricRow]:
        """Adds a round to the rows and the file, and returns its rows.

        Args:
            round_number: the round, from 0.
            columns: one number, or one for each replica, by name.

        Raises:
            ValueError: if the columns differ from those of earlier rounds.
            TrainingError: if a column has a wrong shape.
        """
        values = {name: _per_replica(name, value, self.replicas) for name, value in columns.items()}
        rows: list[MetricRow] = [
            dict(
                round=round_number,
                replica=replica,
                **{name: column[replica] for name, column in values.items()},
            )
            for replica in range(self.replicas)
        ]
        is_new = not self.rows or not self.path.exists()  # it may have been removed
        if self.rows and [*rows[0]] != [*self.rows[0]]:
            raise ValueError(f"a row must have the columns {[*self.rows[0]]}, got {[*rows[0]]}")
        self.rows += rows
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w" if is_new else "a", encoding="utf-8", newline="") as file:
            file.write(_csv(self.rows if is_new else rows, header=is_new))
        return rows

    def state_dict(self) -> dict[str, Any]:
        """Returns all rows."""
        return {"rows": list(self.rows)}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores the state from :meth:`state_dict` and rewrites the file."""
        self.rows = list(state_dict["rows"])
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


def _csv(rows: Sequence[MetricRow], *, header: bool) -> str:
    finite = ({name: "" if cell != cell else cell for name, cell in row.items()} for row in rows)
    return csv_text(finite, rows[0], header=header)


_LOG = logging.getLogger(__name__)

LINES = 40
"""The maximum number of log lines of a training run without a progress bar."""


class RoundProgress:
    """Shows success, reward and remaining time, averaged over the replicas.

    The bar is shown if stderr is a terminal and no other process of a sweep draws on it. Otherwise
    a line is logged after every round. Training for more than 40 rounds logs at most 40 lines, each
    with means over the rounds since the last.

    Args:
        rounds: the number of rounds.
        done: the number of finished rounds (of a resumed run). Defaults to 0.
        name: the prefix of each log line. Defaults to "".
    """

    def __init__(self, rounds: int, *, done: int = 0, name: str = "") -> None:
        self._rounds = rounds
        self._remaining = rounds - done
        self._name = f"{name}: " if name else ""
        self._pending: list[dict[str, float]] = []
        is_in_sweep = multiprocessing.parent_process() is not None
        self._bar = tqdm(
            total=rounds,
            initial=done,
            desc="rounds",
            unit="round",
            dynamic_ncols=True,
            disable=True if is_in_sweep else None,
        )

    def update(self, rows: Sequence[MetricRow]) -> None:
        """Shows the rows of one round, one for each replica."""
        self._remaining -= 1
        means = {name: fmean(row[name] for row in rows) for name in rows[0]}
        self._pending.append(means)
        rates = [row.get("eval_success_rate", math.nan) for row in self._pending]
        evaluated = [f"{rate:.2f}" for rate in rates if rate == rate]
        if self._bar.disable:
            self._log_line(*evaluated[-1:])
            return
        shown = {"success": f"{means['success_rate']:.2f}", "reward": f"{means['reward']:.1f}"}
        if evaluated:
            shown["eval"] = evaluated[-1]
        self._bar.set_postfix(shown, refresh=False)
        self._bar.update()

    def _log_line(self, *evaluated: str) -> None:
        """Logs a line if enough rounds have passed since the last one."""
        done = self._rounds - self._remaining
        if done % math.ceil(self._rounds / LINES) and self._remaining:
            return
        names = ("success_rate", "reward", "seconds")
        success, reward, seconds = (fmean(row[name] for row in self._pending) for name in names)
        _LOG.info(
            "%sround %d of %d: success %.2f%s, reward %.1f, %.1f s a round",
            self._name,
            done,
            self._rounds,
            success,
            "".join(f", evaluation {rate}" for rate in evaluated),
            reward,
            seconds,
        )
        self._pending = []

    def close(self) -> None:
        """Leaves the bar as it is and ends its line."""
        self._bar.close()
