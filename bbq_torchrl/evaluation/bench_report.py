"""The benchmark's page: agents over settings (a domain at an error level), seeds and budgets.

A row is a trained seed. The page is a function of the rows, which are written as one CSV.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from bbq_torchrl.evaluation.curves import LEVEL, Reach, booked, rounds_to_reach
from bbq_torchrl.evaluation.figures import draw_bands
from bbq_torchrl.evaluation.finished_runs import read_runs
from bbq_torchrl.evaluation.groups import difference
from bbq_torchrl.utils.reports import Report, Table
from bbq_torchrl.utils.statistics import (
    bootstrapped,
    estimate,
    estimate_iqm,
    pass_k,
    performance_profile,
    probability_of_improvement,
    stratified,
)
from bbq_torchrl.utils.text import EMPTY

TRIES = (1, 2, 4, 8)
"""Values of k in pass^k."""

NOTE = f"""\
The unit is the training seed: means have their 95 % Student t interval. **Booked**: share of the
first training dialogues that succeeded, exploration included. **Success after**: success of the
reported policy at that budget, without exploration; the last one is the final evaluation.
**Dialogues to {LEVEL}**: training dialogues until the mean of five rounds reaches it; the median,
where a seed that did not reach it counts as longer than all others, and the number that did.
**pass^k**: probability of reaching the same goal k times in a row, under other errors and random
choices of the user (Yao et al. 2024). Schedules of exploration span the largest budget."""

OVER_NOTE = """\
Over the settings that all agents have finished (Agarwal et al. 2021): interquartile mean over all
settings and seeds, and P, the probability that a seed of the first agent scores higher than one of
the second. Their 95 % intervals are bootstrapped within each setting, from five seeds on. By pairs:
mean difference of the same seeds, which saw the same goals and random numbers, averaged over
settings, with its t interval."""

Row = dict[str, Any]
Setting = tuple[str, str]


def rows_of(
    agent: str, setting: Setting, folder: Path, budgets: Sequence[int], plays: Any, wins: Any
) -> list[Row]:
    """Returns a row for each replica of a cell.

    Args:
        agent: the agent's name.
        setting: domain and error level.
        folder: the cell's run folder.
        budgets: numbers of training dialogues, whole rounds, the last one the whole training.
        plays: dialogues for pass^k, shape [replicas, goals].
        wins: those that succeeded, the same shape.
    """
    rows = []
    for replica in read_runs(folder):
        metrics, own, number = replica.metrics, replica.own, replica.number
        success, size = metrics["success_rate"][:, [number]], int(metrics["dialogues"][0, number])
        row: Row = {"agent": agent, "domain": setting[0], "errors": setting[1]}
        row |= {"seed": replica.result.seed, "replica": number}
        row |= {f"booked after {first}": booked(success, size, first)[0] for first in budgets}
        row |= {
            f"success after {first}": float(metrics["eval_success_rate"][first // size - 1, number])
            for first in budgets[:-1]
        }
        row |= {f"success after {budgets[-1]}": own.success_rate, "reward": own.reward}
        row |= {f"dialogues to {LEVEL}": float(rounds_to_reach(success, LEVEL)[0]) * size}
        rows.append(
            row | {f"pass^{k}": float(pass_k(wins[number], plays[number], k)) for k in TRIES}
        )
    return rows


def bench_report(
    rows: Sequence[Row],
    agents: Sequence[str],
    settings: Sequence[Setting],
    about: Mapping[str, Any],
) -> Report:
    """Returns the benchmark's page; its data are written as ``bench.csv``.

    Args:
        rows: the rows of the finished cells.
        agents: names in order.
        settings: settings in order.
        about: the content of bench.json: ``budgets``, ``seeds``, ``missing``, ``scripts``.
    """
    budgets = about["budgets"]
    cells: dict[tuple[str, Setting], list[Row]] = {}
    for row in rows:
        cells.setdefault((row["agent"], (row["domain"], row["errors"])), []).append(row)
    whole = [
        one
        for one in settings
        if all(len(cells.get((agent, one), ())) == about["seeds"] for agent in agents)
    ]
    parts: list[str | Table] = [
        *([f"**Missing:** {'; '.join(about['missing'])}."] if about["missing"] else []),
        "## Over settings",
    ]
    figures: dict[str, tuple[str, Callable[[], Any]]] = {}
    if whole:
        last = budgets[-1]
        scores = {
            name: {
                agent: np.array([[row[column] for row in cells[agent, one]] for one in whole])
                for agent in agents
            }  # [settings, seeds]
            for name, column in (
                ("final success", f"success after {last}"),
                (f"booked after {last:,}", f"booked after {last}"),
            )
        }
        means = [
            {"agent": agent}
            | {f"IQM of {name}": estimate_iqm(of[agent]) for name, of in scores.items()}
            for agent in agents
        ]
        parts += [Table("over", means), _pairs_table(scores), OVER_NOTE]
        profiles = {name: {a: _profile(s) for a, s in of.items()} for name, of in scores.items()}
        title = f"Share of seeds above a score, {len(whole)} setting{'s' * (len(whole) != 1)}"
        draw = partial(draw_bands, profiles, title=title, xlabel="score")
        figures["profiles"] = ("Performance profiles", draw)
    else:
        parts.append("No setting is finished by all agents.")
    parts.append("## Each setting")
    curves = {}
    for one in settings:
        name = setting_name(one)
        if found := {agent: cells[agent, one] for agent in agents if (agent, one) in cells}:
            rates = about["scripts"].get(name, {})
            scripts = ", ".join(f"{script} {rate:.3f}" for script, rate in rates.items())
            parts += [f"### {name}", str(_setting_table(found, budgets)), f"Scripts: {scripts}."]
            curves[name] = {agent: _curve(of, budgets) for agent, of in found.items()}
    parts.append(NOTE)
    title = "Share of training dialogues booked, by budget"
    if rows:
        draw = partial(draw_bands, curves, title=title, xlabel="dialogues")
        figures["booked"] = (title, draw)
    parts.append(f"```bash\n{about['command']}\n```")
    data = [Table("bench", rows, words=3)]
    shown = [str(part) for part in parts]  # as text, since the data are one table
    return Report("bench", "Benchmark", shown, figures, data)


def setting_name(setting: Setting) -> str:
    """Returns the name of a setting, such as ``movie, errors 0``."""
    return f"{setting[0]}, errors {setting[1]}"


def _pairs_table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    rows: list[Row] = []
    for one, other in combinations(next(iter(scores.values())), 2):
        row: Row = {"agents": f"{one} over {other}"}
        for name, of in scores.items():
            both = of[one], of[other]
            row[f"P({name})"] = bootstrapped(probability_of_improvement, *both)
            row[f"{name} by pairs"] = difference((both[0] - both[1]).mean(0).tolist())
        rows.append(row)
    return Table("pairs", rows)


def _profile(scores: Any) -> Any:
    """Returns the curve of a performance profile, shape [4, levels]."""
    levels = np.linspace(0, 1, 101)
    ends = stratified(lambda drawn: performance_profile(drawn, levels), scores)
    return np.stack([levels, performance_profile(scores, levels), *ends])


def _curve(rows: Sequence[Row], budgets: Sequence[int]) -> Any:
    """Returns the curve of booked dialogues by budget, shape [4, budgets]."""
    found = [estimate([row[f"booked after {first}"] for row in rows]) for first in budgets]
    return np.array(
        [budgets, *zip(*((one.value, one.low, one.high) for one in found), strict=True)]
    )


def _setting_table(found: Mapping[str, Sequence[Row]], budgets: Sequence[int]) -> Table:
    def column(name: str, rows: Sequence[Row]) -> list[float]:
        return [row[name] for row in rows]

    table: list[Row] = []
    for agent, rows in found.items():
        reach = Reach(tuple(column(f"dialogues to {LEVEL}", rows)), budgets[-1])
        row: Row = {"agent": agent, "seeds": len(rows)}
        for name in ("booked after", "success after"):
            row |= {f"{name} {b:,}": estimate(column(f"{name} {b}", rows)) for b in budgets}
        row[f"dialogues to {LEVEL}"] = reach
        row["reward"] = float(np.mean(column("reward", rows)))
        passed = {f"pass^{k}": column(f"pass^{k}", rows) for k in TRIES}
        row |= {k: EMPTY if math.isnan(sum(of)) else estimate(of) for k, of in passed.items()}
        table.append(row)
    return Table("setting", table)
