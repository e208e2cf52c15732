"""What the paper claims, and what the committed results say of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.evaluation.pairs import pair
from bbq_torchrl.evaluation.table1 import NOT_RUN, PAPER, comparisons, verdict
from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.statistics import Estimate

__all__ = ["DOMAINS", "claims_table"]

DOMAINS = {"full": "Full domain", "domain_ext": "Domain extension"}
"""Environment -> what it is called."""

FIRST = "BBQN-MAP"
RIVALS = ("DQN", "DQN-Boltzmann", "DQN-Bootstrap", "BBQN-MC", "BBQN-VIME-MAP")
"""Whom BBQN-MAP is claimed to be ahead of: in the paper's Table 1, or in what it says of it."""

ENDS, LEARNS = "final_success", "training_success"
VERBS = {ENDS: "ends higher than", LEARNS: "learns faster than"}

EARLIER = {
    "tcbot": "public setting, 40 rounds",
    "learning_movie": "full domain, first defaults",
    "learning_miulab": "full domain, MiuLab's corpus, first defaults",
    "extension_movie": "domain extension, first defaults",
}
"""Folder in results/ -> what it is called: BBQN-MAP and DQN beside Table 1."""

NEVER = (
    "BBQN-MAP with ε on top of Thompson sampling ends no higher than without",
    "1,000 spiked dialogues start faster than 100 and end lower",
)
"""What the paper says that nothing in results/ is about yet."""

ORDER = ("no", "not decided", "yes")


class Row(NamedTuple):
    """A claim in one setting.

    Attributes:
        claim: the sentence.
        setting: what was trained on.
        pairs: of replicas; 0 where it was not run.
        difference: of BBQN-MAP, with its t interval; None where it was not run.
        paper: the same difference in the paper's table; None where it has none.
        verdict: ``yes``, ``no``, ``not decided`` or ``not run``.
    """

    claim: str
    setting: str
    pairs: int
    difference: Estimate | None
    paper: float | None
    verdict: str


def claims_table(kept: Sequence[Group], read: Callable[[str], list[Group]]) -> str:
    """Returns the claims as Markdown: what contradicts the paper first, what was not run below.

    Args:
        kept: of Table 1.
        read: returns the groups of another experiment by its folder.
    """
    rows = [*_of_table1(kept), *_of_earlier(read), _without_spiking(read("no_spike_movie"))]
    rows += [Row(claim, "full domain", 0, None, None, NOT_RUN) for claim in NEVER]
    missing: dict[str, list[str]] = {}
    for row in rows:
        if row.verdict == NOT_RUN:
            missing.setdefault(row.setting, []).append(row.claim)
    judged = sorted(
        (row for row in rows if row.verdict != NOT_RUN), key=lambda row: ORDER.index(row.verdict)
    )
    head = ("claim", "trained on", "verdict", "pairs", "difference", "the paper's")
    cells = [
        (
            row.claim,
            row.setting,
            row.verdict,
            row.pairs or "–",
            "–" if row.difference is None else f"{row.difference:+.3f}",
            "–" if row.paper is None else f"{row.paper:+.3f}",
        )
        for row in judged
    ]
    parts = [table(head, cells, numbers=3)] if cells else []
    parts += [f"Not run ({where}): {'; '.join(claims)}." for where, claims in missing.items()]
    return "\n\n".join(parts)


def _of_table1(kept: Sequence[Group]) -> list[Row]:
    return [
        Row(
            f"{FIRST} {verb} {item.other}",
            f"Table 1, {title.lower()}",
            0 if item.difference is None else item.difference.count,
            item.difference,
            PAPER[env][FIRST].success_rate - PAPER[env][item.other].success_rate
            if quantity == ENDS
            else None,
            verdict(item.difference, item.p_value),
        )
        for env, title in DOMAINS.items()
        for quantity, verb in VERBS.items()
        for item in comparisons(kept, env, quantity)
        if item.other in RIVALS
    ]


def _of_earlier(read: Callable[[str], list[Group]]) -> list[Row]:
    """The same of the experiments that have BBQN-MAP and DQN; of several DQN the first."""
    rows = []
    for experiment, setting in EARLIER.items():
        kept = {group.runs[0].agent: group for group in reversed(read(experiment))}
        if not {FIRST, "DQN"} <= kept.keys():
            continue
        found = pair(kept[FIRST], kept["DQN"])
        for quantity, verb in VERBS.items():
            difference = found.differences[quantity].t
            judged = verdict(difference, found.p_values[quantity])
            claim = f"{FIRST} {verb} DQN"
            rows.append(Row(claim, setting, found.pairs, difference, None, judged))
    return rows


def _without_spiking(kept: Sequence[Group]) -> Row:
    claim = "nobody learns without spiking"
    if not kept:
        return Row(claim, "full domain", 0, None, None, NOT_RUN)
    successes = sum(float(run.metrics["success_rate"].sum()) for g in kept for run in g.runs)
    dialogues = sum(int(run.metrics["dialogues"].sum()) for g in kept for run in g.runs)
    answer = "yes" if successes == 0 else "no"
    setting = f"full domain, first defaults, {dialogues:,} dialogues of {len(kept)} agents"
    return Row(claim, setting, 0, None, None, answer)
