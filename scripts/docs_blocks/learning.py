"""The tables of docs/learning_starts.md: the plateau, the searches, and what was tried."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING

from scipy import stats

from bbq_torchrl.evaluation.learning import rounds_to_reach
from scripts.docs_blocks.markdown import table
from scripts.docs_blocks.policies import success_rate
from scripts.docs_blocks.results import groups

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.evaluation.groups import Group

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


def _runs() -> Group:
    """Returns the seeds of the README's first command."""
    (group,) = groups("quick")
    return group


def _quick() -> str:
    """Returns a line for each seed of the README's first command."""
    group = _runs()
    took = {int(line["seed"]): line for line in _read("quick_seconds.csv")}
    seeds = [member.seed for member in group.members]
    wall, processor = (
        [float(took[seed][clock]) for seed in seeds] for clock in ("wall", "processor")
    )
    figures = {"final success": group.final, "cumulative training success": group.cumulative}
    reached = rounds_to_reach(group.evaluation, LEVEL, window=1)
    shown = ["not reached" if math.isinf(rounds) else f"{rounds:.0f}" for rounds in reached]
    columns = [
        ["seed", *map(str, seeds), "mean"],
        *([name, *(f"{x:.3f}" for x in (*xs, fmean(xs)))] for name, xs in figures.items()),
        [f"rounds to {LEVEL}", *shown, ""],
        *(
            [name, *(f"{x:.0f}" for x in (*xs, fmean(xs)))]
            for name, xs in (("seconds", wall), ("of a core", processor))
        ),
    ]
    head, *rows = zip(*columns, strict=True)
    return (
        f"{table(head, rows, numbers=6)}\n\n"
        f"The final success of {len(seeds)} seeds is between {min(group.final):.2f} and "
        f"{max(group.final):.2f}. Rounds to {LEVEL}: until an evaluation while training was there. "
        "Seconds are of the whole command, from the start of the process to its end, on a machine "
        f"of two cores beside another process (median {median(wall):.0f}), and those of a core "
        f"that it took (median {median(processor):.0f})."
    )


def _expect() -> str:
    """Returns what a user of the README's first command can expect."""
    finals = _runs().final
    rule, ceiling = (success_rate("movie", "reference", name) for name in ("rule", "clairvoyant"))
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
