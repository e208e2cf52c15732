"""Tables and figures of trained agents, from the experiments' tables in results/."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import yaml
from PIL import Image

from bbq_torchrl.domains.domain import PRIVILEGED_POLICY
from bbq_torchrl.evaluation.compare_runs import PAPER
from bbq_torchrl.evaluation.figures import draw_comparison
from bbq_torchrl.evaluation.groups import EARLY, adjusted, difference, labeled, pair
from bbq_torchrl.evaluation.run_result import reference_lines
from bbq_torchrl.utils.reports import draw_intervals, save
from bbq_torchrl.utils.statistics import ALPHA, estimate
from bbq_torchrl.utils.text import EMPTY
from scripts.docs_blocks import common
from scripts.docs_blocks.common import block, code, commands, groups, minus, table
from scripts.docs_blocks.tables import measured

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.figure import Figure

    from bbq_torchrl.evaluation.groups import Group

OURS = "BBQN-MAP"
"""The agent that Table 1 compares all others with."""

SOFT = "Soft BBQN-MAP"
"""The default of ``agent=bbqn``, which is not the paper's."""

DOMAINS = {"full": "Full domain", "domain_ext": "Domain extension"}
"""Title of each environment of Table 1."""

FAMILIES = {
    "BBQN": (OURS, "BBQN-MC", "BBQN-VIME-MAP", "BBQN-VIME-MC"),
    "DQN": (OURS, "DQN", "DQN-Boltzmann", "DQN-Bootstrap"),
    "DQN with VIME": (OURS, "DQN-VIME-MAP", "DQN-VIME-MC"),
}
"""Panel of Table 1's figure -> its agents."""

EXPERIMENTS = {
    "tcbot": ("The public setting, 2,000 dialogues", "miulab", "v1, no error"),
    "quick": ("The quick form, our corpus", "movie", "reference"),
    "miulab": ("Full domain, MiuLab's corpus", "miulab", "reference"),
    "long": ("Full domain, 400 rounds, our corpus", "movie", "reference"),
    "no_spike": ("Without spiking, our corpus", "movie", "reference"),
}
"""Experiment -> title; corpus and setting of its scripted policies in policies.json."""

COMPARED = yaml.safe_load(Path(__file__).with_name("compared.yaml").read_text(encoding="utf-8"))
"""Compared runs, the claims about them, explorers and ablations."""

EXPLORERS: dict[str, list[str]] = COMPARED["explorers"]
"""Learner -> its runs, the first of which is the reference."""

ABLATIONS: list[dict[str, str]] = COMPARED["ablations"]
"""Runs that change one key -> what they change; p-values of one key are adjusted together."""

QUANTITIES = {"final": "end", "early": f"first {EARLY:,}", "cumulative": "all of training"}
"""Quantity of a pairing -> its column."""


README_AGENTS = ("BBQN-MAP", "DQN-Bootstrap", "DQN-Boltzmann", "DQN")
"""The agents of the README's figure."""


def cells(name: str, env: str) -> dict[str, Group]:
    """Returns the runs of Table 1's agents in an environment, in the paper's order."""
    of_env = labeled(one for one in groups(name) if one.first.env == env)
    found = {one.agent: one for one in of_env}
    return {agent: found[agent] for agent in (*PAPER[env], SOFT) if agent in found}


SETTINGS = {
    "searched/table1": ("searched", SOFT),
    "printed": ("as printed", OURS),
    "table1": ("one for all", OURS),
    "paper_batches": ("batches of 32", OURS),
}
"""Runs of Table 1 -> their setting, and the agent that all others are compared with."""


@block("results.table1", "searched/table1", "printed", "table1")
@block("results.paper_batches", "paper_batches")
def _table1(*names: str) -> str:
    """Returns Table 1's final success in some settings, and BBQN minus it, with commands."""
    head = ["the paper's"]
    for name in names:
        setting, minuend = SETTINGS[name]
        head += [setting, f"{minuend} minus it"]
    parts = []
    for env, title in DOMAINS.items():
        of_settings = [cells(name, env) for name in names]
        papers = {agent: f"{success:.4f}" for agent, (success, *_) in PAPER[env].items()}
        rows = []
        for agent in (*papers, SOFT):
            row = [agent, papers.get(agent, EMPTY)]
            for name, of_agent in zip(names, of_settings, strict=True):
                own, ours = of_agent.get(agent), of_agent.get(SETTINGS[name][1])
                row.append(str(estimate(own.final)) if own else EMPTY)
                is_paired = own and ours and own is not ours
                row.append(str(minus(ours, own, "final")) if is_paired else EMPTY)
            if any(agent in of_agent for of_agent in of_settings):
                rows.append(row)
        parts.append(table((title, *head), rows, numbers=len(head)))
        if "table1" in names:
            parts.append(f"![{title}: learning curves](figures/table1_{env}.png)")
    parts += [commands(name.partition("/")[0]) for name in names if groups(name)]
    return "\n\n".join(parts)


def _early(own: Group) -> tuple[object, object]:
    """Returns the cells of success early and in all of training."""
    booked = own.booked(EARLY)
    return estimate(booked) if booked else EMPTY, estimate(own.cumulative)


def _experiment(name: str) -> str:
    """Returns the table and one command of an experiment."""
    first, *others = groups(name)
    rows = [(first.label, estimate(first.final), *_early(first), EMPTY)]
    rows += [
        (own.label, estimate(own.final), *_early(own), minus(first, own, "final")) for own in others
    ]
    head = ("agent", "final success", f"booked after {EARLY:,}", "cumulative")
    shown = table((*head, f"{first.label} minus it"), rows, numbers=4)
    figure = "" if name == "no_spike" else f"![Training success by round](figures/{name}.png)"
    return "\n\n".join(filter(None, [shown, figure, commands(name)]))


for _name in EXPERIMENTS:
    block(f"results.{_name}", _name)(_experiment)


@block("results.explorers")
def _explorers() -> str:
    """Returns each learner by each explorer, and minus its first one."""
    rows = []
    for learner in EXPLORERS:
        first, *others = _of_learner(learner)
        rows.append((learner, code(first.first.explore), *_both(first), EMPTY, EMPTY))
        for own, gaps in zip(others, _starred(first, others), strict=True):
            rows.append(("", code(own.first.explore), *_both(own), *gaps))
    head = ("learner", "explorer", "final", "cumulative", "final minus first", "cumulative minus")
    return f"{table(head, rows, numbers=4)}\n\n{_STARS}\n\n{commands('explorers')}"


def _of_learner(learner: str) -> list[Group]:
    return groups(*(f"explorers/{name}" for name in EXPLORERS[learner]))


@block("results.ablations")
def _ablations() -> str:
    """Returns the ablations, each minus the reference."""
    reference = common.group("ablations/0_reference")
    rows: list[tuple[object, ...]] = [("reference", *_both(reference), EMPTY, EMPTY)]
    for changes in ABLATIONS:
        changed = [common.group(f"ablations/{name}") for name in changes]
        gaps = _starred(reference, changed)
        for what, own, gap in zip(changes.values(), changed, gaps, strict=True):
            rows.append((what, *_both(own), *gap))
    head = ("changed", "final", "cumulative", "final minus reference", "cumulative minus")
    return f"{table(head, rows, numbers=4)}\n\n{_STARS}\n\n{commands('ablations')}"


_STARS = f"*: p < {ALPHA:g}".replace("0.", ".") + " by Holm's method for the rows of one block."


def _both(own: Group) -> tuple[str, str]:
    return f"{estimate(own.final).value:.3f}", f"{estimate(own.cumulative).value:.3f}"


def _starred(first: Group, others: Sequence[Group]) -> list[tuple[str, ...]]:
    """Returns the differences of final and cumulative success, with a star if significant."""
    columns = []
    for quantity in ("final", "cumulative"):
        gaps = [pair(own, first).differences[quantity] for own in others]
        marks = ["*" if p_value < ALPHA else "" for p_value in adjusted(gaps)]
        columns.append([f"{difference(gap)}{mark}" for gap, mark in zip(gaps, marks, strict=True)])
    return [*zip(*columns, strict=True)]


def _rates(corpus: str, setting: str) -> dict[str, float]:
    """Returns the success of policies that do not learn."""
    return {
        policy: found["success_rate"]
        for (*played_in, policy), found in measured().items()
        if played_in == [corpus, setting]
    }


def compared(rows: Mapping[str, list[str]], head: Sequence[str]) -> str:
    """Returns the differences of two agents by pairs.

    Args:
        rows: title -> the names of their runs; a row without runs is left out.
        head: column titles of the rows and the two agents.
    """
    lines = []
    for title, names in rows.items():
        both = [own for name in names for own in groups(name)]
        if len(both) == 2:
            found = pair(*both).differences
            gaps = (difference(found[q]) if q in found else EMPTY for q in QUANTITIES)
            lines.append((title, *gaps))
    on, one, other = head
    columns = (f"{on}: {one} minus {other}", *QUANTITIES.values())
    return table(columns, lines, numbers=len(QUANTITIES))


for _name, _table in COMPARED["tables"].items():
    block(_name, _table["rows"], _table["head"])(compared)


class Claim(NamedTuple):
    """A claim that one agent is ahead of another, and what came of it."""

    trained_on: str
    one: str
    other: str
    quantity: str
    difference: object
    p: object
    verdict: str
    paper: object


VERDICTS = ("yes", "not significant", "no")

OTHERS = ("DQN", "DQN-Boltzmann", "DQN-Bootstrap", "BBQN-MC", "BBQN-VIME-MAP")
"""Agents that BBQN-MAP is claimed to beat, by the paper's Table 1 or its text."""


def claims() -> Iterator[Claim]:
    """Yields the claims. The p-values of one setting and quantity are adjusted together."""
    for quantity in QUANTITIES:
        for env, title in DOMAINS.items():
            of_env, paper = cells("table1", env), PAPER[env]
            declared = [(OURS, name) for name in paper if name != OURS]
            for claim in _judged(of_env, declared, quantity, f"Table 1, {title.lower()}"):
                lead = f"{paper[OURS][0] - paper[claim.other][0]:+.3f}"
                if claim.other in OTHERS:
                    yield claim._replace(paper=lead if quantity == "final" else EMPTY)
        for setting, claimed in COMPARED["claims"].items():
            names = {one: name for claim in claimed for one, name in (claim[:2], claim[2:])}
            found = {one: own for one, name in names.items() for own in groups(name)}
            declared = [(one, other) for one, _, other, _ in claimed]
            yield from _judged(found, declared, quantity, setting)


def _judged(
    found: Mapping[str, Group], declared: Sequence[tuple[str, str]], quantity: str, setting: str
) -> Iterator[Claim]:
    """Yields the verdict on each declared comparison of runs that both have the quantity."""
    gaps = [
        pair(found[one], found[other]).differences.get(quantity, ())
        if {one, other} <= found.keys()
        else ()
        for one, other in declared
    ]
    for (one, other), gap, p_value in zip(declared, gaps, adjusted(gaps), strict=True):
        if len(gap) > 1:
            mean = difference(gap)
            direction = "yes" if mean.value > 0 else "no"
            verdict = direction if p_value < ALPHA else "not significant"
            yield Claim(setting, one, other, QUANTITIES[quantity], mean, p_value, verdict, EMPTY)


@block("results.claims")
def _claims() -> str:
    """Returns the number of claims by verdict, and those whose reverse is shown."""
    found = [*claims()]
    counts = Counter((claim.trained_on, claim.verdict) for claim in found)
    settings = dict.fromkeys(claim.trained_on for claim in found)
    rows = [(on, *(counts[on, verdict] for verdict in VERDICTS)) for on in settings]
    reversed_ = [
        (f"{one} minus {other}, {quantity}", on, gap)
        for on, one, other, quantity, gap, _, verdict, _ in found
        if verdict == "no"
    ]
    return "\n\n".join(
        [
            table(("claimed to be ahead", *VERDICTS), rows, numbers=3),
            table(("the reverse is shown", "trained on", "difference"), reversed_, numbers=1),
            "Every comparison with its p-value: `results/comparisons.csv`.",
        ]
    )


def write_claims() -> None:
    """Writes comparisons.csv."""
    with (common.RESULTS / "comparisons.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Claim._fields)
        writer.writerows(claims())


def draw_figures() -> None:
    """Draws the learning curves of Table 1 and of the experiments."""
    for env, title in DOMAINS.items():
        of_env = cells("table1", env)
        panels = {
            family: [of_env[agent] for agent in agents] for family, agents in FAMILIES.items()
        }
        # Scripted policies were measured in the full domain only.
        played_in = ("movie", "reference") if env == "full" else None
        _save(_curves(panels, f"Table 1, {title.lower()}", played_in), f"table1_{env}")
        if env == "full":
            few = [of_env[agent] for agent in README_AGENTS]
            _save(_curves({"": few}, "Training success in the full domain", played_in), "readme")
    for name, (title, *played_in) in EXPERIMENTS.items():
        if name != "no_spike":  # without any success
            _save(_curves({"": groups(name)}, title, tuple(played_in)), name)
    by_explorer = {
        learner: {own.first.explore: estimate(own.final) for own in _of_learner(learner)}
        for learner in EXPLORERS
    }
    _save(draw_intervals(by_explorer, title="Final success by explorer"), "grid")
    changed = {"0_reference": "reference"} | {
        run: what for of in ABLATIONS for run, what in of.items()
    }
    ablated = {
        what: estimate(common.group(f"ablations/{run}").final) for run, what in changed.items()
    }
    _save(draw_intervals({"": ablated}, title="Final success of the ablations"), "ablations")


def _curves(
    panels: Mapping[str, Sequence[Group]], title: str, played_in: tuple[str, ...] | None
) -> Figure:
    """Returns learning curves beside the policies that do not learn."""
    rates = _rates(*played_in) if played_in else {}
    privileged = {name: rates.pop(name) for name in (PRIVILEGED_POLICY,) if name in rates}
    references = reference_lines(rates, privileged)
    return draw_comparison(panels, title=title, references=references)


def _save(figure: Figure, name: str) -> None:
    """Writes a figure of the documentation in 256 colors, a third of the size."""
    file = common.FIGURES / f"{name}.png"
    save(figure, file)
    Image.open(file).convert("RGB").quantize(dither=Image.Dither.NONE).save(file, optimize=True)
