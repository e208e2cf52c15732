"""metrics.csv: a row for every round and replica."""

from __future__ import annotations

import csv
import os
from io import StringIO
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

__all__ = ["MetricRow", "MetricsFile", "replace_text"]

MetricRow = dict[str, int | float]


def replace_text(path: Path, text: str) -> None:
    """Writes a file so that a reader, or a crash, finds the old text or the new, never a part."""
    temporary = path.with_name(f".{path.name}.new")
    with temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


class MetricsFile:
    """The metrics of a run, in memory and in a tidy CSV file that grows round by round.

    What a round has not (NaN) is empty in the file.

    The file is a copy: what counts is in the checkpoint. A process killed while it writes, or
    between two checkpoints, leaves rows that a resumed run replaces (:meth:`load_state_dict`).

    Args:
        path (Path): the file; its folder is made if it is missing.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     metrics = MetricsFile(Path(folder) / "metrics.csv")
        ...     metrics.append([{"round": 0, "replica": 0, "success_rate": 0.5}])
        ...     print((Path(folder) / "metrics.csv").read_text().splitlines())
        ['round,replica,success_rate', '0,0,0.5']
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[MetricRow] = []

    def append(self, rows: Sequence[MetricRow]) -> None:
        """Adds rows, in memory and at the end of the file.

        Raises:
            ValueError: if a row has other columns than the first one.
        """
        columns = tuple((self.rows or rows)[0])
        for row in rows:
            if tuple(row) != columns:
                raise ValueError(f"a row must have the columns {columns}, got {tuple(row)}")
        is_first = not self.rows
        self.rows.extend(rows)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w" if is_first else "a", encoding="utf-8", newline="") as file:
            file.write(_csv(rows, header=is_first))

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
            replace_text(self.path, _csv(self.rows, header=True))
        else:
            self.path.unlink(missing_ok=True)


def _csv(rows: Sequence[MetricRow], *, header: bool) -> str:
    buffer = StringIO()
    writer = csv.DictWriter(buffer, fieldnames=list(rows[0]), lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(
        {name: "" if value != value else value for name, value in row.items()} for row in rows
    )
    return buffer.getvalue()
