"""The first dialogues of an evaluation as people read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import nn

from bbq_torchrl.evaluation.rollouts import evaluation_rollouts
from bbq_torchrl.simulator import Transcript

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.envs import DialogueEnv
    from bbq_torchrl.trainers import Policy


def transcripts(env: DialogueEnv, policy: Policy, dialogues: int, *, seed: int = 0) -> list[str]:
    """Plays dialogues and returns them as texts, a line a turn.

    They are the dialogues that :func:`~bbq_torchrl.evaluation.rollouts.evaluate` counts first with
    the same environment and seed; of a run of several replicas, the first one's.

    Args:
        env: batch size [replicas, places].
        policy: writes an action.
        dialogues: how many.
        seed: of everything random in them.
    """
    transcript = Transcript(env.simulator.domain)
    recorder = _Recorder(env, policy)
    texts: list[str] = []
    for rollout in evaluation_rollouts(env, recorder, dialogues, seed=seed):
        states = [*recorder.states, env.dialogues[0].cpu()]
        recorder.states.clear()
        for place in range(rollout.batch_size[-2]):
            texts.append(_text(transcript, len(texts), [state[place] for state in states]))
    return texts


class _Recorder(nn.Module):
    """A policy that keeps what the first replica's dialogues are before each of its actions.

    A module, so that the policy within is put into evaluation mode as it would be by itself.
    """

    def __init__(self, env: DialogueEnv, policy: Policy) -> None:
        super().__init__()
        self.policy = policy
        self.states: list[TensorDictBase] = []
        # An environment is a module too; as an attribute it would become a part of the policy.
        self._dialogues = lambda: env.dialogues[0].cpu()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Notes the dialogues, then acts."""
        self.states.append(self._dialogues())
        return self.policy(tensordict)


def _text(transcript: Transcript, number: int, states: list[TensorDictBase]) -> str:
    """Returns one dialogue: its goal, its turns, how it ended."""
    lines = [f"dialogue {number + 1}: {transcript.goal(states[0])}"]
    for state in states:
        lines += [f"  {line}" for line in transcript.lines(state)]
        if bool(state["done"]):
            lines.append("  success" if bool(state["success"]) else "  failure")
            break
    return "\n".join(lines) + "\n"
