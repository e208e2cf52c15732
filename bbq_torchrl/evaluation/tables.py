"""Rows of tables of groups: success, differences by pairs, learning; and how they are shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.learning import LEVELS, WINDOW, Reach, areas, reach
from bbq_torchrl.evaluation.statistics import Estimate, estimate, estimate_iqm
from bbq_torchrl.markdown import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Pairing

__all__ = [
    "NOTE",
    "as_markdown",
    "learning_rows",
    "pair_rows",
    "pairs_table",
    "success_rows",
]

NOTE = """\
The unit is the training seed, never the dialogue. Means over seeds with their 95 % Student t
interval. IQM: interquartile mean over seeds with its 95 % bootstrap interval (none below five
seeds). Cumulative training success: share of all training dialogues that succeeded.
"""

PAIRS_NOTE = """\
Differences by pairs: replicas of the same seed, which saw the same spiked dialogues, goals and
noise of the simulator, one minus the other, the mean with its 95 % Student t interval.
"""

LEARNING_NOTE = f"""\
Rounds (and dialogues) until success is reached: in training, until the mean of the last {WINDOW}
rounds reaches it; in evaluation, until the first that does. The median over seeds, a seed that did
not reach it counting as longer than all that did (the rounds after which half of the seeds had),
with its 95 % interval from six seeds on; and how many seeds reached it, where not all did. The area
under the curve is its mean height: in training the cumulative success.
"""

DIFFERENCES = {
    "final_success": "final success",
    "training_success": "cumulative training success",
    "evaluation_area": "area under the evaluation curve",
}
"""Quantity of a pairing -> its column."""


def as_markdown(rows: Sequence[Mapping[str, Any]], *, words: int, spec: str = ".3f") -> str:
    """Returns rows, column to cell each, as a Markdown table.

    Args:
        rows: a column that one lacks has a dash there.
        words: how many columns, the first ones, are not numbers.
        spec: format of an :class:`~bbq_torchrl.evaluation.Estimate`.
    """

    def shown(cell: object) -> str:
        if isinstance(cell, Estimate):
            return format(cell, spec)
        return f"{cell:.2f}" if isinstance(cell, float) else str(cell)

    head = list(dict.fromkeys(name for row in rows for name in row))
    cells = [[shown(row.get(name, "–")) for name in head] for row in rows]
    return table(head, cells, numbers=len(head) - words)


def success_rows(groups: Iterable[Group]) -> list[dict[str, Any]]:
    """Returns a row for each group."""
    return [
        {
            "agent": group.label,
            "explore": group.first.explore,
            "seeds": len(group.final),
            "rounds": group.first.rounds,
            "final success": estimate(group.final),
            "IQM": estimate_iqm(group.final),
            "cumulative training success": estimate(group.cumulative),
            "reward": group.reward,
            "turns": group.turns,
        }
        for group in groups
    ]


def pair_rows(compared: Iterable[Pairing]) -> list[dict[str, Any]]:
    """Returns a row for each two groups with pairs."""
    return [
        {"by pairs": item.label, "pairs": item.pairs}
        | {DIFFERENCES[name]: difference for name, difference in item.differences.items()}
        for item in compared
        if item.pairs
    ]


def pairs_table(compared: Sequence[Pairing]) -> str:
    """Returns the rows of pairs as Markdown, and remarks below them; empty without any."""
    rows = pair_rows(compared)
    parts = [as_markdown(rows, words=1, spec="+.3f")] if rows else []
    parts += [
        f"{item.label}: without {item.remark}." for item in compared if item.pairs and item.remark
    ]
    not_paired: dict[str, list[str]] = {}
    for item in compared:
        if not item.pairs:
            names = f"{item.one.label} and {item.other.label}"
            not_paired.setdefault(item.remark, []).append(names)
    parts += [
        f"Not compared by pairs, since {reason}: {'; '.join(names)}."
        for reason, names in not_paired.items()
    ]
    return "\n\n".join(parts)


def learning_rows(groups: Iterable[Group]) -> list[dict[str, Any]]:
    """Returns a row for each learning curve of each group: training, and evaluation if any."""
    return [
        {"agent": group.label, "success in": name, "area under the curve": estimate(area), **levels}
        for group in groups
        for name, area, levels in _curves(group)
    ]


def _curves(group: Group) -> list[tuple[str, Sequence[float], dict[str, Reach]]]:
    # The area under the training curve has a name of its own: it is the cumulative success.
    curves = [("training", group.success, group.cumulative, WINDOW)]
    if (curve := group.evaluation) is not None:
        curves.append(("evaluation", curve, areas(curve), 1))
    dialogues = group.round_dialogues
    return [
        (name, area, {f"to {level}": reach(success, level, dialogues, window) for level in LEVELS})
        for name, success, area, window in curves
    ]
