"""``bbq report``: compares finished runs over their seeds, and by pairs with the first of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from bbq_torchrl.evaluation.curves import FIRST, LEVEL
from bbq_torchrl.evaluation.figures import draw_comparison
from bbq_torchrl.evaluation.finished_runs import find_runs
from bbq_torchrl.evaluation.groups import (
    EARLY,
    Group,
    adjusted,
    difference,
    labeled,
    pair,
    read_groups,
    references,
)
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.reports import Report, Table, draw_intervals
from bbq_torchrl.utils.statistics import estimate, estimate_iqm
from bbq_torchrl.utils.text import EMPTY, as_typed

PAPER = {
    "full": {
        "BBQN-MAP": (0.5031, 10.71),
        "BBQN-MC": (0.4877, 9.98),
        "BBQN-VIME-MAP": (0.4856, 9.86),
        "BBQN-VIME-MC": (0.4941, 10.43),
        "DQN": (0.2693, 0.87),
        "DQN-Boltzmann": (0.2658, 0.42),
        "DQN-Bootstrap": (0.2516, -0.13),
        "DQN-VIME-MAP": (0.3893, 5.86),
        "DQN-VIME-MC": (0.3700, 5.00),
    },
    "domain_ext": {
        "BBQN-MAP": (0.6852, 17.32),
        "BBQN-MC": (0.6722, 16.13),
        "BBQN-VIME-MAP": (0.6813, 15.82),
        "BBQN-VIME-MC": (0.7120, 17.63),
        "DQN": (0.3503, 4.76),
        "DQN-Boltzmann": (0.2435, -3.46),
        "DQN-Bootstrap": (0.3170, -0.68),
        "DQN-VIME-MAP": (0.3751, 4.92),
        "DQN-VIME-MC": (0.3675, 4.83),
    },
}
"""Environment -> agent -> the paper's success rate and reward (AAAI 2018, Table 1).

Means of five runs, 10,000 dialogues each after training, on another corpus and with other noise.
"""

NOTE = f"""\
The unit is the training seed, never the dialogue. Means over seeds with their 95 % Student t
interval, cut where it leaves 0 to 1 (of differences -1 to 1). IQM: interquartile mean over seeds
with its 95 % bootstrap interval (from five seeds on). The paper's corpus and noise were different.
Booked after 1,000: share of the first 1,000 training dialogues that succeeded; cumulative: share of
all of them. Evaluated: mean height of the curve of evaluations during training. Dialogues to
{LEVEL}: until the mean of five rounds' training success reaches it, the median over seeds, where a
seed that did not reach it counts as longer than all others. Minus: by pairs of replicas with the
same seed, which see the same spiked dialogues, goals and simulator noise as far as their settings
agree. p: t test of the differences, adjusted by Holm's method for all rows of the table."""

COLUMNS = {
    "final": "final success",
    "early": f"booked after {EARLY:,}",
    "cumulative": "cumulative",
    "area": "evaluated",
}
"""Quantity of a pairing -> its column."""


def runs_report(groups: Sequence[Group], by: str | None = None) -> Report:
    """Returns the report: tables of success and of paired differences, and figures.

    Args:
        groups: the groups; the first of each section is the one that others are compared with.
        by: a dotted key, such as ``env.name``: a section for each of its values.
    """
    sections = {"": [*groups]} if by is None else _sections(groups, by)
    parts: list[str | Table] = []
    intervals = {}
    for heading, section in sections.items():
        end = f"_{heading}" if heading else ""
        parts += [
            f"## {heading}" if heading else "",
            Table(f"report{end}", [success_row(group) for group in section], words=2),
            *pair_parts(section, f"pairs{end}"),
        ]
        intervals[heading] = {group.label: estimate(group.final) for group in section}
    title = "Training success"
    curves = partial(draw_comparison, sections, title=title, references=references(groups))
    success = partial(draw_intervals, intervals, title="Final success")
    figures = {"curves": (title, curves), "success": ("Final success by group", success)}
    return Report("report", title, [*parts, NOTE], figures, [_replicas_table(groups)])


def _sections(groups: Sequence[Group], by: str) -> dict[str, list[Group]]:
    """Returns heading -> groups of one value of the key, with labels that tell these apart."""
    sections: dict[str, list[Group]] = {}
    for group in groups:
        if by not in group.setting:
            raise ValueError(
                f"--by must be a key of all runs, such as env.name, got {by!r}, which "
                f"{group.replicas[0].folder} lacks"
            )
        sections.setdefault(f"{by}={as_typed(group.setting[by])}", []).append(group)
    return {heading: labeled(section) for heading, section in sections.items()}


def success_row(group: Group) -> dict[str, object]:
    """Returns a group's row: final success, reward, and success in training."""
    paper = PAPER.get(group.first.env, {}).get(group.agent)
    rate, reward = (f"{paper[0]:.4f}", paper[1]) if paper else (EMPTY, EMPTY)
    return {
        "agent": group.label,
        "explore": group.first.explore,
        "seeds": len(group.final),
        "rounds": group.first.rounds,
        "final success": estimate(group.final),
        "IQM": estimate_iqm(group.final),
        "final success: the paper's": rate,
        "reward": group.reward,
        "reward: the paper's": reward,
        "turns": group.turns,
        **{
            f"booked after {first:,}": estimate(found) if (found := group.booked(first)) else EMPTY
            for first in FIRST
        },
        "cumulative": estimate(group.cumulative),
        "evaluated": estimate(area) if (area := group.area) else EMPTY,
        f"dialogues to {LEVEL}": group.reach(LEVEL),
    }


def pair_parts(groups: Sequence[Group], name: str = "pairs") -> list[str | Table]:
    """Returns the table of all other groups minus the first, and remarks on the pairs."""
    first, *others = groups
    compared = [pair(other, first) for other in others]
    p_values = {
        quantity: adjusted([item.differences.get(quantity, ()) for item in compared])
        for quantity in COLUMNS
    }
    rows: list[dict[str, object]] = []
    remarks = []
    for place, (other, item) in enumerate(zip(others, compared, strict=True)):
        row: dict[str, object] = {f"minus {first.label}": other.label, "pairs": item.pairs}
        for quantity, column in COLUMNS.items():
            values = item.differences.get(quantity)
            row[column] = difference(values) if values else EMPTY
            row[f"{column}: p"] = p_values[quantity][place] if values else EMPTY
        rows.append(row)
        if item.different:
            remarks.append(f"{other.label}: other dialogues, by {', '.join(item.different)}.")
    return [Table(name, rows), *remarks]


def _replicas_table(groups: Sequence[Group]) -> Table:
    """Returns the table of replicas, which is written as CSV only."""
    rows = [
        {
            "corpus": replica.result.domain,
            "env": replica.result.env,
            "agent": group.label,
            "replica": replica.number,
            "seed": replica.result.seed,
            "rounds": replica.result.rounds,
            "updates": replica.updates,
            "success_rate": replica.own.success_rate,
            "reward": replica.own.reward,
            "turns": replica.own.turns,
            "cumulative_success": replica.own.training_success,
            "commit": replica.result.code,
        }
        for group in groups
        for replica in group.replicas
    ]
    return Table("replicas", rows)


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    interruption.tell(lambda: "in a report", lambda: "the same command starts again")
    parser = output.Parser(
        prog="bbq report",
        description="Compares finished runs over their seeds: prints the tables as Markdown.",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, help="run folders, or folders with run folders below them"
    )
    parser.add_argument(
        "--by",
        metavar="KEY",
        help="a table for each value of a key, such as env.name; others are compared with the "
        "first run of their table",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for the report as Markdown, its tables and replicas as CSV, its figures as "
        "PNG and SVG",
    )
    given = parser.parse_args(arguments)
    finished, unfinished = find_runs(given.folders)
    report = runs_report(read_groups(finished), given.by)
    if unfinished:
        left_out = f"Left out, since not finished: {', '.join(map(str, unfinished))}."
        report = replace(report, parts=[left_out, *report.parts])
    if given.out is not None:
        report.write(given.out)
    output.write(str(report))
    return 0
