"""Dialogues to read, played anew."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.simulator import Transcript

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["dialogues_blocks"]

_PLAYED = 64
_POLICY = "careful_essential"


def dialogues_blocks() -> dict[str, Callable[[], str]]:
    """Returns the block of dialogues to read."""
    return {"dialogues": _dialogues}


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
