"""A report's tables as CSV files: all that is in them, unrounded."""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.learning import learning, rounds_to_reach
from bbq_torchrl.evaluation.statistics import Estimate, estimate, estimate_iqm

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Pairing

__all__ = ["write_replicas", "write_tables"]


def write_tables(groups: Sequence[Group], compared: Sequence[Pairing], folder: Path) -> None:
    """Writes a CSV file of each table of a report, and ``replicas.csv``."""
    _write(folder / "report.csv", [_row(group) for group in groups])
    _write(folder / "pairs.csv", [_pair_row(item) for item in compared])
    _write(folder / "learning.csv", _learning_rows(groups))
    write_replicas(groups, folder / "replicas.csv")


def write_replicas(groups: Sequence[Group], file: Path) -> None:
    """Writes a CSV file with a row for each replica."""
    _write(file, [row for group in groups for row in _replica_rows(group)])


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


def _row(group: Group) -> dict[str, Any]:
    """Returns what report.csv holds of a group."""
    row: dict[str, Any] = {
        "label": group.label,
        "agent": group.first.agent,
        "explore": group.first.explore,
        "env": group.first.env,
        "domain": group.first.domain,
        "seeds": len(group.final),
        "rounds": group.first.rounds,
    }
    row |= _ends("final_success", estimate(group.final))
    row |= _ends("final_success_iqm", estimate_iqm(group.final))
    row |= _ends("training_success", estimate(group.cumulative))
    return row | {"reward": group.reward, "turns": group.turns}


def _ends(name: str, found: Estimate) -> dict[str, float]:
    return {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}


def _pair_row(item: Pairing) -> dict[str, Any]:
    row: dict[str, Any] = {"one": item.one.label, "other": item.other.label, "pairs": item.pairs}
    for name, difference in item.differences.items():
        row |= _ends(name, difference)
    return row | {"remark": item.remark}


def _learning_rows(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """Returns what learning.csv holds: a row for each learning curve; infinite is empty."""
    rows = []
    for group in groups:
        for curve in learning(group):
            row: dict[str, Any] = {
                "label": group.label,
                "success_in": curve.success_in,
                "seeds": len(group.final),
                "rounds": group.first.rounds,
                **_ends("area", curve.area),
            }
            for item in curve.reach:
                low, high = item.interval
                row |= {
                    f"reached_{item.level}": item.reached,
                    f"rounds_{item.level}": item.median,
                    f"rounds_{item.level}_low": low,
                    f"rounds_{item.level}_high": high,
                    f"dialogues_{item.level}": item.median * group.round_dialogues,
                }
            rows.append(row)
    return rows


def _write(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes a CSV file; what there is not is empty. No file where there are no rows."""
    if not rows:
        file.unlink(missing_ok=True)
        return
    names = max(rows, key=len)  # rows without pairs lack columns of those with
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(names), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({name: value for name, value in row.items() if not _is_none(value)})


def _is_none(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
