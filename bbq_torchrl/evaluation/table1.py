"""The paper's Table 1 from finished runs: its numbers next to ours, declared pairs, missing cells.

The comparisons were declared before the training: BBQN-MAP with each other agent, in both domains,
by success in the final evaluation, in the first 1,000 training dialogues, and in all of them. The
p-values of a quantity in a domain are adjusted by Holm's method for all eight comparisons, run or
not.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

from bbq_torchrl.evaluation.comparison import booked_columns
from bbq_torchrl.evaluation.curves import FIRST, reach
from bbq_torchrl.evaluation.figures import draw_families
from bbq_torchrl.evaluation.groups import references, runs_report
from bbq_torchrl.evaluation.pairs import EARLY, NOT_RUN, compare
from bbq_torchrl.utils.reports import NONE, Report, Table
from bbq_torchrl.utils.statistics import estimate, estimate_iqm

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Comparison


class PaperCell(NamedTuple):
    """The paper's numbers for an agent, on its corpus and with its noise.

    Attributes:
        success_rate: mean of five runs, 10,000 dialogues each after training.
        reward: mean reward of these dialogues.
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
"""The agent that all others are compared with."""

FAMILIES = {
    "BBQN": ("BBQN-MC", "BBQN-VIME-MAP", "BBQN-VIME-MC"),
    "DQN": ("DQN", "DQN-Boltzmann", "DQN-Bootstrap"),
    "DQN with VIME": ("DQN-VIME-MAP", "DQN-VIME-MC"),
}
"""Column of the figure -> its agents, next to BBQN-MAP."""

LEVEL = 0.5
"""Training success for which the number of dialogues is reported."""

TABLE1_NOTE = """\
Means over seeds with their 95 % Student t interval; IQM: interquartile mean with a bootstrap
interval; booked after 500: share of the first 500 training dialogues that succeeded; cumulative:
share of all of them; dialogues to 0.5: until the mean of five rounds' training success reaches it,
the median over seeds. Differences by pairs: replicas that saw the same spiked dialogues, goals and
noise of the simulator. p: t test of the differences, adjusted by Holm's method for the eight
declared comparisons of a column, run or not.
The paper's corpus and noise were different."""


def find_cells(groups: Sequence[Group], env: str) -> dict[str, Group]:
    """Returns the groups of an environment by the paper's name, in the order of its table.

    Raises:
        ValueError: two settings of one agent.
    """
    cells: dict[str, Group] = {}
    for group in groups:
        name = group.agent
        if group.first.env != env or name not in PAPER[env]:
            continue
        if name in cells:
            raise ValueError(
                f"a cell of Table 1 must have one setting, got two of {name} with env={env}: "
                f"{cells[name].folders[0]} and {group.folders[0]}"
            )
        cells[name] = group
    return {name: replace(cells[name], label=name) for name in PAPER[env] if name in cells}


def table1_report(groups: Sequence[Group]) -> Report:
    """Returns the report: missing cells, Table 1, and its declared comparisons."""
    cells = {env: find_cells(groups, env) for env in PAPER}
    names = [(env, name) for env, agents in PAPER.items() for name in agents]
    missing = [f"{name} with env={env}" for env, name in names if name not in cells[env]]
    parts: list[str | Table] = [f"Not run: {'; '.join(missing)}."] if missing else []
    for env in PAPER:
        parts += [f"## env={env}", _cells_table(cells[env], env), _pairs_table(cells[env], env)]
    return runs_report(
        "table1",
        f"Table 1: {len(names) - len(missing)} of {len(names)} cells",
        [group for found in cells.values() for group in found.values()],
        [*parts, TABLE1_NOTE],
        {
            f"table1_{env}": (f"Learning curves, env={env}", partial(draw_table1, found, env))
            for env, found in cells.items()
            if found
        },
    )


def draw_table1(
    cells: Mapping[str, Group], env: str, rates: Mapping[str, float] | None = None
) -> Figure:
    """Draws the agents of Table 1 in an environment, in families with BBQN-MAP in each.

    Args:
        cells: the groups that were run, by the paper's name.
        env: the environment.
        rates: label -> success rate to compare with; None for those in the runs' results.
    """
    families = {
        heading: [cells[name] for name in (OURS, *others) if name in cells]
        for heading, others in FAMILIES.items()
        if any(name in cells for name in others)
    }
    return draw_families(
        families or {"BBQN": [*cells.values()]},
        title=f"Table 1, env={env}",
        references=references([*cells.values()]) if rates is None else rates,
    )


def comparisons(cells: Mapping[str, Group], env: str, quantity: str) -> list[Comparison]:
    """Returns the declared comparisons of an environment by one quantity.

    Args:
        cells: the groups that were run, by the paper's name.
        env: the environment.
        quantity: ``final``, ``early`` or ``cumulative``.
    """
    return compare(cells, [(OURS, name) for name in PAPER[env] if name != OURS], quantity)


def _cells_table(cells: Mapping[str, Group], env: str) -> Table:
    """Returns the table of the cells, including those that were not run."""
    rows: list[dict[str, Any]] = []
    for name, paper in PAPER[env].items():
        row: dict[str, Any] = {
            "agent": name,
            "seeds": 0,
            "rounds": NONE,
            "final success": NOT_RUN,
            "IQM": NONE,
            "final success: the paper's": f"{paper.success_rate:.4f}",
            "reward": NONE,
            "reward: the paper's": paper.reward,
            **{f"booked after {first:,}": NONE for first in FIRST},
            "cumulative": NONE,
            f"dialogues to {LEVEL}": NONE,
        }
        if name in cells:
            group = cells[name]
            row |= {
                "seeds": len(group.final),
                "rounds": group.first.rounds,
                "final success": estimate(group.final),
                "IQM": estimate_iqm(group.final),
                "reward": group.reward,
                **booked_columns(group),
                "cumulative": estimate(group.cumulative),
            }
            found = reach(group.success, LEVEL, group.round_dialogues)
            row[f"dialogues to {LEVEL}"] = found.shown(found.median, found.dialogues)
        rows.append(row)
    return Table(f"table1_{env}", rows)


def _pairs_table(cells: Mapping[str, Group], env: str) -> Table:
    """Returns the table of the declared comparisons."""
    head = (
        *("by pairs", "final success", "final success: p", "ends higher?"),
        *(f"booked after {EARLY:,}", f"booked after {EARLY:,}: p", "books more early?"),
        *("cumulative", "cumulative: p", "books more?"),
    )
    quantities = ("final", "early", "cumulative")
    rows = [
        dict(zip(head, (same[0].label, *chain(*(one.cells() for one in same))), strict=True))
        for same in zip(*(comparisons(cells, env, name) for name in quantities), strict=True)
    ]
    return Table(f"table1_{env}_pairs", rows)
