"""``python -m bbq_torchrl.evaluation.report``: finished runs compared over their seeds.

The tables, the CSV files and the figure of a comparison; what is on the results page of the
documentation is made by the same functions.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.figures import COLOURS, Curves, draw_comparison
from bbq_torchrl.evaluation.groups import Group, find_results, read_groups
from bbq_torchrl.evaluation.markdown import table
from bbq_torchrl.evaluation.statistics import (
    MIN_BOOTSTRAP,
    Estimate,
    estimate,
    interquartile_mean,
    probability_of_improvement,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = [
    "Improvement",
    "Summary",
    "curves",
    "improvement_table",
    "improvements",
    "main",
    "setting_of",
    "success_table",
    "summarise",
    "write_report",
]

NOTE = """\
The unit is the training seed, never the dialogue. Means over seeds with their 95 % bootstrap
interval in brackets (BCa; none below five seeds), and beside it the 95 % Student t interval: of few
seeds the bootstrap interval is too narrow, the t interval is not. IQM: interquartile mean over
seeds. Cumulative training success: share of all training dialogues that succeeded.
"""

_NONE = "–"


@dataclass(frozen=True)
class Summary:
    """A quantity over the seeds of a group.

    Attributes:
        bootstrap: the mean with its bootstrap interval; the interval is NaN below five seeds.
        t: the mean with its Student t interval; the interval is NaN for one seed.
        iqm: interquartile mean with its bootstrap interval; the interval is NaN below five seeds.
    """

    bootstrap: Estimate
    t: Estimate
    iqm: Estimate


@dataclass(frozen=True)
class Improvement:
    """How often a seed of one group does better than one of another.

    Attributes:
        better: the one group.
        worse: the other.
        final: by success of the final evaluation.
        cumulative: by share of successful training dialogues.
    """

    better: Group
    worse: Group
    final: Estimate
    cumulative: Estimate


def summarise(values: Sequence[float]) -> Summary:
    """Sums up a quantity over seeds, one value for each.

    Example:
        >>> summary = summarise([0.7, 0.72, 0.74, 0.76, 0.78])
        >>> print(summary.bootstrap, summary.t)
        0.740 [0.716, 0.764] 0.740 [0.701, 0.779]
    """
    t = estimate(values, method="t")
    if len(values) >= MIN_BOOTSTRAP:
        return Summary(estimate(values), t, estimate(values, "iqm"))
    nothing = (math.nan, math.nan, len(values), "none")
    iqm = float(interquartile_mean(values))
    return Summary(Estimate(t.value, *nothing), t, Estimate(iqm, *nothing))


def improvements(groups: Sequence[Group]) -> list[Improvement]:
    """Compares each group with each that comes after it."""
    return [
        Improvement(
            one,
            other,
            probability_of_improvement(one.final, other.final),
            probability_of_improvement(one.cumulative, other.cumulative),
        )
        for number, one in enumerate(groups)
        for other in groups[number + 1 :]
    ]


def setting_of(groups: Sequence[Group]) -> str:
    """Returns what the groups have in common: ``"env=full, domain=movie"``."""
    common = {name: {getattr(group.first, name) for group in groups} for name in ("env", "domain")}
    return ", ".join(f"{name}={'|'.join(sorted(values))}" for name, values in common.items())


def success_table(groups: Iterable[Group]) -> str:
    """Returns a Markdown table, a row for each group."""
    head = (
        "agent",
        "explore",
        "seeds",
        "rounds",
        "final success",
        "t interval",
        "IQM",
        "cumulative training success",
        "t interval",
        "reward",
        "turns",
    )
    rows = []
    for group in groups:
        final, training = summarise(group.final), summarise(group.cumulative)
        rows.append(
            (
                group.label,
                group.first.explore,
                len(group.final),
                group.first.rounds,
                final.bootstrap,
                _interval(final.t),
                final.iqm,
                training.bootstrap,
                _interval(training.t),
                f"{group.reward:.2f}",
                f"{group.turns:.2f}",
            )
        )
    return table(head, rows, numbers=len(head) - 2)


def improvement_table(groups: Sequence[Group]) -> str:
    """Returns a Markdown table, a row for each pair of groups; empty for a single group."""
    rows = [
        (item.better.label, item.worse.label, item.final, item.cumulative)
        for item in improvements(groups)
    ]
    if not rows:
        return ""
    head = (
        "P(a seed of ...",
        "... beats one of ...)",
        "by final success",
        "by cumulative training success",
    )
    return table(head, rows, numbers=2)


def curves(group: Group) -> Curves:
    """Returns what is drawn of a group."""
    return Curves(group.label, group.success, group.final)


def write_report(groups: Sequence[Group], folder: Path) -> None:
    """Writes ``report.md``, ``report.csv``, ``improvements.csv`` and the learning curves.

    A figure shows at most seven groups: ``curves.png``, then ``curves_2.png`` and so on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = []
    for number, start in enumerate(range(0, len(groups), len(COLOURS)), 1):
        figures.append(folder / ("curves.png" if number == 1 else f"curves_{number}.png"))
        drawn = groups[start : start + len(COLOURS)]
        title = f"Training success: {setting_of(drawn)}"
        draw_comparison(figures[-1], [curves(group) for group in drawn], title=title)
    pictures = [f"![Training success by round]({figure.name})" for figure in figures]
    (folder / "report.md").write_text(_markdown(groups, pictures), encoding="utf-8")
    _write_csv(folder / "report.csv", [_row(group) for group in groups])
    _write_csv(folder / "improvements.csv", [_pair(item) for item in improvements(groups)])


def _markdown(groups: Sequence[Group], pictures: Sequence[str] = ()) -> str:
    parts = [
        f"# {setting_of(groups)}",
        success_table(groups),
        NOTE.strip(),
        improvement_table(groups),
        *pictures,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _interval(value: Estimate) -> str:
    return _NONE if math.isnan(value.low) else f"[{value.low:.3f}, {value.high:.3f}]"


def _row(group: Group) -> dict[str, Any]:
    """Returns what report.csv holds of a group."""
    row: dict[str, Any] = {
        "label": group.label,
        "agent": group.first.agent,
        "explore": group.first.explore,
        "env": group.first.env,
        "domain": group.first.domain,
        "seeds": len(group.final),
        "rounds": group.first.rounds,
    }
    for name, values in (("final_success", group.final), ("training_success", group.cumulative)):
        summary = summarise(values)
        row |= {
            f"{name}_mean": summary.t.value,
            f"{name}_bootstrap_low": summary.bootstrap.low,
            f"{name}_bootstrap_high": summary.bootstrap.high,
            f"{name}_t_low": summary.t.low,
            f"{name}_t_high": summary.t.high,
            f"{name}_iqm": summary.iqm.value,
            f"{name}_iqm_low": summary.iqm.low,
            f"{name}_iqm_high": summary.iqm.high,
        }
    return row | {"reward": group.reward, "turns": group.turns}


def _pair(item: Improvement) -> dict[str, Any]:
    row: dict[str, Any] = {"better": item.better.label, "worse": item.worse.label}
    for name, value in (("final_success", item.final), ("training_success", item.cumulative)):
        row |= {name: value.value, f"{name}_low": value.low, f"{name}_high": value.high}
    return row


def _write_csv(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes a CSV file; what there is not is empty. No file where there are no rows."""
    if not rows:
        file.unlink(missing_ok=True)
        return
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({name: "" if value != value else value for name, value in row.items()})


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m bbq_torchrl.evaluation.report",
        description="Compares finished runs over their seeds: prints the tables as Markdown.",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, help="run folders, or folders with run folders below them"
    )
    parser.add_argument(
        "--out", type=Path, help="folder for report.md, report.csv, improvements.csv, curves.png"
    )
    given = parser.parse_args(arguments)
    try:
        groups = read_groups(find_results(given.folders))
        if given.out is not None:
            write_report(groups, given.out)
    except (ValueError, OSError) as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        return 2
    sys.stdout.write(_markdown(groups))
    return 0


if __name__ == "__main__":
    sys.exit(main())
