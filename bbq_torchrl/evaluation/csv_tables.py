"""A report's tables as CSV files: all that is in them, unrounded."""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.learning import Reach, rounds_to_reach
from bbq_torchrl.evaluation.statistics import Estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bbq_torchrl.evaluation.groups import Group

__all__ = ["write_csv", "write_replicas"]


def write_replicas(groups: Sequence[Group], file: Path) -> None:
    """Writes a CSV file with a row for each replica."""
    write_csv(file, [row for group in groups for row in _replica_rows(group)])


def _replica_rows(group: Group) -> list[dict[str, Any]]:
    reached = iter(rounds_to_reach(group.success, 0.6).tolist())
    return [
        {
            "corpus": run.result.domain,
            "env": run.result.env,
            "agent": group.label,
            "replica": entry.replica,
            "seed": run.result.seed,
            "rounds": run.result.rounds,
            "updates": run.updates[number],
            "success_rate": entry.success_rate,
            "reward": entry.reward,
            "turns": entry.turns,
            "cumulative_success": entry.training_success,
            "rounds_to_60": f"{next(reached):.0f}".replace("inf", ""),
        }
        for run in group.runs
        for number, entry in enumerate(run.result.per_replica)
    ]


def write_csv(file: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes rows, column to cell each, as a CSV file; no file where there are no rows.

    A cell with an interval becomes several columns: ``final_success``, ``final_success_low`` and so
    on. What there is not, such as the interval of a single seed, is empty.
    """
    if not rows:
        file.unlink(missing_ok=True)
        return
    lines = [_line(row) for row in rows]
    names = dict.fromkeys(name for line in lines for name in line)
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(names), lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def _line(row: Mapping[str, Any]) -> dict[str, Any]:
    line: dict[str, Any] = {}
    for column, cell in row.items():
        name = column.lower().replace(" ", "_")
        parts = {"": cell}
        if isinstance(cell, Estimate):
            parts = {"": cell.value, "_low": cell.low, "_high": cell.high}
        elif isinstance(cell, Reach):
            low, high = cell.interval
            parts = {"": cell.median, "_low": low, "_high": high, "_reached": cell.reached}
            parts["_dialogues"] = cell.median * cell.dialogues
        line |= {name + part: "" if _is_none(value) else value for part, value in parts.items()}
    return line


def _is_none(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
