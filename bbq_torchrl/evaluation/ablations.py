"""Ablations: a reference run, and runs that each change one key of it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from bbq_torchrl.evaluation.figures import draw_panels
from bbq_torchrl.evaluation.groups import as_typed, runs_report
from bbq_torchrl.evaluation.pairs import compare
from bbq_torchrl.evaluation.runs import distinguishing_keys
from bbq_torchrl.utils.reports import NONE, Report, Table
from bbq_torchrl.utils.statistics import estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.evaluation.groups import Group

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
