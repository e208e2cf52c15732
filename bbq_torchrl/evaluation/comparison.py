"""The general report: success, paired differences, speed of learning, and curves."""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.curves import FIRST, LEVELS, WINDOW, reach
from bbq_torchrl.evaluation.figures import COLORS, draw_comparison
from bbq_torchrl.evaluation.groups import know_commits, references, runs_report
from bbq_torchrl.evaluation.pairs import EARLY, difference, pair
from bbq_torchrl.utils.reports import NONE, Report, Table
from bbq_torchrl.utils.statistics import estimate, estimate_iqm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.pairs import Pairing

NOTE = """\
The unit is the training seed, never the dialogue. Means over seeds with their 95 % Student t
interval, cut where it leaves 0 to 1 (of differences -1 to 1). IQM: interquartile mean over seeds
with its 95 % bootstrap interval (from five seeds on). Booked after 1,000: share of the first
1,000 training dialogues that succeeded. Cumulative training success: the share of all of them."""

PAIRS_NOTE = """\
Differences by pairs: replicas of the same seed, which saw the same spiked dialogues, goals and
noise of the simulator. Means with their 95 % Student t interval, not adjusted for the number of
comparisons."""

LEARNING_NOTE = f"""\
Rounds (and dialogues) until a level of success is reached: in training by the mean of the last
{WINDOW} rounds, in evaluation by a single one. The median over seeds, where a seed that did not
reach the level counts as longer than all others, with its 95 % interval from six seeds on; and the
number of seeds that reached it, if not all did. The area under the curve is its mean height, with
values joined by straight lines; in training it is the cumulative success."""

NOTES = (NOTE, PAIRS_NOTE, LEARNING_NOTE)

DIFFERENCES = {
    "final": "final success",
    "early": f"booked after {EARLY:,}",
    "cumulative": "cumulative training success",
    "area": "area under the evaluation curve",
}
"""Quantity of a pairing -> its column."""


def comparison_report(groups: Sequence[Group]) -> Report:
    """Returns the report: tables with notes, and curves.

    A figure shows at most seven groups: ``curves``, then ``curves_2`` and so on.
    """
    pairs = [pair(*two) for two in combinations(groups, 2)]
    parts = [
        *(success_table(groups), NOTE),
        *pair_parts(pairs),
        *([PAIRS_NOTE] if any(item.pairs for item in pairs) else []),
        *(learning_table(groups), LEARNING_NOTE),
    ]
    figures = {}
    for number, start in enumerate(range(0, len(groups), len(COLORS)), 1):
        drawn = groups[start : start + len(COLORS)]
        title = f"Training success: {_common(drawn)}"
        draw = partial(draw_comparison, drawn, title=title, references=references(drawn))
        name = "curves" if number == 1 else f"curves_{number}"
        figures[name] = ("Training success by round", draw)
    return runs_report("report", _common(groups), groups, parts, figures)


def _common(groups: Sequence[Group]) -> str:
    """Returns the environment and domain of the groups, such as ``"env=full, domain=movie"``."""
    common = {
        name: sorted({getattr(group.first, name) for group in groups} - {""})
        for name in ("env", "domain")
    }
    return ", ".join(f"{name}={'|'.join(values)}" for name, values in common.items() if values)


def success_table(groups: Sequence[Group]) -> Table:
    """Returns the table of final and training success, a row for each group."""
    rows = [
        {
            "agent": group.label,
            "explore": group.first.explore,
            "seeds": len(group.final),
            "rounds": group.first.rounds,
            "final success": estimate(group.final),
            "IQM": estimate_iqm(group.final),
            **booked_columns(group),
            "cumulative training success": estimate(group.cumulative),
            "reward": group.reward,
            "turns": group.turns,
        }
        | ({"commit": group.commit} if know_commits(groups) else {})
        for group in groups
    ]
    return Table("report", rows, words=2)


def booked_columns(group: Group) -> dict[str, object]:
    """Returns the columns of success in the first training dialogues."""
    return {
        f"booked after {first:,}": estimate(found) if (found := group.booked(first)) else NONE
        for first in FIRST
    }


def pair_parts(compared: Sequence[Pairing]) -> list[str | Table]:
    """Returns the table of paired differences, and remarks on replicas without a partner."""
    rows = [
        {"by pairs": item.label, "pairs": item.pairs}
        | {
            column: difference(item.differences[name])
            for name, column in DIFFERENCES.items()
            if name in item.differences
        }
        for item in compared
        if item.pairs
    ]
    remarks = [
        f"{item.label}: without {item.remark}." for item in compared if item.pairs and item.remark
    ]
    not_paired: dict[str, list[str]] = {}
    for item in compared:
        if not item.pairs:
            names = f"{item.one.label} and {item.other.label}"
            not_paired.setdefault(item.remark, []).append(names)
    remarks += [
        f"Not compared by pairs, since {reason}: {'; '.join(names)}."
        for reason, names in not_paired.items()
    ]
    return [Table("pairs", rows), *remarks]


def learning_table(groups: Sequence[Group]) -> Table:
    """Returns the table of learning speed: a row for each training or evaluation curve."""
    rows: list[dict[str, Any]] = []
    for group in groups:
        # The area under the training curve is the cumulative success.
        curves = [("training", group.success, group.cumulative, WINDOW)]
        if group.evaluation is not None:
            curves.append(("evaluation", group.evaluation, group.area, 1))
        for name, success, area, window in curves:
            row = {"agent": group.label, "success in": name, "area under the curve": estimate(area)}
            for level in LEVELS:
                row[f"to {level}"] = reach(success, level, group.round_dialogues, window)
            rows.append(row)
    return Table("learning", rows, words=2)
