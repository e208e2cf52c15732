"""The tables of docs/learning_starts.md: the plateau, the searches, and what was tried."""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING

from scipy import stats

from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["learning_blocks"]

RESULTS = Path(__file__).resolve().parents[2] / "results"


def learning_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks of the page."""
    return {
        "learning.plateau": _plateau,
        "learning.quick": _quick,
        "learning.from_scratch": _from_scratch,
        "learning.search": _search,
        "learning.tried": partial(_tried, "tried.csv", "success_rate", "final"),
        "learning.targets": partial(_tried, "tried_targets.csv", "late_success", "rounds 26 to 30"),
    }


def _read(name: str) -> list[dict[str, str]]:
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _plateau() -> str:
    """Returns the median over seeds of what is predicted, a line for each start."""
    cells: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for line in _read("plateau.csv"):
        cells[line["start"]][int(line["updates"])].append(float(line["q_value"]))
    # Seeds differ in the length of an epoch by an update or two: the columns are the first start's.
    columns = [f"{updates:,}" for updates in next(iter(cells.values()))]
    rows = [
        (start, *(f"{median(values):.1f}" for values in by_updates.values()))
        for start, by_updates in cells.items()
    ]
    return table(("start, after updates", *columns), rows, numbers=len(columns))


def _quick() -> str:
    """Returns a line for each seed of the README's first command."""
    found = []
    for file in (RESULTS / "quick").glob("*/result.json"):
        result = json.loads(file.read_text(encoding="utf-8"))
        [replica] = result["per_replica"]
        found.append((result["seed"], replica["success_rate"], replica["training_success"]))
    if not found:
        return "Not measured yet."
    rows = [(seed, f"{final:.3f}", f"{training:.3f}") for seed, final, training in sorted(found)]
    finals = [final for _, final, _ in found]
    mean = ("mean", f"{fmean(finals):.3f}", f"{fmean(item[2] for item in found):.3f}")
    head = ("seed", "final success", "cumulative training success")
    return (
        f"{table(head, [*rows, mean], numbers=3)}\n\n"
        f"The final success of {len(found)} seeds is between {min(finals):.2f} and "
        f"{max(finals):.2f}."
    )


def _from_scratch() -> str:
    """Returns what the example in one file came to."""
    ends = [
        f"{float(line['final_success']):.3f} (seed {line['seed']})"
        for line in _read("from_scratch.csv")
    ]
    file = "`examples/bbqn_from_scratch.py`"
    return f"The same in one file of plain torch, {file}, ends at {', '.join(ends)}."


def _search() -> str:
    """Returns the trials of every search, the best one first."""
    parts = []
    for file in sorted((RESULTS / "search").glob("*.csv")):
        lines = _read(f"search/{file.name}")
        keys = [key for key in lines[0] if "." in key]
        done = sorted(lines, key=lambda line: -float(line["value"] or 0))
        rows = [
            (*(_short(line[key]) for key in keys), f"{float(line['value']):.3f}", line["rounds"])
            for line in done
        ]
        head = (*(f"`{key}`" for key in keys), "training success", "rounds")
        parts.append(f"`search={file.stem}`\n\n{table(head, rows, numbers=2)}")
    return "\n\n".join(parts)


def _short(value: str) -> str:
    try:
        return f"{float(value):.3g}"
    except ValueError:
        return value


def _tried(file: str, end: str, name: str) -> str:
    """Returns each variant's difference from the first one, by pairs of seeds.

    Args:
        file: a row for each variant and seed.
        end: the column that says how the training ended.
        name: of that column in the table.
    """
    runs: dict[str, list[dict[str, str]]] = defaultdict(list)
    for line in _read(file):
        runs[line["variant"]].append(line)
    base, *_ = runs
    rows = []
    for variant, lines in runs.items():
        row = [variant, str(len(lines))]
        for key in ("cumulative_success", end):
            own = [float(line[key]) for line in lines]
            row.append(f"{fmean(own):.3f}")
            if variant != base:
                other = [float(line[key]) for line in runs[base]]
                row.append(_difference([a - b for a, b in zip(own, other, strict=True)]))
            else:
                row.append("–")
        rows.append(row)
    head = ("variant", "seeds", "cumulative", "paired difference", name, "paired difference")
    return table(head, rows, numbers=5)


def _difference(values: Sequence[float]) -> str:
    interval = stats.ttest_1samp(values, 0).confidence_interval()
    return f"{fmean(values):+.3f} [{interval.low:+.3f}, {interval.high:+.3f}]"
