"""The first dialogues of an evaluation as people read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.play import evaluate
from bbq_torchrl.simulator import Transcript

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.envs import DialogueEnv
    from bbq_torchrl.trainers import Policy

__all__ = ["transcripts"]


def transcripts(env: DialogueEnv, policy: Policy, dialogues: int, *, seed: int = 0) -> list[str]:
    """Plays one batch and returns its first dialogues, one text each, a line a turn.

    They are the dialogues that :func:`~bbq_torchrl.evaluation.play.evaluate` plays first with the
    same seed; of a run of several replicas, the first one's.

    Args:
        env: batch size [replicas, places]; at most so many dialogues are returned.
        policy: writes an action.
        dialogues: how many.
        seed: of everything random in them.
    """
    states: list[TensorDictBase] = []

    def recording(tensordict: TensorDictBase) -> TensorDictBase:
        states.append(env.dialogues[0, :dialogues].cpu())
        return policy(tensordict)

    evaluate(env, recording, env.batch_size[-1], seed=seed)
    states.append(env.dialogues[0, :dialogues].cpu())
    transcript = Transcript(env.simulator.domain)
    return [
        _text(transcript, number, [state[number] for state in states])
        for number in range(len(states[0]))
    ]


def _text(transcript: Transcript, number: int, states: list[TensorDictBase]) -> str:
    """Returns one dialogue: its goal, its turns, how it ended."""
    lines = [f"dialogue {number + 1}: {transcript.goal(states[0])}"]
    for state in states:
        lines += [f"  {line}" for line in transcript.lines(state)]
        if bool(state["done"]):
            lines.append("  success" if bool(state["success"]) else "  failure")
            break
    return "\n".join(lines) + "\n"
