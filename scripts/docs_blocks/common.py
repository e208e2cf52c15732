"""What the blocks share: how one is declared, the files of results/, Markdown."""

from __future__ import annotations

import csv
import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.evaluation.pairs import difference
from bbq_torchrl.reports import table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

ROOT = Path(__file__).resolve().parents[2]
RESULTS, FIGURES = ROOT / "results", ROOT / "docs" / "figures"

BLOCKS: dict[str, Callable[[], str]] = {}
"""Name -> what returns the block; every page may hold each of them."""


def block(name: str, *given: Any) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Makes a function the block of a name, called with what is given here."""

    def declare(function: Callable[..., str]) -> Callable[..., str]:
        BLOCKS[name] = lambda: function(*given)
        return function

    return declare


def code(text: object) -> str:
    """Returns ``text`` as inline code."""
    return f"`{text}`"


def pivot(corner: str, cells: Mapping[tuple[str, str], object]) -> str:
    """Returns a table of cells by row and column, both in the order in which they come first.

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


def paired(one: Sequence[float], other: Sequence[float]) -> str:
    """Returns the mean of ``one`` minus ``other``, pair by pair, with its t interval."""
    return str(difference([a - b for a, b in zip(one, other, strict=True)]))


def command(folder: Path) -> str:
    """Returns the command that made a run."""
    overrides = yaml.safe_load((folder / "overrides.yaml").read_text(encoding="utf-8"))
    return f"python train.py {shlex.join(overrides)}"


def read_csv(name: str) -> list[dict[str, str]]:
    """Returns the lines of a file in results/."""
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_json(name: str) -> Any:
    """Returns what a file in results/ holds."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))
