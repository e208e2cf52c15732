"""Markdown tables of groups: success, differences by pairs, learning."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.learning import LEVELS, WINDOW, Reach, learning
from bbq_torchrl.evaluation.statistics import estimate, estimate_iqm
from bbq_torchrl.markdown import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Pairing

__all__ = [
    "NOTE",
    "learning_table",
    "pairs_table",
    "success_table",
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


def success_table(groups: Iterable[Group]) -> str:
    """Returns a Markdown table, a row for each group."""
    head = (
        "agent",
        "explore",
        "seeds",
        "rounds",
        "final success",
        "IQM",
        "cumulative training success",
        "reward",
        "turns",
    )
    rows = []
    for group in groups:
        rows.append(
            (
                group.label,
                group.first.explore,
                len(group.final),
                group.first.rounds,
                estimate(group.final),
                estimate_iqm(group.final),
                estimate(group.cumulative),
                f"{group.reward:.2f}",
                f"{group.turns:.2f}",
            )
        )
    return table(head, rows, numbers=len(head) - 2)


def pairs_table(compared: Sequence[Pairing]) -> str:
    """Returns a Markdown table, a row for each two groups with pairs, and remarks below it."""
    columns = {
        "final_success": "final success",
        "training_success": "cumulative training success",
        "evaluation_area": "area under the evaluation curve",
    }
    shown = [name for name in columns if any(name in item.differences for item in compared)]
    rows = []
    for item in compared:
        if item.pairs:
            found = item.differences
            differences = (f"{found[name]:+.3f}" if name in found else "–" for name in shown)
            rows.append((item.label, item.pairs, *differences))
    head = ("by pairs", "pairs", *(columns[name] for name in shown))
    parts = [table(head, rows, numbers=len(head) - 1)] if rows else []
    parts += [
        f"{item.label}: without {item.remark}." for item in compared if item.pairs and item.remark
    ]
    return "\n\n".join([*parts, *_not_paired(compared)])


def _not_paired(compared: Iterable[Pairing]) -> list[str]:
    """Returns a sentence for each reason why groups are not compared by pairs."""
    together: dict[str, list[str]] = {}
    for item in compared:
        if not item.pairs:
            together.setdefault(item.remark, []).append(f"{item.one.label} and {item.other.label}")
    return [
        f"Not compared by pairs, since {reason}: {'; '.join(names)}."
        for reason, names in together.items()
    ]


def learning_table(groups: Sequence[Group]) -> str:
    """Returns a Markdown table, a row for each learning curve of each group."""
    head = ("agent", "success in", "area under the curve")
    rows = [
        (
            group.label,
            curve.success_in,
            curve.area,
            *(_reach(item, group.round_dialogues) for item in curve.reach),
        )
        for group in groups
        for curve in learning(group)
    ]
    return table((*head, *(f"to {level}" for level in LEVELS)), rows, numbers=1 + len(LEVELS))


def _reach(reach: Reach, dialogues: int) -> str:
    """Returns ``38 [34, 45] (1,900), 9 of 10``: rounds, interval, dialogues and seeds."""
    if reach.reached == 0:
        return "not reached"
    low, high = reach.interval
    interval = "" if math.isnan(low) else f" [{reach.shown(low)}, {reach.shown(high)}]"
    text = f"{reach.shown(reach.median)}{interval} ({reach.shown(reach.median, dialogues)})"
    seeds = len(reach.rounds)
    return text if reach.reached == seeds else f"{text}, {reach.reached} of {seeds}"
