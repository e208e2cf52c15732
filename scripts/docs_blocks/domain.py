"""Actions, features, corpus and dialogues to read, from the objects that the code uses."""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from bbq_torchrl.domains import DONT_CARE, NONE, movie_domain, tensorize
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.simulator import FeatureLayout, Transcript
from scripts.docs_blocks.markdown import code, table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["domain_blocks"]

_SHOWN_SLOTS, _PLAYED, _POLICY = 15, 64, "careful_essential"


def domain_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks about the movie domain."""
    return {"actions": _actions, "features": _features, "corpus": _corpus, "dialogues": _dialogues}


def _actions() -> str:
    domain = movie_domain()
    rows = []
    for kind, title in (("act", "without a slot"), ("request", "request"), ("inform", "inform")):
        chosen = [(n, a) for n, a in enumerate(domain.actions) if a.kind == kind]
        names = ", ".join(action.slot or action.act for _, action in chosen)
        rows.append((title, f"{chosen[0][0]}–{chosen[-1][0]}", len(chosen), names))
    return table(("kind", "index", "count", "in this order"), rows)


def _features() -> str:
    layout = FeatureLayout(tensorize(movie_domain()))
    rows = []
    for group in layout.groups:
        place = layout[group.name]
        last = place.stop - 1
        index = f"{place.start}–{last}" if last > place.start else str(last)
        rows.append((code(group.name), index, len(group.members), group.meaning))
    rows.append(("all", f"0–{layout.size - 1}", layout.size, ""))
    return table(("group", "index", "count", "the features are"), rows)


def _corpus() -> str:
    """Returns the sizes of the corpus in the package, and how often its slots are filled."""
    domain = movie_domain()
    records, goals = domain.records, domain.goals
    tensors = tensorize(domain)
    held = tensors.goal_constraints * tensors.constrains
    wanted, have = held[:, None], tensors.records[None]
    can_be_met = ((wanted == NONE) | (wanted == DONT_CARE) | (wanted == have)).all(-1).any(-1)
    sizes = table(
        ("our corpus", ""),
        [
            ("records", len(records)),
            ("slots of a record, mean", f"{fmean(map(len, records)):.1f}"),
            ("goals", len(goals)),
            ("constraints of a goal, mean", f"{fmean(len(g.constraints) for g in goals):.1f}"),
            ("its requests besides ticket, mean", f"{fmean(len(g.requests) for g in goals):.1f}"),
            ("goals whose constraints a record meets", f"{can_be_met.float().mean().item():.1%}"),
        ],
        numbers=1,
    )
    shares = {
        slot: sum(slot in record for record in records) / len(records) for slot in domain.slots
    }
    shown = sorted(shares, key=lambda slot: -shares[slot])[:_SHOWN_SLOTS]
    filled = ", ".join(f"{slot} {shares[slot]:.2f}" for slot in shown if shares[slot] > 0)
    return f"{sizes}\n\nShare of its records that have a slot: {filled}; the rest less."


def _dialogues() -> str:
    """Returns the first dialogue that succeeds and the first that a misheard value spoils."""
    env = DialogueEnv(movie_domain(), batch_size=(_PLAYED,), seed=0)
    policy = scripted_policy(_POLICY, env)
    transcript = Transcript(env.simulator.domain)
    state = env.reset()
    texts = [
        [f"goal:  {transcript.goal(dialogue)}", *_lines(transcript.lines(dialogue))]
        for dialogue in env.dialogues
    ]
    for _ in range(env.max_agent_turns):
        ended = state["done"].squeeze(-1).tolist()
        state = env.step(policy(state))["next"]
        for text, dialogue, is_over in zip(texts, env.dialogues, ended, strict=True):
            if not is_over:
                text += _lines(transcript.lines(dialogue))
    played = list(zip(texts, state["success"].squeeze(-1).tolist(), strict=True))
    good = next(text for text, success in played if success)
    spoiled = next(
        text for text, success in played if not success and any("[heard" in line for line in text)
    )
    parts = (("A dialogue that succeeds:", good), ("One that a misheard value spoils:", spoiled))
    return "\n\n".join(f"{title}\n\n```text\n{chr(10).join(text)}\n```" for title, text in parts)


def _lines(lines: list[str]) -> list[str]:
    """Returns the lines with both speakers' names equally wide."""
    return [line.replace("user: ", "user:  ", 1) for line in lines]
