"""The tables of docs/learning_starts.md: the plateau, the searches, and what was tried."""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING, NamedTuple

from scipy import stats

from bbq_torchrl.evaluation.results import read_metrics
from scripts.docs_blocks.markdown import table
from scripts.docs_blocks.policies import success_rate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["learning_blocks"]

RESULTS = Path(__file__).resolve().parents[2] / "results"

LEVEL = 0.6
"""Success of an evaluation that shows that an agent has learned to book."""


def learning_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks of the page."""
    return {
        "learning.plateau": _plateau,
        "learning.quick": _quick,
        "learning.expect": _expect,
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


class _Quick(NamedTuple):
    """One seed of the README's first command.

    Attributes:
        seed: of the run.
        final: success rate of the final evaluation.
        training: share of all training dialogues that succeeded.
        reached: the round at whose end an evaluation was first at .6 or above; None: in none.
        wall: seconds of the whole command.
        processor: seconds of a core that it took.
    """

    seed: int
    final: float
    training: float
    reached: int | None
    wall: float
    processor: float


def _quick_runs() -> list[_Quick]:
    """Returns what is kept in results/quick, in order of the seeds."""
    found = []
    took = {int(line["seed"]): line for line in _read("quick_seconds.csv")}
    for file in (RESULTS / "quick").glob("*/result.json"):
        result = json.loads(file.read_text(encoding="utf-8"))
        [replica] = result["per_replica"]
        metrics = read_metrics(file.parent)
        is_there = metrics["eval_success_rate"][:, 0] >= LEVEL
        found.append(
            _Quick(
                result["seed"],
                replica["success_rate"],
                replica["training_success"],
                int(is_there.argmax()) + 1 if is_there.any() else None,
                *(float(took[result["seed"]][key]) for key in ("wall", "processor")),
            )
        )
    return sorted(found)


def _quick() -> str:
    """Returns a line for each seed of the README's first command."""
    found = _quick_runs()
    if not found:
        return "Not measured yet."
    rows = [
        (
            run.seed,
            f"{run.final:.3f}",
            f"{run.training:.3f}",
            "not reached" if run.reached is None else run.reached,
            f"{run.wall:.0f}",
            f"{run.processor:.0f}",
        )
        for run in found
    ]
    wall, processor = [run.wall for run in found], [run.processor for run in found]
    mean = (
        "mean",
        f"{fmean(run.final for run in found):.3f}",
        f"{fmean(run.training for run in found):.3f}",
        "",
        f"{fmean(wall):.0f}",
        f"{fmean(processor):.0f}",
    )
    head = (
        *("seed", "final success", "cumulative training success", f"rounds to {LEVEL}"),
        *("seconds", "of a core"),
    )
    finals = [run.final for run in found]
    return (
        f"{table(head, [*rows, mean], numbers=6)}\n\n"
        f"The final success of {len(found)} seeds is between {min(finals):.2f} and "
        f"{max(finals):.2f}. Rounds to {LEVEL}: until an evaluation while training was there. "
        "Seconds are of the whole command, from the start of the process to its end, on a machine "
        f"of two cores beside another process (median {median(wall):.0f}), and those of a core "
        f"that it took (median {median(processor):.0f})."
    )


def _expect() -> str:
    """Returns what a user of the README's first command can expect."""
    finals = [run.final for run in _quick_runs()]
    rule, ceiling = (success_rate("movie", "reference", name) for name in ("rule", "clairvoyant"))
    if not finals or rule is None or ceiling is None:
        return "Not measured yet."
    return (
        "What to expect: nothing in the first five rounds, then success rises; "
        f"{len(finals)} fresh seeds end between {_rate(min(finals))} and {_rate(max(finals))} of "
        f"dialogues booked (mean {_rate(fmean(finals))}), where the rule agent books {_rate(rule)} "
        f"and a privileged policy that reads the user's hidden goal {_rate(ceiling)} "
        "([each seed, and why nothing happens at first](docs/learning_starts.md))."
    )


def _rate(value: float) -> str:
    return f"{value:.2f}".lstrip("0")


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
