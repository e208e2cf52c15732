"""Dialogues without learning: evaluation at the end and during training, and transcripts."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import nn
from torchrl.envs.utils import ExplorationType

from bbq_torchrl.protocols import enter_round
from bbq_torchrl.simulator import Transcript
from bbq_torchrl.trainers import BestWeights, EpisodeStats, Policy, episode_stats, rollouts
from bbq_torchrl.utils.seeds import derive_seed

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from tensordict import TensorDictBase
    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import EnvBase

    from bbq_torchrl.envs import DialogueEnv
    from bbq_torchrl.trainers import Policy


def evaluate(
    env: EnvBase, policy: Policy, dialogues: int, *, seed: int = 0, max_steps: int = 1000
) -> EpisodeStats:
    """Plays exactly ``dialogues`` complete dialogues without exploration.

    They run in lockstep, so that long ones count as much as short ones.

    Args:
        env: batch size [*replicas, dialogues in parallel].
        policy: writes an action.
        dialogues: number of dialogues for each replica.
        seed: seed of policy and environment.
        max_steps: maximum number of turns; a longer dialogue is an error.

    Returns:
        Success (bool), reward (float64) and turns (int64), shape [*replicas, dialogues] each.
    """
    batches = evaluation_rollouts(env, policy, dialogues, seed=seed, max_steps=max_steps)
    stats = [episode_stats(batch) for batch in batches]
    return EpisodeStats(*(torch.cat(parts, -1) for parts in zip(*stats, strict=True)))


def evaluation_rollouts(
    env: EnvBase, policy: Policy, dialogues: int, *, seed: int = 0, max_steps: int = 1000
) -> Iterator[TensorDictBase]:
    """Yields the dialogues of :func:`evaluate` in batches.

    Arguments are those of :func:`evaluate`; rollouts are those of
    :func:`~bbq_torchrl.trainers.rollouts`.
    """
    torch.manual_seed(derive_seed(seed, "torch", "evaluate"))
    env.set_seed(derive_seed(seed, "env", "evaluate"))
    greedy = ExplorationType.DETERMINISTIC
    yield from rollouts(env, policy, dialogues, max_steps=max_steps, exploration=greedy)


_COLUMNS = ("eval_success_rate", "eval_reward", "eval_turns")


@dataclass(eq=False)
class RoundEvaluator:
    """Plays the reported policy, without exploration, at the end of every few rounds.

    A separate environment, and a separate seed for each round, leave the training unchanged and
    give two agents of one seed the same users. The domain has the round's slots.

    Args:
        env: batch size [replicas, dialogues in parallel]; not the training environment.
        policy: returns the policy, which shares the trained weights; called for each evaluation, so
            that weights are drawn anew.
        every: rounds between two evaluations: the first is at the end of round ``every - 1``.
        dialogues: dialogues of an evaluation, for each replica.
        seed: the run's seed.
        max_steps: maximum number of turns of a dialogue.
        changes: the rounds in which the environment changes.

    Attributes:
        best: each replica's weights at its best evaluation. An evaluation from before a change
            counts only until the next evaluation.
    """

    env: EnvBase
    policy: Callable[[], TensorDictModuleBase]
    _: KW_ONLY
    every: int
    dialogues: int
    seed: int
    max_steps: int = 1000
    changes: Collection[int] = ()
    best: BestWeights = field(init=False)

    def __post_init__(self) -> None:
        self.best = BestWeights(self.policy(), self.env.batch_size[0])

    def __call__(self, round_number: int) -> dict[str, float | Tensor]:
        """Returns mean statistics, [replicas] each; NaN in a round without an evaluation."""
        if (round_number + 1) % self.every:
            return dict.fromkeys(_COLUMNS, math.nan)
        enter_round(self.env, round_number)
        seed = derive_seed(self.seed, "evaluate while training", round_number)
        stats = evaluate(
            self.env, self.policy(), self.dialogues, seed=seed, max_steps=self.max_steps
        )
        means = [entry.double().mean(-1) for entry in stats]
        since = max((change for change in self.changes if change <= round_number), default=0)
        self.best.update(round_number, means[0], since=since)
        return dict(zip(_COLUMNS, means, strict=True))


def transcripts(env: DialogueEnv, policy: Policy, dialogues: int, *, seed: int = 0) -> list[str]:
    """Plays dialogues and returns them as texts, a line for each turn.

    They are the first dialogues of :func:`evaluate` with the same environment and seed, of the
    first replica.

    Args:
        env: batch size [replicas, dialogues in parallel].
        policy: writes an action.
        dialogues: number of dialogues.
        seed: seed of policy and environment.
    """
    transcript = Transcript(env.simulator.domain)
    states: list[TensorDictBase] = []
    texts: list[str] = []

    def recorded(tensordict: TensorDictBase) -> TensorDictBase:
        states.append(env.dialogues[0].cpu())
        return policy(tensordict)

    if isinstance(policy, nn.Module):
        policy.eval()
    for rollout in evaluation_rollouts(env, recorded, dialogues, seed=seed):
        states.append(env.dialogues[0].cpu())
        for place in range(rollout.batch_size[-2]):
            texts.append(_text(transcript, len(texts), [state[place] for state in states]))
        states.clear()
    return texts


def _text(transcript: Transcript, number: int, states: list[TensorDictBase]) -> str:
    """Returns the text of a dialogue: goal, turns and outcome."""
    lines = [f"dialogue {number + 1}: {transcript.goal(states[0])}"]
    for state in states:
        lines += [f"  {line}" for line in transcript.lines(state)]
        if bool(state["done"]):
            lines.append("  success" if bool(state["success"]) else "  failure")
            break
    return "\n".join(lines) + "\n"
