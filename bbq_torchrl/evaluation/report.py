"""``python -m bbq_torchrl.evaluation.report``: finished runs compared over their seeds.

The tables, the CSV files and the figure of a comparison; what is on the results page of the
documentation is made by the same functions.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bbq_torchrl import interruption, output
from bbq_torchrl.evaluation.ablations import ablations_text, find_ablations
from bbq_torchrl.evaluation.csv_tables import write_csv, write_replicas
from bbq_torchrl.evaluation.figures import COLORS, Curves, draw_ablations, draw_comparison
from bbq_torchrl.evaluation.grid import grid_text
from bbq_torchrl.evaluation.groups import Group, read_groups
from bbq_torchrl.evaluation.pairs import pairings
from bbq_torchrl.evaluation.runs import find_results
from bbq_torchrl.evaluation.table1 import (
    PAPER,
    TABLE1_NOTE,
    comparisons_table,
    find_cells,
    missing_cells,
    table1,
)
from bbq_torchrl.evaluation.tables import (
    LEARNING_NOTE,
    NOTE,
    PAIRS_NOTE,
    as_markdown,
    learning_rows,
    pair_rows,
    pairs_table,
    success_rows,
)
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = [
    "cells_of_table1",
    "comparison_tables",
    "curves",
    "draw_table1",
    "main",
    "references",
    "setting_of",
    "table1_text",
    "write_ablations",
    "write_grid",
    "write_report",
    "write_table1",
]


def setting_of(groups: Sequence[Group]) -> str:
    """Returns what the groups have in common: ``"env=full, domain=movie"``; no domain if none."""
    common = {
        name: sorted({getattr(group.first, name) for group in groups} - {""})
        for name in ("env", "domain")
    }
    return ", ".join(f"{name}={'|'.join(values)}" for name, values in common.items() if values)


def curves(group: Group) -> Curves:
    """Returns what is drawn of a group."""
    return Curves(group.label, group.success, group.final, group.evaluation, group.training_reward)


def write_table1(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``table1.md``, ``replicas.csv`` and the curves of each domain as PNG and SVG files.

    Returns the tables as Markdown, which begin with what is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for env in PAPER:
        for file in (folder / f"table1_{env}.png", folder / f"table1_{env}.svg"):
            if draw_table1(groups, env, file):
                pictures.append(f"![Learning curves, env={env}]({file.name})\n")
    text = table1_text(groups)
    (folder / "table1.md").write_text("\n".join([text, *pictures[::2]]), encoding="utf-8")
    write_replicas(cells_of_table1(groups), folder / "replicas.csv")
    return text


def cells_of_table1(groups: Sequence[Group]) -> list[Group]:
    """Returns the groups that are cells of Table 1, in its order and by the paper's names."""
    return [
        replace(group, label=name)
        for env in PAPER
        for name, group in find_cells(groups, env).items()
    ]


def draw_table1(groups: Sequence[Group], env: str, file: Path) -> bool:
    """Draws the agents of Table 1 in one environment; returns whether there are any."""
    cells = [group for group in cells_of_table1(groups) if group.first.env == env]
    if cells:
        shown = [curves(group) for group in cells]
        draw_comparison(file, shown, title=f"Table 1, env={env}", panels=True)
    return bool(cells)


def table1_text(groups: Sequence[Group]) -> str:
    """Returns Table 1 and its declared comparisons as Markdown, first of all what is missing."""
    missing = missing_cells(groups)
    count = sum(map(len, PAPER.values()))
    parts = [f"# Table 1: {count - len(missing)} of {count} cells"]
    if missing:
        parts.append(f"Not run: {'; '.join(missing)}.")
    for env in PAPER:
        parts += [f"## env={env}", table1(groups, env), comparisons_table(groups, env)]
    return "\n\n".join([*parts, TABLE1_NOTE.strip()]) + "\n"


def write_grid(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``grid.md`` and ``replicas.csv``. Returns the grid as Markdown."""
    text = grid_text(groups)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "grid.md").write_text(text, encoding="utf-8")
    write_replicas(groups, folder / "replicas.csv")
    return text


def write_ablations(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``ablations.md``, ``replicas.csv`` and the panels as PNG and SVG files.

    Returns the tables as Markdown.
    """
    found = find_ablations(groups)
    text = ablations_text(groups)
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("png", "svg"):
        draw_ablations(folder / f"ablations.{kind}", found)
    picture = "![A panel for each key](ablations.png)\n"
    (folder / "ablations.md").write_text(f"{text}\n{picture}", encoding="utf-8")
    write_replicas(groups, folder / "replicas.csv")
    return text


def references(groups: Sequence[Group]) -> dict[str, float]:
    """Returns the success of the privileged policies, by name, mean over the runs.

    Empty unless the runs all know it and have the same users.
    """
    runs = [run for group in groups for run in group.runs]
    users = [
        {key: value for key, value in run.setting.items() if key.startswith(("env.", "domain."))}
        for run in runs
    ]
    known = [run.result.references for run in runs]
    if any(other != users[0] for other in users) or any(
        one.keys() != known[0].keys() for one in known
    ):
        return {}
    return {name: math.fsum(one[name] for one in known) / len(known) for name in known[0]}


def write_report(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``report.md``, a CSV file of each of its tables, and the learning curves.

    Returns the tables as Markdown.

    The files: ``report.csv`` (success), ``pairs.csv``, ``learning.csv``, and ``replicas.csv`` with
    a row for each replica. A figure shows at most seven groups: ``curves.png``, then
    ``curves_2.png`` and so on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = []
    for number, start in enumerate(range(0, len(groups), len(COLORS)), 1):
        figures.append(folder / ("curves.png" if number == 1 else f"curves_{number}.png"))
        drawn = groups[start : start + len(COLORS)]
        title = f"Training success: {setting_of(drawn)}"
        draw_comparison(
            figures[-1],
            [curves(group) for group in drawn],
            title=title,
            references=references(drawn),
        )
    pictures = [f"![Training success by round]({figure.name})" for figure in figures]
    text = _markdown(groups)
    (folder / "report.md").write_text("\n".join([text, *pictures, ""]), encoding="utf-8")
    write_csv(folder / "report.csv", success_rows(groups))
    write_csv(folder / "pairs.csv", pair_rows(pairings(groups)))
    write_csv(folder / "learning.csv", learning_rows(groups))
    write_replicas(groups, folder / "replicas.csv")
    return text


def comparison_tables(groups: Sequence[Group]) -> list[tuple[str, str]]:
    """Returns the tables of a comparison as Markdown, each with the note that explains it."""
    tables = [
        (as_markdown(success_rows(groups), words=2), NOTE),
        (pairs_table(pairings(groups)), PAIRS_NOTE),
        (as_markdown(learning_rows(groups), words=2), LEARNING_NOTE),
    ]
    return [(table, note.strip()) for table, note in tables if table]


def _markdown(groups: Sequence[Group]) -> str:
    parts = [f"# {setting_of(groups)}"]
    parts += [part for pair in comparison_tables(groups) for part in pair if part]
    return "\n\n".join(parts) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    interruption.tell(lambda: "in a report", lambda: "the same command begins again")
    parser = output.Parser(
        prog="python -m bbq_torchrl.evaluation.report",
        description="Compares finished runs over their seeds: prints the tables as Markdown.",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, help="run folders, or folders with run folders below them"
    )
    parser.add_argument(
        "--out", type=Path, help="folder for report.md, its tables as CSV files, and curves.png"
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--table1",
        action="store_true",
        help="the paper's Table 1: its numbers beside, declared pairs, and what is missing",
    )
    form.add_argument(
        "--grid", action="store_true", help="learner x explorer: each learner by each exploration"
    )
    form.add_argument(
        "--ablations",
        action="store_true",
        help="runs that each change one key of a reference; of one key alone, give that first",
    )
    given = parser.parse_args(arguments)
    try:
        groups = read_groups(find_results(given.folders))
        to_text, write = _markdown, write_report
        if given.table1:
            to_text, write = table1_text, write_table1
        elif given.grid:
            to_text, write = grid_text, write_grid
        elif given.ablations:
            to_text, write = ablations_text, write_ablations
        text = to_text(groups) if given.out is None else write(groups, given.out)
    except (ValueError, OSError) as error:
        output.complain(f"error: {sentence(error)}")
        return 2
    output.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
