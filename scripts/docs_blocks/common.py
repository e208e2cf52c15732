"""Shared parts of the blocks: their registry, readers of results/, Markdown tables."""

from __future__ import annotations

import csv
import json
import shlex
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.finished_runs import RUNS, read_runs
from bbq_torchrl.evaluation.groups import Group, difference, grouped, pair
from bbq_torchrl.utils.reports import table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bbq_torchrl.evaluation.finished_runs import Replica
    from bbq_torchrl.utils.statistics import Estimate

ROOT = Path(__file__).resolve().parents[2]
RESULTS, FIGURES = ROOT / "results", ROOT / "docs" / "figures"

BLOCKS: dict[str, Callable[[], str]] = {}
"""Name -> function that returns the block. Any page may include any block."""


def block(name: str, *given: Any) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Registers a function, with these arguments, as the block of a name."""

    def declare(function: Callable[..., str]) -> Callable[..., str]:
        BLOCKS[name] = lambda: function(*given)
        return function

    return declare


def groups(*names: str) -> list[Group]:
    """Returns the runs of experiments, or those below a name: ``table1/full/dqn``."""
    found: list[Replica] = []
    for name in names:
        experiment, *start = name.split("/")
        folder = RESULTS / experiment
        below = folder.joinpath(*start)
        found += [one for one in _replicas(folder) if one.folder.is_relative_to(below)]
    return grouped(found)


@cache
def _replicas(experiment: Path) -> list[Replica]:
    return read_runs(experiment) if (experiment / RUNS).is_file() else []


def group(name: str) -> Group:
    """Returns the runs below a name, all of one setting."""
    (found,) = groups(name)
    return found


def minus(one: Group, other: Group, quantity: str) -> Estimate:
    """Returns the mean difference of two groups by pairs of seeds, with its interval."""
    return difference(pair(one, other).differences[quantity])


def paired(one: Sequence[float], other: Sequence[float]) -> str:
    """Returns the mean paired difference of ``one`` minus ``other`` with its t interval."""
    return str(difference([a - b for a, b in zip(one, other, strict=True)]))


def command(overrides: Sequence[str]) -> str:
    """Returns the command of a run."""
    return f"python train.py {shlex.join(overrides)}"


def commands(experiment: str) -> str:
    """Returns the sentence with the first command of an experiment, and where the others are."""
    runs = read_json(f"{experiment}/{RUNS}")["runs"]
    first = next(iter(runs.values()))["overrides"]
    return (
        f"The first of {len(runs)} runs: {code(command(first))}. All commands: "
        f"`results/{experiment}/{RUNS}`; all numbers: `bbq report results/{experiment}`."
    )


def code(text: object) -> str:
    """Returns ``text`` as inline code."""
    return f"`{text}`"


def short(rate: float) -> str:
    """Returns a rate with three decimals, without its zero: ``.809``."""
    return f"{rate:.3f}".removeprefix("0")


def pivot(corner: str, cells: Mapping[tuple[str, str], object]) -> str:
    """Returns a table of cells by row and column, both in order of first appearance.

    Examples:
        >>> print(pivot("agent", {("dqn", "seed 0"): 0.5, ("bbqn", "seed 1"): 0.7}))
        | agent | seed 0 | seed 1 |
        | --- | ---: | ---: |
        | dqn | 0.5 | – |
        | bbqn | – | 0.7 |
    """
    rows, columns = (dict.fromkeys(key[place] for key in cells) for place in (0, 1))
    lines = [(row, *(cells.get((row, column), "–") for column in columns)) for row in rows]
    return table((corner, *columns), lines, numbers=len(columns))


def read_csv(name: str) -> list[dict[str, str]]:
    """Returns the rows of a CSV file in results/."""
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_json(name: str) -> Any:
    """Returns the content of a JSON file in results/."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))
