"""Parts of a report: tables (shown as Markdown, kept as CSV), text and figures."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from bbq_torchrl import markdown
from bbq_torchrl.evaluation.figures import save
from bbq_torchrl.evaluation.groups import know_commits
from bbq_torchrl.evaluation.learning import rounds_to_reach

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.evaluation.groups import Group

NONE = "–"
"""Stands in Markdown where there is nothing."""


@runtime_checkable
class Cell(Protocol):
    """A value shown as one cell of a table, by ``str``, and kept as several columns."""

    def columns(self) -> Mapping[str, float]:
        """Returns what the names of the columns end in -> the numbers, with all their digits."""


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes:
        name: of its CSV file.
        rows: column to cell each; a column that a row lacks has a dash there. Of a name such as
            ``reward: the paper's`` the part behind the colon is shown.
        words: how many columns, the first ones, are not numbers.
    """

    name: str
    rows: Sequence[Mapping[str, object]]
    words: int = 1

    def __str__(self) -> str:
        """The table as Markdown; empty without rows."""
        if not self.rows:
            return ""
        names = dict.fromkeys(name for row in self.rows for name in row)
        cells = [[_shown(row.get(name, NONE)) for name in names] for row in self.rows]
        head = [name.rpartition(": ")[2] for name in names]
        return markdown.table(head, cells, numbers=len(head) - self.words)

    def write(self, folder: Path) -> None:
        """Writes the table as ``<name>.csv``, unrounded; no file where there are no rows.

        A cell with an interval becomes several columns: ``final_success``, ``final_success_low``
        and so on. What there is not, such as the interval of a single seed, is empty.
        """
        file = folder / f"{_plain(self.name)}.csv"
        if not self.rows:
            file.unlink(missing_ok=True)
            return
        lines = [_line(row) for row in self.rows]
        names = dict.fromkeys(name for line in lines for name in line)
        with file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, fieldnames=list(names), lineterminator="\n")
            writer.writeheader()
            writer.writerows(lines)


@dataclass(frozen=True)
class Report:
    """A report on groups of runs.

    Attributes:
        name: of its Markdown file.
        title: its heading.
        groups: what it is about.
        parts: paragraphs and tables, in order.
        figures: name of the file -> its title, and what draws the figure.
    """

    name: str
    title: str
    groups: Sequence[Group]
    parts: Sequence[str | Table]
    figures: Mapping[str, tuple[str, Callable[[], Figure]]]

    @property
    def body(self) -> str:
        """The report below its heading, as Markdown; last the commits of the code, where known."""
        return "\n\n".join(filter(None, map(str, (*self.parts, commits_text(self.groups)))))

    def __str__(self) -> str:
        return f"# {self.title}\n\n{self.body}\n"

    def write(self, folder: Path) -> None:
        """Writes ``<name>.md``, each table as CSV, each figure as PNG and as SVG.

        And ``replicas.csv``, a row for each replica.
        """
        folder.mkdir(parents=True, exist_ok=True)
        shown = [f"![{title}]({name}.png)\n" for name, (title, _) in self.figures.items()]
        (folder / f"{self.name}.md").write_text("\n".join([str(self), *shown]), encoding="utf-8")
        for part in (*self.parts, replicas_table(self.groups)):
            if isinstance(part, Table):
                part.write(folder)
        for name, (_, draw) in self.figures.items():
            figure = draw()
            for kind in ("png", "svg"):
                save(figure, folder / f"{name}.{kind}")


def commits_text(groups: Sequence[Group]) -> str:
    """Returns of which commits the runs are; empty where no run knows."""
    if not know_commits(groups):
        return ""
    together: dict[str, list[str]] = {}
    for group in groups:
        together.setdefault(group.commit, []).append(group.label)
    if len({replica.result.code for group in groups for replica in group.replicas}) == 1:
        return f"All runs are of commit {groups[0].commit}."
    lines = [f"- {commit}: {'; '.join(labels)}" for commit, labels in together.items()]
    return "\n".join(["The runs are of different commits:\n", *lines])


def replicas_table(groups: Sequence[Group], name: str = "replicas") -> Table:
    """Returns a row for each replica."""
    rows = [
        {
            "corpus": replica.result.domain,
            "env": replica.result.env,
            "agent": group.label,
            "replica": replica.number,
            "seed": replica.result.seed,
            "rounds": replica.result.rounds,
            "updates": replica.updates,
            "success_rate": replica.own.success_rate,
            "reward": replica.own.reward,
            "turns": replica.own.turns,
            "cumulative_success": replica.own.training_success,
            "rounds_to_60": f"{reached:.0f}".replace("inf", ""),
        }
        | ({"commit": replica.result.code} if know_commits(groups) else {})
        for group in groups
        for replica, reached in zip(
            group.replicas, rounds_to_reach(group.success, 0.6).tolist(), strict=True
        )
    ]
    return Table(name, rows)


def _shown(cell: object) -> str:
    return f"{cell:.2f}" if type(cell) is float else str(cell)


def _line(row: Mapping[str, object]) -> dict[str, object]:
    line: dict[str, object] = {}
    for column, cell in row.items():
        parts = cell.columns() if isinstance(cell, Cell) else {"": cell}
        line |= {_plain(column) + end: _kept(part) for end, part in parts.items()}
    return line


def _plain(name: str) -> str:
    """Returns a name without spaces and the like: ``final_success`` for ``final success``."""
    return re.sub(r"[^\w.]+", "_", name.lower().replace("'", "")).strip("_")


def _kept(value: object) -> object:
    is_none = value == NONE or (isinstance(value, float) and not math.isfinite(value))
    return "" if is_none else value
