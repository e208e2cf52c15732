"""Tables of what makes learning start earlier or end higher."""

from __future__ import annotations

from collections import defaultdict
from math import isfinite
from statistics import fmean, median
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.curves import Reach, rounds_to_reach
from bbq_torchrl.evaluation.groups import EARLY
from bbq_torchrl.utils.statistics import estimate
from bbq_torchrl.utils.text import EMPTY
from scripts.docs_blocks.common import (
    block,
    code,
    group,
    groups,
    minus,
    paired,
    pivot,
    read_csv,
    table,
)

if TYPE_CHECKING:
    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.utils.statistics import Estimate


@block("learning.plateau")
def _plateau() -> str:
    """Returns the median prediction over seeds, a line for each initial posterior."""
    values = defaultdict(list)
    for line in read_csv("plateau.csv"):
        values[line["start"], f"{int(line['updates']):,}"].append(float(line["q_value"]))
    cells = {key: f"{median(of_seeds):.1f}" for key, of_seeds in values.items()}
    return pivot("start, after updates", cells)


@block("learning.imitation")
def _imitation() -> str:
    """Returns the table of a network that imitates the best script without its memory."""
    found: dict[str, list[float]] = defaultdict(list)
    for row in read_csv("imitation.csv"):
        found[f"{int(row['dialogues']):,}"].append(float(row["success"]))
    rows = [
        (n, f"{fmean(rates):.3f}", ", ".join(f"{r:.3f}" for r in rates))
        for n, rates in found.items()
    ]
    return table(("dialogues imitated", "success", "seeds"), rows)


@block("results.width")
def _width() -> str:
    """Returns how wide the posteriors are where an agent has acted often, rarely, and never."""
    agents = {"bbqn": "BBQN", "gp": "Gaussian process"}
    return pivot(
        "median std of Q over draws; the action was taken",
        {
            (agents[row["agent"]], row["visited"]): f"{float(row['std']):.2f}"
            for row in read_csv("width.csv")
        },
    )


GP_EXPLORERS = {
    "a draw a turn": "gp",
    "a draw a dialogue": "gp_explorers/episode",
    "Boltzmann": "gp_explorers/boltzmann",
    "ε": "gp_explorers/epsilon_greedy",
    "greedily": "gp_explorers/greedy",
}
"""Explorer of the Gaussian process -> its runs, the first of which is the reference."""


@block("results.gp_explorers")
def _gp_explorers() -> str:
    """Returns what the Gaussian process books by its draws and by other explorers, by pairs."""
    reference, rows = group("gp"), []
    for explorer, name in GP_EXPLORERS.items():
        for own in groups(name):
            row = [explorer, len(own.final)]
            for quantity, values in (("early", own.booked(EARLY)), ("final", own.final)):
                gap = EMPTY if name == "gp" else minus(reference, own, quantity)
                row += [estimate(values), gap]
            rows.append(row)
    minuend = f"{next(iter(GP_EXPLORERS))} minus it"
    head = (f"booked of the first {EARLY:,}", minuend, "at the end", minuend)
    return table(("Gaussian process", "seeds", *head), rows, numbers=5)


@block("results.visits")
def _visits() -> str:
    """Returns what DQN books early by a process of what was visited, next to other explorers."""
    own = [float(row["booked_1000"]) for row in read_csv("visits.csv")]
    rows = [("DQN and the process", estimate(own), EMPTY)]
    for name, agent in (("DQN", "dqn"), ("DQN-Boltzmann", "dqn_boltzmann"), ("BBQN", "bbqn")):
        other = group(f"searched/{agent}_default").booked(EARLY)
        rows.append((name, estimate(other), paired(own, other)))
    return table(
        ("agent", f"booked of the first {EARLY:,}", "the process minus it"), rows, numbers=2
    )


@block("learning.tried", "tried.csv", "success_rate", "final")
@block("learning.early", "tried_early.csv", "evaluation_20", "after 20 rounds")
@block("learning.targets", "tried_targets.csv", "late_success", "rounds 26 to 30")
@block("learning.experience", "tried_experience.csv", "success_rate", "final")
@block("learning.end", "tried_end.csv", "success_rate", "final")
@block("learning.end_more", "tried_end_more.csv", "success_rate", "final")
@block("learning.end_table1", "tried_end_table1.csv", "success_rate", "final")
def _tried(file: str, end: str, name: str) -> str:
    """Returns each variant's difference from the first one by pairs of seeds, and the first one.

    Args:
        file: a row for each variant and seed.
        end: the column that says how the training ended.
        name: of that column in the table.
    """
    runs = defaultdict(list)
    for line in read_csv(file):
        runs[line["variant"]].append((float(line["cumulative_success"]), float(line[end])))
    (variant, values), *others = runs.items()
    base = [*zip(*values, strict=True)]
    rows = [(variant, *(f"{fmean(of):.3f}" for of in base))]
    for other, of in others:
        columns = zip(zip(*of, strict=True), base, strict=True)
        rows.append((other, *(paired(own, first) for own, first in columns)))
    return table((f"variant, {len(values)} seeds", "cumulative", name), rows, numbers=2)


@block("learning.expect")
def _expect() -> str:
    """Returns the sentence on the outcome of the README's first command."""
    finals = group("quick").final
    low, mean, high = (f"{of(finals):.2f}" for of in (min, fmean, max))
    return (
        f"Success stays near zero for the first five rounds, then rises: {len(finals)} seeds end "
        f"by booking between {low} and {high} of the dialogues (mean {mean})."
    )


@block("learning.spikes")
def _spikes() -> str:
    """Returns the table of what the buffer is spiked with."""
    shown = []
    for own in groups("quick_soft/soft", "spikes"):
        setting = own.setting
        spike = f"{setting['spike.dialogues']:,} of {code(setting['spike.policy'])}"
        if setting.get("spike.margin"):
            spike += ", imitated"
        rounds, env, final = own.first.rounds, own.first.env, estimate(own.final)
        rate = "constant" if setting["protocol.lr_final"] == 1 else "falls"
        order = (rounds, env != "full", final.value)
        shown.append(
            (order, (spike, own.agent, env, rounds, rate, estimate(own.booked(EARLY)), final))
        )
    rows = [row for _, row in sorted(shown, key=lambda item: item[0])]
    head = ("spiked with", "agent", "env", "rounds", "rate", f"booked after {EARLY:,}", "final")
    return table(head, rows, numbers=2)


SEARCHED = ("bbqn", "dqn_boltzmann", "noisy_dqn", "dqn", "dqn_bootstrap", "dqn_vime")
"""Agents with searched settings."""


@block("learning.searched")
def _searched() -> str:
    """Returns agents with searched settings, each next to the default, and between agents."""
    rows = []
    for agent in SEARCHED:
        searched, default = (group(f"searched/{agent}_{of}") for of in ("searched", "default"))
        name = searched.agent.removeprefix("Soft ")
        rows.append((name, *_early_and_end(searched), *_gaps(searched, default)))
    for part in ("posterior", "learner"):
        own, default = group(f"searched/bbqn_{part}"), group("searched/bbqn_default")
        rows.append((f"BBQN-MAP, only the {part}", *_early_and_end(own), *_gaps(own, default)))
    head = ("searched", f"first {EARLY:,}", "final", f"minus default, {EARLY:,}", "final")
    bbqn = [(name, group(f"searched/{name}")) for name in ("bbqn_searched", "bbqn_default")]
    between = []
    for other in SEARCHED[1:3]:
        for name, own in bbqn:
            rival = group(f"searched/{name.replace('bbqn', other)}")
            between.append((f"{name.partition('_')[2]}, {rival.agent}", *_gaps(own, rival)))
    extension = (group(f"searched/extension_{agent}_searched") for agent in SEARCHED[:2])
    between.append(("searched, DQN-Boltzmann, extension", *_gaps(*extension)))
    beside = ("BBQN minus", f"first {EARLY:,}", "final")
    return f"{table(head, rows, numbers=4)}\n\n{table(beside, between, numbers=2)}"


def _early_and_end(own: Group) -> tuple[str, str]:
    return f"{estimate(own.booked(EARLY)).value:.3f}", f"{estimate(own.final).value:.3f}"


def _gaps(one: Group, other: Group) -> tuple[Estimate, Estimate]:
    return minus(one, other, "early"), minus(one, other, "final")


def unspiked() -> dict[tuple[str, str], list[dict[str, str]]]:
    """Returns the seeds that learn without spiking, by domain and agent."""
    seeds: dict[tuple[str, str], list[dict[str, str]]] = defaultdict(list)
    for row in read_csv("unspiked.csv"):
        seeds[row["domain"], row["agent"]].append(row)
    return seeds


@block("results.unspiked_by_success")
def _unspiked_by_success() -> str:
    """Returns BBQN with a temperature that falls with success, next to others; all unspiked."""
    own = group("by_success/unspiked")
    found = int((own.success > 0).any(0).sum())
    reached = sum(isfinite(rounds) for rounds in rounds_to_reach(own.success, 0.3))
    waiting = "`agent=bbqn`, falling with success"
    rows = [(waiting, len(own.final), found, reached, estimate(own.final))]
    for agent, name in (("bbqn_map_soft", "`agent=bbqn`"), ("dqn_boltzmann", "DQN-Boltzmann")):
        seeds = unspiked()["movie", agent]
        counts = (sum(bool(row[key]) for row in seeds) for key in ("first_success", "to_0.3"))
        finals = estimate([float(row["final"]) for row in seeds])
        rows.append((name, len(seeds), *counts, finals))
    return table(("movies", "seeds", "find a success", "reach .3", "end"), rows, numbers=4)


@block("results.unspiked")
def _unspiked() -> str:
    """Returns a table for each domain of agents that learn without spiking, the best first."""
    tables: dict[str, list[tuple[float, tuple[str, ...]]]] = defaultdict(list)
    for (domain, agent), rows in unspiked().items():
        booked, final = (
            estimate([float(row[column]) for row in rows]) for column in ("booked", "final")
        )
        times = tuple(float(row["to_0.3"] or "inf") for row in rows)
        reached = str(Reach(times, int(rows[0]["dialogues"])))
        row = (code(agent), reached, f"{booked.value:.3f}", str(final))
        tables[domain].append((booked.value, row))
    return "\n\n".join(
        table(
            (f"domain {code(domain)}", "dialogues to .3", "booked in all", "final success"),
            [cells for _, cells in sorted(lines, key=lambda line: -line[0])],
            numbers=3,
        )
        for domain, lines in tables.items()
    )
