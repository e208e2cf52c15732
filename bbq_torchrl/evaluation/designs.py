"""Reports of designed comparisons: ablations, and learner x explorer.

Ablations are a reference run, and runs that each change one key of it.

Learner x explorer separates the effect of learning from that of exploration: the same learner is
trained on the dialogues of several strategies. If its row of the grid is level, apparently better
exploration is better learning.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from bbq_torchrl.evaluation.figures import draw_panels
from bbq_torchrl.evaluation.finished_runs import agent_name, distinguishing_keys
from bbq_torchrl.evaluation.groups import label, runs_report
from bbq_torchrl.evaluation.pairs import NOT_RUN, compare
from bbq_torchrl.utils.reports import NONE, Report, Table
from bbq_torchrl.utils.statistics import Estimate, estimate
from bbq_torchrl.utils.text import as_typed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Comparison


ABLATIONS_NOTE = """\
Means over seeds with their 95 % Student t interval; every table has the reference. Others are
compared with it by pairs: replicas of one seed, which saw the same spiked dialogues, goals and
noise of the simulator, except for changes by the key itself. p: t test of the differences, adjusted
by Holm's method for the values of the key."""


class Ablations(NamedTuple):
    """A reference setting, and settings that change one key of it, or keys of one group.

    Attributes:
        reference: the runs of the reference.
        keys: dotted key (several: ``explore.per, explore.shared``) -> value -> its runs, including
            the reference; numbers in order. Several settings of an option are told apart by their
            keys: ``epsilon_greedy, explore.eps_init=0.1``.
    """

    reference: Group
    keys: Mapping[str, Mapping[str, Group]]


def find_ablations(groups: Sequence[Group]) -> Ablations:
    """Finds the reference: the first group from which all others differ in one key or one group.

    Raises:
        ValueError: no such group, or fewer than two groups.
    """
    if len(groups) < 2:
        raise ValueError(f"ablations need runs of two settings, got {len(groups)}")
    settings = [group.setting for group in groups]
    changed = [[_changed(own, other) for other in settings] for own in settings]
    extents = [max((_groups(names), len(names)) for names in row) for row in changed]
    reference = extents.index(min(extents))
    rows: dict[tuple[str, ...], list[Group]] = {}
    for group, names in zip(groups, changed[reference], strict=True):
        if _groups(names) > 1:
            raise ValueError(
                "ablations must differ from one run in one key each, or in keys of one group, but "
                f"{groups[reference].folders[0]} and {group.folders[0]} differ in "
                f"{', '.join(names)}"
            )
        if names:
            rows.setdefault(tuple(names), [groups[reference]]).append(group)
    return Ablations(
        groups[reference],
        {", ".join(names).removesuffix(".name"): _row(names, row) for names, row in rows.items()},
    )


def _row(names: Sequence[str], row: Sequence[Group]) -> dict[str, Group]:
    """Returns the groups of a row by their values of its keys."""
    settings = [group.setting for group in row]
    values = []
    for own, group in zip(settings, row, strict=True):
        different = dict.fromkeys(key for other in settings for key in _changed(own, other))
        more = [
            f"{key}={as_typed(own[key])}" for key in different if key in own and key not in names
        ]
        value = _value(own, names)
        values.append((", ".join([as_typed(value), *more]) if more else value, group))
    return {as_typed(value): group for value, group in sorted(values, key=_place)}


def _changed(own: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    return distinguishing_keys(key for key in {**own, **other} if own.get(key) != other.get(key))


def _groups(names: Sequence[str]) -> int:
    return len({name.partition(".")[0] for name in names})


def _value(setting: Mapping[str, Any], names: Sequence[str]) -> Any:
    first, *more = (setting.get(name) for name in names)
    return ", ".join(map(as_typed, (first, *more))) if more else first


def _place(entry: tuple[Any, Group]) -> tuple[bool, float]:
    """Sort key: other values in their order, then numbers."""
    value, _ = entry
    is_number = isinstance(value, int | float)
    return is_number, value if is_number else 0.0


def ablations_report(groups: Sequence[Group]) -> Report:
    """Returns the report: a table and a panel for each key.

    Raises:
        ValueError: see :func:`find_ablations`.
    """
    reference, keys = find_ablations(groups)
    title = f"Ablations of {reference.agent}"
    parts: list[str | Table] = []
    for key, row in keys.items():
        (own,) = (value for value, group in row.items() if group is reference)
        declared = [(value, own) for value in row if value != own]
        differences = {
            (item.one, quantity): item.cells()[:2]
            for quantity in ("final", "cumulative")
            for item in compare(row, declared, quantity, same_dialogues=False)
        }
        rows = []
        for value, group in row.items():
            cells: dict[str, object] = {key: f"{value} (reference)" if value == own else value}
            cells["seeds"] = len(group.final)
            for quantity, name in (("final", "final success"), ("cumulative", "cumulative")):
                cells[name] = estimate(getattr(group, quantity))
                minus, p_value = differences.get((value, quantity), (NONE, NONE))
                cells |= {f"{name}: minus the reference": minus, f"{name}: p": p_value}
            rows.append(cells)
        parts += [f"## {key}", Table(f"ablations_{key}", rows)]
    draw = partial(draw_panels, keys, title=f"{title} (*: the reference)", marked=reference)
    figures = {"ablations": ("A panel for each key", draw)}
    return runs_report("ablations", title, groups, [*parts, ABLATIONS_NOTE], figures)


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
