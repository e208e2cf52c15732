"""Learner x explorer: which part of a result is the learner's, and which its exploration's.

The same learner is trained on the dialogues of several strategies. Where its row of the grid is
level, what looks like better exploration is better learning.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.learning import areas
from bbq_torchrl.evaluation.names import agent_name
from bbq_torchrl.evaluation.pairs import NOT_RUN, compare
from bbq_torchrl.evaluation.statistics import estimate
from bbq_torchrl.markdown import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Comparison

__all__ = ["GRID_NOTE", "Grid", "deviations", "find_grid", "grid_text"]

QUANTITIES = {
    "final_success": "final success",
    "training_success": "cumulative training success",
    "evaluation_area": "success in evaluation while training",
}

GRID_NOTE = """\
Means over seeds with their 95 % Student t interval. Training success counts what exploring costs;
evaluation, a mean over the training, counts what was learned. By pairs, replicas that saw the same
spiked dialogues, goals and noise of the simulator: a learner's explorers and its first one, and an
explorer's learners and its first one. p: of a t test of the differences, by Holm's
method for all explorers of the learner, or all learners of the explorer.
"""

Grid = Mapping[str, Mapping[str, "Group"]]
"""Learner -> explorer -> the runs, both in the order in which they were given."""


def find_grid(groups: Sequence[Group]) -> Grid:
    """Returns the groups by learner and explorer.

    A learner is the agent without its exploration, such as ``BBQN-MAP``, and the keys of ``agent``
    in which learners of that name differ.

    Raises:
        ValueError: two settings of one cell.
    """
    names = [_name(group) for group in groups]
    grid: dict[str, dict[str, Group]] = {}
    for name, group in zip(names, groups, strict=True):
        same = [
            _keys(other)
            for other_name, other in zip(names, groups, strict=True)
            if other_name == name
        ]
        own = _keys(group)
        told = [
            f"{key}={value}"
            for key, value in own.items()
            if any(keys.get(key) != value for keys in same)
        ]
        row = grid.setdefault(", ".join([name, *told]), {})
        explorer = group.first.explore
        if explorer in row:
            raise ValueError(
                f"a cell of the grid must have one setting, got two of {name} with "
                f"explore={explorer}: {row[explorer].runs[0].folder} and {group.runs[0].folder}"
            )
        row[explorer] = group
    return grid


def _name(group: Group) -> str:
    return agent_name({**group.runs[0].config, "explore": {}})


def _keys(group: Group) -> dict[str, Any]:
    setting = group.runs[0].setting
    return {key: value for key, value in setting.items() if key.startswith("agent.")}


def deviations(row: Mapping[str, Group], quantity: str) -> list[Comparison]:
    """Returns a learner's explorers, or an explorer's learners, minus the first of them."""
    first, *others = row
    return compare(row, [(other, first) for other in others], quantity)


def grid_text(groups: Sequence[Group]) -> str:
    """Returns the grid and its comparisons as Markdown.

    Raises:
        ValueError: see :func:`find_grid`.
    """
    grid = find_grid(groups)
    explorers = list(dict.fromkeys(explorer for row in grid.values() for explorer in row))
    columns = {
        name: {learner: row[name] for learner, row in grid.items() if name in row}
        for name in explorers
    }
    parts = ["# Learner x explorer"]
    for quantity, title in QUANTITIES.items():
        if quantity == "evaluation_area" and any(group.evaluation is None for group in groups):
            continue
        rows = [
            (learner, *(_cell(row.get(explorer), quantity) for explorer in explorers))
            for learner, row in grid.items()
        ]
        parts += [f"## {title.capitalize()}", table(("learner", *explorers), rows)]
        for head, rows_or_columns in (("learner", grid), ("explorer", columns)):
            compared = [
                (name, f"{item.one} minus {item.other}", *item.cells())
                for name, compared_groups in rows_or_columns.items()
                for item in deviations(compared_groups, quantity)
            ]
            if compared:
                names = (head, "by pairs", "difference", "p", "better?")
                parts.append(table(names, compared, numbers=3))
    return "\n\n".join([*parts, GRID_NOTE.strip()]) + "\n"


def _cell(group: Group | None, quantity: str) -> str:
    if group is None:
        return NOT_RUN
    if quantity == "evaluation_area":
        values = areas(group.evaluation)
    else:
        values = group.final if quantity == "final_success" else group.cumulative
    return f"{estimate(values)} ({len(values)} seeds)"
