"""``python -m bbq_torchrl.evaluation.report``: finished runs compared over their seeds.

The tables, the CSV files and the figure of a comparison; what is on the results page of the
documentation is made by the same functions.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from bbq_torchrl import interruption, output
from bbq_torchrl.evaluation.ablations import ablations_text, find_ablations
from bbq_torchrl.evaluation.csv_tables import write_csv, write_replicas
from bbq_torchrl.evaluation.figures import COLORS, draw_ablations, draw_comparison
from bbq_torchrl.evaluation.grid import grid_text
from bbq_torchrl.evaluation.groups import Group, read_groups
from bbq_torchrl.evaluation.pairs import pairings
from bbq_torchrl.evaluation.runs import find_results
from bbq_torchrl.evaluation.table1 import (
    PAPER,
    cells_of_table1,
    find_cells,
    table1_text,
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
    from collections.abc import Callable, Sequence

__all__ = [
    "comparison_tables",
    "draw_table1",
    "main",
    "references",
    "report_text",
    "setting_of",
    "write_report",
]


def setting_of(groups: Sequence[Group]) -> str:
    """Returns what the groups have in common: ``"env=full, domain=movie"``; no domain if none."""
    common = {
        name: sorted({getattr(group.first, name) for group in groups} - {""})
        for name in ("env", "domain")
    }
    return ", ".join(f"{name}={'|'.join(values)}" for name, values in common.items() if values)


def draw_table1(groups: Sequence[Group], env: str, file: Path) -> bool:
    """Draws the agents of Table 1 in one environment; returns whether there are any."""
    cells = find_cells(groups, env)
    if cells:
        draw_comparison(file, [*cells.values()], title=f"Table 1, env={env}", panels=True)
    return bool(cells)


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


def comparison_tables(groups: Sequence[Group]) -> list[tuple[str, str]]:
    """Returns the tables of a comparison as Markdown, each with the note that explains it."""
    tables = [
        (as_markdown(success_rows(groups), words=2), NOTE),
        (pairs_table(pairings(groups)), PAIRS_NOTE),
        (as_markdown(learning_rows(groups), words=2), LEARNING_NOTE),
    ]
    return [(table, note.strip()) for table, note in tables if table]


def report_text(groups: Sequence[Group]) -> str:
    """Returns the comparison of the groups as Markdown."""
    parts = [f"# {setting_of(groups)}"]
    parts += [part for pair in comparison_tables(groups) for part in pair]
    return "\n\n".join(parts) + "\n"


def _add_to_report(groups: Sequence[Group], folder: Path) -> dict[str, str]:
    write_csv(folder / "report.csv", success_rows(groups))
    write_csv(folder / "pairs.csv", pair_rows(pairings(groups)))
    write_csv(folder / "learning.csv", learning_rows(groups))
    figures = {}
    for number, start in enumerate(range(0, len(groups), len(COLORS)), 1):
        drawn = groups[start : start + len(COLORS)]
        name = "curves.png" if number == 1 else f"curves_{number}.png"
        title = f"Training success: {setting_of(drawn)}"
        draw_comparison(folder / name, drawn, title=title, references=references(drawn))
        figures[name] = "Training success by round"
    return figures


def _add_to_table1(groups: Sequence[Group], folder: Path) -> dict[str, str]:
    found = [env for env in PAPER if draw_table1(groups, env, folder / f"table1_{env}.png")]
    for env in found:
        draw_table1(groups, env, folder / f"table1_{env}.svg")
    return {f"table1_{env}.png": f"Learning curves, env={env}" for env in found}


def _add_to_ablations(groups: Sequence[Group], folder: Path) -> dict[str, str]:
    for kind in ("png", "svg"):
        draw_ablations(folder / f"ablations.{kind}", find_ablations(groups))
    return {"ablations.png": "A panel for each key"}


FORMS: dict[str, tuple[Callable[..., str], Callable[..., dict[str, str]]]] = {
    "report": (report_text, _add_to_report),
    "table1": (table1_text, _add_to_table1),
    "grid": (grid_text, lambda groups, folder: {}),
    "ablations": (ablations_text, _add_to_ablations),
}
"""Name -> what makes the Markdown of the groups; and what writes the other files into a folder and
returns the figures among them, file name -> title."""


def write_report(form: str, groups: Sequence[Group], folder: Path) -> str:
    """Writes a form of report: ``<form>.md``, its figures, ``replicas.csv`` with a row a replica.

    The form ``report`` also has its tables as ``report.csv`` (success), ``pairs.csv`` and
    ``learning.csv``; a figure of it shows at most seven groups: ``curves.png``, then
    ``curves_2.png`` and so on. Those of ``table1`` and ``ablations`` are PNG and SVG files.

    Returns the tables as Markdown.
    """
    to_text, add = FORMS[form]
    text = to_text(groups)
    folder.mkdir(parents=True, exist_ok=True)
    figures = [f"![{title}]({name})\n" for name, title in add(groups, folder).items()]
    (folder / f"{form}.md").write_text("\n".join([text, *figures]), encoding="utf-8")
    write_replicas(groups, folder / "replicas.csv")
    return text


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
    for name, meaning in (
        ("table1", "the paper's Table 1: its numbers beside, declared pairs, and what is missing"),
        ("grid", "learner x explorer: each learner by each exploration"),
        (
            "ablations",
            "runs that each change one key of a reference; of one key alone, give that first",
        ),
    ):
        form.add_argument(
            f"--{name}",
            dest="form",
            action="store_const",
            const=name,
            default="report",
            help=meaning,
        )
    given = parser.parse_args(arguments)
    try:
        groups = read_groups(find_results(given.folders))
        if given.form == "table1":
            groups = cells_of_table1(groups)
        if given.out is None:
            text = FORMS[given.form][0](groups)
        else:
            text = write_report(given.form, groups, given.out)
    except (ValueError, OSError) as error:
        output.complain(f"error: {sentence(error)}")
        return 2
    output.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
