"""Tables and figures of trained agents, from the result folders in results/.

``results/<experiment>/<run>/`` is what ``scripts/keep_result.py`` keeps of a run folder.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import yaml

from bbq_torchrl.evaluation.csv_tables import write_replicas
from bbq_torchrl.evaluation.figures import draw_comparison
from bbq_torchrl.evaluation.groups import Group, read_groups
from bbq_torchrl.evaluation.pairs import pair, pairings
from bbq_torchrl.evaluation.report import cells_of_table1, curves, draw_table1
from bbq_torchrl.evaluation.statistics import summarize
from bbq_torchrl.evaluation.table1 import (
    PAPER,
    comparisons_table,
    find_cells,
    missing_cells,
    table1,
)
from bbq_torchrl.evaluation.tables import (
    improvement_table,
    learning_table,
    pairs_table,
    success_table,
)
from scripts.docs_blocks.claims import DOMAINS, claims_table
from scripts.docs_blocks.markdown import table
from scripts.docs_blocks.policies import success_rate

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.evaluation.runs import Run

__all__ = ["EXPERIMENTS", "command", "draw_figures", "groups", "results_blocks", "table1_groups"]

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
FIGURES = ROOT / "docs" / "figures"


class Experiment(NamedTuple):
    """What is kept of some agents in one setting.

    Attributes:
        title: what was trained on.
        ended_in: corpus and setting of results/policies.json in which its training ended.
        is_main: whether it compares BBQN with DQN.
    """

    title: str
    ended_in: tuple[str, str] = ("movie", "reference")
    is_main: bool = True


EXPERIMENTS = {
    "tcbot": Experiment("The public setting, 2,000 dialogues", ("miulab", "v1, no error")),
    "quick": Experiment("The quick form, our corpus", is_main=False),
    "learning_movie": Experiment("Full domain, our corpus, first defaults", is_main=False),
    "learning_miulab": Experiment(
        "Full domain, the public MiuLab corpus, first defaults", ("miulab", "reference")
    ),
    "extension_movie": Experiment("Domain extension, our corpus, first defaults", is_main=False),
    "no_spike_movie": Experiment("Without spiking, our corpus, first defaults", is_main=False),
}
"""Folder in results/ -> what it is of."""

MAIN = {name: of.title for name, of in EXPERIMENTS.items() if of.is_main}


def groups(experiment: str) -> list[Group]:
    """Returns what is kept of an experiment, in order of the folders' names."""
    return read_groups(sorted(file.parent for file in (RESULTS / experiment).glob("*/result.json")))


def table1_groups() -> list[Group]:
    """Returns what is kept of Table 1: ``results/table1/<domain>/<agent>/seed<n>``."""
    return read_groups(sorted(file.parent for file in (RESULTS / "table1").rglob("result.json")))


def command(run: Run) -> str:
    """Returns the command that made a run."""
    overrides = yaml.safe_load((run.folder / "overrides.yaml").read_text(encoding="utf-8"))
    quoted = (f"'{item}'" if "[" in item else item for item in overrides)  # for the shell
    return " ".join(["python train.py", *quoted])


def results_blocks() -> dict[str, Callable[[], str]]:
    """Returns a block for every experiment, and three of the main ones."""
    blocks: dict[str, Callable[[], str]] = {
        "results.readme": _readme,
        "results.main": _main,
        "results.claims": lambda: claims_table(table1_groups(), groups),
        "results.table1": _table1,
    }
    return blocks | {f"results.{name}": partial(_experiment, name) for name in EXPERIMENTS}


def draw_figures() -> list[Path]:
    """Draws the learning curves of every experiment, and writes table1.csv; returns the files."""
    FIGURES.mkdir(exist_ok=True)
    drawn = []
    for env in PAPER:
        if draw_table1(table1_groups(), env, FIGURES / f"table1_{env}.png"):
            drawn.append(FIGURES / f"table1_{env}.png")
    if drawn:
        drawn.append(RESULTS / "table1.csv")
        write_replicas(cells_of_table1(table1_groups()), drawn[-1])
    for experiment, of in EXPERIMENTS.items():
        if kept := groups(experiment):
            drawn.append(FIGURES / f"{experiment}.png")
            ceiling = success_rate(*of.ended_in, "clairvoyant")
            draw_comparison(
                drawn[-1],
                [curves(group) for group in kept],
                title=of.title,
                references={} if ceiling is None else {"clairvoyant": ceiling},
            )
    return drawn


def _table1() -> str:
    """Returns Table 1 with what is missing, its figures, and the commands of what was run."""
    kept = table1_groups()
    if not kept:
        return "No cell has been run with the present defaults yet."
    missing = missing_cells(kept)
    parts = [f"Not run yet: {'; '.join(missing)}."] if missing else []
    for env, title in DOMAINS.items():
        parts += [f"### {title}", table1(kept, env)]
        if find_cells(kept, env):
            parts.append(comparisons_table(kept, env))
            parts.append(f"![{title}: learning curves](figures/table1_{env}.png)")
    commands = [command(run) for group in kept for run in group.runs]
    if commands:
        parts.append("```bash\n" + "\n".join(commands) + "\n```")
    return "\n\n".join(parts)


def _experiment(experiment: str) -> str:
    """Returns table, comparison, figure and commands of one experiment."""
    kept = groups(experiment)
    commands = [command(run) for group in kept for run in group.runs]
    parts = [
        success_table(kept),
        improvement_table(kept),
        pairs_table(pairings(kept)),
        learning_table(kept),
        f"![Training success by round](figures/{experiment}.png)",
        "```bash\n" + "\n".join(commands) + "\n```",
    ]
    return "\n\n".join(part for part in parts if part)


def _readme() -> str:
    """Returns the final success of BBQN-MAP and DQN wherever both were trained, by pairs."""
    cells = {env: find_cells(table1_groups(), env) for env in PAPER}
    compared = [
        (f"{DOMAINS[env]}, our corpus", [found["BBQN-MAP"], found["DQN"]])
        for env, found in cells.items()
        if {"BBQN-MAP", "DQN"} <= found.keys()
    ]
    main = [(title, groups(experiment)[:2]) for experiment, title in MAIN.items()]
    compared += [(title, kept) for title, kept in main if kept]
    rows = []
    for title, (own, other) in compared:
        found = [str(summarize(group.final).t) for group in (own, other)]
        ends, learns = (
            f"{pair(own, other).differences[name].t:+.3f}"
            for name in ("final_success", "training_success")
        )
        rows.append((title, *found, ends, learns))
    head = ("trained on", "BBQN-MAP", "DQN", "difference", "of all training")
    return table(head, rows, numbers=4)


def _main() -> str:
    """Returns every agent of the main experiments in one table."""
    rows = [
        (title, *row)
        for experiment, title in MAIN.items()
        for row in _main_rows(groups(experiment))
    ]
    head = ("trained on", "agent", "seeds", "final success", "cumulative training success")
    return (
        f"{table(head, rows, numbers=3)}\n\n"
        "(Mean over seeds with its 95 % t interval; differences are by pairs. Final success: "
        "10,000 dialogues of each seed, 2,000 in the public setting. First defaults: BBQN from the "
        "paper's start, DQN with dropout .5.)"
    )


def _main_rows(kept: list[Group]) -> list[tuple[object, ...]]:
    """Returns a row for each agent, and the first one's difference to each of the others."""
    rows: list[tuple[object, ...]] = [
        (
            group.label,
            len(group.final),
            summarize(group.final).t,
            summarize(group.cumulative).t,
        )
        for group in kept
    ]
    for item in (pair(kept[0], other) for other in kept[1:]):
        if item.pairs:
            found = (item.differences[name].t for name in ("final_success", "training_success"))
            rows.append((item.label, item.pairs, *(f"{difference:+.3f}" for difference in found)))
    return rows
