"""Collection of complete dialogues, played in parallel, and replay buffer spiking."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import fmean
from typing import NamedTuple

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers.checkpoint import TrainingError

Policy = Callable[[TensorDictBase], TensorDictBase]


class EpisodeStats(NamedTuple):
    """Statistics of dialogues, each of shape [*batch].

    Attributes:
        success: whether the dialogue succeeded (bool).
        reward: the sum of the rewards (float64).
        turns: the number of agent turns (int64).
    """

    success: Tensor
    reward: Tensor
    turns: Tensor


@torch.no_grad()
def rollout(
    env: EnvBase,
    policy: Policy,
    *,
    max_steps: int = 1000,
    exploration: ExplorationType = ExplorationType.RANDOM,
) -> TensorDictBase:
    """Plays one complete dialogue in each batch element of the environment.

    Returns the rollout, batch size [*batch, turns], with the entry ``valid`` [*batch, turns], False
    for the turns after a dialogue's end, which wait for the last dialogue. The policy reads
    ``is_init`` [*batch, 1], True in the first turn (as from ``InitTracker``). Every dialogue is
    played to its end, so the rollout is not biased towards short ones. The policy plays in
    evaluation mode (no dropout); its mode is restored afterwards.

    Args:
        env: an environment whose last batch dimension is the dialogues.
        policy: a policy that writes an action.
        max_steps: the maximum number of turns of a dialogue. Defaults to 1000.
        exploration: the ``exploration_type()`` of the policy. Defaults to
            ``ExplorationType.RANDOM``.

    Raises:
        RuntimeError: if a dialogue has not ended after ``max_steps`` turns.
    """
    was_training = isinstance(policy, nn.Module) and policy.training
    if isinstance(policy, nn.Module):
        policy.eval()
    try:
        with set_exploration_type(exploration):
            played = env.rollout(
                max_steps,
                _marking_the_first_turn(policy),
                break_when_any_done=False,
                break_when_all_done=True,
                trust_policy=True,
            )
    finally:
        if isinstance(policy, nn.Module):
            policy.train(was_training)
    done = played["next", "done"].squeeze(-1)
    if not bool(done[..., -1].all()):
        raise RuntimeError(f"every dialogue must end within max_steps = {max_steps} turns")
    return played.set("valid", (done.cumsum(-1) - done.long()) == 0)


def _marking_the_first_turn(policy: Policy) -> Policy:
    """Returns a policy that marks the first turn of a rollout; cheaper than a transform."""
    is_first = True

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        nonlocal is_first
        shape = (*tensordict.batch_size, 1)
        marks = torch.full(shape, is_first, dtype=torch.bool, device=tensordict.device)
        is_first = False
        return policy(tensordict.set("is_init", marks))

    return act


def rollouts(
    env: EnvBase,
    policy: Policy,
    dialogues: int,
    *,
    max_steps: int = 1000,
    exploration: ExplorationType = ExplorationType.RANDOM,
) -> Iterator[TensorDictBase]:
    """Yields rollouts of :func:`rollout` until every replica has played its dialogues.

    Args:
        env: an environment of batch size [*replicas, parallel].
        policy: a policy that writes an action.
        dialogues: the number of dialogues of each replica. Surplus dialogues of the last rollout
            are cut off by index, whatever their lengths.
        max_steps: the maximum number of turns of a dialogue. Defaults to 1000.
        exploration: the ``exploration_type()`` of the policy.
    """
    parallel = env.batch_size[-1]
    for begun in range(0, dialogues, parallel):
        played = rollout(env, policy, max_steps=max_steps, exploration=exploration)
        yield played[..., : min(parallel, dialogues - begun), :]


def episode_stats(rollout: TensorDictBase) -> EpisodeStats:
    """Returns the statistics of the dialogues in a rollout of :func:`rollout`, [*batch] each.

    Args:
        rollout: batch size [*batch, turns], with ``valid`` and ``("next", "success")``, whether
            the dialogue has succeeded so far.

    Raises:
        TrainingError: if the rollout has no ``("next", "success")``.
    """
    valid = rollout["valid"]
    after = rollout["next"]
    success = after.get("success", None)
    if success is None:
        raise TrainingError(
            "the environment must write ('next', 'success'), whether the episode has succeeded"
        )
    success = success.squeeze(-1) & valid
    reward = after["reward"].squeeze(-1).double() * valid
    return EpisodeStats(success.any(-1), reward.sum(-1), valid.sum(-1))


def rows_per_replica(rollout: TensorDictBase, keys: tuple[NestedKey, ...]) -> list[TensorDictBase]:
    """Returns each replica's valid transitions in the order of dialogues, batch sizes [rows].

    Args:
        rollout: batch size [replicas, dialogues, turns], with ``valid``.
        keys: the entries to keep.
    """
    valid = rollout["valid"]
    counts = valid.sum((-2, -1)).tolist()
    return list(rollout.select(*keys)[valid].split(counts))


def collect_dialogues(
    replay: ReplicaReplay,
    env: EnvBase,
    policy: Policy,
    dialogues: int,
    *,
    max_steps: int,
) -> dict[str, Tensor]:
    """Plays and stores dialogues, and returns their mean statistics by name, [replicas] each.

    These include the metrics of the replay's transform for these transitions.

    Args:
        replay: the buffers.
        env: an environment of batch size [replicas, parallel].
        policy: a policy that writes an action.
        dialogues: the number of dialogues of each replica.
        max_steps: the maximum number of turns of a dialogue.
    """
    totals: Tensor | None = None
    for played in rollouts(env, policy, dialogues, max_steps=max_steps):
        result = episode_stats(played)
        sums = torch.stack([entry.double().sum(-1) for entry in result])
        totals = sums if totals is None else totals + sums
        played["succeeded"] = result.success.unsqueeze(-1).expand_as(played["valid"])
        replay.extend(rows_per_replica(played, (*replay.keys, "succeeded")))
    assert totals is not None
    means = dict(zip(("success_rate", "reward", "turns"), totals / dialogues, strict=True))
    return {**means, **replay.pop_metrics()}


_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Spike:
    """Fills the buffers before the first round with dialogues of another policy.

    Args:
        policy: a policy that writes an action.
        dialogues: the number of its dialogues in each replica's buffer.
        protect: whether their transitions are never evicted. Defaults to True.
    """

    policy: Policy
    dialogues: int
    protect: bool = True

    def fill(self, replay: ReplicaReplay, env: EnvBase, *, max_steps: int) -> None:
        """Plays and stores the dialogues of each replica, and protects them if so set.

        The log has their success rate, and a warning for each replica without a success.

        Args:
            replay: the buffers.
            env: an environment of batch size [replicas, parallel].
            max_steps: the maximum number of turns of a dialogue.

        Raises:
            TrainingError: if the transitions would fill a replica's capacity.
        """
        played = collect_dialogues(replay, env, self.policy, self.dialogues, max_steps=max_steps)
        if max(replay.lengths) >= replay.capacity:
            raise TrainingError(
                f"the transitions of {self.dialogues} spiked dialogues must be fewer than the "
                f"capacity {replay.capacity}: raise the capacity or spike with fewer dialogues"
            )
        if self.protect:
            replay.protect()
        rates, count = played["success_rate"].tolist(), self.dialogues
        _LOG.info("%.1f %% of the %d spiked dialogues succeed", 100 * fmean(rates), count)
        without = [str(replica) for replica, rate in enumerate(rates) if not rate]
        if without:
            _LOG.warning("no spiked dialogue of replica %s succeeds", ", ".join(without))
