"""Tables of who is best when: by budget, in both environments, with and without the spike."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains.domain import PRIVILEGED_POLICY
from bbq_torchrl.evaluation.compare_runs import PAPER
from bbq_torchrl.evaluation.groups import difference
from bbq_torchrl.utils.statistics import estimate
from scripts.docs_blocks.common import block, group, groups, read_json, short, table
from scripts.docs_blocks.learning import unspiked
from scripts.docs_blocks.results import cells
from scripts.docs_blocks.tables import measured

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    Seeds = Mapping[object, float]
    """Seed of an agent -> its success; seeds of one name saw the same dialogues."""

BUDGETS = (500, 1_000, 5_000)

FILES = {name: name.lower().replace("-", "_") for name in PAPER["full"]}
FILES |= {"Soft BBQN-MAP": "bbqn_map_soft", "GP": "gp"}
"""Agent -> its name in results/."""

README = ("BBQN-MAP", "DQN-Bootstrap", "DQN-Boltzmann", "DQN", "GP")
"""Agents of the small table: those of README's figure, and the fastest learner."""


LEFT_OUT = tuple(
    f"{name}, searched"
    for name in PAPER["full"]
    if name not in ("DQN", "DQN-Boltzmann", "DQN-Bootstrap")
)
"""Searched agents not in the small table: with Soft BBQN-MAP's settings, or far below DQN."""

SCRIPTS = {"repair": "script `repair`", PRIVILEGED_POLICY: "privileged ceiling"}
"""Policies that do not learn -> their rows."""

UNSPIKED = {"movie": "no spike, full: end", "hotel": "no spike, hotels: end"}
"""Domain of the runs without a spike -> their column."""


def _columns() -> dict[str, dict[str, Seeds]]:
    """Returns column -> agent -> seeds: ``full: 500`` and so on."""
    columns: dict[str, dict[str, Seeds]] = {}
    for env, of_env in (("full", "full"), ("extension", "domain_ext")):
        runs = {agent: group(f"table1/{env}/{name}") for agent, name in FILES.items()}
        searched = cells("searched/table1", of_env)
        runs |= {f"{agent}, searched": own for agent, own in searched.items()}
        for agent, own in runs.items():
            values = {f"{budget:,}": own.booked(budget) for budget in BUDGETS} | {"end": own.final}
            for column, of in values.items():
                seeds = dict(zip(own.members, of, strict=True))
                columns.setdefault(f"{env}: {column}", {})[agent] = seeds
    rows = unspiked()
    for domain, column in UNSPIKED.items():
        columns[column] = {
            agent: {row["replica"]: float(row["final"]) for row in rows[domain, name]}
            for agent, name in FILES.items()
            if (domain, name) in rows
        }
    return columns


def _marked(agents: Mapping[str, Seeds]) -> dict[str, str]:
    """Returns agent -> mean; bold unless its difference from the best one is shown by pairs."""
    means = {name: estimate([*of.values()]).value for name, of in agents.items()}
    best = agents[max(means, key=means.__getitem__)]
    cells = {}
    for name, of in agents.items():
        gap = difference([best[seed] - of[seed] for seed in best])
        text = short(means[name])
        cells[name] = text if gap.low > 0 else f"**{text}**"
    return cells


def _shown(columns: Mapping[str, Mapping[str, Seeds]], heads: Sequence[str]) -> str:
    """Returns the table of some columns with these heads, and what bold numbers are."""
    cells = {column: _marked(agents) for column, agents in columns.items()}
    for own in groups("no_spike"):  # of fewer dialogues
        cells[UNSPIKED["movie"]][own.agent] = f"{short(estimate(own.final).value)}*"
    hotel = read_json("bench/bench.json")["scripts"]["hotel, errors reference"]
    for policy, name in SCRIPTS.items():
        movie = short(measured()["movie", "reference", policy]["success_rate"])
        for column, of in cells.items():
            if column == UNSPIKED["hotel"]:
                of[name] = short(hotel[policy])
            elif not column.startswith("extension"):
                of[name] = movie
    names = [name for name in next(iter(cells.values())) if name not in SCRIPTS.values()]
    names += SCRIPTS.values()
    rows = [(name, *(of.get(name, "–") for of in cells.values())) for name in names]
    return (
        f"{table(('agent', *heads), rows, numbers=len(heads))}\n\n"
        "Bold: the best learner of a column, and all whose difference from it is not shown by "
        "pairs of ten seeds (95 % interval)."
    )


@block("results.best")
def _best() -> str:
    """Returns all agents by budget and environment, and without the spike."""
    columns = _columns()
    ends = [group(f"table1/{env}/dqn").dialogues for env in ("full", "extension")]
    ends += [int(unspiked()[domain, "dqn_boltzmann"][0]["dialogues"]) for domain in UNSPIKED]
    note = (
        "End: final success after {:,} dialogues of the full domain, {:,} of domain extension; "
        "without the spike {:,}, in the hotels {:,} (*: {:,}, five seeds).".format(
            *ends, group("no_spike/dqn").dialogues
        )
    )
    return f"{_shown(columns, [*columns])} {note}"


@block("results.best_small")
def _best_small() -> str:
    """Returns the agents of the figure: early, at the end, and without the spike."""
    columns = _columns()
    chosen = {
        column: {
            agent: of
            for agent, of in columns[column].items()
            if agent in README or (agent.endswith(", searched") and agent not in LEFT_OUT)
        }
        for column in ("full: 1,000", "full: end", UNSPIKED["movie"])
    }
    finals = chosen["full: end"]
    ends = {agent: short(estimate([*of.values()]).value) for agent, of in finals.items()}
    one, other = (finals[agent] for agent in ("BBQN-MAP", "DQN"))
    gap = difference([one[seed] - other[seed] for seed in one])
    searched = ", ".join(
        f"{agent.partition(',')[0]} {end}" for agent, end in ends.items() if agent not in README
    )
    shown = _shown(chosen, ["booked of the first 1,000", "end", "end, without the spike"])
    return (
        f"**BBQN-MAP ends with a success of {ends['BBQN-MAP']}, DQN with {ends['DQN']}** where all "
        f"share one setting (a difference of {short(gap.value)}, 95 % interval {short(gap.low)} to "
        f"{short(gap.high)}). With settings searched for each: {searched}.\n\n"
        f"{shown} *: of {group('no_spike/dqn').dialogues:,} dialogues, five seeds."
    )
