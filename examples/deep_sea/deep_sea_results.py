"""The table of results, with a line for each agent, size and seed."""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

AGENT_NAMES = {
    "epsilon_greedy": "ε-greedy",
    "bootstrap": "bootstrap",
    "bootstrap_prior": "bootstrap with priors",
    "bbqn_mean": "BBQN, mean target (MAP)",
    "bbqn_independent": "BBQN, target of its own noise (MC)",
    "bbqn_shared": "BBQN, target of the same noise",
    "bbqn_mean_zero": "BBQN (MAP), zero means",
    "bbqn_independent_zero": "BBQN (MC), zero means",
    "bbqn_shared_zero": "BBQN (same noise), zero means",
    "gp_mean": "GP, mean target",
    "gp_draw": "GP, target of one draw (RLSVI)",
    "epinet": "epinet",
    "langevin": "Adam LMCDQN",
}
"""The agents, and their names in the figure."""

RESULTS = Path(__file__).resolve().parents[2] / "results" / "deep_sea.csv"


@dataclass(frozen=True)
class Line:
    """The result of a replica.

    Attributes:
        agent: the agent's name.
        size: N of the sea of N x N cells.
        seed: the replica's seed.
        episodes_to_solve: episodes until the sea was solved, or None.
        episodes: number of episodes (replicas trained together stop together).
        treasures: number of episodes in which the treasure was found.
    """

    agent: str
    size: int
    seed: int
    episodes_to_solve: int | None
    episodes: int
    treasures: int


def read(file: Path = RESULTS) -> list[Line]:
    """Returns the lines of a file; an empty list if it does not exist."""
    if not file.is_file():
        return []
    with file.open(newline="", encoding="utf-8") as opened:
        return [
            Line(
                agent=row["agent"],
                size=int(row["size"]),
                seed=int(row["seed"]),
                episodes_to_solve=int(row["episodes_to_solve"] or 0) or None,
                episodes=int(row["episodes"]),
                treasures=int(row["treasures"]),
            )
            for row in csv.DictReader(opened)
        ]


def append(lines: Iterable[Line], file: Path = RESULTS) -> None:
    """Adds lines to a file, and the header if the file is new."""
    file.parent.mkdir(parents=True, exist_ok=True)
    is_new = not file.is_file()
    with file.open("a", newline="", encoding="utf-8") as opened:
        writer = csv.DictWriter(opened, [field.name for field in fields(Line)], lineterminator="\n")
        if is_new:
            writer.writeheader()
        writer.writerows(asdict(line) for line in lines)


def typical(lines: Sequence[Line]) -> float | None:
    """Returns the median of the episodes to solve; None if at least half of the seeds failed.

    Examples:
        >>> lines = [Line("a", 4, s, n, 90, 9) for s, n in enumerate((30, None, 10))]
        >>> typical(lines), typical(lines[:2])
        (30, None)
    """
    middle = median(line.episodes_to_solve or float("inf") for line in lines)
    return None if middle == float("inf") else middle


def table(lines: Sequence[Line], agents: Sequence[str]) -> str:
    """Returns a Markdown table: for each agent and size the median and the number of solved seeds.

    If at most half of the seeds solved the sea, the cell has the limit of episodes.

    Examples:
        >>> lines = [Line("a", 4, s, n, 90, 9) for s, n in enumerate((30, None, 10))]
        >>> print(table([*lines, Line("b", 6, 0, None, 500, 0)], ["a", "b"]))
        | agent | N = 4 | N = 6 |
        | --- | ---: | ---: |
        | `a` | 30 (2) |  |
        | `b` |  | > 500 (0) |
    """
    sizes = sorted({line.size for line in lines})
    rows = [
        ["agent", *(f"N = {size}" for size in sizes)],
        ["---", *("---:" for _ in sizes)],
    ]
    for agent in agents:
        cells = []
        for size in sizes:
            of_cell = [line for line in lines if (line.agent, line.size) == (agent, size)]
            cells.append(_cell(of_cell) if of_cell else "")
        rows.append([f"`{agent}`", *cells])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _cell(lines: Sequence[Line]) -> str:
    solved = sum(line.episodes_to_solve is not None for line in lines)
    middle = typical(lines)
    limit = max(line.episodes for line in lines)
    value = f"> {limit}" if middle is None else f"{middle:g}"
    return f"{value} ({solved})"
