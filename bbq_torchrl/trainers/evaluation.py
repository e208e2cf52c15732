"""Dialogues without learning: evaluation at the end and during training, and the best weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType

from bbq_torchrl.protocols import enter_round
from bbq_torchrl.trainers.collect import EpisodeStats, Policy, episode_stats, rollouts
from bbq_torchrl.utils.seeds import derive_seed


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


class BestWeights:
    """Stores a copy of a policy's weights for each replica at its best evaluation.

    Checkpoints include it (``state_dict``), so a resumed training run knows the best of earlier
    rounds.

    Args:
        policy: a policy with parameters [replicas, *] and constant buffers.
        replicas: the number of replicas.

    Attributes:
        round: the round of each replica's best evaluation, int64 [replicas]; -1 before the first.
        success_rate: the success rate in that round, float64 [replicas].

    Examples:
        >>> import torch
        >>> policy = torch.nn.Module()
        >>> policy.weight = torch.nn.Parameter(torch.tensor([[1.0], [1.0]]))
        >>> best = BestWeights(policy, replicas=2)
        >>> best.update(0, torch.tensor([0.3, 0.5]))
        >>> _ = torch.nn.init.constant_(policy.weight, 2.0)
        >>> best.update(1, torch.tensor([0.4, 0.2]))
        >>> best.put_back()
        >>> policy.weight.tolist(), best.round.tolist()
        ([[2.0], [1.0]], [1, 0])
    """

    def __init__(self, policy: nn.Module, replicas: int) -> None:
        self.round = torch.full((replicas,), -1)
        self.success_rate = torch.zeros(replicas, dtype=torch.float64)
        self._policy = policy
        self._weights: dict[str, Tensor] = _weights(policy)

    def update(self, round_number: int, success_rate: Tensor, *, since: int = 0) -> None:
        """Copies the weights of replicas with a new best success rate.

        Args:
            round_number: the policy's round.
            success_rate: the success rate of each replica, [replicas].
            since: the first round that counts; an earlier best is replaced.
        """
        rate = success_rate.double().cpu()
        better = (rate > self.success_rate) | (self.round < since)
        self.round = torch.where(better, round_number, self.round)
        self.success_rate = torch.where(better, rate, self.success_rate)
        for name, now in _weights(self._policy).items():
            best = self._weights[name]
            best[better.to(best.device)] = now[better.to(now.device)]

    def put_back(self) -> None:
        """Loads the best weights into the policy.

        Raises:
            ValueError: before the first evaluation.
        """
        if bool((self.round < 0).any()):
            raise ValueError("there are no best weights before the first evaluation while training")
        self._policy.load_state_dict(self._weights, strict=False)

    def state_dict(self) -> dict[str, Any]:
        """Returns rounds, success rates and weights."""
        return {
            "round": self.round,
            "success_rate": self.success_rate,
            "weights": dict(self._weights),
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores the state from :meth:`state_dict`."""
        self.round = state_dict["round"].clone()
        self.success_rate = state_dict["success_rate"].clone()
        for name, best in self._weights.items():
            best.copy_(state_dict["weights"][name])


def _weights(policy: nn.Module) -> dict[str, Tensor]:
    """Returns copies of a policy's parameters by name."""
    return {name: weight.detach().clone() for name, weight in policy.named_parameters()}


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
