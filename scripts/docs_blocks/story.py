"""The claims that open the page of results, each with its figure and verdict."""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.compare_runs import PAPER
from bbq_torchrl.evaluation.groups import EARLY
from scripts.docs_blocks.common import block, code, group, groups, minus, short, table
from scripts.docs_blocks.learning import unspiked
from scripts.docs_blocks.results import cells
from scripts.docs_blocks.tables import measured

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.utils.statistics import Estimate

TABLE1 = {"full": "table1/full", "domain_ext": "table1/extension"}
"""Environment -> folder of its runs in results/."""

SOFT = [(f"{folder}/bbqn_map_soft", f"{folder}/dqn_boltzmann") for folder in TABLE1.values()]
SEARCHED_LONG = [
    (f"searched/{folder}/bbqn_map_soft", f"searched/{folder}/dqn_boltzmann")
    for folder in TABLE1.values()
]
"""BBQN and DQN-Boltzmann, both searched in Table 1's setting, in each environment."""

SEARCHED_DQN = [
    (f"searched/{folder}/bbqn_map_soft", f"searched/{folder}/dqn") for folder in TABLE1.values()
]
"""BBQN and DQN, likewise."""

BY_ENV = "{} in the full domain, {} in domain extension"


def _verdict(*differences: Estimate) -> str:
    """Returns whether all differences are above 0, by their intervals."""
    if all(item.low > 0 for item in differences):
        return "yes"
    return "no, the reverse" if all(item.high < 0 for item in differences) else "not shown"


def _range(rates: Sequence[float]) -> str:
    return f"{short(min(rates))} to {short(max(rates))}"


def _cells() -> dict[str, dict[str, Group]]:
    """Returns the runs of Table 1: environment -> agent -> group."""
    return {env: cells(name, env) for env, name in TABLE1.items()}


def _differences(one: str, other: str, quantity: str) -> list[Estimate]:
    """Returns the difference of two agents of Table 1 in each of its environments."""
    return [minus(of_env[one], of_env[other], quantity) for of_env in _cells().values()]


def _of_folders(one: str, other: str, quantity: str) -> Estimate:
    """Returns the difference of the runs of two result folders."""
    return minus(group(one), group(other), quantity)


def _of_each(pairs_of_folders: Sequence[tuple[str, str]], quantity: str) -> list[Estimate]:
    return [_of_folders(*folders, quantity) for folders in pairs_of_folders]


def _finals(names: Iterable[str]) -> list[list[float]]:
    """Returns the mean final success of agents of Table 1 in each of its environments."""
    chosen = [*names]
    return [[fmean(of_env[name].final) for name in chosen] for of_env in _cells().values()]


def _learned_unspiked() -> dict[str, int]:
    """Returns in how many seeds of the movies each agent learns unspiked."""
    return {
        agent: sum(bool(row["to_0.3"]) for row in rows)
        for (domain, agent), rows in unspiked().items()
        if domain == "movie"
    }


@block("results.story")
def _story() -> str:
    """Returns the claims as Markdown, contradictions of the paper or of us first."""
    scripted = measured()["movie", "reference", "repair"]["success_rate"]
    trained = _finals(PAPER["full"])
    bbqn = _finals(name for name in PAPER["full"] if name.startswith("BBQN"))
    early = _differences("BBQN-MAP", "DQN-Boltzmann", "early")
    soft = _of_each(SOFT, "early")
    by_vime = _differences("DQN-VIME-MAP", "DQN", "final")
    final = _differences("BBQN-MAP", "DQN", "final")
    level = _of_folders("table1/full/bbqn_map", "searched/table1/full/dqn_boltzmann", "final")
    leads = [of_env["BBQN-MAP"][0] - of_env["DQN"][0] for of_env in PAPER.values()]
    explorers = [
        group(f"explorers/bbqn/{number}_{name}")
        for number, name in enumerate(("thompson", "greedy", "epsilon_greedy", "boltzmann"))
    ]
    by_epsilon, greedily = (
        group(f"explorers/dqn/{name}") for name in ("0_epsilon_greedy", "1_greedy")
    )
    process = _of_folders("gp", "gp_explorers/boltzmann", "early")
    in_vain = sum(own.dialogues * len(own.final) for own in groups("no_spike"))
    ablated = group("ablations/spike_none")
    found = sum(share > 0 for share in ablated.cumulative)
    learned = _learned_unspiked()
    best = max(learned, key=learned.__getitem__)
    seeds = unspiked()["movie", best]
    rows = [
        (
            "BBQN is ahead from the first dialogue",
            f"booked of the first {EARLY:,} dialogues, BBQN-MAP minus DQN-Boltzmann: "
            f"{BY_ENV.format(*early)}; Soft BBQN-MAP, the default of `agent=bbqn`: "
            f"{BY_ENV.format(*soft)}; both with [searched "
            "settings](learning_starts.md#search-settings): "
            f"{BY_ENV.format(*_of_each(SEARCHED_LONG, 'early'))}",
            _verdict(*soft),
        ),
        (
            "A trained agent beats a script",
            f"`repair`, a script that reads only observations, books {short(scripted)} of the "
            f"full domain; the nine agents end at {BY_ENV.format(*map(_range, trained))}",
            "yes" if max(trained[0]) > scripted else "no",
        ),
        (
            "VIME helps",
            f"DQN-VIME-MAP minus DQN: {BY_ENV.format(*by_vime)}; the four BBQN, with VIME and "
            f"without, end at {BY_ENV.format(*map(_range, bbqn))}",
            _verdict(*by_vime),
        ),
        (
            "BBQN ends higher than DQN",
            f"BBQN-MAP minus DQN: {BY_ENV.format(*final)}; the paper: "
            + " and ".join(f"{lead:+.3f}" for lead in leads)
            + "; BBQN-MAP minus DQN-Boltzmann with [searched settings]"
            f"(learning_starts.md#search-settings): {level} in the full domain, both "
            f"searched: {BY_ENV.format(*_of_each(SEARCHED_LONG, 'final'))}, minus DQN, both "
            f"searched: {BY_ENV.format(*_of_each(SEARCHED_DQN, 'final'))}",
            _verdict(*final, level),
        ),
        (
            "Thompson sampling explores better",
            "the same learner books {} of its training dialogues by Thompson sampling, {} "
            "greedily, {} by ε and {} by Boltzmann. But the Gaussian process: {} of the first "
            "1,000 against Boltzmann, and DQN ends {} higher greedily than by the paper's ε".format(
                *(short(fmean(own.cumulative)) for own in explorers),
                process,
                minus(greedily, by_epsilon, "final"),
            ),
            _verdict(*(minus(explorers[0], one, "cumulative") for one in explorers[1:]), process),
        ),
        (
            "Nobody learns without spiking",
            f"BBQN-MAP and DQN by ε .04: no success in {in_vain:,} dialogues, where uniformly "
            "random actions succeed in one of 2,000; a first success within "
            f"{ablated.dialogues:,} dialogues for {found} of {len(ablated.final)} other seeds of "
            f"BBQN-MAP; but within {int(seeds[0]['dialogues']):,} dialogues "
            f"{learned['dqn_boltzmann']} of {len(seeds)} seeds of DQN-Boltzmann and "
            f"{learned[best]} of {code(best)} reach .3 in training, "
            f"{learned['bbqn_map_soft']} of `agent=bbqn`",
            "no" if learned[best] else "not shown",
        ),
    ]
    return table(("claim", "figure", "verdict"), rows)
