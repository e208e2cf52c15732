"""Actions, features, corpus and dialogues to read, from the objects that the code uses."""

from __future__ import annotations

from statistics import fmean

from bbq_torchrl.domains import DONT_CARE, NONE, movie_domain, tensorize
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.evaluation.transcripts import transcripts
from bbq_torchrl.simulator import FeatureLayout
from scripts.docs_blocks.common import block, code, table

_SHOWN_SLOTS, _PLAYED, _POLICY = 15, 64, "careful_essential"


@block("actions")
def _actions() -> str:
    domain = movie_domain()
    rows = []
    for kind, title in (("act", "without a slot"), ("request", "request"), ("inform", "inform")):
        chosen = [(n, a) for n, a in enumerate(domain.actions) if a.kind == kind]
        names = ", ".join(action.slot or action.act for _, action in chosen)
        rows.append((title, f"{chosen[0][0]}–{chosen[-1][0]}", len(chosen), names))
    return table(("kind", "index", "count", "in this order"), rows)


@block("features")
def _features() -> str:
    layout = FeatureLayout(tensorize(movie_domain()))
    rows = []
    for group in layout.groups:
        first, last = layout[group.name].start, layout[group.name].stop - 1
        index = f"{first}–{last}" if last > first else str(last)
        rows.append((code(group.name), index, len(group.members), group.meaning))
    rows.append(("all", f"0–{layout.size - 1}", layout.size, ""))
    return table(("group", "index", "count", "the features are"), rows)


@block("corpus")
def _corpus() -> str:
    """Returns the sizes of the corpus in the package, and how often its slots are filled."""
    domain = movie_domain()
    records, goals, tensors = domain.records, domain.goals, tensorize(domain)
    wanted = (tensors.goal_constraints * tensors.constrains)[:, None]
    is_met = (wanted == NONE) | (wanted == DONT_CARE) | (wanted == tensors.records[None])
    rows = [
        ("records", len(records)),
        ("slots of a record, mean", f"{fmean(map(len, records)):.1f}"),
        ("goals", len(goals)),
        ("constraints of a goal, mean", f"{fmean(len(g.constraints) for g in goals):.1f}"),
        ("its requests besides ticket, mean", f"{fmean(len(g.requests) for g in goals):.1f}"),
        (
            "goals whose constraints a record meets",
            f"{is_met.all(-1).any(-1).float().mean().item():.1%}",
        ),
    ]
    shares = {slot: fmean(slot in record for record in records) for slot in domain.slots}
    shown = sorted(shares, key=lambda slot: -shares[slot])[:_SHOWN_SLOTS]
    filled = ", ".join(f"{slot} {shares[slot]:.2f}" for slot in shown if shares[slot] > 0)
    sizes = table(("our corpus", ""), rows, numbers=1)
    return f"{sizes}\n\nShare of its records that have a slot: {filled}; the rest less."


@block("dialogues")
def _dialogues() -> str:
    """Returns the first dialogue that succeeds and the first that a misheard value spoils."""
    env = DialogueEnv(movie_domain(), batch_size=(1, _PLAYED), seed=0)
    texts = transcripts(env, scripted_policy(_POLICY, env), _PLAYED)
    good = next(text for text in texts if text.endswith("success\n"))
    spoiled = next(text for text in texts if text.endswith("failure\n") and "[heard" in text)
    parts = (("A dialogue that succeeds:", good), ("One that a misheard value spoils:", spoiled))
    return "\n\n".join(f"{title}\n\n```text\n{text}```" for title, text in parts)
