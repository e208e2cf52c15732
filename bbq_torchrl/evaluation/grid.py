"""Learner x explorer: separates the effect of learning from that of exploration.

The same learner is trained on the dialogues of several strategies. If its row of the grid is level,
apparently better exploration is better learning.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.evaluation.figures import draw_panels
from bbq_torchrl.evaluation.groups import label, runs_report
from bbq_torchrl.evaluation.pairs import NOT_RUN, compare
from bbq_torchrl.evaluation.runs import agent_name
from bbq_torchrl.utils.reports import Report, Table
from bbq_torchrl.utils.statistics import Estimate, estimate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Comparison

QUANTITIES = {
    "final": "Final success",
    "cumulative": "Cumulative training success",
    "area": "Success in evaluation while training",
}

GRID_NOTE = """\
Means over seeds with their 95 % Student t interval. Training success counts what exploring costs;
evaluation, the mean height of its curve, counts what was learned. By pairs, replicas that saw the
same spiked dialogues, goals and noise of the simulator: a learner's explorers and its first one,
and an explorer's learners and its first one. p: t test of the differences, adjusted by Holm's
method for all explorers of the learner, or all learners of the explorer."""

Grid = Mapping[str, Mapping[str, "Group"]]
"""Learner -> explorer -> the runs, both in the given order."""


def find_grid(groups: Sequence[Group]) -> Grid:
    """Returns the groups by learner and explorer.

    A learner is the agent without its exploration, such as ``BBQN-MAP``, and the keys of ``agent``
    in which learners of that name differ.

    Raises:
        ValueError: two settings of one cell.
    """
    learners = [
        (
            agent_name({**group.replicas[0].config, "explore": {}}),
            {key: value for key, value in group.setting.items() if key.startswith("agent.")},
        )
        for group in groups
    ]
    grid: dict[str, dict[str, Group]] = {}
    for (name, setting), group in zip(learners, groups, strict=True):
        row = grid.setdefault(label(name, setting, learners), {})
        explorer = group.first.explore
        if explorer in row:
            raise ValueError(
                f"a cell of the grid must have one setting, got two of {name} with "
                f"explore={explorer}: {row[explorer].folders[0]} and {group.folders[0]}"
            )
        row[explorer] = group
    return grid


def deviations(row: Mapping[str, Group], quantity: str) -> list[Comparison]:
    """Returns a learner's explorers, or an explorer's learners, minus the first of them."""
    first, *others = row
    return compare(row, [(other, first) for other in others], quantity)


def grid_report(groups: Sequence[Group]) -> Report:
    """Returns the report: the grid and its comparisons.

    Raises:
        ValueError: see :func:`find_grid`.
    """
    grid = find_grid(groups)
    explorers = dict.fromkeys(explorer for row in grid.values() for explorer in row)
    columns = {
        name: {learner: row[name] for learner, row in grid.items() if name in row}
        for name in explorers
    }
    parts: list[str | Table] = []
    for quantity, title in QUANTITIES.items():
        if not all(getattr(group, quantity) for group in groups):
            continue
        rows: list[dict[str, object]] = []
        for learner, row in grid.items():
            cells = {name: _Cell.of(row[name], quantity) for name in explorers if name in row}
            rows.append({"learner": learner, **dict.fromkeys(explorers, NOT_RUN), **cells})
        parts += [f"## {title}", Table(f"grid_{quantity}", rows, words=1 + len(explorers))]
        for head, compared in (("learner", grid), ("explorer", columns)):
            names = (head, "by pairs", "difference", "p", "better?")
            pairs = [
                dict(zip(names, (name, item.label, *item.cells()), strict=True))
                for name, row in compared.items()
                for item in deviations(row, quantity)
            ]
            parts.append(Table(f"grid_{quantity}_by_{head}", pairs, words=2))
    draw = partial(draw_panels, grid, title="Learner x explorer")
    figures = {"grid": ("A panel for each learner", draw)}
    return runs_report("grid", "Learner x explorer", groups, [*parts, GRID_NOTE], figures)


class _Cell(NamedTuple):
    """Success over some seeds."""

    success: Estimate
    seeds: int

    @classmethod
    def of(cls, group: Group, quantity: str) -> _Cell:
        return cls(estimate(getattr(group, quantity)), len(group.final))

    def __str__(self) -> str:
        return f"{self.success} ({self.seeds} seeds)"

    def csv_columns(self) -> dict[str, float]:
        return {**self.success.csv_columns(), "_seeds": self.seeds}
