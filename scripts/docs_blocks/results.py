"""Tables and figures of trained agents, from the result folders in results/.

``results/<experiment>/<run>/`` is what ``scripts/keep_result.py`` keeps of a run folder.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from bbq_torchrl.evaluation.csv_tables import write_replicas
from bbq_torchrl.evaluation.figures import draw_comparison
from bbq_torchrl.evaluation.groups import Group, read_groups
from bbq_torchrl.evaluation.pairs import pair
from bbq_torchrl.evaluation.report import (
    cells_of_table1,
    comparison_tables,
    curves,
    draw_table1,
    table1_text,
)
from bbq_torchrl.evaluation.statistics import summarize
from bbq_torchrl.evaluation.table1 import PAPER, find_cells
from scripts.docs_blocks import common
from scripts.docs_blocks.common import block, table
from scripts.docs_blocks.tables import success_rate

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from bbq_torchrl.evaluation.runs import Run

__all__ = ["DOMAINS", "EXPERIMENTS", "command", "draw_figures", "groups"]

DOMAINS = {"full": "Full domain", "domain_ext": "Domain extension"}
"""Environment -> what it is called."""


EXPERIMENTS = {
    "tcbot": ("The public setting, 2,000 dialogues", "miulab", "v1, no error"),
    "quick": ("The quick form, our corpus", "movie", "reference"),
    "learning_movie": ("Full domain, our corpus, first defaults", "movie", "reference"),
    "learning_miulab": (
        "Full domain, the public MiuLab corpus, first defaults",
        "miulab",
        "reference",
    ),
    "extension_movie": ("Domain extension, our corpus, first defaults", "movie", "reference"),
    "no_spike_movie": ("Without spiking, our corpus, first defaults", "movie", "reference"),
}
"""Folder in results/ -> what was trained on; corpus and setting of results/policies.json."""

MAIN = ("tcbot", "learning_miulab")
"""Those that compare BBQN with DQN beside Table 1."""


def groups(experiment: str) -> list[Group]:
    """Returns what is kept of an experiment: ``results/<experiment>/**/result.json``."""
    files = (common.RESULTS / experiment).rglob("result.json")
    return read_groups(sorted(file.parent for file in files))


def command(run: Run) -> str:
    """Returns the command that made a run."""
    overrides = yaml.safe_load((run.folder / "overrides.yaml").read_text(encoding="utf-8"))
    quoted = (f"'{item}'" if "[" in item else item for item in overrides)  # for the shell
    return " ".join(["python train.py", *quoted])


def _commands(kept: Iterable[Group]) -> str:
    return "\n".join(["```bash", *(command(run) for group in kept for run in group.runs), "```"])


def draw_figures() -> list[Path]:
    """Draws the learning curves of every experiment, and writes table1.csv; returns the files."""
    common.FIGURES.mkdir(exist_ok=True)
    of_table1 = groups("table1")
    figures = {env: common.FIGURES / f"table1_{env}.png" for env in PAPER}
    drawn = [file for env, file in figures.items() if draw_table1(of_table1, env, file)]
    if drawn:
        drawn.append(common.RESULTS / "table1.csv")
        write_replicas(cells_of_table1(of_table1), drawn[-1])
    for name, (title, *ended_in) in EXPERIMENTS.items():
        if kept := groups(name):
            drawn.append(common.FIGURES / f"{name}.png")
            ceiling = success_rate(*ended_in, "clairvoyant")
            references = {} if ceiling is None else {"clairvoyant": ceiling}
            shown = [curves(group) for group in kept]
            draw_comparison(drawn[-1], shown, title=title, references=references)
    return drawn


@block("results.table1")
def _table1() -> str:
    """Returns the report on Table 1, its figures, and the commands of what was run."""
    kept = groups("table1")
    if not kept:
        return "No cell has been run with the present defaults yet."
    text = table1_text(kept).partition("\n\n")[2].strip()  # its first line is the page's heading
    for env, title in DOMAINS.items():
        text = text.replace(f"## env={env}\n", f"### {title}\n")
    figures = [
        f"![{title}: learning curves](figures/table1_{env}.png)"
        for env, title in DOMAINS.items()
        if find_cells(kept, env)
    ]
    return "\n\n".join([text, *figures, _commands(kept)])


def _experiment(name: str) -> str:
    """Returns the report's tables, figure and commands of one experiment."""
    kept = groups(name)
    figure = f"![Training success by round](figures/{name}.png)"
    tables = (table for table, _ in comparison_tables(kept))
    return "\n\n".join([*tables, figure, _commands(kept)])


for _name in EXPERIMENTS:
    block(f"results.{_name}", _name)(_experiment)


@block("results.readme")
def _readme() -> str:
    """Returns the final success of BBQN-MAP and DQN wherever both were trained, by pairs."""
    cells = {title: find_cells(groups("table1"), env) for env, title in DOMAINS.items()}
    compared = [
        (f"{title}, our corpus", [found["BBQN-MAP"], found["DQN"]])
        for title, found in cells.items()
        if {"BBQN-MAP", "DQN"} <= found.keys()
    ]
    compared += [(EXPERIMENTS[name][0], kept[:2]) for name in MAIN if (kept := groups(name))]
    rows = []
    for title, (own, other) in compared:
        found = pair(own, other).differences
        ends, learns = (f"{found[of].t:+.3f}" for of in ("final_success", "training_success"))
        rows.append((title, summarize(own.final).t, summarize(other.final).t, ends, learns))
    head = ("trained on", "BBQN-MAP", "DQN", "difference", "of all training")
    return table(head, rows, numbers=4)
