"""The paper's Table 1 from finished runs: its numbers beside ours, declared pairs, what is missing.

The comparisons are declared here, before anything is trained: BBQN-MAP and each other agent, in
both domains, by the success of the final evaluation (who ends higher) and by cumulative training
success (who books more in training). In a domain, the p-values of a quantity are adjusted by Holm's
method for all eight, whether they have been run or not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.evaluation.learning import reach
from bbq_torchrl.evaluation.pairs import NOT_RUN, compare
from bbq_torchrl.evaluation.statistics import estimate, estimate_iqm
from bbq_torchrl.markdown import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Comparison

__all__ = [
    "PAPER",
    "PaperCell",
    "cells_of_table1",
    "comparisons",
    "comparisons_table",
    "find_cells",
    "missing_cells",
    "table1",
    "table1_text",
]


class PaperCell(NamedTuple):
    """What the paper reports of an agent, on its own corpus and with its own noise.

    Attributes:
        success_rate: of 10,000 dialogues after training, mean of five runs.
        reward: mean of such a dialogue.
    """

    success_rate: float
    reward: float


PAPER = {
    "full": {
        "BBQN-MAP": PaperCell(0.5031, 10.71),
        "BBQN-MC": PaperCell(0.4877, 9.98),
        "BBQN-VIME-MAP": PaperCell(0.4856, 9.86),
        "BBQN-VIME-MC": PaperCell(0.4941, 10.43),
        "DQN": PaperCell(0.2693, 0.87),
        "DQN-Boltzmann": PaperCell(0.2658, 0.42),
        "DQN-Bootstrap": PaperCell(0.2516, -0.13),
        "DQN-VIME-MAP": PaperCell(0.3893, 5.86),
        "DQN-VIME-MC": PaperCell(0.3700, 5.00),
    },
    "domain_ext": {
        "BBQN-MAP": PaperCell(0.6852, 17.32),
        "BBQN-MC": PaperCell(0.6722, 16.13),
        "BBQN-VIME-MAP": PaperCell(0.6813, 15.82),
        "BBQN-VIME-MC": PaperCell(0.7120, 17.63),
        "DQN": PaperCell(0.3503, 4.76),
        "DQN-Boltzmann": PaperCell(0.2435, -3.46),
        "DQN-Bootstrap": PaperCell(0.3170, -0.68),
        "DQN-VIME-MAP": PaperCell(0.3751, 4.92),
        "DQN-VIME-MC": PaperCell(0.3675, 4.83),
    },
}
"""Environment -> agent -> the paper's cell (AAAI 2018, Table 1)."""

OURS = "BBQN-MAP"
"""What each other agent is compared with."""

LEVELS = (0.5, 0.6, 0.7)

TABLE1_NOTE = """\
Means over seeds with their 95 % Student t interval; IQM: interquartile mean with a bootstrap
interval; cumulative: share of all training dialogues that succeeded; rounds until the mean of five
rounds' training success reaches a level, the median over seeds. Differences by pairs: replicas that
saw the same spiked dialogues, goals and noise of the simulator. p: of a t test of the differences,
by Holm's method for the eight comparisons of a column that were declared, those not run included.
The paper's numbers are of another corpus and other noise.
"""


def find_cells(groups: Sequence[Group], env: str) -> dict[str, Group]:
    """Returns the groups of an environment by the paper's name, in the order of its table.

    Raises:
        ValueError: two settings of one agent.
    """
    cells: dict[str, Group] = {}
    for group in groups:
        name = group.runs[0].agent
        if group.first.env != env or name not in PAPER[env]:
            continue
        if name in cells:
            raise ValueError(
                f"a cell of Table 1 must have one setting, got two of {name} with env={env}: "
                f"{cells[name].runs[0].folder} and {group.runs[0].folder}"
            )
        cells[name] = group
    return {name: replace(cells[name], label=name) for name in PAPER[env] if name in cells}


def cells_of_table1(groups: Sequence[Group]) -> list[Group]:
    """Returns the groups that are cells of Table 1, in its order and by the paper's names."""
    return [group for env in PAPER for group in find_cells(groups, env).values()]


def missing_cells(groups: Sequence[Group]) -> list[str]:
    """Returns the cells that no run is there for, such as ``"DQN with env=full"``."""
    return [
        f"{name} with env={env}"
        for env, agents in PAPER.items()
        for name in agents
        if name not in find_cells(groups, env)
    ]


def comparisons(groups: Sequence[Group], env: str, quantity: str) -> list[Comparison]:
    """Returns the declared comparisons of an environment by one quantity."""
    declared = [(OURS, name) for name in PAPER[env] if name != OURS]
    return compare(find_cells(groups, env), declared, quantity)


def table1(groups: Sequence[Group], env: str) -> str:
    """Returns Table 1 of an environment as Markdown; a cell that was not run is named so."""
    cells = find_cells(groups, env)
    head = (
        "agent",
        "seeds",
        "rounds",
        "final success",
        "IQM",
        "the paper's",
        "reward",
        "the paper's",
        "cumulative",
        *(f"rounds to {level}" for level in LEVELS),
    )
    rows: list[tuple[object, ...]] = []
    for name, paper in PAPER[env].items():
        theirs = (f"{paper.success_rate:.4f}", f"{paper.reward:.2f}")
        if name not in cells:
            never = ("–",) * (1 + len(LEVELS))
            rows.append((name, 0, "–", NOT_RUN, "–", theirs[0], "–", theirs[1], *never))
            continue
        group = cells[name]
        rows.append(
            (
                name,
                len(group.final),
                group.first.rounds,
                estimate(group.final),
                estimate_iqm(group.final),
                theirs[0],
                f"{group.reward:.2f}",
                theirs[1],
                estimate(group.cumulative),
                *(_rounds(group, level) for level in LEVELS),
            )
        )
    return table(head, rows, numbers=len(head) - 1)


def _rounds(group: Group, level: float) -> str:
    found = reach(group.success, level, group.round_dialogues)
    return found.shown(found.median)


def comparisons_table(groups: Sequence[Group], env: str) -> str:
    """Returns the declared comparisons of an environment as Markdown, a row for each."""
    finals, speeds = (
        comparisons(groups, env, quantity) for quantity in ("final_success", "training_success")
    )
    rows = [
        (f"{OURS} minus {final.other}", *final.cells(), *speed.cells())
        for final, speed in zip(finals, speeds, strict=True)
    ]
    head = ("by pairs", "final success", "p", "ends higher?", "cumulative", "p", "books more?")
    return table(head, rows, numbers=len(head) - 1)


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
