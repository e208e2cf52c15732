"""Tables and figures of trained agents, from the result folders in results/.

``results/<experiment>/<run>/`` is what ``scripts/keep_result.py`` keeps of a run folder.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

import yaml
from PIL import Image

from bbq_torchrl.domains.domain import PRIVILEGED_POLICY, RANDOM_POLICY
from bbq_torchrl.evaluation import comparison, pairs, table1
from bbq_torchrl.evaluation.curves import rounds_to_reach
from bbq_torchrl.evaluation.designs import ablations_report, grid_report
from bbq_torchrl.evaluation.figures import draw_comparison
from bbq_torchrl.evaluation.groups import Group, read_groups
from bbq_torchrl.evaluation.run_result import reference_lines
from bbq_torchrl.utils.reports import NONE, Report, save
from bbq_torchrl.utils.statistics import estimate
from scripts.docs_blocks import common
from scripts.docs_blocks.common import block, code, command, paired, table
from scripts.docs_blocks.tables import measured

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

DOMAINS = {"full": "Full domain", "domain_ext": "Domain extension"}
"""Title of each environment."""

EXPERIMENTS = {
    "tcbot": ("The public setting, 2,000 dialogues", "miulab", "v1, no error"),
    "quick": ("The quick form, our corpus", "movie", "reference"),
    "miulab": ("Full domain, MiuLab's corpus", "miulab", "reference"),
    "long": ("Full domain, 400 rounds, our corpus", "movie", "reference"),
    "no_spike": ("Without spiking, our corpus", "movie", "reference"),
}
"""Folder in results/ -> title; corpus and setting of its scripted policies in policies.json."""

COMPARED = yaml.safe_load(Path(__file__).with_name("compared.yaml").read_text(encoding="utf-8"))
"""Compared runs and the claims about them."""

_SPIKED = (500, 1_000, 2_000)

VERBS = {
    "early": f"books more in the first {pairs.EARLY:,} dialogues than",
    "final": "ends higher than",
    "cumulative": "books more in training than",
}
COLUMNS = {
    "final": "difference",
    "early": f"of the first {pairs.EARLY:,} dialogues",
    "cumulative": "of all training",
}
"""Column of each paired quantity, after the final success of two agents."""

OTHERS = ("DQN", "DQN-Boltzmann", "DQN-Bootstrap", "BBQN-MC", "BBQN-VIME-MAP")
"""Agents that BBQN-MAP is claimed to beat, by the paper's Table 1 or its text."""


def groups(*folders: str) -> list[Group]:
    """Returns the runs below folders of results/: ``results/<folder>/**/result.json``."""
    files = [file for name in folders for file in (common.RESULTS / name).rglob("result.json")]
    return read_groups(sorted(file.parent for file in files))


def _commands(kept: list[Group], fence: str = "bash") -> str:
    made = (command(folder) for group in kept for folder in group.folders)
    return "\n".join([f"```{fence}", *made, "```"])


@block("results.baselines", "baselines", "bash")
@block("results.extending", "extending", "text")  # not without that package
def _commands_of(folder: str, fence: str) -> str:
    return _commands(groups(folder), fence)


def _save(figure: Figure, name: str) -> None:
    """Writes a figure of the documentation in 256 colors, a third of the size."""
    file = common.FIGURES / f"{name}.png"
    save(figure, file)
    Image.open(file).convert("RGB").quantize(dither=Image.Dither.NONE).save(file, optimize=True)


def draw_figures() -> None:
    """Draws the learning curves of every experiment, and writes table1.csv."""
    for folder in ("table1", "paper_batches", "printed"):
        kept = groups(folder)
        for env in DOMAINS:
            # Scripted policies were measured in the full domain only.
            references = _references("movie", "reference") if env == "full" else None
            if cells := table1.find_cells(kept, env):
                _save(table1.draw_table1(cells, env, references), f"{folder}_{env}")
        if folder == "table1":
            (replicas,) = table1.table1_report(kept).data
            replace(replicas, name="table1").write(common.RESULTS)
    for folder, report in (("ablations", ablations_report), ("explorers", grid_report)):
        if kept := groups(folder):
            for name, (_, draw) in report(kept).figures.items():
                _save(draw(), name)
    for name, (title, *played_in) in EXPERIMENTS.items():
        _save(draw_comparison(groups(name), title=title, references=_references(*played_in)), name)


def _references(corpus: str, setting: str) -> dict[str, float]:
    """Returns the success of policies that do not learn, as reference lines of a figure."""
    rates = {
        policy: found["success_rate"]
        for (*played_in, policy), found in measured().items()
        if played_in == [corpus, setting]
    }
    privileged = {name: rates.pop(name) for name in (PRIVILEGED_POLICY,) if name in rates}
    return reference_lines(rates, privileged)


@block("results.table1", "table1")
@block("results.paper_batches", "paper_batches")
@block("results.printed", "printed")
def _table1(folder: str) -> str:
    """Returns the report on Table 1, its figures, and the commands of its runs."""
    kept = groups(folder)
    found = table1.table1_report(kept)
    text = found.body
    for env, title in DOMAINS.items():
        text = text.replace(f"## env={env}\n", f"### {title}\n")
        if f"table1_{env}" in found.figures:
            text += f"\n\n![{title}: learning curves](figures/{folder}_{env}.png)"
    return f"{text}\n\n{_commands(kept)}"


@block("results.explorers", grid_report, "explorers")
@block("results.ablations", ablations_report, "ablations")
def _report(made: Callable[[Sequence[Group]], Report], folder: str) -> str:
    """Returns a report on the runs of a folder, without its heading."""
    return made(groups(folder)).body.replace("## ", "### ")


@block("results.modes")
def _modes() -> str:
    """Returns the success of one posterior's policies and their paired difference to its mean's."""
    lines = (common.RESULTS / "modes.jsonl").read_text(encoding="utf-8").splitlines()
    played = {entry["mode"]: entry["success_rate_per_replica"] for entry in map(json.loads, lines)}
    rows = [
        (code(mode), estimate(rates), "–" if mode == "mean" else paired(rates, played["mean"]))
        for mode, rates in played.items()
    ]
    return table(("evaluated by", "success", "minus the mean's"), rows, numbers=2)


def _experiment(name: str) -> str:
    """Returns the report's tables, figure and commands of one experiment."""
    kept = groups(name)
    figure = f"![Training success by round](figures/{name}.png)"
    parts = comparison.comparison_report(kept).parts
    shown = (str(part) for part in parts if part not in comparison.NOTES)
    return "\n\n".join([*filter(None, shown), figure, _commands(kept)])


for _name in EXPERIMENTS:
    block(f"results.{_name}", _name)(_experiment)


@block("learning.quick")
def _quick() -> str:
    """Returns a row for each seed of the README's first command."""
    (group,) = groups("quick")
    reached = rounds_to_reach(group.evaluation, 0.6, window=1).tolist()
    rows = [
        (seed, f"{final:.3f}", f"{training:.3f}", f"{rounds:.0f}")
        for (seed, *_), final, training, rounds in zip(
            group.members, group.final, group.cumulative, reached, strict=True
        )
    ]
    return table(("seed", "final success", "cumulative", "rounds to 0.6"), rows, numbers=4)


@block("learning.expect")
def _expect() -> str:
    """Returns the sentence on the outcome of the README's first command."""
    (group,) = groups("quick")
    finals = group.final
    low, mean, high = (f"{of(finals):.2f}" for of in (min, fmean, max))
    return (
        "Success stays near zero for the first five rounds, then rises: "
        f"{len(finals)} seeds end by booking between {low} and {high} of the dialogues "
        f"(mean {mean}; [each seed, and why learning starts late](docs/learning_starts.md))."
    )


@block("learning.spikes")
def _spikes() -> str:
    """Returns the table of what the buffer is spiked with."""
    head = ("spiked with", "agent", "env", "rounds", "rate", "seeds")
    shown = []
    for group in groups("quick_soft/soft", "spikes"):
        setting = group.setting
        spike = setting["spike.policy"] or {"rule": "rule"}.get(setting["spike.name"], "repair")
        spike = f"{setting['spike.dialogues']:,} of {code(spike)}"
        if setting.get("spike.margin"):
            spike += ", imitated"
        about = (spike, group.label.partition(",")[0], setting["env.name"])
        booked = [str(estimate(group.booked(first))) for first in _SPIKED]
        rate = "constant" if setting["protocol.lr_final"] == 1 else "falls"
        trained = (str(setting["protocol.rounds"]), rate, str(len(group.final)))
        shown.append((*about, *trained, *booked, str(estimate(group.final))))
    shown.sort(key=lambda row: (int(row[3]), row[2] != "full", float(row[-1].partition(" ")[0])))
    return table((*head, *(f"booked after {n:,}" for n in _SPIKED), "final"), shown)


def _booked(name: str, group: Group, budgets: Sequence[int]) -> tuple[object, ...]:
    """Returns a row: the name, the shares booked after the budgets, and the final success."""
    return (name, *(estimate(group.booked(first)) for first in budgets), estimate(group.final))


def _booked_head(of: str, budgets: Sequence[int]) -> tuple[str, ...]:
    return (of, *(f"booked after {first:,}" for first in budgets), "final")


@block("learning.searched")
def _searched() -> str:
    """Returns the searched settings of agents next to the defaults, and differences by pairs."""
    budgets = (500, 1_000, 3_000)
    settings = ("searched", "default")
    agents = ("bbqn", "dqn_boltzmann", "noisy_dqn", "dqn", "dqn_bootstrap", "dqn_vime")
    keys = [f"{agent}_{setting}" for agent in agents for setting in settings]
    keys[2:2] = ["bbqn_posterior", "bbqn_learner"]
    keys += [f"extension_{agent}_searched" for agent in agents[:2]]
    found = {key: groups(f"searched/{key}")[0] for key in keys}
    parts = {
        "posterior": "default, but the posterior searched",
        "learner": "default, but the learner searched",
    }
    names = {}
    for key, group in found.items():
        setting = key.rpartition("_")[2]
        name = f"{group.agent.removeprefix('Soft ')}, {parts.get(setting, setting)}"
        names[key] = name + (", domain extension" if key.startswith("extension") else "")
    rows = [_booked(names[key], group, budgets) for key, group in found.items()]
    compared = [(f"{agent}_searched", f"{agent}_default") for agent in agents]
    compared += [
        (f"bbqn_{setting}", f"{other}_{setting}")
        for other in agents[1:3]
        for setting in settings[::-1]
    ]
    compared.append(("extension_bbqn_searched", "extension_dqn_boltzmann_searched"))
    differences = []
    for one, other in compared:
        values = pairs.pair(found[one], found[other]).differences
        shown = (pairs.difference(values[quantity]) for quantity in ("early", "final"))
        differences.append((f"{names[one]}, minus {names[other]}", *shown))
    beside = _booked_head("difference by pairs", (pairs.EARLY,))
    return f"{table(_booked_head('agent', budgets), rows)}\n\n{table(beside, differences)}"


@block("learning.searched_long")
def _searched_long() -> str:
    """Returns agents with their searched settings in Table 1's setting, next to others."""
    budgets = (1_000, 5_000)
    folders = ["searched/table1_dqn_boltzmann", "searched/table1_bbqn"]
    folders += [f"table1/full/{agent}" for agent in ("dqn_boltzmann", "bbqn_map_soft", "bbqn_map")]
    found = [groups(folder)[0] for folder in folders]
    rows: list[tuple[object, ...]] = []
    for folder, group in zip(folders, found, strict=True):
        name = group.agent + ", searched" * folder.startswith("searched")
        difference = pairs.pair(group, found[0]).differences["final"]
        beside = NONE if group is found[0] else pairs.difference(difference)
        rows.append((*_booked(name, group, budgets), beside))
    return table((*_booked_head("150 rounds", budgets), "minus the first"), rows)


@block("gp.table1")
def _gaussian_process() -> str:
    """Returns the Gaussian process next to agents of Table 1, a table for each environment."""
    budgets = (500, 1_000, 2_000, 5_000)
    tables = []
    for env, of in (("full domain", "full"), ("domain extension", "extension")):
        rows = []
        for name in ("gp", "bbqn_map_soft", "bbqn_map", "dqn_boltzmann", "dqn"):
            (group,) = groups(f"table1/{of}/{name}")
            rows.append((*_booked(group.agent, group, budgets), f"{group.reward:.2f}"))
        tables.append(table((*_booked_head(env, budgets), "reward"), rows))
    return "\n\n".join(tables)


@block("results.scripts")
def _best_script() -> str:
    """Returns the sentence on the success of scripted policies in the full domain."""
    script, best, rule, ceiling = _scripts()
    return (
        f"In the full domain the best script, {code(script)}, books {best} of the dialogues, the "
        f"rule agent that spikes the buffer {rule}, and a privileged policy that reads the user's "
        f"hidden goal {ceiling}."
    )


def _scripts() -> tuple[str, str, str, str]:
    """Returns the best script of our corpus, its success, the rule agent's and the ceiling."""
    rates = {
        policy: found["success_rate"]
        for (*played_in, policy), found in measured().items()
        if played_in == ["movie", "reference"]
    }
    best = max(rates.keys() - {RANDOM_POLICY, PRIVILEGED_POLICY}, key=rates.__getitem__)
    return best, *(f"{rates[name]:.2f}" for name in (best, "rule", PRIVILEGED_POLICY))


def compared(rows: dict[str, list[str]], head: list[str]) -> str:
    """Returns the final success of two agents and their differences by pairs.

    Args:
        rows: title -> the folders of their runs; a row without runs is left out.
        head: column titles of the rows and the two agents.
    """
    lines = []
    for title, folders in rows.items():
        both = [group for folder in folders for group in groups(folder)]
        if len(both) == 2:
            one, other = both
            found = pairs.pair(one, other).differences
            differences = (
                pairs.difference(found[quantity]) if quantity in found else NONE
                for quantity in COLUMNS
            )
            lines.append((title, estimate(one.final), estimate(other.final), *differences))
    return table((*head, *COLUMNS.values()), lines, numbers=2 + len(COLUMNS))


for _name, _table in COMPARED["tables"].items():
    block(_name, _table["rows"], _table["head"])(compared)


@block("results.claims")
def _claims() -> str:
    """Returns the claims as Markdown: contradictions of the paper first, claims not run last."""
    of_table1 = groups("table1")
    rows = []
    for quantity, verb in VERBS.items():
        found: list[tuple[str, pairs.Comparison, str]] = []
        for env, title in DOMAINS.items():
            paper = table1.PAPER[env]
            for item in table1.comparisons(table1.find_cells(of_table1, env), env, quantity):
                rate = paper[item.one].success_rate - paper[item.other].success_rate
                theirs = f"{rate:+.3f}" if quantity == "final" else "–"
                if item.other in OTHERS:
                    found.append((f"Table 1, {title.lower()}", item, theirs))
        for setting, claimed in COMPARED["claims"].items():
            folders = {one: folder for claim in claimed for one, folder in (claim[:2], claim[2:])}
            kept = {name: group for name, folder in folders.items() for group in groups(folder)}
            declared = [(one, other) for one, _, other, _ in claimed]
            for item in pairs.compare(kept, declared, quantity, same_dialogues=False):
                found.append((setting, item, "–"))
        for setting, item, theirs in found:
            *numbers, answer = item.cells()
            claim = f"{item.one} {verb} {item.other}"
            rows.append((claim, setting, answer, *numbers, theirs))
    order = ("no", "not significant", "yes", pairs.NOT_PAIRED, pairs.NOT_RUN)
    rows.sort(key=lambda row: order.index(row[2]))
    head = ("claim", "trained on", "verdict", "difference", "p", "the paper's difference")
    return table(head, rows, numbers=3)
