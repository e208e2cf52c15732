"""Tables of who is best when: by budget, in both environments, with and without the spike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bbq_torchrl.domains.domain import PRIVILEGED_POLICY
from bbq_torchrl.evaluation.compare_runs import PAPER
from bbq_torchrl.evaluation.pairs import difference
from bbq_torchrl.utils.statistics import estimate
from scripts.docs_blocks.common import block, group, groups, read_json, short, table
from scripts.docs_blocks.learning import unspiked
from scripts.docs_blocks.tables import measured

Seeds = Mapping[object, float]
"""Seed of an agent -> its success; seeds of one name saw the same dialogues."""

ENVS = {"full": "full domain", "extension": "domain extension"}
"""Folder of Table 1's runs -> title of the environment."""

BUDGETS = (500, 1_000, 5_000)

UNSPIKED = {
    "BBQN-MAP": "bbqn_map",
    "BBQN-MC": "bbqn_mc",
    "BBQN-VIME-MAP": "bbqn_vime_map",
    "BBQN-VIME-MC": "bbqn_vime_mc",
    "DQN": "dqn",
    "DQN-Boltzmann": "dqn_boltzmann",
    "DQN-Bootstrap": "dqn_bootstrap",
    "DQN-VIME-MAP": "dqn_vime",
    "DQN-VIME-MC": "dqn_vime_mc",
    "Soft BBQN-MAP": "bbqn_map_soft",
    "GP": "gp",
}
"""Agent -> its name in unspiked.csv."""

SEARCHED = {"Soft BBQN-MAP, searched": "bbqn", "DQN-Boltzmann, searched": "dqn_boltzmann"}
"""Agent with searched settings -> the end of its folder's name."""

DOMAINS = {"movie": "full domain, no spike", "hotel": "hotels, no spike"}
"""Domain of the runs without a spike -> title."""

SCRIPT, CEILING = "script `repair`", "privileged ceiling"


def _rates(folder: str) -> dict[str, Seeds]:
    """Returns column -> seeds of the runs in a result folder."""
    own = group(folder)
    columns = {f"{budget:,}": own.booked(budget) for budget in BUDGETS} | {"end": own.final}
    return {name: dict(zip(own.members, of, strict=True)) for name, of in columns.items()}


def _table1(env: str) -> dict[str, dict[str, Seeds]]:
    """Returns agent -> column -> seeds in an environment of Table 1."""
    names = [*PAPER["full"], "Soft BBQN-MAP", "GP"]
    folders = {"Soft BBQN-MAP": "bbqn_map_soft"}
    found = {
        name: _rates(f"table1/{env}/{folders.get(name, name.lower().replace('-', '_'))}")
        for name in names
    }
    infix = "" if env == "full" else f"{env}_"
    return found | {name: _rates(f"searched/table1_{infix}{end}") for name, end in SEARCHED.items()}


def _without_spike(domain: str) -> dict[str, Seeds]:
    """Returns agent -> seeds at the end of the runs without a spike in a domain."""
    rows = unspiked()
    return {
        name: {row["replica"]: float(row["final"]) for row in rows[domain, own]}
        for name, own in UNSPIKED.items()
        if (domain, own) in rows
    }


def _not_as_long() -> dict[str, str]:
    """Returns agent -> success of the shorter runs without a spike in the full domain."""
    return {own.agent: f"{short(estimate(own.final).value)}*" for own in groups("no_spike")}


def _columns() -> dict[tuple[str, str], dict[str, Seeds]]:
    """Returns (what was trained on, column) -> agent -> seeds."""
    columns: dict[tuple[str, str], dict[str, Seeds]] = {}
    for env, title in ENVS.items():
        agents = _table1(env)
        for column in next(iter(agents.values())):
            columns[title, column] = {name: of[column] for name, of in agents.items()}
    for domain, title in DOMAINS.items():
        columns[title, "end"] = _without_spike(domain)
    return columns


def _references() -> dict[str, dict[str, float]]:
    """Returns reference -> what was trained on -> its success, which no budget changes."""
    hotel = read_json("bench/bench.json")["scripts"]["hotel, errors reference"]
    found = {}
    for name, policy in ((SCRIPT, "repair"), (CEILING, PRIVILEGED_POLICY)):
        rate = measured()["movie", "reference", policy]["success_rate"]
        found[name] = {"full domain": rate, "full domain, no spike": rate}
        found[name]["hotels, no spike"] = hotel[policy]
    return found


def _marked(agents: Mapping[str, Seeds]) -> dict[str, str]:
    """Returns agent -> mean; bold unless its difference from the best one is shown by pairs."""
    means = {name: estimate([*of.values()]).value for name, of in agents.items()}
    best = agents[max(means, key=means.__getitem__)]
    cells = {}
    for name, of in agents.items():
        gaps = [best[seed] - of[seed] for seed in best]
        text = short(means[name])
        cells[name] = text if difference(gaps).low > 0 else f"**{text}**"
    return cells


def _shown(columns: Mapping[tuple[str, str], Mapping[str, Seeds]], heads: Sequence[str]) -> str:
    """Returns the table of some columns with these heads."""
    cells = {key: _marked(agents) for key, agents in columns.items()}
    cells["full domain, no spike", "end"] |= _not_as_long()
    names = dict.fromkeys(name for of in cells.values() for name in of)
    rows = [(name, *(of.get(name, "–") for of in cells.values())) for name in names]
    for name, rates in _references().items():
        rows.append((name, *(short(rates[on]) if on in rates else "–" for on, _ in columns)))
    return table(("agent", *heads), rows, numbers=len(columns))


_BOLD = (
    "Bold: the best learner of a column, and all whose difference from it is not shown by pairs of "
    "ten seeds (95 % interval). "
)


@block("results.best")
def _best() -> str:
    """Returns all agents by budget and environment, and without the spike."""
    columns = _columns()
    titles = {
        "full domain": "full",
        "domain extension": "extension",
        "full domain, no spike": "no spike, full",
        "hotels, no spike": "no spike, hotels",
    }
    heads = [f"{titles[on]}: {column}" for on, column in columns]
    ends = [group(f"table1/{env}/dqn").dialogues for env in ENVS]
    ends += [int(unspiked()[domain, "dqn_boltzmann"][0]["dialogues"]) for domain in DOMAINS]
    note = (
        "End: final success after {:,} dialogues of the full domain, {:,} of domain extension; "
        "without the spike {:,}, in the hotels {:,} (*: {:,}, five seeds).".format(
            *ends, group("no_spike/dqn").dialogues
        )
    )
    return f"{_shown(columns, heads)}\n\n{_BOLD}{note}"


@block("results.best_small")
def _best_small() -> str:
    """Returns all agents in the full domain: early, at the end, and without the spike."""
    heads = {
        ("full domain", "1,000"): "booked of the first 1,000",
        ("full domain", "end"): "end",
        ("full domain, no spike", "end"): "end, without the spike",
    }
    columns = _columns()
    chosen = {
        key: {name: of for name, of in columns[key].items() if name not in SEARCHED}
        for key in heads
    }
    note = f"*: of {group('no_spike/dqn').dialogues:,} dialogues, five seeds."
    return f"{_shown(chosen, [*heads.values()])}\n\n{_BOLD}{note}"
