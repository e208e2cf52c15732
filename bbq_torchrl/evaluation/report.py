"""``python -m bbq_torchrl.evaluation.report``: finished runs compared over their seeds.

The tables, the CSV files and the figure of a comparison; what is on the results page of the
documentation is made by the same functions.
"""

from __future__ import annotations

import csv
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl import interruption, output
from bbq_torchrl.evaluation.figures import COLORS, Curves, draw_comparison, draw_panels
from bbq_torchrl.evaluation.grid import grid_text
from bbq_torchrl.evaluation.groups import Group, find_results, read_groups
from bbq_torchrl.evaluation.learning import learning, rounds_to_reach
from bbq_torchrl.evaluation.pairs import Pairing, pairings
from bbq_torchrl.evaluation.statistics import Summary, summarize
from bbq_torchrl.evaluation.table1 import (
    PAPER,
    TABLE1_NOTE,
    comparisons_table,
    find_cells,
    missing_cells,
    table1,
)
from bbq_torchrl.evaluation.tables import (
    LEARNING_NOTE,
    NOTE,
    PAIRS_NOTE,
    Improvement,
    improvement_table,
    improvements,
    learning_table,
    pairs_table,
    success_table,
)
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = [
    "cells_of_table1",
    "curves",
    "draw_table1",
    "main",
    "references",
    "setting_of",
    "table1_text",
    "write_grid",
    "write_replicas",
    "write_report",
    "write_table1",
]


def setting_of(groups: Sequence[Group]) -> str:
    """Returns what the groups have in common: ``"env=full, domain=movie"``; no domain if none."""
    common = {
        name: sorted({getattr(group.first, name) for group in groups} - {""})
        for name in ("env", "domain")
    }
    return ", ".join(f"{name}={'|'.join(values)}" for name, values in common.items() if values)


def curves(group: Group) -> Curves:
    """Returns what is drawn of a group."""
    return Curves(group.label, group.success, group.final, group.evaluation, group.training_reward)


def write_table1(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``table1.md``, ``replicas.csv`` and the curves of each domain as PNG and SVG files.

    Returns the tables as Markdown, which begin with what is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for env in PAPER:
        for file in (folder / f"table1_{env}.png", folder / f"table1_{env}.svg"):
            if draw_table1(groups, env, file):
                pictures.append(f"![Learning curves, env={env}]({file.name})\n")
    text = table1_text(groups)
    (folder / "table1.md").write_text("\n".join([text, *pictures[::2]]), encoding="utf-8")
    write_replicas(cells_of_table1(groups), folder / "replicas.csv")
    return text


def cells_of_table1(groups: Sequence[Group]) -> list[Group]:
    """Returns the groups that are cells of Table 1, in its order and by the paper's names."""
    return [
        replace(group, label=name)
        for env in PAPER
        for name, group in find_cells(groups, env).items()
    ]


def draw_table1(groups: Sequence[Group], env: str, file: Path) -> bool:
    """Draws the agents of Table 1 in one environment; returns whether there are any."""
    cells = [group for group in cells_of_table1(groups) if group.first.env == env]
    if cells:
        draw_panels(file, [curves(group) for group in cells], title=f"Table 1, env={env}")
    return bool(cells)


def table1_text(groups: Sequence[Group]) -> str:
    """Returns Table 1 and its declared comparisons as Markdown, first of all what is missing."""
    missing = missing_cells(groups)
    count = sum(map(len, PAPER.values()))
    parts = [f"# Table 1: {count - len(missing)} of {count} cells"]
    if missing:
        parts.append(f"Not run: {'; '.join(missing)}.")
    for env in PAPER:
        parts += [f"## env={env}", table1(groups, env), comparisons_table(groups, env)]
    return "\n\n".join([*parts, TABLE1_NOTE.strip()]) + "\n"


def write_replicas(groups: Sequence[Group], file: Path) -> None:
    """Writes a CSV file with a row for each replica."""
    _write_csv(file, [row for group in groups for row in _replica_rows(group)])


def _replica_rows(group: Group) -> list[dict[str, Any]]:
    reached = iter(rounds_to_reach(group.success, 0.6).tolist())
    return [
        {
            "corpus": run.result.domain,
            "env": run.result.env,
            "agent": group.label,
            "replica": entry.replica,
            "seed": run.result.seed,
            "rounds": run.result.rounds,
            "updates": run.updates[number],
            "success_rate": entry.success_rate,
            "reward": entry.reward,
            "turns": entry.turns,
            "cumulative_success": entry.training_success,
            "rounds_to_60": f"{next(reached):.0f}".replace("inf", ""),
        }
        for run in group.runs
        for number, entry in enumerate(run.result.per_replica)
    ]


def write_grid(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``grid.md`` and ``replicas.csv``. Returns the grid as Markdown."""
    text = grid_text(groups)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "grid.md").write_text(text, encoding="utf-8")
    write_replicas(groups, folder / "replicas.csv")
    return text


def references(groups: Sequence[Group]) -> dict[str, float]:
    """Returns the success of the privileged policies, by name, mean over the runs.

    Empty unless the runs all know it and have the same users.
    """
    runs = [run for group in groups for run in group.runs]
    users = [
        {key: value for key, value in run.setting.items() if key.startswith(("env.", "domain."))}
        for run in runs
    ]
    known = [run.result.references for run in runs]
    if any(other != users[0] for other in users) or any(
        one.keys() != known[0].keys() for one in known
    ):
        return {}
    return {name: math.fsum(one[name] for one in known) / len(known) for name in known[0]}


def write_report(groups: Sequence[Group], folder: Path) -> str:
    """Writes ``report.md``, a CSV file of each of its tables, and the learning curves.

    Returns the tables as Markdown.

    The files: ``report.csv`` (success), ``improvements.csv``, ``pairs.csv``, ``learning.csv``, and
    ``replicas.csv`` with a row for each replica. A figure shows at most seven groups:
    ``curves.png``, then ``curves_2.png`` and so on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = []
    for number, start in enumerate(range(0, len(groups), len(COLORS)), 1):
        figures.append(folder / ("curves.png" if number == 1 else f"curves_{number}.png"))
        drawn = groups[start : start + len(COLORS)]
        title = f"Training success: {setting_of(drawn)}"
        draw_comparison(
            figures[-1],
            [curves(group) for group in drawn],
            title=title,
            references=references(drawn),
        )
    pictures = [f"![Training success by round]({figure.name})" for figure in figures]
    compared = pairings(groups)
    text = _markdown(groups, compared)
    (folder / "report.md").write_text("\n".join([text, *pictures, ""]), encoding="utf-8")
    _write_csv(folder / "report.csv", [_row(group) for group in groups])
    _write_csv(folder / "improvements.csv", [_improvement(item) for item in improvements(groups)])
    _write_csv(folder / "pairs.csv", [_pair_row(item) for item in compared])
    _write_csv(folder / "learning.csv", _learning_rows(groups))
    write_replicas(groups, folder / "replicas.csv")
    return text


def _markdown(groups: Sequence[Group], compared: Sequence[Pairing]) -> str:
    parts = [
        f"# {setting_of(groups)}",
        success_table(groups),
        NOTE.strip(),
        improvement_table(groups),
        *([pairs_table(compared), PAIRS_NOTE.strip()] if compared else []),
        learning_table(groups),
        LEARNING_NOTE.strip(),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


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
        row |= _summary(name, summarize(values))
    return row | {"reward": group.reward, "turns": group.turns}


def _summary(name: str, summary: Summary) -> dict[str, float]:
    return {
        f"{name}_mean": summary.t.value,
        f"{name}_bootstrap_low": summary.bootstrap.low,
        f"{name}_bootstrap_high": summary.bootstrap.high,
        f"{name}_t_low": summary.t.low,
        f"{name}_t_high": summary.t.high,
        f"{name}_iqm": summary.iqm.value,
        f"{name}_iqm_low": summary.iqm.low,
        f"{name}_iqm_high": summary.iqm.high,
    }


def _improvement(item: Improvement) -> dict[str, Any]:
    row: dict[str, Any] = {"better": item.better.label, "worse": item.worse.label}
    for name, value in (("final_success", item.final), ("training_success", item.cumulative)):
        row |= {name: value.value, f"{name}_low": value.low, f"{name}_high": value.high}
    return row


def _pair_row(item: Pairing) -> dict[str, Any]:
    row: dict[str, Any] = {"one": item.one.label, "other": item.other.label, "pairs": item.pairs}
    for name, difference in item.differences.items():
        row |= _summary(name, difference)
    return row | {"remark": item.remark}


def _learning_rows(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """Returns what learning.csv holds: a row for each learning curve; infinite is empty."""
    rows = []
    for group in groups:
        for curve in learning(group):
            row: dict[str, Any] = {
                "label": group.label,
                "success_in": curve.success_in,
                "seeds": len(group.final),
                "rounds": group.first.rounds,
                **_summary("area", curve.area),
            }
            for item in curve.reach:
                low, high = item.interval
                row |= {
                    f"reached_{item.level}": item.reached,
                    f"rounds_{item.level}": item.median,
                    f"rounds_{item.level}_low": low,
                    f"rounds_{item.level}_high": high,
                    f"dialogues_{item.level}": item.median * group.round_dialogues,
                }
            rows.append(row)
    return rows


def _write_csv(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes a CSV file; what there is not is empty. No file where there are no rows."""
    if not rows:
        file.unlink(missing_ok=True)
        return
    names = max(rows, key=len)  # rows without pairs lack columns of those with
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(names), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({name: value for name, value in row.items() if not _is_none(value)})


def _is_none(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    interruption.tell(lambda: "in a report", lambda: "the same command begins again")
    parser = output.Parser(
        prog="python -m bbq_torchrl.evaluation.report",
        description="Compares finished runs over their seeds: prints the tables as Markdown.",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, help="run folders, or folders with run folders below them"
    )
    parser.add_argument(
        "--out", type=Path, help="folder for report.md, its tables as CSV files, and curves.png"
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--table1",
        action="store_true",
        help="the paper's Table 1: its numbers beside, declared pairs, and what is missing",
    )
    form.add_argument(
        "--grid", action="store_true", help="learner x explorer: each learner by each exploration"
    )
    given = parser.parse_args(arguments)
    try:
        groups = read_groups(find_results(given.folders))
        if given.table1:
            text = table1_text(groups) if given.out is None else write_table1(groups, given.out)
        elif given.grid:
            text = grid_text(groups) if given.out is None else write_grid(groups, given.out)
        elif given.out is not None:
            text = write_report(groups, given.out)
        else:
            text = _markdown(groups, pairings(groups))
    except (ValueError, OSError) as error:
        output.complain(f"error: {sentence(error)}")
        return 2
    output.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
