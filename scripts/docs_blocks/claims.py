"""What the paper claims, and what the committed results say of it."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.pairs import NOT_RUN, pair, verdict
from bbq_torchrl.evaluation.table1 import PAPER, comparisons
from scripts.docs_blocks.common import block, table
from scripts.docs_blocks.results import DOMAINS, EXPERIMENTS, groups

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bbq_torchrl.evaluation.statistics import Estimate

    Claim = tuple[str, str, Estimate | None, float | None, str]
    """The claim, what was trained on, BBQN-MAP's difference, the paper's, and the verdict."""

FIRST = "BBQN-MAP"
RIVALS = ("DQN", "DQN-Boltzmann", "DQN-Bootstrap", "BBQN-MC", "BBQN-VIME-MAP")
"""Whom BBQN-MAP is claimed to be ahead of: in the paper's Table 1, or in what it says of it."""

EARLIER = ("tcbot", "learning_movie", "learning_miulab", "extension_movie")
"""Experiments of BBQN-MAP and DQN beside Table 1."""

VERBS = {"final_success": "ends higher than", "training_success": "learns faster than"}
NEVER = (
    "BBQN-MAP with ε on top of Thompson sampling ends no higher than without",
    "1,000 spiked dialogues start faster than 100 and end lower",
)
"""What the paper says that nothing in results/ is about yet."""


@block("results.claims")
def _claims() -> str:
    """Returns the claims as Markdown: what contradicts the paper first, what was not run below."""
    judged, missing = [], defaultdict(list)
    for claim, setting, difference, paper, answer in _all():
        if answer == NOT_RUN:
            missing[setting].append(claim)
            continue
        ours = ("–", "–") if difference is None else (difference.count, f"{difference:+.3f}")
        theirs = "–" if paper is None else f"{paper:+.3f}"
        judged.append((claim, setting, answer, *ours, theirs))
    judged.sort(key=lambda row: ("no", "not decided", "yes").index(row[2]))
    head = ("claim", "trained on", "verdict", "pairs", "difference", "the paper's")
    parts = [table(head, judged, numbers=3)] if judged else []
    parts += [f"Not run ({where}): {'; '.join(claims)}." for where, claims in missing.items()]
    return "\n\n".join(parts)


def _all() -> Iterator[Claim]:
    for env, title in DOMAINS.items():
        rates = {name: cell.success_rate for name, cell in PAPER[env].items()}
        for quantity, verb in VERBS.items():
            for item in comparisons(groups("table1"), env, quantity):
                if item.other in RIVALS:
                    ends = quantity == "final_success"
                    paper = rates[FIRST] - rates[item.other] if ends else None
                    answer = verdict(item.difference, item.p_value)
                    claim = f"{FIRST} {verb} {item.other}"
                    yield claim, f"Table 1, {title.lower()}", item.difference, paper, answer
    for name in EARLIER:
        # of several DQN the first
        kept = {group.runs[0].agent: group for group in reversed(groups(name))}
        if {FIRST, "DQN"} <= kept.keys():
            found = pair(kept[FIRST], kept["DQN"])
            for quantity, verb in VERBS.items():
                difference = found.differences[quantity].t
                answer = verdict(difference, found.p_values[quantity])
                yield f"{FIRST} {verb} DQN", EXPERIMENTS[name][0], difference, None, answer
    yield _without_spiking()
    for claim in NEVER:
        yield claim, "full domain", None, None, NOT_RUN


def _without_spiking() -> Claim:
    claim, kept = "nobody learns without spiking", groups("no_spike_movie")
    if not kept:
        return claim, "full domain", None, None, NOT_RUN
    tables = [run.metrics for group in kept for run in group.runs]
    successes = sum(float(metrics["success_rate"].sum()) for metrics in tables)
    dialogues = sum(int(metrics["dialogues"].sum()) for metrics in tables)
    setting = f"{EXPERIMENTS['no_spike_movie'][0]}, {dialogues:,} dialogues of {len(kept)} agents"
    return claim, setting, None, None, "no" if successes else "yes"
